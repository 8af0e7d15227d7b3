//! Runs of the system, started as a user starts them, and their stamps.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow};
use rangehound_node::rendezvous::RunDescription;
use rangehound_node::system::signal::Termination;
use rangehound_shared::record::RobotRecord;
use rustix::process::{Pid, Signal, kill_process};

use super::outcome::Contender;
use super::samples::Exchange;
use crate::failure::Failure;
use crate::files::atomic_file;
use crate::files::layout::REPORT;
use crate::results::hops::HopSummary;
use crate::run::experiment::Experiment;
use crate::run::folder;
use crate::run::node::{start_logged, this_program};
use crate::study::hosts::Hosts;

/// Interval between checks of the run: long, to disturb the measurement little.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// Most time for a robot on another host to leave a run that has ended.
const LEAVING: Duration = Duration::from_secs(5);

/// Most time for a run to end on request.
const ENDING: Duration = Duration::from_secs(30);

/// Folder of a round's run.
pub(super) fn folder(out_dir: &Path, contender: Contender, round: u64) -> PathBuf {
    out_dir.join(format!("{contender}-{round}"))
}

/// Runs the experiment to its end as its own process, with its own folder; on several hosts if there are some.
///
/// # Errors
/// [`Failure`], with the run's last message if it failed.
pub(super) fn run(
    experiment: &Experiment,
    folder: &Path,
    termination: &Termination,
    mut hosts: Option<&mut Hosts>,
) -> Result<RunDescription, Failure> {
    let (scenario, log_path) = (folder.with_extension("toml"), folder.with_extension("log"));
    atomic_file::write(&scenario, experiment.scenario_file.to_toml()?)?;
    let robots = experiment.description.scenario.robots.len();
    let mut command = hosts.as_deref().map_or_else(this_program, Hosts::on_run_host);
    command
        .arg("run")
        .arg(&scenario)
        .args([
            "--no-record",
            "--name",
            &experiment.name.to_string(),
            "--end-with",
            &std::process::id().to_string(),
            "--out",
        ])
        .arg(folder)
        .args(hosts.as_deref().map(|hosts| hosts.arguments(robots)).unwrap_or_default());
    let mut child = start_logged(&mut command, &log_path)?;
    if let Some(hosts) = hosts.as_deref_mut() {
        hosts.start(robots, &folder.with_extension("hosts.log"))?;
    }
    let mut asked: Option<Instant> = None;
    let status = loop {
        if let Some(status) = child.try_wait()? {
            break status;
        }
        match asked {
            None if termination.requested() => {
                let _ = kill_process(Pid::from_child(&child), Signal::TERM);
                asked = Some(Instant::now());
            }
            Some(at) if at.elapsed() > ENDING => child.kill()?,
            _ => {}
        }
        if let Some(hosts) = hosts.as_deref_mut() {
            hosts.look()?;
        }
        std::thread::sleep(POLL_INTERVAL);
    };
    if let Some(hosts) = hosts {
        hosts.end(LEAVING);
    }
    if !status.success() {
        let log = std::fs::read_to_string(&log_path).unwrap_or_default();
        let last_message = log.lines().last().unwrap_or_default().trim_start_matches("rangehound: ").to_owned();
        let is_input = status.code() == Some(2);
        return Err(if is_input {
            Failure::input(last_message)
        } else {
            anyhow!("the run failed: {last_message}").into()
        });
    }
    folder::read_description(folder)
}

/// The hops in the run's report.
///
/// # Errors
/// If its report cannot be read.
pub(super) fn hops_us(description: &RunDescription) -> anyhow::Result<HopSummary> {
    #[derive(serde::Deserialize)]
    struct Reported {
        hops_us: HopSummary,
    }
    let path = description.out_dir.join(REPORT);
    let unreadable = || format!("cannot read {}", path.display());
    let text = std::fs::read_to_string(&path).with_context(unreadable)?;
    Ok(serde_json::from_str::<Reported>(&text).with_context(unreadable)?.hops_us)
}

/// The stamps of a robot's record.
pub(super) fn exchange(robot: &RobotRecord) -> Exchange {
    Exchange { sent_ns: robot.range_sent_ns, held_ns: robot.heading_held_ns }
}
