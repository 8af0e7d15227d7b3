//! `chaos`: hurts a run of its own at random times, and judges whether it kept its promises.
//!
//! Which faults come, and to whom, is a function of the seed of chaos alone; what they meet is up to the
//! kernel's scheduling, as in life.

mod campaign;
mod faults;
mod live;
mod outcome;
mod run;
mod ticks;

use rangehound_node::rendezvous::living_runs;
use rangehound_node::signal::Termination;
use rangehound_shared::scenario::{Clock, PatienceKey, Scenario, Source};

use crate::cli::{ChaosArgs, ClockArg, ExperimentArgs};
use crate::failure::{self, Failure};
use crate::files::layout::Kind;
use crate::files::out_folder;
use crate::run::experiment::{Experiment, Naming, Reserved, free_name};
use crate::terminal;
use campaign::Campaign;
use faults::Faults;
use outcome::Outcome;

/// `rangehound chaos`.
///
/// # Errors
/// [`Failure`], a broken promise among them.
pub fn chaos(args: &ChaosArgs) -> Result<(), Failure> {
    let (experiment, _reserved) = experiment(args)?;
    let Experiment { name, description, .. } = &experiment;
    let faults = Faults::new(args, description.scenario.robots.len())?;
    if living_runs().contains(name) {
        return Err(Failure::input(format!("--name: expected a free name, run {name} goes on")));
    }
    let termination = Termination::listen()?;
    let claim = out_folder::claim(&description.out_dir, Kind::Chaos, &experiment.inputs())?;
    claim.clear()?;
    let mut campaign = Campaign::new(&experiment, faults, args, &termination);
    let mut outcome = Outcome::new(&description.scenario, args);
    while campaign.goes_on() {
        outcome.add(campaign.round()?);
        // After each run, so that what it showed is not lost.
        outcome.injected = campaign.injected().to_vec();
        outcome.judge();
        outcome.write(&description.out_dir)?;
        if !outcome.broken.is_empty() {
            break;
        }
    }
    if args.json {
        failure::print_json(&outcome)?;
    } else {
        let folder = terminal::field("run folder", description.out_dir.display());
        failure::print(format!("{outcome}\n{folder}\n"))?;
    }
    match outcome.broken.as_slice() {
        [] => Ok(()),
        broken => Err(Failure::Running(anyhow::anyhow!("{}", broken.join("; ")))),
    }
}

/// The run to be hurt: in lock step it waits for everybody, so that its digest must not change.
fn experiment(args: &ChaosArgs) -> Result<(Experiment, Option<Reserved>), Failure> {
    let given = &args.experiment;
    let clock = given.clock.unwrap_or(ClockArg::Lockstep);
    let forever = PatienceKey::Word("forever".to_owned());
    if given.patience.as_ref().is_some_and(|patience| *patience != forever) {
        return Err(Failure::input("--patience: expected forever, as going on without a node changes the digest"));
    }
    let (name, reserved) = match &given.name {
        Some(name) => (name.clone(), None),
        None => free_name("chaos", given.out.is_some())?,
    };
    let wanted = |ticks| ExperimentArgs {
        scenario: given.scenario.clone(),
        robots: given.robots,
        ticks,
        seed: given.seed,
        clock: Some(clock),
        planner: given.planner.clone(),
        stand_off: given.stand_off,
        patience: Some(forever.clone()),
        name: Some(name.clone()),
        out: given.out.clone(),
    };
    let experiment = Experiment::from_run(&wanted(given.ticks), Naming::Exact)?;
    let scenario = &experiment.description.scenario;
    let experiment = match (given.ticks, &scenario.source) {
        (None, Source::Simulated { .. }) => {
            Experiment::from_run(&wanted(Some(enough_ticks(scenario, args))), Naming::Exact)?
        }
        _ => experiment,
    };
    Ok((experiment, reserved))
}

/// Ticks of one run: seconds in lock step, until the faults are in and got over in real time.
fn enough_ticks(scenario: &Scenario, args: &ChaosArgs) -> u64 {
    match scenario.clock {
        Clock::Lockstep => (400_000 / scenario.robots.len().max(1) as u64).clamp(4_000, 100_000),
        Clock::Realtime => ((args.faults as f64 / args.rate + 3.0) / scenario.dt_s).clamp(50.0, 100_000.0) as u64,
    }
}
