//! The simulator.
//!
//! Its place in the loop is where a tick begins and ends; observers hear what only it knows:
//!
//! ```text
//! robot 0..M-1 --drive--> SIM --world--> robot 0..M-1
//!                          `--truth--> observers
//! ```
//!
//! It keeps the team's clock: `world(k)` says where each robot is and what its sensor would measure,
//! and the next tick starts when the robots have said what they drive (lock step) or when it is time
//! (real time). What it shows of the target are ranges only; the true state goes to observers.
//!
//! | module | what |
//! |---|---|
//! | [`world`] | what a tick shows: the trait behind both kinds |
//! | [`simulation`] | a target that moves by its model, robots that move as they drive |
//! | [`playback`] | recorded ranges in place of a simulation |
//! | [`machine`] | the protocol: what comes in, what to do out |

pub mod machine;
pub mod playback;
pub mod simulation;
pub mod world;

use std::sync::Arc;

use rangehound_shared::recording::Recording;
use rangehound_shared::scenario::{RecordedRanges, Scenario, Source};
use rangehound_shared::with_state_dim;

use playback::Playback;
use simulation::Simulation;
pub use world::World;

/// The world of a scenario at tick 0. A recording that this process has not read itself is had from `read`.
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
            Box::new(Playback::new(recording, ranges.target_height_m))
        }
    })
}
