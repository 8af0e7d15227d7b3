//! What measures and compares: `plan`, `compare`, `chaos`, `latency`.

use std::path::PathBuf;

use clap::Args;
use rangehound_shared::run_name::RunName;
use rangehound_shared::scenario::{Clock, PatienceKey, PlannerTable, Source};

use super::values::{CLOCKS, KINDS, PlannerName, VICTIMS, number, standbys, whole};
use super::{ExperimentArgs, InputArgs};
use crate::failure::Failure;
use crate::plan;
use crate::run::experiment::{Experiment, Naming, Reserved, free_name};
use crate::run::pin::Pin;
use crate::study::chaos::enough_ticks;
use crate::study::chaos::faults::{Asked, Kind, Victim};
use crate::study::{calibrate, chaos, compare, explore, latency};

/// `plan`.
#[derive(Debug, Default, Args)]
pub struct PlanArgs {
    /// Problems, one JSON object a line; - or nothing for standard input
    pub file: Option<PathBuf>,
    /// Planner of the lines that name none [default: certified]
    #[arg(long, value_name = "NAME", value_parser = PlannerName)]
    pub planner: Option<String>,
    /// Node budget of the certified planner
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub nodes: Option<u64>,
    /// Iterations of the relaxations
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub iterations: Option<u64>,
    /// Relaxation factor of the adaptive relaxation, 0 to 1
    #[arg(long, value_name = "A", value_parser = number, allow_negative_numbers = true)]
    pub alpha: Option<f64>,
    /// Step of the grid search on the bearing, rad
    #[arg(long, value_name = "RAD", value_parser = number, allow_negative_numbers = true)]
    pub step_rad: Option<f64>,
    /// Seed of the random planner, whose headings depend on it and on the line's number
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub seed: Option<u64>,
}

/// `compare`.
#[derive(Debug, Args)]
pub struct CompareArgs {
    /// Scenario file [default: the paper's experiment, see `rangehound scenario`]
    pub scenario: Option<PathBuf>,
    /// The same scenario file, as a flag
    #[arg(long = "scenario", value_name = "FILE", conflicts_with = "scenario")]
    pub scenario_flag: Option<PathBuf>,
    /// Planners to compare, separated by commas
    #[arg(
        long,
        value_name = "NAMES",
        value_delimiter = ',',
        value_parser = PlannerName,
        default_value = "certified,adaptive,standard,greedy,pursue,random"
    )]
    pub planners: Vec<String>,
    /// Runs of each planner; run i has the same target, noise and prior for all planners
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true, default_value_t = 1_000)]
    pub runs: u64,
    /// Time steps of a run
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true, default_value_t = 300)]
    pub ticks: u64,
    /// Seed of the first run; each next run has the next seed [default: the scenario's]
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub seed: Option<u64>,
    /// Number of robots, all alike [default: the scenario's]
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub robots: Option<u64>,
    /// Least distance that robots keep to where the target is predicted, m; 0 as in the paper
    /// [default: the scenario's]
    #[arg(long, value_name = "M", value_parser = number, allow_negative_numbers = true)]
    pub stand_off: Option<f64>,
    /// Threads to run on; no figure but the timings depends on it [default: one for each core]
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub threads: Option<u64>,
    /// Folder for compare.json and the pictures; what it holds of an earlier comparison is replaced
    /// [default: runs/compare, numbered if another comparison goes on in it]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print the figures as one line of JSON, with the keys of compare.json
    #[arg(long)]
    pub json: bool,
}

/// `calibrate`.
#[derive(Debug, Args)]
pub struct CalibrateArgs {
    /// What is read, and how
    #[command(flatten)]
    pub input: InputArgs,
    /// True track to compare the ranges with: CSV with time_s,x_m,y_m [default: from the ranges alone]
    #[arg(long, value_name = "FILE")]
    pub truth: Option<PathBuf>,
    /// Folder for calibration.toml and residuals.svg [default: runs/calibrate]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print the findings as one line of JSON
    #[arg(long)]
    pub json: bool,
}

/// `latency`.
#[derive(Debug, Args)]
pub struct LatencyArgs {
    /// Scenario file [default: the paper's experiment, see `rangehound scenario`]
    pub scenario: Option<PathBuf>,
    /// Number of robots, all alike [default: the scenario's]
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub robots: Option<u64>,
    /// Time steps of each round [default: 5000 in lock step, 10 s in real time]
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub ticks: Option<u64>,
    /// What starts the next tick: wall time, or all answers [default: lockstep, realtime if a rate is given]
    #[arg(long, value_parser = CLOCKS)]
    pub clock: Option<Clock>,
    /// Ticks a second in real time [default: the scenario's]
    #[arg(long, value_name = "HZ", value_parser = number, allow_negative_numbers = true)]
    pub rate: Option<f64>,
    /// How headings are chosen [default: the scenario's]
    #[arg(long, value_name = "NAME", value_parser = PlannerName)]
    pub planner: Option<String>,
    /// Processors for all processes: none (any), one-core, or their numbers as in 0,1
    #[arg(long, value_name = "CPUS", default_value_t)]
    pub pin: Pin,
    /// How often each is measured, in turns
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true, default_value_t = 5)]
    pub rounds: u64,
    /// Name of the runs [default: latency and the number of this process]
    #[arg(long)]
    pub name: Option<RunName>,
    /// Folder for latency.json, latency.svg and the folders of the system's runs; those of an earlier call are replaced
    /// [default: runs/latency, numbered if another measurement goes on in it]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print the figures as one line of JSON, with the keys of latency.json
    #[arg(long)]
    pub json: bool,
}

