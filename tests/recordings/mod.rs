//! Recorded ranges: the shipped recording, and real ones if they are beside the project.

pub(crate) mod bags;
mod intake;
mod verdicts;

use std::path::{Path, PathBuf};

use nalgebra::Vector2;
use rangehound::files::input;
use rangehound::results::report::Truth;
use rangehound::run::in_process::Team;
use rangehound_shared::scenario::{
    FilterTable, GateKey, RecordedSensorTable, RecordingTable, Scenario, ScenarioFile, TargetTable,
};

/// A recording with its assumed noise.
struct Case {
    folder: PathBuf,
    accel_psd: f64,
    range_std_m: f64,
    bias_m: f64,
    scale: f64,
    /// Time that the start may take, s.
    start_s: f64,
}

impl Case {
    fn scenario(&self) -> Scenario {
        let file = ScenarioFile {
            recording: Some(RecordingTable {
                ranges: Some("ranges.csv".to_owned()),
                range_std_m: Some(self.range_std_m),
                bias_m: Some(self.bias_m),
                scale: Some(self.scale),
                ..RecordingTable::default()
            }),
            target: Some(TargetTable { noise_psd: Some(self.accel_psd), ..TargetTable::default() }),
            ..ScenarioFile::default()
        };
        input::scenario(&file, "test", &self.folder).unwrap()
    }

    /// Position errors after the start, ascending, m.
    fn errors_m(&self) -> Vec<f64> {
        let truth = Truth::read(&self.folder.join("truth.csv")).unwrap();
        let mut errors = errors_m(&self.scenario(), &truth, self.start_s);
        errors.sort_by(f64::total_cmp);
        errors
    }
}

fn errors_m(scenario: &Scenario, truth: &Truth, start_s: f64) -> Vec<f64> {
    let mut team = Team::new(scenario).unwrap();
    let first_s = team.world().time_s();
    let mut errors = Vec::new();
    for _ in 0..=scenario.ticks {
        team.tick().unwrap();
        let time_s = team.world().time_s();
        if time_s > first_s + start_s
            && let Some(truth_m) = truth.at(time_s)
        {
            let state = team.centre().state();
            errors.push((Vector2::new(state[0], state[1]) - truth_m).norm());
        }
        team.advance();
    }
    errors
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64).sqrt()
}

/// Path of real recordings beside the project; they are not part of it.
fn real(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data").join(name);
    assert!(folder.join("ranges.csv").exists(), "the recording {name} is not at {}", folder.display());
    folder
}

fn shipped() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/recording")
}

#[test]
fn the_shipped_recording_is_tracked_from_its_ranges_alone() {
    let case = Case { folder: shipped(), accel_psd: 0.05, range_std_m: 0.15, bias_m: 0.0, scale: 0.0, start_s: 5.0 };
    let errors = case.errors_m();
    assert!(errors.len() > 200 && rms(&errors) < 0.25, "{} m over {}", rms(&errors), errors.len());
}

#[test]
#[ignore = "needs recordings that are not part of the project, in ../shared/data; .ci/run runs it where they are"]
fn real_recordings_are_tracked_to_the_figures() {
    let cases = [
        ("labyrinth", 0.2, 0.12, 0.0, 0.0, 3.0, 0.25, f64::INFINITY),
        ("lias_uwb_mid", 0.2, 0.23, 0.0, 0.0, 10.0, 0.18, f64::INFINITY),
        ("lias_uwb_mid", 0.2, 0.23, 0.184, 0.0078, 10.0, 0.10, f64::INFINITY),
        ("plaza1", 1.0, 0.5, 0.032, 0.0694, 10.0, f64::INFINITY, 0.65),
        ("murp17", 0.2, 0.25, 0.0, 0.0, 10.0, 1.5, f64::INFINITY),
    ];
    for (name, accel_psd, range_std_m, bias_m, scale, start_s, rms_max_m, median_max_m) in cases {
        let errors = Case { folder: real(name), accel_psd, range_std_m, bias_m, scale, start_s }.errors_m();
        let (rms_m, median_m) = (rms(&errors), errors[errors.len() / 2]);
        println!("{name} bias {bias_m} scale {scale}: {rms_m:.3} m RMS, {median_m:.3} m median");
        assert!(rms_m <= rms_max_m && median_m <= median_max_m, "{name}: {rms_m} {median_m}");
    }
}

/// Each sensor's own calibration is removed from its own ranges.
#[test]
fn bias_and_scale_of_one_sensor_are_its_own() {
    let sensor = |bias_m, scale| RecordedSensorTable {
        id: "2".parse().unwrap(),
        bias_m: Some(bias_m),
        scale: Some(scale),
        range_std_m: Some(0.3),
    };
    let file = |sensor: Option<Vec<RecordedSensorTable>>| ScenarioFile {
        recording: Some(RecordingTable { ranges: Some("ranges.csv".to_owned()), sensor, ..RecordingTable::default() }),
        filter: Some(FilterTable { gate_sigma: Some(GateKey::Sigma(3.0)), ..FilterTable::default() }),
        ..ScenarioFile::default()
    };
    let plain = input::scenario(&file(None), "test", &shipped()).unwrap();
    let special = input::scenario(&file(Some(vec![sensor(0.5, 0.1)])), "test", &shipped()).unwrap();
    assert_eq!(plain.robots[..2], special.robots[..2]);
    assert_eq!((special.robots[2].calibration.bias_m, special.robots[2].sensor.range.unwrap().std_m), (0.5, 0.3));

    let unknown = RecordedSensorTable::new("77".parse().unwrap());
    let error = input::scenario(&file(Some(vec![unknown])), "test", &shipped()).unwrap_err().to_string();
    assert!(
        error.contains("recording.sensor[0].id is 77 in test: expected a sensor of the recording (0, 1, 2)"),
        "{error}"
    );
    let twice = vec![sensor(0.1, 0.0), sensor(0.2, 0.0)];
    let error = input::scenario(&file(Some(twice)), "test", &shipped()).unwrap_err().to_string();
    assert!(error.contains("2 for the second time"), "{error}");
}
