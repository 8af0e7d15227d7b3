//! A run tick by tick: all that travelled on its topics, from what the nodes put down.

use rangehound_fusion::LATE_TICKS_MAX;
use rangehound_node::logs;
use rangehound_node::rendezvous::RunDescription;
use rangehound_node::tick_log::{TickLogError, TickLogReader};
use rangehound_shared::message::Estimate;
use rangehound_shared::record::{EstimateRecord, Exchange, WorldRecord};
use rangehound_shared::scenario::Scenario;

/// The newest ticks, whose records fusion may still amend, or put down anew when it comes back from a kill.
pub const UNSETTLED_TICKS: usize = LATE_TICKS_MAX + 1;

/// One tick of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// The tick.
    pub tick: u64,
    /// What fusion knew after it.
    pub estimate: EstimateRecord,
    /// What fusion heard of each robot, and told it.
    pub exchanges: Vec<Exchange>,
    /// Where all were, and what the robots did.
    pub world: WorldRecord,
}

/// The frames of a run folder, in order, while the run goes on or after it. Nobody is asked or woken: the nodes'
/// own logs are read.
#[derive(Debug)]
pub struct Frames {
    scenario: Scenario,
    estimates: TickLogReader,
    worlds: TickLogReader,
}

impl Frames {
    /// Opens the logs of a run.
    ///
    /// # Errors
    /// If one is not there yet, or is another run's.
    pub fn open(description: &RunDescription) -> Result<Self, TickLogError> {
        Ok(Self {
            scenario: description.scenario.clone(),
            estimates: logs::read_estimates(description)?,
            worlds: logs::read_worlds(description)?,
        })
    }

    /// The newest tick that both logs have room for; `None` before the first.
    ///
    /// # Errors
    /// If the system does not tell.
    pub fn newest_tick(&self) -> Result<Option<u64>, TickLogError> {
        Ok(self.estimates.newest_tick()?.min(self.worlds.newest_tick()?))
    }

    /// The newest tick that fusion's log has room for, whether or not the simulator's has.
    ///
    /// # Errors
    /// If the system does not tell.
    pub fn newest_estimate(&self) -> Result<Option<u64>, TickLogError> {
        self.estimates.newest_tick()
    }

    /// What fusion has put down of a tick, whether or not the simulator has.
    ///
    /// # Errors
    /// If its log cannot be read.
    pub fn estimate(&mut self, tick: u64) -> Result<Option<Estimate>, TickLogError> {
        let state_dim = self.scenario.motion.state_dim();
        Ok(self.estimates.at(tick)?.map(|words| EstimateRecord::from_words(words, state_dim).estimate))
    }

    /// The frame of a tick; `None` if one of the nodes has not put it down.
    ///
    /// # Errors
    /// If a log cannot be read.
    pub fn at(&mut self, tick: u64) -> Result<Option<Frame>, TickLogError> {
        let Self { scenario, estimates, worlds } = self;
        let state_dim = scenario.motion.state_dim();
        let Some(words) = estimates.at(tick)? else { return Ok(None) };
        let estimate = EstimateRecord::from_words(words, state_dim);
        let exchanges = EstimateRecord::exchanges(words, state_dim).collect();
        let Some(words) = worlds.at(tick)? else { return Ok(None) };
        let world = WorldRecord::from_words(words, scenario);
        Ok(Some(Frame { tick, estimate, exchanges, world }))
    }
}
