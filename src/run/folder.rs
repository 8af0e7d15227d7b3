//! The run folder before and between runs: preparing, reading, and checking it for `resume`.

use std::path::Path;

use rangehound_node::rendezvous::{Role, RunDescription};
use rangehound_node::system::bounded;
use rangehound_node::tick_log::TickLogError;
use rangehound_node::{checkpoint, logs};
use rangehound_shared::scenario::{COPY, Source};
use rangehound_shared::sealed;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::experiment::Experiment;
use super::external::External;
use crate::failure::Failure;
use crate::files::atomic_file::{self, AtomicFile};
use crate::files::input::in_utf8;
use crate::files::layout::{DESCRIPTION, EXTERNAL, HOSTS, Kind, SCENARIO};
use crate::files::out_folder::{self, Claim};
use crate::run::supervisor::Hosts;

/// Longest file of what is kept for `resume`, bytes: all robots of the largest team fit in.
const KEPT_LEN_MAX: usize = 64 << 10;

/// Prepares and claims the run folder: removes an earlier run's results, writes the scenario.
///
/// # Errors
/// [`Failure::Input`] if the folder cannot be used.
pub fn prepare_folder(experiment: &Experiment) -> Result<Claim, Failure> {
    let out_dir = &experiment.description.out_dir;
    let claim = out_folder::claim(out_dir, Kind::Run, &experiment.inputs())?;
    claim.clear()?;
    let written = || {
        if let Source::Recorded(ranges) = &experiment.description.scenario.source
            && let Some(recording) = ranges.already_read()
        {
            let mut copy = AtomicFile::create(&out_dir.join(COPY))?;
            recording.write_csv(&mut copy)?;
            copy.finish()?;
        }
        atomic_file::write(&out_dir.join(SCENARIO), experiment.scenario_file.to_toml()?)?;
        atomic_file::write_for_owner(&out_dir.join(DESCRIPTION), experiment.description_for_nodes().seal()?)
    };
    written().map_err(|error: anyhow::Error| {
        Failure::input(format!(
            "cannot write to the run folder (--out): {error}: expected a folder that can be written"
        ))
    })?;
    for log in [logs::ESTIMATES, logs::WORLDS] {
        claim.make_growing(log)?;
    }
    Ok(claim)
}

/// Keeps in the run folder how robots on other hosts join, for `resume`; nothing if none do.
///
/// # Errors
/// [`Failure`] if the file cannot be written.
pub fn write_hosts(folder: &Path, hosts: Option<Hosts>) -> Result<(), Failure> {
    keep(folder, HOSTS, hosts.as_ref())
}

/// How robots on other hosts joined the run of this folder; `None` if none did.
///
/// # Errors
/// [`Failure::Input`] if the file cannot be used.
pub fn read_hosts(folder: &Path) -> Result<Option<Hosts>, Failure> {
    kept(folder, HOSTS, "how robots on other hosts join")
}

/// Keeps in the run folder which nodes of this host others start, for `resume`; nothing if there are none.
///
/// # Errors
/// [`Failure`] if the file cannot be written.
pub fn write_external(folder: &Path, external: Option<&External>) -> Result<(), Failure> {
    keep(folder, EXTERNAL, external)
}

/// The nodes of this host that others started in the run of this folder; `None` if there were none.
///
/// # Errors
/// [`Failure::Input`] if the file cannot be used.
pub fn read_external(folder: &Path) -> Result<Option<External>, Failure> {
    kept(folder, EXTERNAL, "which nodes others start")
}

fn keep<T: Serialize>(folder: &Path, name: &str, value: Option<&T>) -> Result<(), Failure> {
    let Some(value) = value else { return Ok(()) };
    let text = serde_json::to_string_pretty(value).map_err(|error| Failure::Running(error.into()))?;
    atomic_file::write(&folder.join(name), text + "\n").map_err(Failure::Running)
}

