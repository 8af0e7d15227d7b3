//! The simulator.
//!
//! Each tick begins and ends here. Observers receive the truth, which no other node has:
//!
//! ```text
//! robot 0..M-1 --drive--> SIM --world--> robot 0..M-1
//!                          `--truth--> observers
//! ```
//!
//! It keeps the team's clock: `world(k)` has what each robot's localiser says and what its sensor can measure,
//! and the next tick starts when all robots have sent their drives (lock step) or by the clock (real time).
//! Robots receive measurements only; the target's true state goes to observers.
//!
//! | module | what |
//! |---|---|
//! | [`world`] | the trait of both kinds of world |
//! | [`simulation`] | the target moves by its model, the robots by their drives |
//! | `errors` | errors of the robots' poses, and biases of their ranges |
//! | [`playback`] | recorded ranges in place of a simulation |
//! | [`machine`] | the protocol: messages in, actions out |

mod errors;
pub mod machine;
pub mod playback;
pub mod simulation;
pub mod world;

use std::sync::Arc;

use rangehound_shared::recording::Recording;
use rangehound_shared::scenario::{RecordedRanges, Scenario, Source};
use rangehound_shared::with_state_dim;

use playback::Playback;
use simulation::{Simulation, TargetMotion};
pub use world::World;

/// The world of a scenario at tick 0. A recording that this process has not read comes from `read`.
///
/// # Errors
/// Those of `read`.
pub fn world_of<E>(
    scenario: &Scenario,
    read: impl FnOnce(&RecordedRanges) -> Result<Arc<Recording>, E>,
) -> Result<Box<dyn World>, E> {
    Ok(match &scenario.source {
        Source::Simulated { target_start } => {
            with_state_dim!(target_start.len(), N => Box::new(Simulation::<N>::new(scenario, target_start)))
        }
        Source::Recorded(ranges) => {
            let recording = ranges.already_read().map_or_else(|| read(ranges), Ok)?;
            let errors = scenario.robots.iter().map(|sensor| sensor.nuisances).collect();
            Box::new(Playback::new(recording, ranges.target_height_m).with_errors(errors, ranges.start_s))
        }
    })
}

/// The world of a scenario whose target moves by another motion than its model's; `None` if its target is recorded.
#[must_use]
pub fn world_moved_by(scenario: &Scenario, motion: Box<dyn TargetMotion>) -> Option<Box<dyn World>> {
    let Source::Simulated { target_start } = &scenario.source else { return None };
    Some(with_state_dim!(target_start.len(), N => {
        Box::new(Simulation::<N>::new(scenario, target_start).moved_by(motion))
    }))
}
