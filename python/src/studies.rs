//! Many runs, and the analysis of one: `compare` and `calibrate`.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use anstream::adapter::strip_str;
use pyo3::prelude::*;
use rangehound::files::{calibration, input as files};
use rangehound::results::report::Truth;
use rangehound::study::calibrate::{Found, check};
use rangehound::study::compare::monte_carlo::{CustomParts, Trials, Variant, Varied};
use rangehound::study::compare::{first_scenarios, of_trials};
use rangehound_shared::scenario::PLANNERS;

use crate::errors::{Raised, failed, input};
use crate::run::parts;
use crate::scenario::Scenario;

/// Compares planners: `(name, function or None)` for each. Returns the keys of `compare.json` as JSON, and the table.
#[pyfunction]
#[pyo3(signature = (
    scenario, planners, *, sensors=Vec::new(), nuisances=Vec::new(), sensor=None, target=None, runs, ticks, seed=None,
    threads=None, progress=None
))]
#[allow(clippy::too_many_arguments, reason = "keywords of Python")]
pub(crate) fn compare(
    py: Python<'_>,
    scenario: &Scenario,
    planners: Vec<(String, Option<Py<PyAny>>)>,
    sensors: Vec<String>,
    nuisances: Vec<String>,
    sensor: Option<Py<PyAny>>,
    target: Option<Py<PyAny>>,
    runs: u64,
    ticks: u64,
    seed: Option<u64>,
    threads: Option<usize>,
    progress: Option<Py<PyAny>>,
) -> PyResult<(String, String)> {
    let raised = Raised::default();
    let mut variants = Vec::new();
    for (index, (name, function)) in planners.iter().enumerate() {
        if function.is_none() && !PLANNERS.contains(&name.as_str()) {
            return Err(input(format!(
                "planners has {name:?}: expected functions, or names out of {}",
                PLANNERS.join(", ")
            )));
        }
        if planners[..index].iter().any(|(before, _)| before == name) {
            return Err(input(format!("planners has {name} twice: expected each name once")));
        }
    }
    let names: Vec<String> = planners.iter().map(|(name, _)| name.clone()).collect();
    let (sensor, target) = (sensor.map(Arc::new), target.map(Arc::new));
    for mut variant in Variant::all(&names, Varied { sensors: &sensors, nuisances: &nuisances, ..Varied::default() }) {
        let function = planners.iter().find(|(name, _)| Some(name) == variant.planner.as_ref());
        let planner = function.and_then(|(_, function)| function.as_ref()).map(|f| Arc::new(f.clone_ref(py)));
        if planner.is_some() {
            variant.planner = None;
        }
        if planner.is_some() || sensor.is_some() || target.is_some() {
            let (sensor, target, raised) = (sensor.clone(), target.clone(), raised.clone());
            variant.custom = Some(CustomParts(Arc::new(move |scenario| {
                let own =
                    |function: &Option<Arc<Py<PyAny>>>| function.as_ref().map(|f| Python::attach(|py| f.clone_ref(py)));
                parts(scenario, own(&planner), own(&sensor), own(&target), &raised)
            })));
        }
        variants.push(variant);
    }
    let mut given = scenario.given.clone();
    given.file.ticks = Some(ticks);
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let count = runs.saturating_mul(variants.len() as u64).max(1);
    let threads = (threads.unwrap_or(cores).clamp(1, 1_024) as u64).min(count) as usize;
    let trials = Trials { given, variants, runs, first_seed: seed.unwrap_or(scenario.checked.seed), threads };
    trials.check_extent(ticks).map_err(input)?;
    let scenarios = first_scenarios(&trials).map_err(failed)?;
    let compared = py.detach(|| {
        of_trials(&trials, &scenarios, |done| {
            Python::attach(|py| {
                py.check_signals()?;
                raised.check()?;
                progress.as_ref().map_or(Ok(()), |progress| progress.call1(py, (done, count)).map(drop))
            })
            .map_err(anyhow::Error::from)
        })
    });
    let comparison = compared.map_err(failed)?;
    raised.check()?;
    Ok((serde_json::to_string(&comparison).map_err(failed)?, strip_str(&comparison.to_string()).to_string()))
}

/// Calibrates the sensors of a recording's scenario: the keys of `calibrate --json` as JSON, `calibration.toml`, and range
/// and residual of each reading by sensor.
#[pyfunction]
#[pyo3(signature = (keys, *, truth=None, progress=None))]
#[allow(clippy::type_complexity, reason = "a tuple of Python")]
pub(crate) fn calibrate(
    py: Python<'_>,
    keys: &str,
    truth: Option<PathBuf>,
    progress: Option<Py<PyAny>>,
) -> PyResult<(String, String, Vec<Vec<(f64, f64)>>)> {
    let file = crate::scenario::from_keys(keys)?;
    let table = file.recording.ok_or_else(|| input("recording is missing: expected a table"))?;
    let (recording, _) = files::recording_of(&table, "the call of calibrate", Path::new("")).map_err(input)?;
    check(&table, &recording).map_err(failed)?;
    let truth = truth.map(|path| Truth::read(&path)).transpose().map_err(failed)?;
    let (fitted, is_wanted) = (AtomicUsize::new(0), AtomicBool::new(true));
    let work = || {
        let show = |models| fitted.store(models, Ordering::Relaxed);
        Found::of(&recording, table.target_height_m, truth.as_ref(), show, &|| is_wanted.load(Ordering::Relaxed))
    };
    let look = || {
        Python::attach(|py| {
            py.check_signals()?;
            let done = fitted.load(Ordering::Relaxed);
            progress.as_ref().map_or(Ok(()), |progress| progress.call1(py, (done, MODELS)).map(drop))
        })
    };
    let found = py.detach(|| {
        std::thread::scope(|scope| {
            let worker = std::thread::Builder::new().name("calibrate".to_owned()).spawn_scoped(scope, work);
            let worker = worker.map_err(|error| failed(anyhow::Error::from(error)))?;
            while !worker.is_finished() {
                std::thread::sleep(LOOK);
                look().inspect_err(|_| is_wanted.store(false, Ordering::Relaxed))?;
            }
            worker.join().map_err(|_| failed(anyhow::anyhow!("the calibration panicked: please report this")))
        })
    })?;
    let json = serde_json::to_string(&found).map_err(failed)?;
    Ok((json, found.to_toml(), found.points))
}

/// How long a fit goes on until Python can act on signals and show progress.
const LOOK: Duration = Duration::from_millis(10);

/// Models that are fitted.
const MODELS: usize = rangehound::study::calibrate::model::Model::ALL.len();

/// Adds a calibration to the keys of a recording's scenario, which take precedence: JSON of the keys, `calibration.toml`.
#[pyfunction]
pub(crate) fn calibrated(keys: &str, toml: &str) -> PyResult<String> {
    let mut file = crate::scenario::from_keys(keys)?;
    let found = calibration::parse(toml)
        .map_err(|problem| input(format!("calibration: expected one as `calibrate` makes it: {problem}")))?;
    if let Some(table) = &mut file.recording {
        let read = files::recording_of(table, "the call of track", Path::new("")).map_err(input)?;
        let known: Vec<String> = read.0.sensors().iter().map(|sensor| sensor.name.to_string()).collect();
        calibration::merge(&found, &known, table, &mut file.target.get_or_insert_default().noise_psd);
    }
    serde_json::to_string(&file).map_err(input)
}