/// `explore`.
#[derive(Debug, Args)]
pub struct ExploreArgs {
    /// The first seed
    #[arg(long, value_name = "FIRST", value_parser = whole, allow_negative_numbers = true, default_value_t = 1)]
    pub seed: u64,
    /// How many seeds, one after the other
    #[arg(long, value_name = "COUNT", value_parser = whole, allow_negative_numbers = true, default_value_t = 20_000)]
    pub seeds: u64,
    /// Print what each node did, for each seed
    #[arg(long)]
    pub story: bool,
}

/// `chaos`.
#[derive(Debug, Args)]
pub struct ChaosArgs {
    /// The experiment; in lock step, the default here, with endless patience
    #[command(flatten)]
    pub experiment: ExperimentArgs,
    /// Number of faults; a run that ends before them is followed by one of the next seed
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true, default_value_t = 50)]
    pub faults: u64,
    /// Kinds of faults, separated by commas
    #[arg(long, value_name = "KINDS", value_parser = KINDS, value_delimiter = ',', default_value = "all")]
    pub kinds: Vec<Option<Kind>>,
    /// Who is hurt: sim, fusion (whoever leads), robot, standby, separated by commas
    #[arg(long, value_name = "ROLES", value_parser = VICTIMS, value_delimiter = ',', default_value = "sim,fusion,robot")]
    pub roles: Vec<Victim>,
    /// Fusion processes that stand by in the runs
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = standbys)]
    pub standby: usize,
    /// Longest stop, s
    #[arg(long, value_name = "SECONDS", value_parser = number, allow_negative_numbers = true, default_value_t = 0.5)]
    pub longest_stop: f64,
    /// Faults a second in the mean; the gaps are exponential
    #[arg(long, value_name = "PER_S", value_parser = number, allow_negative_numbers = true, default_value_t = 10.0)]
    pub rate: f64,
    /// Seed of the faults
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true, default_value_t = 1)]
    pub chaos_seed: u64,
    /// Print the outcome as one line of JSON, with the keys of chaos.json
    #[arg(long)]
    pub json: bool,
}

impl PlanArgs {
    /// Plans the lines.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn carry_out(&self) -> Result<(), Failure> {
        let table = PlannerTable {
            name: self.planner.clone(),
            nodes: self.nodes,
            iterations: self.iterations,
            alpha: self.alpha,
            step_rad: self.step_rad,
            ..PlannerTable::default()
        };
        plan::plan(table, self.seed, self.file.as_deref())
    }
}

impl CompareArgs {
    /// Compares the planners.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn carry_out(&self) -> Result<(), Failure> {
        let experiment = ExperimentArgs {
            scenario: self.scenario.clone().or_else(|| self.scenario_flag.clone()),
            robots: self.robots,
            ticks: Some(self.ticks),
            seed: self.seed,
            stand_off: self.stand_off,
            ..ExperimentArgs::default()
        };
        let (given, planners) = (experiment.given()?, self.planners.clone());
        let wanted = compare::Wanted { given, planners, runs: self.runs, threads: self.threads };
        compare::compare(wanted, self.out.as_deref(), self.json)
    }
}

impl CalibrateArgs {
    /// Finds the sensors' errors.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn carry_out(&self) -> Result<(), Failure> {
        calibrate::calibrate(&self.input.table()?, self.truth.as_deref(), self.out.as_deref(), self.json)
    }
}

impl LatencyArgs {
    /// Measures.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn carry_out(&self) -> Result<(), Failure> {
        let clock = match (self.clock, self.rate) {
            (Some(Clock::Lockstep), Some(_)) => {
                return Err(Failure::input("--rate: expected --clock realtime, as lock step has none"));
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
            // In lock step nobody is left out: each wait is a sample.
            patience: (clock == Clock::Lockstep).then(|| PatienceKey::Word("forever".to_owned())),
            ..ExperimentArgs::default()
        };
        let wanted = latency::Wanted {
            rate_hz: self.rate,
            chooses_ticks: self.ticks.is_none(),
            pin: self.pin.clone(),
            rounds: self.rounds,
            name: self.name.clone(),
        };
        latency::latency(experiment.given()?, &wanted, self.out.as_deref(), self.json)
    }
}

impl ExploreArgs {
    /// Explores the seeds.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn carry_out(&self) -> Result<(), Failure> {
        explore::explore(self.seed, self.seeds, self.story)
    }
}

impl ChaosArgs {
    /// Hurts runs.
    ///
    /// # Errors
    /// [`Failure`].
    pub fn carry_out(&self) -> Result<(), Failure> {
        let asked = self.asked();
        let (experiment, _reserved) = self.experiment(&asked)?;
        chaos::chaos(&experiment, &asked, self.json)
    }

    /// What is asked of the campaign.
    fn asked(&self) -> Asked {
        Asked {
            faults: self.faults,
            kinds: self.kinds.iter().copied().collect(),
            victims: self.roles.clone(),
            standbys: self.standby,
            longest_stop_s: self.longest_stop,
            rate_per_s: self.rate,
            seed: self.chaos_seed,
        }
    }

    /// The run to be hurt: in lock step it waits for everybody, so that its digest must not change.
    fn experiment(&self, asked: &Asked) -> Result<(Experiment, Option<Reserved>), Failure> {
        let given = &self.experiment;
        let clock = given.clock.unwrap_or(Clock::Lockstep);
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
        let experiment = wanted(given.ticks).experiment(Naming::Exact)?;
        let scenario = &experiment.description.scenario;
        let experiment = match (given.ticks, &scenario.source) {
            (None, Source::Simulated { .. }) => {
                wanted(Some(enough_ticks(scenario, asked))).experiment(Naming::Exact)?
            }
            _ => experiment,
        };
        Ok((experiment, reserved))
    }
}
