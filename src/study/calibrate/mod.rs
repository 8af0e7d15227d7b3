//! `rangehound calibrate`: noise, bias and scale of each sensor from a recording, with or without the true track.
//!
//! | module | what |
//! |---|---|
//! | [`model`] | readings by knots of the path, and the models of systematic error |
//! | [`smoother`] | robust estimate of path and errors together |
//! | [`search`] | the fits of all models to the ranges alone |
//! | [`verdict`] | selection of a model, and what the data cannot determine |
//! | [`regression`] | errors against a known track |
//! | `text` | `calibration.toml` |
//! | [`picture`] | residuals over range |

pub mod model;
pub mod picture;
pub mod regression;
pub mod search;
#[allow(clippy::needless_range_loop, reason = "matrices by row and column, as in the equations")]
pub mod smoother;
mod text;
pub mod verdict;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use nalgebra::Vector4;
use rangehound_shared::recording::{RecordedMeasurement, Recording};
use rangehound_shared::scenario::RecordingTable;
use serde::ser::SerializeMap;
use serde::{Serialize, Serializer};

use crate::failure::{self, Failure};
use crate::files::atomic_file;
use crate::files::input::{self, COMMAND_LINE};
use crate::files::layout::Kind;
use crate::files::layout::{CALIBRATION, RESIDUALS};
use crate::files::out_folder::claim_or_number;
use crate::results::report::Truth;
use crate::run::experiment::Flag;
use crate::run::watch::Progress;
use crate::statistics::median;
use crate::terminal;
use model::{Measured, Model, Problem, Reading};
use verdict::Findings;

/// Default output folder.
const OUT: &str = "runs/calibrate";

/// `rangehound calibrate`, against the true track if it is given. `flags` are the keys of `table` that flags gave, and
/// `truth_file` is the file that the truth was read from, if any.
///
/// # Errors
/// [`Failure`]; also if nothing could be determined.
pub fn calibrate(
    table: &RecordingTable,
    flags: &[Flag],
    truth: Option<&Truth>,
    truth_file: Option<&Path>,
    out: Option<&Path>,
    json: bool,
) -> Result<(), Failure> {
    let read = input::recording_of(table, COMMAND_LINE, Path::new(""))
        .map_err(|error| Failure::input(error.by_flag(flags)))?;
    check(table, &read.0)?;
    read.1.lines().iter().for_each(|line| failure::print_stderr(format_args!("recording: {line}")));
    let mut inputs: Vec<PathBuf> = table.inputs(Path::new("")).collect();
    inputs.extend(truth_file.map(Path::to_owned));
    let inputs: Vec<&Path> = inputs.iter().map(PathBuf::as_path).collect();
    let claim = claim_or_number(out, OUT, Kind::Calibrate, &inputs)?;
    let out = claim.path();
    let mut progress = Progress::new("model", Model::ALL.len() as u64);
    let found = Found::of(&read.0, table.target_height_m, truth, |done| progress.show(done as u64, ""), &|| true);
    progress.finish();
    let Found { names, findings, points, ranges, used } = &found;
    if used < ranges {
        failure::print_stderr(format_args!("{used} of {ranges} ranges are used, spread evenly in time"));
    }
    if found.is_determined() {
        atomic_file::write(&out.join(CALIBRATION), found.to_toml())?;
        picture::draw(points, names, out)?;
    }
    if json {
        failure::print_json(&found)?;
    } else {
        let ranges = table.ranges.as_deref().unwrap_or_default();
        failure::print(report(findings, names, ranges, out, found.is_determined()))?;
    }
    if found.is_determined() {
        return Ok(());
    }
    Err(Failure::Running(anyhow::anyhow!("no calibration was written: cannot determine {}", found.obstacle())))
}

/// Checks that a recording can be calibrated.
///
/// # Errors
/// [`Failure::Input`] if it has no ranges, or heights are incomplete.
pub fn check(table: &RecordingTable, recording: &Recording) -> Result<(), Failure> {
    let ranges = table.ranges.as_deref().unwrap_or_default();
    if table.target_height_m.is_some() && !recording.has_heights() {
        return Err(Failure::input(format!(
            "--target-height is given without heights of the sensors in {ranges}: expected a column sensor_z_m, or z_m in \
             the anchors' file"
        )));
    }
    if !recording.has_ranges() {
        return Err(Failure::input(format!("no range in {ranges}: expected ranges: bearings cannot be calibrated")));
    }
    Ok(())
}

