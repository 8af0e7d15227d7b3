//! `chaos`: injects faults into its own runs at random times, and checks the promised invariants.
//!
//! The seed of the faults determines the faults and their targets. The state of the run at a fault also depends on the
//! kernel's scheduling, as in practice.

mod campaign;
pub mod faults;
mod live;
mod outcome;
mod run;
mod ticks;

use rangehound_node::rendezvous::living_runs;
use rangehound_node::system::signal::Termination;
use rangehound_shared::scenario::{Clock, Scenario};

use crate::failure::{self, Failure};
use crate::files::layout::Kind;
use crate::files::out_folder;
use crate::run::experiment::Experiment;
use crate::terminal;
use campaign::Campaign;
use faults::{Asked, Faults};
use outcome::Outcome;

/// `rangehound chaos`: injects faults into runs of an experiment.
///
/// # Errors
/// [`Failure`], also for a broken promise.
pub fn chaos(experiment: &Experiment, asked: &Asked, json: bool) -> Result<(), Failure> {
    let Experiment { name, description, .. } = experiment;
    let faults = Faults::new(asked, description.scenario.robots.len());
    if living_runs().contains(name) {
        return Err(Failure::input(format!("run {name} (--name) is already running: choose another name")));
    }
    let termination = Termination::listen()?;
    let claim = out_folder::claim(&description.out_dir, Kind::Chaos, &experiment.inputs())?;
    claim.clear()?;
    let mut campaign = Campaign::new(experiment, faults, asked, &termination)?;
    let mut outcome = Outcome::new(&description.scenario, asked);
    while campaign.goes_on() {
        outcome.add(campaign.round()?);
        // Written after each run, so that its result is not lost.
        outcome.injected = campaign.injected().to_vec();
        outcome.judge();
        outcome.write(&description.out_dir)?;
        if !outcome.broken.is_empty() || outcome.is_interrupted() {
            break;
        }
    }
    if json {
        failure::print_json(&outcome)?;
    } else {
        let folder = terminal::field("run folder", description.out_dir.display());
        failure::print(format!("{outcome}\n{folder}\n"))?;
    }
    match outcome.broken.as_slice() {
        [] if outcome.is_interrupted() => Err(Failure::Running(anyhow::anyhow!(
            "interrupted after {} of {} faults; no promise was broken until then",
            outcome.faults_done(),
            asked.faults
        ))),
        [] => Ok(()),
        broken => Err(Failure::Running(anyhow::anyhow!("{}", broken.join("; ")))),
    }
}

/// Ticks of one run: seconds in lock step; in real time, until all faults are injected and recovered from.
#[must_use]
pub fn enough_ticks(scenario: &Scenario, asked: &Asked) -> u64 {
    match scenario.clock {
        Clock::Lockstep => (400_000 / scenario.robots.len().max(1) as u64).clamp(4_000, 100_000),
        Clock::Realtime => {
            ((asked.faults as f64 / asked.rate_per_s + 3.0) / scenario.dt_s).clamp(50.0, 100_000.0) as u64
        }
    }
}
