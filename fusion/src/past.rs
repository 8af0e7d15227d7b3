//! The last few ticks, stored so that a late range can still be fused at its own time.

use std::collections::VecDeque;

use rangehound_shared::measurement::Measurement;
use rangehound_shared::message::Command;
use rangehound_shared::record::GateResults;

use crate::trust::Trust;

/// Number of stored ticks: a range that is later than this is not fused. At the paper's tick length they cover half a
/// second; a process that was suspended for longer has missed more than one range.
pub const LATE_TICKS_MAX: usize = 5;

/// A processed tick, with all that is needed to process it again.
#[derive(Debug)]
pub(crate) struct PastTick {
    pub(crate) tick: u64,
    pub(crate) dt_s: f64,
    /// The tracker's saved state before the tick.
    pub(crate) tracker: Vec<u8>,
    /// The trust before the tick.
    pub(crate) trust: Trust,
    pub(crate) reports: Vec<Option<Measurement>>,
    /// How the reports were used.
    pub(crate) judged: Vec<GateResults>,
    /// The commands published after it.
    pub(crate) commands: Vec<Command>,
}

/// The last [`LATE_TICKS_MAX`] ticks, oldest first. Allocates nothing once it is full.
#[derive(Debug, Default)]
pub(crate) struct TickHistory(VecDeque<PastTick>);

impl TickHistory {
    /// Memory for the next tick: that of the oldest tick once [`LATE_TICKS_MAX`] are stored.
    pub(crate) fn place(&mut self, robots: usize, trust: &Trust) -> PastTick {
        let full = self.0.len() == LATE_TICKS_MAX;
        full.then(|| self.0.pop_front()).flatten().unwrap_or_else(|| PastTick {
            tick: 0,
            dt_s: 0.0,
            tracker: Vec::new(),
            trust: trust.clone(),
            reports: vec![None; robots],
            judged: vec![GateResults::default(); robots],
            commands: vec![Command::default(); robots],
        })
    }

    /// Appends a tick.
    pub(crate) fn push(&mut self, tick: PastTick) {
        self.0.push_back(tick);
    }

    /// The newest tick.
    pub(crate) fn newest(&mut self) -> Option<&mut PastTick> {
        self.0.back_mut()
    }

    /// A tick, if it is stored.
    pub(crate) fn at(&self, tick: u64) -> Option<&PastTick> {
        self.0.iter().find(|past| past.tick == tick)
    }

    /// A tick and all later ones; none if the tick is not stored.
    pub(crate) fn since(&mut self, tick: u64) -> impl Iterator<Item = &mut PastTick> {
        let is_kept = self.at(tick).is_some();
        self.0.iter_mut().filter(move |past| is_kept && past.tick >= tick)
    }

    /// Removes all ticks.
    pub(crate) fn clear(&mut self) {
        self.0.clear();
    }
}