/// The result of a calibration.
#[derive(Debug)]
pub struct Found {
    /// Names of the sensors that have ranges.
    pub names: Vec<String>,
    /// Their errors, in the same order.
    pub findings: Findings,
    /// Range and residual of each reading, m, by sensor.
    pub points: Points,
    /// Ranges in the recording.
    pub ranges: usize,
    /// Ranges that were used, spread evenly in time.
    pub used: usize,
}

impl Found {
    /// Calibrates the sensors of a recording, against the true track if it is given. `show` receives the number of models
    /// that have been fitted. Once `go_on` says no, the fits end at their next step, and what is found has no meaning.
    #[must_use]
    pub fn of(
        recording: &Recording,
        target_height_m: Option<f64>,
        truth: Option<&Truth>,
        show: impl FnMut(usize),
        go_on: &dyn Fn() -> bool,
    ) -> Self {
        let (names, readings) = readings(recording, target_height_m);
        let problem = Problem::new(&readings, names.len());
        let (findings, points) = match truth {
            Some(truth) => against_truth(&readings, &names, truth, go_on),
            None => from_ranges(&readings, &problem, show, go_on),
        };
        let used = if problem.thinned > 0 { problem.observations.len() } else { readings.len() };
        Self { names, findings, points, ranges: readings.len(), used }
    }

    /// True if the data determine the noise of a sensor and the manoeuvres of the target.
    #[must_use]
    pub fn is_determined(&self) -> bool {
        self.findings.sensors.iter().any(|sensor| sensor.range_std_m.is_some()) && self.findings.accel_psd.is_some()
    }

    /// The values that the data do not determine, and why.
    #[must_use]
    pub fn obstacle(&self) -> &str {
        self.findings.undetermined.first().map_or("nothing was found", String::as_str)
    }

    /// The text of `calibration.toml`.
    #[must_use]
    pub fn to_toml(&self) -> String {
        text::text(&self.findings, &self.names)
    }
}

impl Serialize for Found {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let Self { names, findings, .. } = self;
        let mut map = serializer.serialize_map(Some(3))?;
        map.serialize_entry("determined", &self.is_determined())?;
        map.serialize_entry("sensor_ids", names)?;
        map.serialize_entry("findings", findings)?;
        map.end()
    }
}

/// The ranges, and the names of the sensors that have any.
fn readings(recording: &Recording, target_height_m: Option<f64>) -> (Vec<String>, Vec<Reading>) {
    let reading = |time_s: f64, measurement: RecordedMeasurement| {
        let RecordedMeasurement { sensor, position_m, height_m, range_m, .. } = measurement;
        let height_m = target_height_m.zip(height_m).map_or(0.0, |(target_m, sensor_m)| sensor_m - target_m);
        Some(Reading { time_s, sensor, position_m, height_m, range_m: range_m? })
    };
    let instants = (0..recording.len()).filter_map(|index| recording.instant(index));
    let readings = instants.flat_map(|(time_s, of)| of.filter_map(move |measurement| reading(time_s, measurement)));
    let mut readings: Vec<Reading> = readings.collect();
    let mut has_range = vec![false; recording.sensors().len()];
    readings.iter().for_each(|reading| has_range[reading.sensor] = true);
    let (mut numbers, mut names) = (Vec::new(), Vec::new());
    for (sensor, has_range) in recording.sensors().iter().zip(has_range) {
        numbers.push(names.len());
        if has_range {
            names.push(sensor.name.to_string());
        }
    }
    readings.iter_mut().for_each(|reading| reading.sensor = numbers[reading.sensor]);
    (names, readings)
}

/// Range and residual of each reading, by sensor.
pub type Points = Vec<Vec<(f64, f64)>>;

fn from_ranges(
    readings: &[Reading],
    problem: &Problem,
    show: impl FnMut(usize),
    go_on: &dyn Fn() -> bool,
) -> (Findings, Points) {
    if let Some(why) = verdict::obstacle(readings, problem.sensors) {
        let mut counts = vec![0; problem.sensors];
        readings.iter().for_each(|reading| counts[reading.sensor] += 1);
        return (Findings::nothing(&counts, &why), Vec::new());
    }
    let fits = search::search(problem, show, go_on);
    let (findings, chosen) = verdict::judge(problem, &fits);
    let mut points = vec![Vec::new(); problem.sensors];
    if let Some(fit) = chosen {
        for (observation, residual) in problem.observations.iter().zip(&fit.solution.residuals_m) {
            points[observation.reading.sensor].push((observation.reading.range_m, *residual));
        }
    }
    (findings, points)
}

