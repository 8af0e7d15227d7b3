//! `rangehound compare`: Monte Carlo of the planners in one process, on all cores.
//!
//! | module | what |
//! |---|---|
//! | [`monte_carlo`] | the runs, spread over threads |
//! | [`certified_reference`] | the distance of a plan from the certified optimum |
//! | [`summary`] | the figures: `compare.json` and the table |
//! | [`planning_time`] | planning time over the size of the team |
//! | [`pictures`] | the pictures |

pub mod certified_reference;
pub mod monte_carlo;
pub mod pictures;
pub mod planning_time;
pub mod summary;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::Context;
use rangehound_fusion::planner;
use rangehound_shared::scenario::Scenario;

use crate::failure::{self, Failure};
use crate::files::atomic_file;
use crate::files::layout::COMPARISON;
use crate::files::layout::Kind;
use crate::files::out_folder::claim_or_number;
use crate::run::experiment::Given;
use crate::run::in_process::TeamError;
use crate::run::watch::Progress;
use monte_carlo::Trials;
use summary::{Comparison, Summary};

/// Default folder of the results.
const OUT: &str = "runs/compare";

/// `rangehound compare`.
///
/// # Errors
/// [`Failure`].
pub fn compare(trials: Trials, out: Option<&Path>, json: bool) -> Result<(), Failure> {
    let scenarios = first_scenarios(&trials)?;
    let inputs: Vec<&Path> = trials.given.path.iter().map(PathBuf::as_path).collect();
    let claim = claim_or_number(out, OUT, Kind::Compare, &inputs)?;
    let out = claim.path();
    let began = Instant::now();
    let mut progress = Progress::new("run", trials.count());
    let comparison = of_trials(&trials, &scenarios, |done| {
        progress.show(done, &time_left(began.elapsed(), done, trials.count()));
        Ok(())
    })?;
    progress.finish();
    atomic_file::write(&out.join(COMPARISON), serde_json::to_string_pretty(&comparison)? + "\n")?;
    pictures::draw(&comparison, &scenarios, out)?;
    if json {
        return failure::print_json(&comparison);
    }
    failure::print(format!("{comparison}\n\nfigures and pictures in {}\n", out.display()))
}

/// Runs the trials and sums them up. `scenarios` are those of [`first_scenarios`]; `on_progress` as for [`Trials::run`].
///
/// # Errors
/// As [`Trials::run`].
pub fn of_trials(
    trials: &Trials,
    scenarios: &[Scenario],
    on_progress: impl FnMut(u64) -> anyhow::Result<()>,
) -> anyhow::Result<Comparison> {
    let first = scenarios.first().context("nothing to compare: expected at least one planner")?;
    let began = Instant::now();
    let results = trials.run(on_progress)?;
    let built_in = trials.variants.iter().zip(scenarios).filter(|(variant, _)| variant.planner.is_some());
    Ok(Comparison {
        scenario: first.name.clone(),
        seed: first.seed,
        runs: trials.runs,
        ticks: first.ticks,
        robots: first.robots.len(),
        gap_meaning: summary::gap_meaning(scenarios),
        stand_off_m: first.clearance.stand_off_m,
        stand_off_sigma: first.clearance.stand_off_sigma,
        wall_s: began.elapsed().as_secs_f64(),
        anees_bounds: summary::anees_bounds(trials.runs),
        time_s: (1..=first.ticks).map(|tick| tick as f64 * first.dt_s).collect(),
        planners: trials
            .variants
            .iter()
            .zip(&results)
            .map(|(variant, trials)| Summary::new(&variant.name, trials, first.ticks))
            .collect(),
        planning_time: built_in.map(|(variant, scenario)| planning_time::measure(&variant.name, scenario)).collect(),
    })
}

/// Each variant's first scenario: if it can be set up, so can all other runs of the variant.
///
/// # Errors
/// [`Failure::Input`] for the first fault.
pub fn first_scenarios(trials: &Trials) -> Result<Vec<Scenario>, Failure> {
    let Given { file, file_name, .. } = &trials.given;
    if file.recording.is_some() {
        return Err(Failure::input(format!(
            "recording is given in {file_name}: expected a simulated target, because recorded sensors cannot be planned for"
        )));
    }
    let scenarios: Result<Vec<Scenario>, _> =
        trials.variants.iter().map(|variant| trials.scenario(variant, 0)).collect();
    let scenarios = scenarios.map_err(Failure::input)?;
    for scenario in &scenarios {
        if scenario.has_real_target {
            return Err(Failure::Input(failure::located(TeamError::RealTarget, file_name)));
        }
        planner::for_team(scenario.planner, scenario.robots.len(), scenario.seed)
            .map_err(|error| Failure::Input(failure::located(error, file_name)))?;
    }
    Ok(scenarios)
}

fn time_left(elapsed: Duration, done: u64, all: u64) -> String {
    if done == 0 {
        return String::new();
    }
    let left_s = elapsed.as_secs_f64() * all.saturating_sub(done) as f64 / done as f64;
    format!("{left_s:.0} s left")
}
