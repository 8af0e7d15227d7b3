//! Many runs, and the analysis of one: `compare` and `calibrate`.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use anstream::adapter::strip_str;
use pyo3::prelude::*;
use rangehound::files::bytes_read::BytesRead;
use rangehound::files::{calibration, input as files};
use rangehound::study::calibrate::{Found, check};
use rangehound::study::compare::monte_carlo::{CustomParts, Trials, Variant, Varied};
use rangehound::study::compare::{first_scenarios, of_trials};
use rangehound_shared::scenario::PLANNERS;

use crate::errors::{Raised, failed, input, interruptible, read_truth};
use crate::run::parts;
use crate::scenario::Scenario;

/// A thing compared: its name in the table, what the scenario calls it, and the function in its place.
type Compared = (String, Option<String>, Option<Py<PyAny>>);

/// The function of the thing of this name.
fn function_of(py: Python<'_>, compared: &[Compared], name: Option<&String>) -> Option<Arc<Py<PyAny>>> {
    let (_, _, function) = compared.iter().find(|(of, ..)| Some(of) == name)?;
    function.as_ref().map(|function| Arc::new(function.clone_ref(py)))
}

/// Compares planners, and sensors and targets if those are given. Returns the keys of `compare.json` as JSON, and the table.
#[pyfunction]
#[pyo3(signature = (
    scenario, planners, *, sensors=Vec::new(), targets=Vec::new(), nuisances=Vec::new(), sensor=None, target=None, runs, ticks,
    seed=None, threads=None, progress=None
))]
#[allow(clippy::too_many_arguments, reason = "keywords of Python")]
pub(crate) fn compare(
    py: Python<'_>,
    scenario: &Scenario,
    planners: Vec<Compared>,
    sensors: Vec<Compared>,
    targets: Vec<Compared>,
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
    for (name, built_in, function) in &planners {
        if function.is_none() && !built_in.as_deref().is_some_and(|name| PLANNERS.contains(&name)) {
            return Err(input(format!(
                "planners has {name:?}: expected functions, or names out of {}",
                PLANNERS.join(", ")
            )));
        }
    }
    for (what, compared) in [("planners", &planners), ("sensors", &sensors), ("targets", &targets)] {
        if let Some((name, ..)) = (0..compared.len())
            .find(|index| compared[..*index].iter().any(|(before, ..)| *before == compared[*index].0))
            .map(|index| &compared[index])
        {
            return Err(input(format!("{what} has {name} twice: expected each name once")));
        }
    }
    let names = |compared: &[Compared]| compared.iter().map(|(name, ..)| name.clone()).collect::<Vec<_>>();
    let (sensor, target) = (sensor.map(Arc::new), target.map(Arc::new));
    let mut variants = Vec::new();
    for mut variant in Variant::all(
        &names(&planners),
        Varied { sensors: &names(&sensors), nuisances: &nuisances, ..Varied::default() },
    ) {
        let planner = function_of(py, &planners, variant.planner.as_ref());
        if planner.is_some() {
            variant.planner = None;
        }
        let sensor = function_of(py, &sensors, variant.sensor.as_ref()).or_else(|| sensor.clone());
        let of_scenario = sensors.iter().find(|(name, ..)| Some(name) == variant.sensor.as_ref());
        variant.sensor = of_scenario.and_then(|(_, of_scenario, _)| of_scenario.clone());
        // Without targets there is one: the scenario's, or the function of all.
        let labels: Vec<Option<String>> =
            if targets.is_empty() { vec![None] } else { names(&targets).into_iter().map(Some).collect() };
        for label in labels {
            let mut variant = variant.clone();
            let target = function_of(py, &targets, label.as_ref()).or_else(|| target.clone());
            if let Some(label) = &label {
                variant.name = format!("{} {label}", variant.name);
            }
            if planner.is_some() || sensor.is_some() || target.is_some() {
                let (planner, sensor, raised) = (planner.clone(), sensor.clone(), raised.clone());
                variant.custom = Some(CustomParts(Arc::new(move |scenario| {
                    let own = |function: &Option<Arc<Py<PyAny>>>| {
                        function.as_ref().map(|f| Python::attach(|py| f.clone_ref(py)))
                    };
                    parts(scenario, own(&planner), own(&sensor), own(&target), &raised)
                })));
            }
            variants.push(variant);
        }
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
/// and residual of each reading by sensor. `reading` is a function of the bytes that have been read and of all, `progress` one of models.
#[pyfunction]
#[pyo3(signature = (keys, *, truth=None, reading=None, progress=None))]
#[allow(clippy::type_complexity, reason = "a tuple of Python")]
pub(crate) fn calibrate(
    py: Python<'_>,
    keys: &str,
    truth: Option<PathBuf>,
    reading: Option<Py<PyAny>>,
    progress: Option<Py<PyAny>>,
) -> PyResult<(String, String, Vec<Vec<(f64, f64)>>)> {
    let file = crate::scenario::from_keys(keys)?;
    let table = file.recording.ok_or_else(|| input("recording is missing: expected a table"))?;
    let given = table.clone();
    let read = move |bytes: &BytesRead| {
        files::recording_of_with(&given, "the call of calibrate", Path::new(""), bytes).map_err(input)
    };
    let (recording, _) = interruptible(py, reading.as_ref(), read)?;
    check(&table, &recording).map_err(failed)?;
    let truth = read_truth(py, truth)?;
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
            let mut looked = Ok(());
            while looked.is_ok() && !worker.is_finished() {
                std::thread::sleep(PROGRESS_INTERVAL);
                looked = look();
            }
            is_wanted.store(looked.is_ok(), Ordering::Relaxed);
            let found = worker.join();
            looked?;
            found.map_err(|_| failed(anyhow::anyhow!("the calibration panicked: please report this")))
        })
    })?;
    let json = serde_json::to_string(&found).map_err(failed)?;
    Ok((json, found.to_toml(), found.points))
}

/// How long a fit goes on until Python can act on signals and show progress.
const PROGRESS_INTERVAL: Duration = Duration::from_millis(10);

/// Models that are fitted.
const MODELS: usize = rangehound::study::calibrate::model::Model::ALL.len();

/// Adds a calibration to the keys of a recording's scenario, which take precedence: JSON of the keys, `calibration.toml`. `reading` is
/// as for [`calibrate`].
#[pyfunction]
#[pyo3(signature = (keys, toml, *, reading=None))]
pub(crate) fn calibrated(py: Python<'_>, keys: &str, toml: &str, reading: Option<Py<PyAny>>) -> PyResult<String> {
    let mut file = crate::scenario::from_keys(keys)?;
    let found = calibration::parse(toml).map_err(|problem| {
        input(format!("cannot read the calibration: {problem}: expected one as `calibrate` makes it"))
    })?;
    if let Some(table) = &mut file.recording {
        let given = table.clone();
        let read = move |bytes: &BytesRead| {
            files::recording_of_with(&given, "the call of track", Path::new(""), bytes).map_err(input)
        };
        let (recording, _) = interruptible(py, reading.as_ref(), read)?;
        let known: Vec<String> = recording.sensors().iter().map(|sensor| sensor.name.to_string()).collect();
        calibration::merge(&found, &known, table, &mut file.target.get_or_insert_default().noise_psd);
    }
    serde_json::to_string(&file).map_err(input)
}
