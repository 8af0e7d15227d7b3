//! `rangehound compare`: Monte Carlo of the planners in one process, on all cores.
//!
//! | module | what |
//! |---|---|
//! | [`monte_carlo`] | the runs, spread over threads |
//! | [`summary`] | the figures: `compare.json` and the table |
//! | [`planning_time`] | planning time over the size of the team |
//! | [`pictures`] | the pictures |

pub mod monte_carlo;
pub mod pictures;
pub mod planning_time;
pub mod summary;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use rangehound_fusion::planner;
use rangehound_shared::scenario::{PLANNERS, Scenario, defaults};

use crate::failure::{self, Failure};
use crate::files::layout::COMPARISON;
use crate::files::layout::Kind;
use crate::files::out_folder::claim_or_number;
use crate::files::whole_file;
use crate::run::experiment::Given;
use crate::run::watch::Progress;
use monte_carlo::Trials;
use summary::{Comparison, Summary};

/// Where they go unless told otherwise.
const OUT: &str = "runs/compare";

/// Ticks of all runs together: what is kept of them then takes two gigabytes.
const TICKS_MAX: u64 = 30_000_000;

const THREADS_MAX: u64 = 1_024;

/// What is to be compared.
#[derive(Debug)]
pub struct Wanted {
    /// The scenario; its ticks are those of each run.
    pub given: Given,
    /// The planners' names.
    pub planners: Vec<String>,
    /// Runs of each.
    pub runs: u64,
    /// Threads to run on; `None` for one on each core.
    pub threads: Option<u64>,
}

/// `rangehound compare`.
///
/// # Errors
/// [`Failure`].
pub fn compare(wanted: Wanted, out: Option<&Path>, json: bool) -> Result<(), Failure> {
    let inputs = wanted.given.path.clone();
    let (trials, scenarios) = checked(wanted)?;
    let inputs: Vec<&Path> = inputs.iter().map(PathBuf::as_path).collect();
    let claim = claim_or_number(out, OUT, Kind::Compare, &inputs)?;
    let out = claim.path();
    let began = Instant::now();
    let results = {
        let mut progress = Progress::new("run", trials.count());
        let results = trials.run(|done| progress.show(done, &time_left(began.elapsed(), done, trials.count())));
        progress.finish();
        results?
    };
    let [first, ..] = scenarios.as_slice() else { return Ok(()) };
    let summaries = trials.planners.iter().zip(&results);
    let comparison = Comparison {
        scenario: first.name.clone(),
        seed: first.seed,
        runs: trials.runs,
        ticks: first.ticks,
        robots: first.robots.len(),
        stand_off_m: first.clearance.stand_off_m,
        stand_off_sigma: first.clearance.stand_off_sigma,
        wall_s: began.elapsed().as_secs_f64(),
        anees_bounds: summary::anees_bounds(trials.runs),
        time_s: (1..=first.ticks).map(|tick| tick as f64 * first.dt_s).collect(),
        planners: summaries.map(|(name, trials)| Summary::new(name, trials, first.ticks)).collect(),
        planning_time: scenarios.iter().map(planning_time::measure).collect(),
    };
    whole_file::write(&out.join(COMPARISON), serde_json::to_string_pretty(&comparison)? + "\n")?;
    pictures::draw(&comparison, &scenarios, out)?;
    if json {
        return failure::print_json(&comparison);
    }
    failure::print(format!("{comparison}\n\nfigures and pictures in {}\n", out.display()))
}

/// What is to be run, and each planner's first scenario.
fn checked(wanted: Wanted) -> Result<(Trials, Vec<Scenario>), Failure> {
    let Wanted { given, planners, runs, threads } = wanted;
    if given.file.recording.is_some() {
        let problem = "recording: expected a simulated target: robots of a recording cannot be planned for";
        return Err(Failure::input(format!("{}: {problem}", given.file_name)));
    }
    for (index, name) in planners.iter().enumerate() {
        if !PLANNERS.contains(&name.as_str()) {
            let known = PLANNERS.join(", ");
            return Err(Failure::input(format!("--planners: expected names out of {known}, got {name:?}")));
        }
        if planners[..index].contains(name) {
            return Err(Failure::input(format!("--planners: expected each name once, got {name} twice")));
        }
    }
    let ticks = runs.saturating_mul(given.file.ticks.unwrap_or(defaults::TICKS)).saturating_mul(planners.len() as u64);
    if runs == 0 || ticks > TICKS_MAX {
        let expected = format!("at least one run and at most {TICKS_MAX} ticks of all runs of all planners");
        return Err(Failure::input(format!("--runs: expected {expected}, got {runs} runs")));
    }
    let first_seed = given.file.seed.unwrap_or(defaults::SEED);
    if first_seed.checked_add(runs).is_none() {
        return Err(Failure::input(format!("--seed: expected room for {runs} seeds above, got {first_seed}")));
    }
    let cores = std::thread::available_parallelism().map_or(1, |cores| cores.get() as u64);
    let threads = threads.unwrap_or(cores);
    if !(1..=THREADS_MAX).contains(&threads) {
        return Err(Failure::input(format!("--threads: expected 1 to {THREADS_MAX}, got {threads}")));
    }
    let mut trials = Trials { given, planners, runs, first_seed, threads: 0 };
    trials.threads = threads.min(trials.count()) as usize;
    let scenarios: Result<Vec<Scenario>, _> = trials.planners.iter().map(|name| trials.scenario(name, 0)).collect();
    let scenarios = scenarios.map_err(Failure::input)?;
    for scenario in &scenarios {
        planner::for_team(scenario.planner, scenario.robots.len(), scenario.seed)
            .map_err(|error| Failure::input(format!("{}: {error}", trials.given.file_name)))?;
    }
    Ok((trials, scenarios))
}

fn time_left(elapsed: Duration, done: u64, all: u64) -> String {
    if done == 0 {
        return String::new();
    }
    let left_s = elapsed.as_secs_f64() * all.saturating_sub(done) as f64 / done as f64;
    format!("{left_s:.0} s left")
}
