//! `compare`: its flags, checked.

use std::path::{Path, PathBuf};

use clap::Args;
use rangehound_shared::scenario::{EXACT, OWN, PLANNERS, defaults};

use crate::cli::ExperimentArgs;
use crate::cli::values::{PlannerName, number, whole, within};
use crate::failure::Failure;
use crate::study::compare;
use crate::study::compare::monte_carlo::{TREATMENTS, Trials, Variant, Varied};

const THREADS_MAX: u64 = 1_024;

/// The planners that are compared by default: those that serve a team of any size.
const COMPARED: [&str; 6] = ["certified", "adaptive", "standard", "greedy", "pursue", "random"];

/// `compare`.
#[derive(Debug, Args)]
pub struct CompareArgs {
    /// Scenario file [default: the paper's experiment, see `rangehound scenario`]
    pub scenario: Option<PathBuf>,
    /// Scenario file, as a flag
    #[arg(long = "scenario", value_name = "FILE", conflicts_with = "scenario")]
    pub scenario_flag: Option<PathBuf>,
    /// Planners to compare, separated by commas [default: certified,adaptive,standard,greedy,pursue,random; only certified
    /// with --sensors, --localisers or --nuisances]
    #[arg(long, value_name = "NAMES", value_delimiter = ',', value_parser = PlannerName)]
    pub planners: Option<Vec<String>>,
    /// Sensors to compare, separated by commas. For each name, all robots have the sensor [sensor.NAME] of the scenario; own
    /// keeps each robot's own
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub sensors: Vec<String>,
    /// Errors of the robots' poses to compare, separated by commas. For each name, all robots have [localiser.NAME] of the
    /// scenario; exact means no error; own keeps each robot's own
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub localisers: Vec<String>,
    /// Treatments of uncertain poses and biases to compare, separated by commas: ignored, inflated, schmidt, estimated
    #[arg(long, value_name = "NAMES", value_delimiter = ',', value_parser = TREATMENTS)]
    pub nuisances: Vec<String>,
    /// Number of runs for each row of the table; run i has the same target, noise and prior in all rows
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true, default_value_t = 1_000)]
    pub runs: u64,
    /// Number of time steps of a run
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true, default_value_t = 300)]
    pub ticks: u64,
    /// Seed of the first run; each further run has the next seed [default: the scenario's]
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub seed: Option<u64>,
    /// Number of robots, all with the same properties [default: the scenario's]
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub robots: Option<u64>,
    /// Least distance of the robots to the predicted target, m; the paper has 0
    /// [default: the scenario's]
    #[arg(long, value_name = "M", value_parser = number, allow_negative_numbers = true)]
    pub stand_off: Option<f64>,
    /// Number of threads; only timings depend on it [default: one for each core]
    #[arg(long, value_name = "N", value_parser = whole, allow_negative_numbers = true)]
    pub threads: Option<u64>,
    /// Folder for compare.json and the pictures; those of an earlier comparison are replaced
    /// [default: runs/compare, numbered if another comparison is using it]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print the figures as one line of JSON, with the keys of compare.json
    #[arg(long)]
    pub json: bool,
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
        let mut given = experiment.given()?;
        given.flags.push(("planner.name", "--planners"));
        let (runs, first_seed) = (self.runs, given.file.seed.unwrap_or(defaults::SEED));
        let asked = self.planners.as_deref().unwrap_or_default();
        check_names("--planners", asked, PLANNERS.into_iter(), "planners")?;
        let file = given.path.as_deref().unwrap_or(Path::new("scenarios/paper.toml")).display();
        let sensors = given.file.sensor.iter().flatten().map(|(name, _)| name.as_str());
        check_names("--sensors", &self.sensors, sensors.chain([OWN]), &format!("tables [sensor.NAME] of {file}"))?;
        let localisers = given.file.localiser.iter().flatten().map(|(name, _)| name.as_str());
        let tables = format!("tables [localiser.NAME] of {file}");
        check_names("--localisers", &self.localisers, localisers.chain([EXACT, OWN]), &tables)?;
        let ticks_of_run = given.file.ticks.unwrap_or(defaults::TICKS);
        // Where something else varies, one planner is enough unless more are asked for.
        let varied = Varied { sensors: &self.sensors, localisers: &self.localisers, nuisances: &self.nuisances };
        let planners = match &self.planners {
            None if varied.is_given() => vec![defaults::PLANNER.to_owned()],
            None => COMPARED.map(str::to_owned).to_vec(),
            Some(names) => names.clone(),
        };
        let variants = Variant::all(&planners, varied);
        let cores = std::thread::available_parallelism().map_or(1, |cores| cores.get() as u64);
        let threads =
            within("--threads", 1..=THREADS_MAX, &format!("1 to {THREADS_MAX}"), self.threads.unwrap_or(cores))?;
        // At most one thread for each run.
        let threads = threads.min(runs.saturating_mul(variants.len() as u64)) as usize;
        let trials = Trials { given, variants, runs, first_seed, threads };
        trials.check_extent(ticks_of_run).map_err(|problem| Failure::input(format!("--{problem}")))?;
        compare::compare(trials, self.out.as_deref(), self.json)
    }
}

/// Each name must be known, and is needed once.
fn check_names<'a>(
    flag: &str,
    asked: &[String],
    known: impl Iterator<Item = &'a str>,
    what: &str,
) -> Result<(), Failure> {
    let known: Vec<&str> = known.collect();
    for (index, name) in asked.iter().enumerate() {
        if !known.contains(&name.as_str()) {
            let known = known.join(", ");
            return Err(Failure::input(format!("{flag} has {name:?}: expected names out of {known} ({what})")));
        }
        if asked[..index].contains(name) {
            return Err(Failure::input(format!("{flag} has {name} twice: expected each name once")));
        }
    }
    Ok(())
}
