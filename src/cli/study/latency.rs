//! `latency`: its flags, checked.

use std::path::{Path, PathBuf};

use clap::Args;
use rangehound_shared::run_name::RunName;
use rangehound_shared::scenario::{Clock, Scenario, TimeoutKey};

use crate::cli::ExperimentArgs;
use crate::cli::values::{CLOCKS, PlannerName, number, whole, within};
use crate::failure::Failure;
use crate::run::experiment::{Experiment, Given, Naming};
use crate::run::pin::Pin;
use crate::study::hosts::HOSTS_MAX;
use crate::study::latency::{self, OUT};

/// Ticks of a round in lock step: seconds.
const TICKS: u64 = 5_000;

/// Time of a round in real time, s.
const ROUND_S: f64 = 10.0;

const ROUNDS_MAX: u64 = 1_000;

/// Most ranges of one round: their samples take some hundred megabytes.
const RANGES_MAX: u64 = 20_000_000;

/// `latency`.
#[derive(Debug, Args)]
pub struct LatencyArgs {
    /// Scenario file [default: the paper's experiment, see `rangehound scenario`]
    pub scenario: Option<PathBuf>,
    /// Number of robots, all with the same properties [default: the scenario's]
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub robots: Option<u64>,
    /// Number of time steps of each round [default: 5000 in lock step, 10 s in real time]
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub ticks: Option<u64>,
    /// Start of the next tick: by wall time (realtime), or by the answers of all robots (lockstep) [default: realtime if --rate is given, else lockstep]
    #[arg(long, value_parser = CLOCKS)]
    pub clock: Option<Clock>,
    /// Ticks per second in real time [default: the scenario's]
    #[arg(long, value_name = "HZ", value_parser = number, allow_negative_numbers = true)]
    pub rate: Option<f64>,
    /// Planner: how headings are chosen [default: the scenario's]
    #[arg(long, value_name = "NAME", value_parser = PlannerName)]
    pub planner: Option<String>,
    /// Processors for all processes: none (any processor), one-core, or numbers as in 0,1
    #[arg(long, value_name = "CPUS", default_value_t)]
    pub pin: Pin,
    /// Number of hosts: network namespaces of this machine, which need root. All robots are on other hosts than the run, and
    /// the references are the system on one host, and QUIC, UDP and, if the gateway was built with it, zenoh
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub hosts: Option<u64>,
    /// Number of rounds; each measures the system and all references
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true, default_value_t = 5)]
    pub rounds: u64,
    /// Name of the runs [default: latency-PID]
    #[arg(long)]
    pub name: Option<RunName>,
    /// Folder for latency.json, latency.svg and the runs' folders; those of an earlier measurement are replaced
    /// [default: runs/latency, numbered if another measurement is using it]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print the figures as one line of JSON, with the keys of latency.json
    #[arg(long)]
    pub json: bool,
}

impl LatencyArgs {
    /// Measures.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn carry_out(&self) -> Result<(), Failure> {
        let clock = match (self.clock, self.rate) {
            (Some(Clock::Lockstep), Some(_)) => {
                return Err(Failure::input(
                    "--rate is given in lock step, which has no rate: add --clock realtime, or leave --rate out",
                ));
            }
            (clock, None) => clock.unwrap_or(Clock::Lockstep),
            (_, Some(_)) => Clock::Realtime,
        };
        let experiment = ExperimentArgs {
            scenario: self.scenario.clone(),
            robots: self.robots,
            ticks: self.ticks,
            clock: Some(clock),
            planner: self.planner.clone(),
            // In lock step no robot may be skipped: each wait is a sample.
            timeout: (clock == Clock::Lockstep).then(|| TimeoutKey::Word("forever".to_owned())),
            ..ExperimentArgs::default()
        };
        let most = format!("1 to {ROUNDS_MAX}");
        let rounds = within("--rounds", 1..=ROUNDS_MAX, &most, self.rounds)?;
        let experiment = self.experiment(experiment.given()?)?;
        let most = (experiment.description.scenario.robots.len() + 1).min(HOSTS_MAX) as u64;
        let expected = format!("2 to {most}, with a robot on each but the run's");
        let hosts = self.hosts.map(|hosts| within("--hosts", 2..=most, &expected, hosts)).transpose()?;
        let wanted = latency::Wanted { pin: self.pin.clone(), rounds, hosts: hosts.map(|hosts| hosts as usize) };
        latency::latency(experiment, &wanted, self.out.as_deref(), self.json)
    }

    /// The measured experiment. If it gives no number of ticks, it gets as many as a round needs.
    fn experiment(&self, mut given: Given) -> Result<Experiment, Failure> {
        if given.file.recording.is_some() {
            return Err(Failure::input(format!(
                "recording is given in {}: expected a simulated target, whose ticks come at a steady rate",
                given.file_name
            )));
        }
        if let Some(rate_hz) = self.rate {
            given.file.dt_s = Some(1.0 / within("--rate", 1e-3..=1e4, "0.001 to 10000 Hz", rate_hz)?);
        }
        let name: RunName = match &self.name {
            Some(name) => name.clone(),
            // The process number keeps measurements that run at the same time apart.
            None => format!("latency-{}", std::process::id()).parse().map_err(Failure::input)?,
        };
        let out = self.out.as_deref().unwrap_or(Path::new(OUT));
        let checked = |given| Experiment::from_given(given, Some(&name), Naming::Exact, Some(out));
        let mut experiment = checked(given.clone())?;
        if self.ticks.is_none() {
            let scenario = &experiment.description.scenario;
            given.file.ticks = Some(match scenario.clock {
                Clock::Lockstep => TICKS,
                Clock::Realtime => (ROUND_S / scenario.dt_s).clamp(20.0, TICKS as f64 * 20.0) as u64,
            });
            experiment = checked(given)?;
        }
        let Scenario { ticks, robots, .. } = &experiment.description.scenario;
        if ticks.saturating_mul(robots.len() as u64) > RANGES_MAX {
            let most = RANGES_MAX / robots.len() as u64;
            return Err(Failure::input(format!(
                "--ticks is {ticks}: expected at most {most} for {} robots",
                robots.len()
            )));
        }
        Ok(experiment)
    }
}
