//! Runs with bearings and uncertain robots: what the report says, and the run as a recording that `track` reads.

use std::path::Path;

use serde_json::Value;

use crate::support::Run;

/// A run of one of the project's scenarios, as a recording too.
fn run_of(scenario: &str) -> (Run, String) {
    let run = Run::new();
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios").join(scenario);
    let outcome = run.lockstep(&format!("--in-process --write-recording {}", path.display())).finish().succeeded();
    (run, outcome.stdout)
}

fn totals(report: &Value, keys: [&str; 2]) -> [u64; 2] {
    let sensors = report["sensors"].as_array().unwrap();
    keys.map(|key| sensors.iter().filter_map(|sensor| sensor.get(key)?.as_u64()).sum())
}

/// Tracks the recording of a run, and compares with the run's own report.
#[track_caller]
fn assert_tracked(run: &Run, flags: &str, rmse_max_m: f64) {
    let tracked = Run::new();
    for file in ["ranges.csv", "truth.csv"] {
        tracked.write(file, run.read(file));
    }
    tracked.command(&format!("track ranges.csv --truth truth.csv --in-process --strict {flags}")).finish().succeeded();
    let (before, report) = (run.report(), tracked.report());
    let keys = ["ranges", "bearings"];
    assert_eq!(totals(&report, keys), totals(&before, keys), "{report}");
    assert_eq!(report["recording"]["ignored_columns"], Value::Array(Vec::new()));
    assert!(report["position_rmse_m"].as_f64().unwrap() < rmse_max_m, "{}", report["position_rmse_m"]);
}

#[test]
fn a_team_with_cameras_radios_and_uncertain_robots_is_reported_and_read_back() {
    let (run, printed) = run_of("mixed_sensors.toml");
    let report = run.report();
    assert_eq!(report["verdict"]["sound"], true, "{}", report["verdict"]);
    assert!(printed.contains("measurements") && printed.contains("measurements fused"), "{printed}");
    let sensor = |robot: usize| &report["sensors"][robot];
    assert!(sensor(0)["ranges"] == 400 && sensor(0).get("bearings").is_none(), "{}", sensor(0));
    assert!(sensor(2)["ranges"] == 0 && sensor(2)["bearings_fused"].as_u64() > Some(100), "{}", sensor(2));
    assert!(sensor(4)["ranges"] == 400 && sensor(4)["bearings"] == 400, "{}", sensor(4));
    let [ranges, bearings] = totals(&report, ["fused", "bearings_fused"]);
    assert_eq!(report["ranges"]["fused"], ranges + bearings);
    assert_eq!(report["ranges"]["published"], ranges + bearings);
    let page = run.read("report.html");
    for expected in ["<dt>measurements</dt>", "NIS for each measurement", "Pale lines are bearings", "its own 3 sigma"]
    {
        assert!(page.contains(expected), "{expected}");
    }
    let header = "time_s,sensor_id,sensor_x_m,sensor_y_m,range_m,bearing_rad,sensor_heading_rad,sensor_std_m,\
                  sensor_heading_std_rad\n";
    assert!(run.read("ranges.csv").starts_with(header));
    assert_tracked(&run, "--range-std 0.5 --bearing-std 0.03 --accel-psd 0.2 --pose-correlation 30", 0.5);
}

#[test]
fn cameras_alone_are_reported_and_read_back_without_columns_that_they_do_not_need() {
    let (run, printed) = run_of("cameras.toml");
    assert_eq!(run.report()["verdict"]["sound"], true, "{printed}");
    let recording = run.read("ranges.csv");
    let (header, rows) = recording.split_once('\n').unwrap();
    assert_eq!(header, "time_s,sensor_id,sensor_x_m,sensor_y_m,range_m,bearing_rad,sensor_heading_rad");
    assert_eq!(rows.lines().count(), 900);
    assert_tracked(&run, "--bearing-std 0.02 --accel-psd 0.2", 0.3);
}

#[test]
fn a_replay_with_bearings_refuses_the_planner_that_serves_only_ranges() {
    let run = Run::new();
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/cameras.toml");
    run.lockstep(&format!("--record --in-process --ticks 5 {}", path.display())).finish().succeeded();
    let refused = run.start(&["replay", "out/run.mcap", "--planner", "grid"]).finish();
    assert_eq!(refused.code, Some(2), "{refused:#?}");
    assert!(refused.stderr.contains("--planner is \"grid\": expected another planner"), "{}", refused.stderr);
}
