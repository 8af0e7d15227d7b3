//! A checked scenario.

use std::path::{Path, PathBuf};

use pyo3::prelude::*;
use rangehound::failure;
use rangehound::files::input as files;
use rangehound::files::layout::SCENARIO;
use rangehound::run::experiment::Given;
use rangehound_fusion::planner;
use rangehound_shared::scenario::{self as shared, ScenarioFile, Source};
use serde_json::Value;

use crate::errors::{InputError, failed, input, interruptible};

/// Stands in errors for the name of a file.
const NAMELESS: &str = "the scenario";

/// A checked scenario, and the file or keys that it was made of.
#[pyclass(frozen, subclass, module = "rangehound._native", name = "Scenario")]
pub(crate) struct Scenario {
    pub(crate) given: Given,
    pub(crate) checked: shared::Scenario,
}

impl Scenario {
    pub(crate) fn of(py: Python<'_>, given: Given, progress: Option<&Py<PyAny>>) -> PyResult<Self> {
        let Given { file, file_name, folder, .. } = &given;
        let checked = if file.recording.is_some() {
            let (file, file_name, folder) = (file.clone(), file_name.clone(), folder.clone());
            interruptible(py, progress, move |bytes| {
                files::scenario_with(&file, &file_name, &folder, bytes).map_err(input)
            })?
        } else {
            files::scenario(file, file_name, folder).map_err(input)?
        };
        planner::for_team(checked.planner, checked.robots.len(), checked.seed)
            .map_err(|error| input(failure::located(error, file_name)))?;
        Ok(Self { given, checked })
    }

    /// The scenario of a run folder, if its file is there and can be used again.
    pub(crate) fn of_run(py: Python<'_>, folder: &Path) -> PyResult<Option<Self>> {
        let Ok(given) = Given::read(Some(&folder.join(SCENARIO))) else { return Ok(None) };
        match Self::of(py, given, None) {
            Err(error) if error.is_instance_of::<InputError>(py) => Ok(None),
            scenario => scenario.map(Some),
        }
    }

    /// The scenario that is run: with another seed and length, if they are given.
    pub(crate) fn with(&self, py: Python<'_>, seed: Option<u64>, ticks: Option<u64>) -> PyResult<shared::Scenario> {
        if seed.is_none() && ticks.is_none() {
            return Ok(self.checked.clone());
        }
        let mut given = self.given.clone();
        given.file.seed = seed.or(given.file.seed);
        given.file.ticks = ticks.or(given.file.ticks);
        Self::of(py, given, None).map(|scenario| scenario.checked)
    }
}

#[pymethods]
impl Scenario {
    /// `path`: a scenario file. `keys`: JSON of a scenario file. Neither: the paper's experiment. `over`: JSON of keys that
    /// replace those of the same name. `progress`: a function of the bytes of its recording that have been read, and of all.
    #[new]
    #[pyo3(signature = (path=None, keys=None, over=None, folder=None, progress=None))]
    fn new(
        py: Python<'_>,
        path: Option<PathBuf>,
        keys: Option<&str>,
        over: Option<&str>,
        folder: Option<PathBuf>,
        progress: Option<Py<PyAny>>,
    ) -> PyResult<Self> {
        let mut given = match keys {
            Some(keys) => Given {
                file: from_keys(keys)?,
                file_name: NAMELESS.to_owned(),
                folder: folder.unwrap_or_default(),
                path: None,
                flags: Vec::new(),
            },
            None => Given::read(path.as_deref()).map_err(failed)?,
        };
        if given.path.is_none() {
            given.file_name = NAMELESS.to_owned();
        }
        if let Some(over) = over {
            let over = serde_json::from_str(over).map_err(input)?;
            let mut merged = serde_json::to_value(&given.file).map_err(input)?;
            merge(&mut merged, over);
            given.file = from_keys(&merged.to_string())?;
        }
        Self::of(py, given, progress.as_ref())
    }

    /// Its keys as JSON.
    fn keys(&self) -> PyResult<String> {
        let mut keys = serde_json::to_value(&self.given.file).map_err(input)?;
        strip(&mut keys);
        Ok(keys.to_string())
    }

    /// The folder that relative paths in it start from.
    #[getter]
    fn folder(&self) -> PathBuf {
        self.given.folder.clone()
    }

    /// The text of a scenario file.
    fn to_toml(&self) -> PyResult<String> {
        self.given.file.to_toml().map_err(input)
    }

    /// Its name.
    #[getter]
    fn name(&self) -> &str {
        &self.checked.name
    }

    /// Time steps after tick 0.
    #[getter]
    fn ticks(&self) -> u64 {
        self.checked.ticks
    }

    /// Length of a time step, s.
    #[getter]
    fn dt_s(&self) -> f64 {
        self.checked.dt_s
    }

    /// Seed of all random numbers.
    #[getter]
    fn seed(&self) -> u64 {
        self.checked.seed
    }

    /// Number of robots, or of a recording's sensors.
    #[getter]
    fn robots(&self) -> usize {
        self.checked.robots.len()
    }

    /// Names of the robots.
    #[getter]
    fn robot_names(&self) -> Vec<String> {
        (0..self.checked.robots.len()).map(|id| self.checked.name_of(id)).collect()
    }

    /// Dimension n of the target's state.
    #[getter]
    fn state_dim(&self) -> usize {
        self.checked.motion.state_dim()
    }

    /// Name of the planner.
    #[getter]
    fn planner(&self) -> &'static str {
        self.checked.planner.name()
    }

    /// True if its measurements are recorded, not simulated.
    #[getter]
    fn is_recording(&self) -> bool {
        matches!(self.checked.source, Source::Recorded(_))
    }

    /// Lines about how its recording was read: what was skipped, and what is in doubt.
    #[getter]
    fn notes(&self) -> Vec<String> {
        match &self.checked.source {
            Source::Recorded(ranges) => ranges.summary.lines().iter().map(ToString::to_string).collect(),
            Source::Simulated { .. } => Vec::new(),
        }
    }
}

/// Reads the keys of a scenario file from JSON.
pub(crate) fn from_keys(json: &str) -> PyResult<ScenarioFile> {
    let reader = &mut serde_json::Deserializer::from_str(json);
    serde_path_to_error::deserialize(reader).map_err(|error| {
        let key = error.path().to_string();
        let message = error.inner().to_string();
        let message = message.rsplit_once(" at line ").map_or(message.as_str(), |(message, _)| message);
        let (problem, expected) = message.split_once(", expected ").unwrap_or((message, "another value"));
        let expected = match expected.trim_start_matches("expected ") {
            "u64" => "a whole number that is not negative",
            "f64" => "a number",
            other => other,
        };
        let key = if key == "." { "top level" } else { &key };
        input(format!("{problem} in {NAMELESS}, key {key}: expected {expected}"))
    })
}

/// Puts the values of `over` over those of `base`, table by table.
fn merge(base: &mut Value, over: Value) {
    match (base, over) {
        (Value::Object(base), Value::Object(over)) => {
            for (key, value) in over {
                merge(base.entry(key).or_insert(Value::Null), value);
            }
        }
        (base, over) => *base = over,
    }
}

/// Removes keys without a value.
fn strip(value: &mut Value) {
    match value {
        Value::Object(keys) => {
            keys.retain(|_, value| !value.is_null());
            keys.values_mut().for_each(strip);
        }
        Value::Array(values) => values.iter_mut().for_each(strip),
        _ => {}
    }
}
