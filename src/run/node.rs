//! One node: what `sim`, `fusion` and `robot` run, started by hand or by `run`.

use std::ffi::CStr;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process;

use rangehound_node::fusion::FusionError;
use rangehound_node::rendezvous::{Rendezvous, RendezvousError, Role, RunDescription};
use rangehound_node::robot::RobotError;
use rangehound_node::signal::Termination;
use rangehound_node::sim::SimError;
use rangehound_shared::run_name::RunName;
use rangehound_shared::scenario::{Scenario, Source};
use rustix::process::{Pid, Signal, getppid, set_parent_process_death_signal};

use crate::cli::{ExperimentArgs, FusionArgs, NodeArgs, ParentArgs, RobotArgs, SimArgs};
use crate::failure::{self, Failure};
use crate::files::input;
use crate::files::layout::SCENARIO;
use crate::files::out_folder::Claim;
use crate::run::experiment::{Experiment, Naming, override_with};
use crate::run::folder;

/// Of who looks on.
const LEAST_PRIORITY: i32 = 19;

/// `rangehound sim`.
///
/// # Errors
/// [`Failure`].
pub fn sim(args: &SimArgs) -> Result<(), Failure> {
    let joined = args.parent.end_with.and(args.experiment.name.as_ref());
    // Before requests to end are listened for: a wait for a pipe's writer ends as the system ends it.
    let founded = if joined.is_none() { Some(Experiment::from_run(&args.experiment, Naming::Exact)?) } else { None };
    let termination = prepare(Role::Sim, &args.parent)?;
    let (rendezvous, _folder) = match (joined, founded) {
        (Some(name), _) => (join(name, &termination)?, None),
        (None, Some(experiment)) => found(args, &experiment)?,
        (None, None) => return Err(Failure::input("--name: expected the name of a run")),
    };
    rangehound_node::sim::run(&rendezvous, &termination).map_err(|error| match error {
        _ if rendezvous.is_removed() => input_or_running(rendezvous.removed()),
        SimError::Rendezvous(error) => input_or_running(error),
        error @ (SimError::Checkpoint(_) | SimError::Sealed(_) | SimError::Recording(_)) => Failure::input(error),
        other => Failure::from(other),
    })
}

/// `rangehound fusion`.
///
/// # Errors
/// [`Failure`].
pub fn fusion(args: &FusionArgs) -> Result<(), Failure> {
    let termination = prepare(Role::Fusion, &args.node.parent)?;
    let rendezvous = join(&args.node.name, &termination)?;
    let run = if args.standby { rangehound_node::fusion::run_standby } else { rangehound_node::fusion::run };
    run(&rendezvous, &termination).map_err(|error| match error {
        _ if rendezvous.is_removed() => input_or_running(rendezvous.removed()),
        FusionError::Rendezvous(error) => input_or_running(error),
        error @ (FusionError::Checkpoint(_) | FusionError::Sealed(_)) => Failure::input(error),
        other => Failure::from(other),
    })
}

/// `rangehound robot`.
///
/// # Errors
/// [`Failure`].
pub fn robot(args: &RobotArgs) -> Result<(), Failure> {
    let id = usize::try_from(args.id)?;
    let termination = prepare(Role::Robot(id), &args.node.parent)?;
    let rendezvous = join(&args.node.name, &termination)?;
    rangehound_node::robot::run(&rendezvous, id, &termination).map_err(|error| match error {
        // Whatever it came to first.
        _ if rendezvous.is_removed() => input_or_running(rendezvous.removed()),
        RobotError::Rendezvous(error) => input_or_running(error),
        error @ RobotError::NoSuchRobot { .. } => Failure::input(error),
        other => Failure::from(other),
    })
}

