//! One node of a run, started by hand or by a supervisor, and code that nodes and observers share.

use std::ffi::CStr;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process;

use anyhow::Context;
use rangehound_node::fusion::FusionError;
use rangehound_node::rendezvous::{Rendezvous, RendezvousError, Role};
use rangehound_node::robot::RobotError;
use rangehound_node::sim::SimError;
use rangehound_node::system::signal::Termination;
use rangehound_shared::run_name::RunName;
use rustix::process::{Pid, Signal, getppid, set_parent_process_death_signal};

use crate::failure::{self, Failure};
use crate::files::out_folder;

/// Priority of observers: the lowest.
const LEAST_PRIORITY: i32 = 19;

/// Runs the simulator of a run until it ends.
///
/// # Errors
/// [`Failure`].
pub fn sim(rendezvous: &Rendezvous, termination: &Termination) -> Result<(), Failure> {
    rangehound_node::sim::run(rendezvous, termination).map_err(|error| match error {
        _ if rendezvous.is_removed() => input_or_running(rendezvous.removed()),
        SimError::Rendezvous(error) => input_or_running(error),
        error @ (SimError::Checkpoint(_) | SimError::Sealed(_) | SimError::Recording(_)) => Failure::input(error),
        other => Failure::from(other),
    })?;
    tell_of_early_end(rendezvous, Role::Sim, termination);
    Ok(())
}

/// Runs the fusion centre of a run, or one that stands by, until it ends; and until this process's parent ends, if that
/// is given.
///
/// # Errors
/// [`Failure`].
pub fn fusion(name: &RunName, stands_by: bool, parent: Option<u32>) -> Result<(), Failure> {
    let termination = prepare(Role::Fusion, parent)?;
    let rendezvous = join(name, &termination)?;
    let run = if stands_by { rangehound_node::fusion::run_standby } else { rangehound_node::fusion::run };
    run(&rendezvous, &termination).map_err(|error| of_fusion(&rendezvous, error))?;
    tell_of_early_end(&rendezvous, Role::Fusion, &termination);
    Ok(())
}

/// Tells why a node ends that others have started, if its run is ended before its last tick.
fn tell_of_early_end(rendezvous: &Rendezvous, role: Role, termination: &Termination) {
    if rendezvous.is_ending() && !rendezvous.is_finished() && !termination.requested() {
        failure::print_stderr(format!("run {} was ended before its last tick: {role} ends too", rendezvous.name()));
    }
}

/// The failure of a fusion centre that ended early.
#[must_use]
pub fn of_fusion(rendezvous: &Rendezvous, error: FusionError) -> Failure {
    match error {
        _ if rendezvous.is_removed() => input_or_running(rendezvous.removed()),
        FusionError::Rendezvous(error) => input_or_running(error),
        error @ (FusionError::Checkpoint(_) | FusionError::Sealed(_)) => Failure::input(error),
        other => Failure::from(other),
    }
}

/// Runs a robot of a run, by id, as [`fusion`] does.
///
/// # Errors
/// [`Failure`].
pub fn robot(name: &RunName, id: usize, parent: Option<u32>) -> Result<(), Failure> {
    let termination = prepare(Role::Robot(id), parent)?;
    let rendezvous = join(name, &termination)?;
    rangehound_node::robot::run(&rendezvous, id, &termination).map_err(|error| of_robot(&rendezvous, error))?;
    tell_of_early_end(&rendezvous, Role::Robot(id), &termination);
    Ok(())
}

/// The failure of a robot that ended early.
#[must_use]
pub fn of_robot(rendezvous: &Rendezvous, error: RobotError) -> Failure {
    match error {
        // Whatever it came to first.
        _ if rendezvous.is_removed() => input_or_running(rendezvous.removed()),
        RobotError::Rendezvous(error) => input_or_running(error),
        error @ RobotError::NoSuchRobot { .. } => Failure::input(error),
        other => Failure::from(other),
    }
}

