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
    assert_eq!(report["verdict"]["valid"], true, "{}", report["verdict"]);
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
    assert_eq!(run.report()["verdict"]["valid"], true, "{printed}");
    let recording = run.read("ranges.csv");
    let (header, rows) = recording.split_once('\n').unwrap();
    assert_eq!(header, "time_s,sensor_id,sensor_x_m,sensor_y_m,range_m,bearing_rad,sensor_heading_rad");
    assert_eq!(rows.lines().count(), 900);
    assert_tracked(&run, "--bearing-std 0.02 --accel-psd 0.2", 0.3);
}

/// The column of the recording says how far odometry may have drifted; from its growth the filter infers that errors stay.
#[test]
fn positions_that_become_uncertain_are_taken_as_a_drift_unless_flags_say_otherwise() {
    let run = Run::new();
    run.write(
        "drift.toml",
        "ticks = 600\n[target]\nstart = [0.0, 0.0, 1.0, 0.5]\nnoise_psd = 0.1\n[localiser.odometry]\nstd_m = 0.1\n\
         drift_m = 0.2\n[robots]\ncount = 4\nrange_std_m = 0.2\nlocaliser = \"odometry\"\n[planner]\nstand_off_m = 5.0\n",
    );
    run.lockstep("--in-process --write-recording drift.toml").finish().succeeded();
    let anees = |flags: &str| {
        let tracked = Run::new();
        for file in ["ranges.csv", "truth.csv"] {
            tracked.write(file, run.read(file));
        }
        let words = format!("track ranges.csv --truth truth.csv --in-process --range-std 0.2 --accel-psd 0.1 {flags}");
        tracked.command(&words).finish().succeeded();
        tracked.report()["anees"].as_f64().unwrap()
    };
    // Errors that drift for a minute are one draw, so a single run may be off by more than its band.
    let (known, inferred, white) = (run.report()["anees"].as_f64().unwrap(), anees(""), anees("--pose-std 0.1"));
    assert!((0.5..1.5).contains(&(inferred / known)) && white > 4.0 * known, "{known} {inferred} {white}");
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
