//! A run tick by tick: all that travelled on its topics, from what the nodes put down. Report, tables, curves, the page and
//! recordings are made from here.

use nalgebra::Vector2;
use rangehound_fusion::LATE_TICKS_MAX;
use rangehound_node::logs;
use rangehound_node::rendezvous::RunDescription;
use rangehound_node::tick_log::{TickLogError, TickLogReader};
use rangehound_shared::message::Estimate;
use rangehound_shared::record::{FusionRecord, WorldRecord};

/// The newest ticks, whose records fusion may still amend, or put down anew when it comes back from a kill.
pub const UNSETTLED_TICKS: usize = LATE_TICKS_MAX + 1;

/// One tick of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// The tick.
    pub tick: u64,
    /// What fusion heard, knew and commanded.
    pub fusion: FusionRecord,
    /// Where all were, and what the robots did.
    pub world: WorldRecord,
}

/// One tick as far as it was put down: a node that was killed may lack one that the other has.
#[derive(Debug, Clone, Copy)]
pub struct PutDown<'a> {
    /// The tick.
    pub tick: u64,
    /// What fusion heard, knew and commanded.
    pub fusion: Option<&'a FusionRecord>,
    /// Where all were, and what the robots did.
    pub world: Option<&'a WorldRecord>,
}

impl PutDown<'_> {
    /// Where the target truly was, if the simulator knew, m.
    #[must_use]
    pub fn target_m(&self) -> Option<Vector2<f64>> {
        let truth = &self.world?.truth;
        Some(Vector2::new(*truth.first()?, *truth.get(1)?))
    }
}

/// The ticks of a run folder, while the run goes on or after it. Nobody is asked or woken: the nodes' own logs are read.
#[derive(Debug)]
pub struct Frames {
    fusion: TickLogReader<FusionRecord>,
    world: TickLogReader<WorldRecord>,
}

impl Frames {
    /// Opens the logs of a run.
    ///
    /// # Errors
    /// If one is not there yet, or is another run's.
    pub fn open(description: &RunDescription) -> Result<Self, TickLogError> {
        Ok(Self { fusion: logs::read_estimates(description)?, world: logs::read_worlds(description)? })
    }

    /// The newest tick that both logs have room for; `None` before the first.
    ///
    /// # Errors
    /// If the system does not tell.
    pub fn newest_tick(&self) -> Result<Option<u64>, TickLogError> {
        Ok(self.fusion.newest_tick()?.min(self.world.newest_tick()?))
    }

    /// The newest tick that fusion's log has room for, whether or not the simulator's has.
    ///
    /// # Errors
    /// If the system does not tell.
    pub fn newest_estimate(&self) -> Result<Option<u64>, TickLogError> {
        self.fusion.newest_tick()
    }

    /// What fusion has put down of a tick, whether or not the simulator has.
    ///
    /// # Errors
    /// If its log cannot be read.
    pub fn estimate(&mut self, tick: u64) -> Result<Option<Estimate>, TickLogError> {
        Ok(self.fusion.at(tick)?.map(|record| record.estimate))
    }

    /// The frame of a tick; `None` if one of the nodes has not put it down.
    ///
    /// # Errors
    /// If a log cannot be read.
    pub fn at(&mut self, tick: u64) -> Result<Option<Frame>, TickLogError> {
        let (Some(fusion), Some(world)) = (self.fusion.at(tick)?, self.world.at(tick)?) else { return Ok(None) };
        Ok(Some(Frame { tick, fusion: fusion.clone(), world: world.clone() }))
    }

    /// Looks at each tick that either node has put down, in order.
    ///
    /// # Errors
    /// If a log cannot be read, and those of `look`.
    pub fn for_each(self, mut look: impl FnMut(PutDown<'_>) -> anyhow::Result<()>) -> anyhow::Result<()> {
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
            look(PutDown { tick: next, fusion: known_now, world: shown_now })?;
            if known_now.is_some() {
                known = fusion.next().transpose()?;
            }
            if shown_now.is_some() {
                shown = world.next().transpose()?;
            }
        }
    }
}
