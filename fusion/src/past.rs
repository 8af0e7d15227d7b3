//! The last few ticks, kept so that a range that comes late can still be fused at its own time.

use std::collections::VecDeque;

use rangehound_shared::measurement::Measurement;
use rangehound_shared::message::Command;
use rangehound_shared::record::Judged;

use crate::trust::Trust;

/// Ticks that are kept: a range that is later is fused no more. Half a second of the paper's ticks; a process that
/// was not run for longer has missed more than its range.
pub const LATE_TICKS_MAX: usize = 5;

/// A tick that was processed, with all that it takes to do so again.
#[derive(Debug)]
pub(crate) struct PastTick {
    pub(crate) tick: u64,
    pub(crate) dt_s: f64,
    /// The tracker before the tick, as it saved itself.
    pub(crate) tracker: Vec<u8>,
    /// The trust in the robots before the tick.
    pub(crate) trust: Trust,
    pub(crate) reports: Vec<Option<Measurement>>,
    /// What became of the reports' ranges.
    pub(crate) judged: Vec<Option<Judged>>,
    /// The commands published after it.
    pub(crate) commands: Vec<Command>,
}

/// The last [`LATE_TICKS_MAX`] ticks, oldest first. Allocates nothing once it is full.
#[derive(Debug, Default)]
pub(crate) struct Past(VecDeque<PastTick>);

impl Past {
    /// A place for a tick after all others: the oldest one's, once there are enough.
    pub(crate) fn place(&mut self, robots: usize, trust: &Trust) -> PastTick {
        let full = self.0.len() == LATE_TICKS_MAX;
        full.then(|| self.0.pop_front()).flatten().unwrap_or_else(|| PastTick {
            tick: 0,
            dt_s: 0.0,
            tracker: Vec::new(),
            trust: trust.clone(),
            reports: vec![None; robots],
            judged: vec![None; robots],
            commands: vec![Command::default(); robots],
        })
    }

    /// Puts a tick after all others.
    pub(crate) fn push(&mut self, tick: PastTick) {
        self.0.push_back(tick);
    }

    /// The newest tick.
    pub(crate) fn newest(&mut self) -> Option<&mut PastTick> {
        self.0.back_mut()
    }

    /// A tick, if it is kept.
    pub(crate) fn at(&self, tick: u64) -> Option<&PastTick> {
        self.0.iter().find(|past| past.tick == tick)
    }

    /// A tick and all after it, none if it is not kept.
    pub(crate) fn since(&mut self, tick: u64) -> impl Iterator<Item = &mut PastTick> {
        let is_kept = self.at(tick).is_some();
        self.0.iter_mut().filter(move |past| is_kept && past.tick >= tick)
    }

    /// Forgets all.
    pub(crate) fn clear(&mut self) {
        self.0.clear();
    }
}
