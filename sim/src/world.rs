//! What the team lives in, pure: no I/O, no clock.

use rangehound_shared::message::{Drive, WorldEntry};
use rangehound_shared::recording::RecordingError;
use rangehound_shared::scenario::{Scenario, Source};
use rangehound_shared::with_state_dim;

use crate::playback::Playback;
use crate::simulation::Simulation;

/// The present tick and the way to the next.
pub trait World: std::fmt::Debug + Send {
    /// Time of the present tick, s.
    fn time_s(&self) -> f64;

    /// Each robot's place and what its sensor would measure.
    fn entries(&self) -> &[WorldEntry];

    /// The target's true state; empty if nobody knows it.
    fn truth(&self) -> &[f64];

    /// Goes to the next tick. `drives` has an entry for each robot; one without stands still.
    fn advance(&mut self, drives: &[Option<Drive>]);
}

/// The world of a scenario at tick 0.
///
/// # Errors
/// [`RecordingError`] if the recording that the scenario names cannot be read (again).
pub fn for_scenario(scenario: &Scenario) -> Result<Box<dyn World>, RecordingError> {
    Ok(match &scenario.source {
        Source::Simulated { target_start } => {
            with_state_dim!(target_start.len(), N => Box::new(Simulation::<N>::new(scenario, target_start)))
        }
        Source::Recorded { ranges } => Box::new(Playback::read(ranges)?),
    })
}
