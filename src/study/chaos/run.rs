//! A run under its own supervisor, a child of this process.

use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::Context;
use rangehound_node::rendezvous::living_runs;
use rangehound_shared::run_name::RunName;
use rustix::process::{Pid, Signal, kill_process};

use crate::files::atomic_file;
use crate::files::out_folder;
use crate::run::experiment::Experiment;

const POLL: Duration = Duration::from_millis(1);

/// Most time for a run to end once it is finished or asked to end.
const ENDING: Duration = Duration::from_secs(30);

/// File for a run's output, beside its folder.
pub(super) fn log(out_dir: &Path) -> PathBuf {
    out_dir.with_extension("log")
}

/// The child that supervises a run.
pub(super) struct Run {
    pub(super) child: Child,
    pub(super) name: RunName,
    pub(super) standbys: usize,
    pub(super) out_dir: PathBuf,
}

impl Run {
    pub(super) fn start(experiment: &Experiment, seed: u64, standbys: usize, out_dir: &Path) -> anyhow::Result<Self> {
        let scenario = out_dir.with_extension("toml");
        atomic_file::write(&scenario, experiment.scenario_file.to_toml()?)?;
        let name = experiment.name.clone();
        let mut run = Command::new(std::env::current_exe().context("cannot find this program's own file")?);
        run.arg("run").arg(&scenario).args(["--seed", &seed.to_string(), "--out"]).arg(out_dir);
        let child = Self::spawn(run, &name, standbys, out_dir)?;
        Ok(Self { child, name, standbys, out_dir: out_dir.to_owned() })
    }

    pub(super) fn spawn(
        mut command: Command,
        name: &RunName,
        standbys: usize,
        out_dir: &Path,
    ) -> anyhow::Result<Child> {
        let output = out_folder::append(&log(out_dir))?;
        command
            .args(["--no-record", "--name", &name.to_string(), "--standby", &standbys.to_string()])
            // Its last message is quoted in errors.
            .env("NO_COLOR", "1")
            // Own process group: Ctrl-C reaches this process only, which ends the run in order.
            .process_group(0)
            .stdin(Stdio::null())
            .stdout(output.try_clone()?)
            .stderr(output)
            .spawn()
            .context("cannot start the run")
    }

    /// Kills the supervisor and all nodes, then resumes the run.
    pub(super) fn kill_all_and_resume(&mut self) -> anyhow::Result<()> {
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
        let mut resume = Command::new(std::env::current_exe().context("cannot find this program's own file")?);
        resume.arg("resume").arg(&self.out_dir);
        self.child = Self::spawn(resume, &self.name, self.standbys, &self.out_dir)?;
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

    pub(super) fn last_words(&self) -> String {
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