fn kept<T: DeserializeOwned>(folder: &Path, name: &str, expected: &str) -> Result<Option<T>, Failure> {
    let path = folder.join(name);
    let unusable = |reason: &dyn std::fmt::Display| {
        let path = path.display();
        Failure::input(format!("cannot use {path}: {reason}: expected {expected}, as `run` writes it"))
    };
    let text = match bounded::read(&path, KEPT_LEN_MAX) {
        Ok(text) => text,
        Err(_) if !path.exists() => return Ok(None),
        Err(error) => return Err(unusable(&error)),
    };
    serde_json::from_slice(&text).map(Some).map_err(|error| unusable(&error))
}

/// Reads a run's description from its folder, which may have been moved.
///
/// # Errors
/// [`Failure::Input`] if the folder is not a run folder.
pub fn read_description(folder: &Path) -> Result<RunDescription, Failure> {
    let path = folder.join(DESCRIPTION);
    let expected = |reason: &dyn std::fmt::Display| {
        Failure::input(format!("cannot use {}: {reason}: expected the folder of a run", path.display()))
    };
    let sealed = bounded::read(&path, sealed::FILE_LEN_MAX).map_err(|error| expected(&error))?;
    let description = RunDescription::open(&sealed).map_err(|error| expected(&error))?;
    let out_dir = std::path::absolute(folder).map_err(|error| expected(&error))?;
    in_utf8("DIR", &out_dir)?;
    Ok(RunDescription { out_dir, ..description })
}

/// Checks that the nodes of a run to resume will find the states from which they go on.
///
/// # Errors
/// [`Failure::Input`] if a node has logged ticks, and its state is missing.
pub fn look_for_states(description: &RunDescription) -> Result<(), Failure> {
    let out_dir = &description.out_dir;
    // A log that cannot be read is another problem.
    let has_ticks = |newest: Result<Option<u64>, TickLogError>| matches!(newest, Ok(Some(_)));
    let logged = [
        (Role::Sim, logs::read_worlds(description).and_then(|log| log.newest_tick())),
        (Role::Fusion, logs::read_estimates(description).and_then(|log| log.newest_tick())),
    ];
    for (role, newest) in logged {
        let state = out_dir.join(checkpoint::file_name(role));
        if has_ticks(newest) && !state.exists() {
            return Err(Failure::input(format!(
                "cannot resume {}: {} is missing, which `run --in-process` does not write: start a new run",
                out_dir.display(),
                checkpoint::file_name(role)
            )));
        }
    }
    Ok(())
}

/// Claims the folder of a run to resume, and checks that its files can be written: a node that cannot write its log
/// would continue without it.
///
/// # Errors
/// [`Failure::Input`] with the first file that cannot be written.
pub fn look_for_writable(description: &RunDescription) -> Result<Claim, Failure> {
    let out_dir = &description.out_dir;
    let claim = out_folder::claim_again(out_dir)?;
    let checkpoints = [Role::Sim, Role::Fusion].map(|role| out_dir.join(checkpoint::file_name(role)));
    let logs = [logs::estimates_path(out_dir), logs::worlds_path(out_dir)];
    for path in logs.iter().chain(&checkpoints) {
        let opened = std::fs::OpenOptions::new().append(true).open(path);
        if let Err(error) = opened
            && error.kind() != std::io::ErrorKind::NotFound
        {
            return Err(Failure::input(format!(
                "cannot write {}: {error}: expected a file that can be written",
                path.display()
            )));
        }
    }
    // A node would overwrite the log of another run.
    let has_content = |log: &Path| std::fs::metadata(log).is_ok_and(|log| log.len() > 0);
    let [estimates, worlds] = &logs;
    if has_content(estimates) {
        logs::read_estimates(description).map_err(Failure::input)?;
    }
    if has_content(worlds) {
        logs::read_worlds(description).map_err(Failure::input)?;
    }
    Ok(claim)
}
