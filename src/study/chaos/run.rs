//! A run under its own supervisor, a child of this process.

use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use rangehound_node::rendezvous::living_runs;
use rangehound_shared::run_name::RunName;
use rustix::process::{Pid, Signal, kill_process};

use crate::failure::Failure;
use crate::files::atomic_file;
use crate::run::experiment::Experiment;
use crate::run::gateway;
use crate::run::node::start_logged;
use crate::study::hosts::Hosts;

const POLL: Duration = Duration::from_millis(1);

/// Most time for a run to end once it is finished or asked to end.
const ENDING: Duration = Duration::from_secs(30);

/// File for a run's output, beside its folder.
pub(super) fn log(out_dir: &Path) -> PathBuf {
    out_dir.with_extension("log")
}

/// The program files that a campaign starts. With another build in their place, or without them, it could not go on.
#[derive(Debug)]
pub(super) struct Programs(Vec<(PathBuf, Identity)>);

/// The identity of a file: its device, number, length and time of change.
type Identity = (u64, u64, u64, i64);

impl Programs {
    /// Those of a campaign, with or without several hosts.
    ///
    /// # Errors
    /// [`Failure`] if one is missing.
    pub(super) fn of_campaign(has_hosts: bool) -> Result<Self, Failure> {
        let own = std::env::current_exe().context("cannot find this program's own file")?;
        let gateway = has_hosts.then(gateway::program).transpose()?;
        let programs = std::iter::once(own).chain(gateway);
        let known = |path: PathBuf| {
            let found = identity(&path).with_context(|| path.display().to_string())?;
            anyhow::Ok((path, found))
        };
        Ok(Self(programs.map(known).collect::<anyhow::Result<_>>()?))
    }

    /// Checks that they are still there.
    ///
    /// # Errors
    /// With the first that is not.
    pub(super) fn check(&self) -> anyhow::Result<()> {
        let changed = self.0.iter().find(|(path, known)| identity(path).ok().as_ref() != Some(known));
        match changed {
            Some((path, _)) => {
                bail!(
                    "{} was replaced or removed meanwhile: start chaos again, and leave the file alone",
                    path.display()
                )
            }
            None => Ok(()),
        }
    }
}

fn identity(path: &Path) -> std::io::Result<Identity> {
    let file = std::fs::metadata(path)?;
    Ok((file.dev(), file.ino(), file.len(), file.mtime()))
}

/// The child that supervises a run.
pub(super) struct Run {
    pub(super) child: Child,
    pub(super) name: RunName,
    pub(super) out_dir: PathBuf,
    /// Arguments that `run` and `resume` have in common.
    arguments: Vec<String>,
}

impl Run {
    /// Starts a run of an experiment; on several hosts if there are some.
    pub(super) fn start(
        experiment: &Experiment,
        seed: u64,
        standbys: usize,
        out_dir: &Path,
        hosts: Option<&Hosts>,
    ) -> anyhow::Result<Self> {
        let scenario = out_dir.with_extension("toml");
        atomic_file::write(&scenario, experiment.scenario_file.to_toml()?)?;
        let name = experiment.name.clone();
        let mut arguments = ["--no-record", "--name", &name.to_string()].map(str::to_owned).to_vec();
        arguments.extend(["--standby".to_owned(), standbys.to_string()]);
        if let Some(hosts) = hosts {
            arguments.extend(hosts.arguments(experiment.description.scenario.robots.len()));
        }
        let mut run = program(hosts)?;
        run.arg("run").arg(&scenario).args(["--seed", &seed.to_string(), "--out"]).arg(out_dir);
        let child = start_logged(run.args(&arguments), &log(out_dir))?;
        Ok(Self { child, name, out_dir: out_dir.to_owned(), arguments })
    }