fn against_truth(
    readings: &[Reading],
    names: &[String],
    truth: &Truth,
    go_on: &dyn Fn() -> bool,
) -> (Findings, Points) {
    let mut pairs = vec![Vec::new(); names.len()];
    let mut in_time = Vec::new();
    for reading in readings {
        if let Some(at) = truth.at(reading.time_s) {
            let distance = reading.distance_m([at[0], at[1]]);
            pairs[reading.sensor].push((distance, reading.range_m - distance));
            in_time.push((reading, at));
        }
    }
    let mut findings = regression::regress(&pairs, names);
    let value = |measured: Option<Measured>| measured.map_or(0.0, |measured| measured.value);
    let corrected: Vec<Reading> = in_time
        .iter()
        .map(|(reading, _)| {
            let errors = &findings.sensors[reading.sensor];
            let range_m = (reading.range_m - value(errors.bias_m)) / (1.0 + value(errors.scale));
            Reading { range_m: range_m.max(0.0), ..**reading }
        })
        .collect();
    let problem = Problem::new(&corrected, names.len());
    let places = problem.knots_s.iter().map(|time_s| truth.at(*time_s).unwrap_or_default());
    let states = places.map(|place_m| Vector4::new(place_m.x, place_m.y, 0.0, 0.0)).collect();
    if !corrected.is_empty() {
        findings.accel_psd = search::manoeuvring(&problem, states, go_on);
    } else {
        findings.undetermined.insert(0, "anything: no range lies within the true track's time".to_owned());
    }
    let mut points = vec![Vec::new(); names.len()];
    for (sensor, pairs) in pairs.iter().enumerate() {
        let errors = &findings.sensors[sensor];
        let residual = |&(d, e): &(f64, f64)| (d + e, e - value(errors.bias_m) - value(errors.scale) * d);
        points[sensor] = pairs.iter().map(residual).collect();
    }
    (findings, points)
}

fn report(findings: &Findings, names: &[String], ranges: &str, out: &Path, found: bool) -> String {
    let title = terminal::TITLE;
    let mut text = format!("{title}calibration of {}{title:#}\n", ranges);
    let cell = |measured: Option<Measured>| {
        measured.map_or("undetermined".to_owned(), |m| format!("{:.4} ± {:.4}", m.value, m.half_width))
    };
    let _ = writeln!(text, "{:<12} {:>7}  {:>17}  {:>17}  {:>17}", "sensor", "ranges", "bias, m", "scale", "noise, m");
    for (name, errors) in names.iter().zip(&findings.sensors) {
        let (bias, scale, noise) = (cell(errors.bias_m), cell(errors.scale), cell(errors.range_std_m));
        let _ = writeln!(text, "{name:<12} {:>7}  {bias:>17}  {scale:>17}  {noise:>17}", errors.ranges);
    }
    if let Some(psd) = findings.accel_psd {
        let _ = writeln!(
            text,
            "acceleration's spectral density {:.4} ± {:.4} m^2/s^3; intervals are of 95 %",
            psd.value, psd.half_width
        );
    }
    for line in &findings.undetermined {
        let _ = writeln!(text, "cannot determine {line}");
    }
    if found {
        let path = out.join(CALIBRATION);
        let _ = writeln!(text, "\nuse it:\n  rangehound track {ranges} --calibration {}", path.display());
        let _ = writeln!(text, "or as flags:\n  {}", flags(findings, names));
        let _ = writeln!(text, "residuals over range in {}", out.join(RESIDUALS).display());
    }
    text
}

/// The same as flags of `track`, with one noise for all sensors.
fn flags(findings: &Findings, names: &[String]) -> String {
    let mut stds: Vec<f64> = findings.sensors.iter().filter_map(|s| s.range_std_m.map(|m| m.value)).collect();
    let mut text = median(&mut stds).map_or(String::new(), |std| format!("--range-std {std:.4}"));
    if let Some(psd) = findings.accel_psd {
        let _ = write!(text, " --accel-psd {:.6}", psd.value);
    }
    for (name, errors) in names.iter().zip(&findings.sensors) {
        if let Some(bias) = errors.bias_m {
            let _ = write!(text, " --range-bias {name}={:.4}", bias.value);
        }
        if let Some(scale) = errors.scale {
            let _ = write!(text, " --range-scale {name}={:.5}", scale.value);
        }
    }
    text
}