/// Joins a run; reports to the user if it must wait.
///
/// # Errors
/// [`Failure`].
pub fn join(name: &RunName, termination: &Termination) -> Result<Rendezvous, Failure> {
    let waiting = || failure::print_stderr(format!("waiting for run {name}: `rangehound sim --name {name}` starts it"));
    Rendezvous::join(name, termination, waiting).map_err(input_or_running)
}

/// Joins a run as an observer, with the lowest priority, so that it never delays other processes. Its title (at most
/// 15 bytes) distinguishes it from the nodes in the kernel's lists. `None` if asked to end before it could join, as by a
/// supervisor whose run could not start.
///
/// # Errors
/// [`Failure`].
pub fn observe(title: &CStr, name: &RunName, termination: &Termination) -> Result<Option<Rendezvous>, Failure> {
    // Failures are harmless: the observer also works without title and priority.
    let _ = rustix::thread::set_name(title);
    let _ = rustix::process::setpriority_process(None, LEAST_PRIORITY);
    match join(name, termination) {
        Err(_) if termination.requested() => Ok(None),
        joined => joined.map(Some),
    }
}

/// Names the process, ties it to its parent, listens for requests to end.
///
/// # Errors
/// [`Failure`].
pub fn prepare(role: Role, parent: Option<u32>) -> Result<Termination, Failure> {
    let termination = Termination::listen()?;
    role.name_process();
    end_with(parent)?;
    Ok(termination)
}

/// This program again. Not by its path, where another build may be by now.
#[must_use]
pub fn this_program() -> process::Command {
    let mut command = process::Command::new("/proc/self/exe");
    // Its output goes to a log, which errors may quote.
    command.arg0("rangehound").env("NO_COLOR", "1");
    command
}

/// Starts a process beside this one, with its output in a log of an output folder.
///
/// # Errors
/// If the log cannot be opened, or the process cannot be started.
pub fn start_logged(command: &mut process::Command, log: &Path) -> anyhow::Result<process::Child> {
    let output = out_folder::append(log).with_context(|| format!("cannot write {}", log.display()))?;
    command
        // Errors may quote its last message.
        .env("NO_COLOR", "1")
        // Own process group: Ctrl-C reaches this process only, which ends the other in order.
        .process_group(0)
        .stdin(process::Stdio::null())
        .stdout(output.try_clone()?)
        .stderr(output)
        .spawn()
        .with_context(|| format!("cannot start {}", command.get_program().display()))
}

/// The command line of a node that ends with this process, as a user would type it.
#[must_use]
pub fn command_line(role: Role, name: &RunName) -> Vec<String> {
    let kind = match role {
        Role::Robot(id) => vec!["robot".to_owned(), "--id".to_owned(), id.to_string()],
        Role::Standby(_) => vec!["fusion".to_owned(), "--standby".to_owned()],
        role => vec![role.to_string()],
    };
    kind.into_iter().chain(of_run(name)).collect()
}

/// The part of it that names the run, and this process as the one to end with.
#[must_use]
pub fn of_run(name: &RunName) -> [String; 4] {
    ["--name".to_owned(), name.to_string(), "--end-with".to_owned(), process::id().to_string()]
}

/// Asks the kernel to end this process when its parent ends, if the parent is given.
///
/// # Errors
/// [`Failure`] if the parent has already ended.
pub fn end_with(parent: Option<u32>) -> Result<(), Failure> {
    if let Some(pid) = parent {
        set_parent_process_death_signal(Some(Signal::TERM))?;
        // The parent may have died before the line above.
        if getppid().map(Pid::as_raw_pid) != i32::try_from(pid).ok() {
            return Err(Failure::Running(anyhow::anyhow!(
                "the process that started this one (--end-with) has ended: start the run again"
            )));
        }
    }
    Ok(())
}

/// A taken name or role, or a run of another version, is an input error; all others are system errors.
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
            let expected = format!("{words} --name demo --end-with {}", process::id());
            assert_eq!(command_line(role, &name).join(" "), expected);
        }
    }
}