/// The simulator started by hand founds the run; started again after a kill, it goes back to it. With the claim on the
/// run folder.
fn found(args: &SimArgs, experiment: &Experiment) -> Result<(Rendezvous, Option<Claim>), Failure> {
    if let Some(living) = Rendezvous::join_if_alive(&experiment.name).map_err(input_or_running)? {
        refuse_other_experiment(&args.experiment, experiment, living.description())?;
        failure::tell(format!("sim: run {} goes on already; taking the simulator's place in it", experiment.name));
        // Its supervisor may have the folder, if there is one.
        let folder = folder::look_for_writable(living.description()).ok();
        return Ok((living, folder));
    }
    let name = &experiment.name;
    // Before nodes can join the run and write into its folder.
    let folder = folder::prepare_folder(experiment)?;
    let rendezvous = Rendezvous::found(name, experiment.description_for_nodes()).map_err(input_or_running)?;
    let robots = rendezvous.description().scenario.robots.len();
    failure::tell(format!(
        "sim: founded run {name}; join it from other terminals with\n  rangehound fusion --name {name}\n  \
         rangehound robot --id 0 --name {name}   (to --id {})\n  rangehound watch --name {name}",
        robots - 1
    ));
    Ok((rendezvous, Some(folder)))
}

/// Refuses flags that say another experiment than the one that goes on: they would be without effect.
fn refuse_other_experiment(args: &ExperimentArgs, asked: &Experiment, living: &RunDescription) -> Result<(), Failure> {
    let name = &asked.name;
    let refuse = |flag: &str, is: &dyn std::fmt::Display| {
        Failure::input(format!(
            "{flag}: run {name} goes on already, with {is}: leave the flag out to take the simulator's place, or choose another \
             --name"
        ))
    };
    let real = |folder: &Path| folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
    if args.out.is_some() && real(&asked.description.out_dir) != real(&living.out_dir) {
        return Err(refuse("--out", &format_args!("its folder in {}", living.out_dir.display())));
    }
    let other = &"another scenario";
    // The run's copy of a recording says less of how it was read.
    let same_recording = |given: &Source| matches!((given, &living.scenario.source), (Source::Recorded(a), Source::Recorded(b)) if a.digest == b.digest);
    let scenario = |given: &Scenario| {
        let source = if same_recording(&given.source) { &living.scenario.source } else { &given.source };
        Scenario { name: String::new(), source: source.clone(), ..given.clone() }
    };
    if let Some(file) = &args.scenario {
        let is_same = scenario(&asked.description.scenario) == scenario(&living.scenario);
        return if is_same { Ok(()) } else { Err(refuse(&file.display().to_string(), other)) };
    }
    let own_file = living.out_dir.join(SCENARIO);
    for (flag, alone) in one_by_one(args) {
        // The run's own scenario, with this one flag over it.
        let with_flag = input::scenario_file(&own_file).map_err(Failure::input).and_then(|mut file| {
            override_with(&mut file, &alone)?;
            input::scenario(&file, &own_file.display().to_string(), &living.out_dir).map_err(Failure::input)
        });
        if with_flag.is_ok_and(|with_flag| scenario(&with_flag) == scenario(&living.scenario)) {
            continue;
        }
        return Err(match flag {
            "--seed" => refuse(flag, &format_args!("seed {}", living.scenario.seed)),
            "--ticks" => refuse(flag, &format_args!("{} ticks", living.scenario.ticks)),
            "--robots" => refuse(flag, &format_args!("{} robots", living.scenario.robots.len())),
            flag => refuse(flag, other),
        });
    }
    Ok(())
}

/// The flags that change the experiment, each without the others.
fn one_by_one(args: &ExperimentArgs) -> Vec<(&'static str, ExperimentArgs)> {
    let none = ExperimentArgs::default;
    let ExperimentArgs { robots, ticks, seed, clock, planner, stand_off, patience, .. } = args;
    let each = [
        ("--robots", robots.is_some(), ExperimentArgs { robots: *robots, ..none() }),
        ("--ticks", ticks.is_some(), ExperimentArgs { ticks: *ticks, ..none() }),
        ("--seed", seed.is_some(), ExperimentArgs { seed: *seed, ..none() }),
        ("--clock", clock.is_some(), ExperimentArgs { clock: *clock, ..none() }),
        ("--planner", planner.is_some(), ExperimentArgs { planner: planner.clone(), ..none() }),
        ("--stand-off", stand_off.is_some(), ExperimentArgs { stand_off: *stand_off, ..none() }),
        ("--patience", patience.is_some(), ExperimentArgs { patience: patience.clone(), ..none() }),
    ];
    each.into_iter().filter(|(_, is_given, _)| *is_given).map(|(flag, _, alone)| (flag, alone)).collect()
}