    /// Kills the supervisor and all nodes, then resumes the run.
    pub(super) fn kill_all_and_resume(&mut self, hosts: Option<&Hosts>) -> anyhow::Result<()> {
        // A stopped supervisor starts no nodes while the others are killed.
        let _ = kill_process(Pid::from_child(&self.child), Signal::STOP);
        loop {
            let left = processes_of(&self.name);
            // A process that is no longer listed may still be exiting.
            if left.is_empty() && !living_runs().contains(&self.name) {
                break;
            }
            for pid in left.into_iter().filter_map(Pid::from_raw) {
                let _ = kill_process(pid, Signal::KILL);
            }
            let _ = self.child.try_wait()?;
            std::thread::sleep(POLL);
        }
        self.child.wait()?;
        let mut resume = program(hosts)?;
        resume.arg("resume").arg(&self.out_dir);
        self.child = start_logged(resume.args(&self.arguments), &log(&self.out_dir))?;
        Ok(())
    }

    pub(super) fn has_ended(&mut self) -> std::io::Result<bool> {
        Ok(self.child.try_wait()?.is_some())
    }

    /// Waits for the end; asks the run to end if it is not over, and finally kills it. Returns the exit code, if
    /// there is one.
    pub(super) fn end(&mut self, is_over: bool) -> std::io::Result<Option<i32>> {
        for attempt in usize::from(!is_over).. {
            match attempt {
                0 => {}
                1 if !self.has_ended()? => drop(kill_process(Pid::from_child(&self.child), Signal::TERM)),
                1 => {}
                _ => drop(self.child.kill()),
            }
            let began = Instant::now();
            while began.elapsed() < ENDING {
                if let Some(status) = self.child.try_wait()? {
                    return Ok(status.code());
                }
                std::thread::sleep(POLL);
            }
        }
        Ok(None)
    }

    pub(super) fn last_message(&self) -> String {
        let text = std::fs::read_to_string(log(&self.out_dir)).unwrap_or_default();
        let complaint = text.lines().rev().find(|line| line.starts_with("rangehound: "));
        complaint.or(text.lines().last()).unwrap_or_default().trim_start_matches("rangehound: ").to_owned()
    }
}

impl Drop for Run {
    /// An error in this process must not leave a run behind.
    fn drop(&mut self) {
        if matches!(self.has_ended(), Ok(false)) {
            let _ = self.end(false);
        }
    }
}

/// The start of this program, on the run's host if there are several.
fn program(hosts: Option<&Hosts>) -> anyhow::Result<Command> {
    let own = || std::env::current_exe().context("cannot find this program's own file").map(Command::new);
    hosts.map_or_else(own, |hosts| Ok(hosts.on_run_host()))
}

/// Living processes of this program in this PID namespace with this run's name, except this process. Another container
/// may have a run of the same name.
pub(super) fn processes_of(name: &RunName) -> Vec<i32> {
    let program = std::env::current_exe().ok();
    let name = name.to_string();
    let is_of_run = |pid: &i32| {
        let arguments = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
        let mut arguments = arguments.split(|byte| *byte == 0);
        arguments.any(|argument| argument == b"--name") && arguments.next() == Some(name.as_bytes())
    };
    let namespace = |process: &str| std::fs::read_link(format!("/proc/{process}/ns/pid")).ok();
    let here = namespace("self");
    // If `/proc` is of another namespace, its process ids are not those that signals use.
    let is_own = std::fs::read_link("/proc/self").is_ok_and(|me| me.as_os_str() == &*std::process::id().to_string());
    let processes = is_own.then(|| std::fs::read_dir("/proc").ok()).flatten();
    processes
        .into_iter()
        .flatten()
        .flatten()
        .filter_map(|entry| entry.file_name().to_str()?.parse::<i32>().ok())
        .filter(|pid| here.is_some() && namespace(&pid.to_string()) == here)
        .filter(|pid| Some(*pid) != i32::try_from(std::process::id()).ok())
        .filter(|pid| std::fs::read_link(format!("/proc/{pid}/exe")).ok() == program)
        .filter(is_of_run)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_file_that_is_replaced_or_removed_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let program = folder.path().join("program");
        std::fs::write(&program, "one").unwrap();
        let programs = Programs(vec![(program.clone(), identity(&program).unwrap())]);
        assert!(programs.check().is_ok());
        let other = folder.path().join("other");
        std::fs::write(&other, "two").unwrap();
        std::fs::rename(&other, &program).unwrap();
        let refused = programs.check().unwrap_err().to_string();
        assert!(refused.contains("program was replaced or removed"), "{refused}");
        std::fs::remove_file(&program).unwrap();
        assert!(programs.check().is_err());
    }
}
