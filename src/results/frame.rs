//! A run tick by tick: all messages of its topics, read from the nodes' logs. Report, tables, curves, page and
//! recordings are made from these frames.

use nalgebra::Vector2;
use rangehound_fusion::LATE_TICKS_MAX;
use rangehound_node::logs;
use rangehound_node::rendezvous::RunDescription;
use rangehound_node::tick_log::{TickLogError, TickLogReader};
use rangehound_shared::message::Estimate;
use rangehound_shared::record::{FusionRecord, WorldRecord};

/// The newest ticks. Fusion may still change their records, or write them again after a kill.
pub const UNSETTLED_TICKS: usize = LATE_TICKS_MAX + 1;

/// One tick of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// The tick.
    pub tick: u64,
    /// Fusion's input, estimate and commands.
    pub fusion: FusionRecord,
    /// True positions, and the robots' actions.
    pub world: WorldRecord,
}

/// One logged tick; after a kill one node's record may be missing.
#[derive(Debug, Clone, Copy)]
pub struct LoggedTick<'a> {
    /// The tick.
    pub tick: u64,
    /// Fusion's input, estimate and commands.
    pub fusion: Option<&'a FusionRecord>,
    /// True positions, and the robots' actions.
    pub world: Option<&'a WorldRecord>,
}

impl LoggedTick<'_> {
    /// The target's true position, m, if the simulator knew it.
    #[must_use]
    pub fn target_m(&self) -> Option<Vector2<f64>> {
        let truth = &self.world?.truth;
        Some(Vector2::new(*truth.first()?, *truth.get(1)?))
    }
}

/// The ticks of a run folder, during the run or after it. Only the nodes' logs are read; no node is contacted.
#[derive(Debug)]
pub struct Frames {
    fusion: TickLogReader<FusionRecord>,
    world: TickLogReader<WorldRecord>,
}

impl Frames {
    /// Opens the logs of a run.
    ///
    /// # Errors
    /// If a log does not exist yet, or belongs to another run.
    pub fn open(description: &RunDescription) -> Result<Self, TickLogError> {
        Ok(Self { fusion: logs::read_estimates(description)?, world: logs::read_worlds(description)? })
    }

    /// The newest tick that both logs have room for; `None` before the first.
    ///
    /// # Errors
    /// If the length of a log cannot be read.
    pub fn newest_tick(&self) -> Result<Option<u64>, TickLogError> {
        Ok(self.fusion.newest_tick()?.min(self.world.newest_tick()?))
    }

    /// The newest tick that fusion's log has room for, whether or not the simulator's has.
    ///
    /// # Errors
    /// If the length of the log cannot be read.
    pub fn newest_estimate(&self) -> Result<Option<u64>, TickLogError> {
        self.fusion.newest_tick()
    }

    /// Fusion's record of a tick, even if the simulator has none yet.
    ///
    /// # Errors
    /// If its log cannot be read.
    pub fn estimate(&mut self, tick: u64) -> Result<Option<Estimate>, TickLogError> {
        Ok(self.fusion.at(tick)?.map(|record| record.estimate))
    }

    /// The part of a tick that is logged so far.
    ///
    /// # Errors
    /// If a log cannot be read.
    pub fn logged(&mut self, tick: u64) -> Result<LoggedTick<'_>, TickLogError> {
        Ok(LoggedTick { tick, fusion: self.fusion.at(tick)?, world: self.world.at(tick)? })
    }

    /// The frame of a tick; `None` if a node has not logged it.
    ///
    /// # Errors
    /// If a log cannot be read.
    pub fn at(&mut self, tick: u64) -> Result<Option<Frame>, TickLogError> {
        let (Some(fusion), Some(world)) = (self.fusion.at(tick)?, self.world.at(tick)?) else { return Ok(None) };
        Ok(Some(Frame { tick, fusion: fusion.clone(), world: world.clone() }))
    }

    /// Visits each tick that at least one node has logged, in order.
    ///
    /// # Errors
    /// If a log cannot be read; also the errors of `visit`.
    pub fn for_each(self, mut visit: impl FnMut(LoggedTick<'_>) -> anyhow::Result<()>) -> anyhow::Result<()> {
        let Self { mut fusion, mut world } = self;
        let (mut known, mut shown) = (fusion.next().transpose()?, world.next().transpose()?);
        loop {
            let next = match (known, shown) {
                (None, None) => return Ok(()),
                (Some((tick, _)), None) | (None, Some((tick, _))) => tick,
                (Some((known, _)), Some((shown, _))) => known.min(shown),
            };
            let known_now = known.filter(|(tick, _)| *tick == next).map(|(_, record)| record);
            let shown_now = shown.filter(|(tick, _)| *tick == next).map(|(_, record)| record);
            visit(LoggedTick { tick: next, fusion: known_now, world: shown_now })?;
            if known_now.is_some() {
                known = fusion.next().transpose()?;
            }
            if shown_now.is_some() {
                shown = world.next().transpose()?;
            }
        }
    }
}