/// Joins a run, telling the user if it must wait.
///
/// # Errors
/// [`Failure`].
pub fn join(name: &RunName, termination: &Termination) -> Result<Rendezvous, Failure> {
    let waiting = || failure::tell(format!("waiting for run {name}; `rangehound sim --name {name}` starts it"));
    Rendezvous::join(name, termination, waiting).map_err(input_or_running)
}

/// Joins a run to look on, under a name (of at most 15 bytes) that tells it from the nodes in the kernel's lists, and with
/// the least priority: whoever else wants the processor has it. `None` if asked to end before, as by a supervisor whose run
/// could not start.
///
/// # Errors
/// [`Failure`].
pub fn look_on(name: &CStr, node: &NodeArgs, termination: &Termination) -> Result<Option<Rendezvous>, Failure> {
    // Without name or priority it looks on all the same.
    let _ = rustix::thread::set_name(name);
    let _ = rustix::process::setpriority_process(None, LEAST_PRIORITY);
    end_with(&node.parent)?;
    match join(&node.name, termination) {
        Err(_) if termination.requested() => Ok(None),
        joined => joined.map(Some),
    }
}

/// Names the process, ties it to its parent, listens for requests to end.
///
/// # Errors
/// [`Failure`].
pub fn prepare(role: Role, parent: &ParentArgs) -> Result<Termination, Failure> {
    let termination = Termination::listen()?;
    role.name_process();
    end_with(parent)?;
    Ok(termination)
}

/// This program once more; not by its path, which another build may have taken meanwhile.
#[must_use]
pub fn this_program() -> process::Command {
    let mut command = process::Command::new("/proc/self/exe");
    // What it says goes to a log, and from there may be quoted.
    command.arg0("rangehound").env("NO_COLOR", "1");
    command
}

/// The command line of a node of a run that ends with this process, as a person would write it.
#[must_use]
pub fn command_line(role: Role, name: &RunName) -> Vec<String> {
    let kind = match role {
        Role::Robot(id) => vec!["robot".to_owned(), "--id".to_owned(), id.to_string()],
        Role::Standby(_) => vec!["fusion".to_owned(), "--standby".to_owned()],
        role => vec![role.to_string()],
    };
    let run = ["--name".to_owned(), name.to_string(), "--end-with".to_owned(), process::id().to_string()];
    kind.into_iter().chain(run).collect()
}

/// Has this process asked to end when the one that started it ends.
///
/// # Errors
/// [`Failure`] if that has ended already.
pub fn end_with(parent: &ParentArgs) -> Result<(), Failure> {
    if let Some(pid) = parent.end_with {
        set_parent_process_death_signal(Some(Signal::TERM))?;
        // The parent may have died before the line above.
        if getppid().map(Pid::as_raw_pid) != i32::try_from(pid).ok() {
            return Err(Failure::Running(anyhow::anyhow!("the process that started this one is gone")));
        }
    }
    Ok(())
}

/// A name or role that is taken, or a run of another version, is the user's to mend; the rest is the system's.
#[must_use]
pub fn input_or_running(error: RendezvousError) -> Failure {
    match error {
        RendezvousError::Taken { .. }
        | RendezvousError::RoleTaken { .. }
        | RendezvousError::NotOurs(_)
        | RendezvousError::NoFolder(_)
        | RendezvousError::Short(_)
        | RendezvousError::OtherBuild { .. }
        | RendezvousError::Unusable { .. }
        | RendezvousError::StateLost { .. } => Failure::input(error),
        other => Failure::Running(anyhow::Error::new(other)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::Cli;
    use clap::Parser;

    #[test]
    fn nodes_are_started_as_a_person_would_start_them() {
        let name: RunName = "demo".parse().unwrap();
        let expected = [
            (Role::Sim, "sim"),
            (Role::Fusion, "fusion"),
            (Role::Standby(1), "fusion --standby"),
            (Role::Robot(255), "robot --id 255"),
        ];
        for (role, words) in expected {
            let args = command_line(role, &name);
            assert_eq!(args.join(" "), format!("{words} --name demo --end-with {}", process::id()));
            Cli::try_parse_from(std::iter::once("rangehound".to_owned()).chain(args)).unwrap();
        }
    }
}
