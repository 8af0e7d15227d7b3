//! Runs with real processes: the estimates are those of one process, whatever happens to the processes.

mod by_hand;
mod chaos;
mod disturbed;
mod drivers;
mod latency;
mod memory;
mod missing;
mod removed;
mod resources;
mod rogue;
mod standby;
mod strangers;

use std::collections::BTreeSet;

use serde_json::Value;

use crate::support::{Run, comm, digest_in_process};

#[test]
fn twenty_runs_and_one_process_give_one_digest_and_another_seed_another() {
    let words = "--robots 3 --ticks 50";
    let expected = digest_in_process(words);
    for _ in 0..20 {
        let run = Run::new();
        run.lockstep(words).finish().succeeded();
        assert_eq!(run.digest(), expected);
    }
    let other = Run::new();
    other.lockstep("--robots 3 --ticks 50 --seed 2").finish().succeeded();
    assert_ne!(other.digest(), expected);
}

#[test]
fn teams_of_every_size_and_every_planner_do_as_one_process_does() {
    for planner in ["adaptive", "standard", "certified --stand-off 2"] {
        for (robots, ticks) in [(1, 100), (3, 100), (10, 50), (32, 20)] {
            let words = format!("--robots {robots} --ticks {ticks} --planner {planner}");
            let run = Run::new();
            run.lockstep(&words).finish().succeeded();
            assert_eq!(run.digest(), digest_in_process(&words), "{words}");
            let report = run.report();
            for key in ["published", "fused"] {
                assert_eq!(report["ranges"][key], robots * ticks, "{words}: {key}");
            }
            for key in ["rejected", "late", "missing"] {
                assert_eq!(report["ranges"][key], 0, "{words}: {key}");
            }
            assert_eq!(report["latency_us"]["count"], robots * ticks, "{words}");
        }
    }
}

#[test]
fn a_team_of_128_starts_and_finishes() {
    let run = Run::new();
    run.lockstep("--robots 128 --ticks 3").finish().succeeded();
    let report = run.report();
    assert_eq!(report["ticks"], 3);
    assert_eq!(report["ranges"]["fused"], 3 * 128);
    assert_eq!(report["nodes"].as_array().unwrap().len(), 130);
    run.assert_nothing_left();
}

#[test]
fn two_runs_side_by_side_do_not_touch_each_other() {
    let words = ["--ticks 3000 --seed 11", "--ticks 3000 --seed 12"];
    let runs = [Run::new(), Run::new()];
    let processes: Vec<_> = runs.iter().zip(words).map(|(run, words)| run.lockstep(words)).collect();
    for (process, (run, words)) in processes.into_iter().zip(runs.iter().zip(words)) {
        process.finish().succeeded();
        assert_eq!(run.digest(), digest_in_process(words));
        run.assert_nothing_left();
    }
}

#[test]
fn real_time_counts_what_it_did() {
    let run = Run::new();
    run.write("fast.toml", "dt_s = 0.01\nticks = 100\n");
    run.command("run fast.toml --clock realtime").finish().succeeded();
    let report = run.report();
    assert_eq!(report["clock"], "realtime");
    assert_eq!(report["ticks"], 100);
    // The clock never runs ahead: 100 steps of 10 ms take at least 1 s.
    assert!(report["wall_s"].as_f64().unwrap() > 0.99, "{report}");
    let count = |table: &str, key: &str| report[table][key].as_u64().unwrap();
    assert!(count("ranges", "published") > 0 && count("latency_us", "count") > 0, "{report}");
    // Late or not, each tick counts each robot.
    assert_eq!(count("ranges", "fused") + count("ranges", "missing"), 300, "{report}");
    run.assert_nothing_left();
}

#[test]
fn nodes_have_distinct_names() {
    let run = Run::new();
    let _supervisor = run.command("run --clock realtime --ticks 100000 --robots 2");
    for role in ["sim", "fusion", "robot-0", "robot-1"] {
        assert_eq!(comm(run.pid_of(role, 1)), format!("rh-{role}"));
    }
}

fn keys(value: &Value) -> BTreeSet<&str> {
    value.as_object().unwrap().keys().map(String::as_str).collect()
}

fn words(text: &str) -> BTreeSet<&str> {
    text.split_whitespace().collect()
}

#[test]
fn the_report_has_the_agreed_keys() {
    for words_of_run in ["--ticks 20", "--ticks 20 --in-process"] {
        let run = Run::new();
        run.lockstep(words_of_run).finish().succeeded();
        let report = run.report();
        let top = "scenario seed clock planner robots ticks wall_s ticks_per_s digest position_rmse_m anees \
                   nis_mean nis_all_mean gate_widened position_trace_m2 ranges sensors headings refused distrusted latency_us hops_us nodes recording verdict";
        assert_eq!(keys(&report), words(top));
        assert_eq!(keys(&report["position_trace_m2"]), words("final median"));
        assert_eq!(keys(&report["ranges"]), words("published fused rejected late fused_late missing"));
        assert_eq!(keys(&report["refused"]), words("impostor out_of_range malformed future contradiction jump"));
        assert!(report["refused"].as_object().unwrap().values().all(|count| *count == 0), "{report}");
        assert_eq!(report["distrusted"], serde_json::json!([]));
        assert_eq!((&report["gate_widened"], &report["nis_all_mean"]), (&serde_json::json!(0), &report["nis_mean"]));
        for (id, sensor) in report["sensors"].as_array().unwrap().iter().enumerate() {
            assert_eq!(keys(sensor), words("name ranges fused rejected distrusted nis_mean"));
            assert_eq!(
                (&sensor["name"], &sensor["fused"]),
                (&serde_json::json!(id.to_string()), &serde_json::json!(20))
            );
        }
        assert_eq!(keys(&report["headings"]), words("fresh late none refused"));
        assert_eq!(keys(&report["latency_us"]), words("count p50 p90 p99 p99_9 max"));
        let nodes = report["nodes"].as_array().unwrap();
        for node in nodes {
            assert_eq!(keys(node), words("name starts kills exits hangs"));
        }
        let names: Vec<&str> = nodes.iter().filter_map(|node| node["name"].as_str()).collect();
        let expected: &[&str] =
            if words_of_run.contains("in-process") { &[] } else { &["sim", "fusion", "robot-0", "robot-1", "robot-2"] };
        assert_eq!(names, expected);
        for (key, value) in [("scenario", "paper"), ("clock", "lockstep"), ("planner", "adaptive")] {
            assert_eq!(report[key], value);
        }
        for (key, value) in [("seed", 5), ("robots", 3), ("ticks", 20)] {
            assert_eq!(report[key], value);
        }
        for key in ["wall_s", "ticks_per_s", "position_rmse_m", "anees", "nis_mean"] {
            assert!(report[key].as_f64().is_some_and(|value| value > 0.0), "{key}: {report}");
        }
    }
}

/// Rows of a CSV table with this header.
fn rows(text: &str, header: &str) -> Vec<Vec<f64>> {
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some(header));
    let rows: Vec<Vec<f64>> = lines.map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect()).collect();
    let columns = header.split(',').count();
    assert!(rows.iter().all(|row| row.len() == columns && row.iter().all(|value| value.is_finite())), "{text}");
    rows
}

#[test]
fn the_run_folder_has_the_agreed_files_and_a_recording_that_can_be_tracked() {
    let run = Run::new();
    run.lockstep("--ticks 60 --write-recording").finish().succeeded();
    let listing = |folder: &str| -> BTreeSet<String> {
        let entries = std::fs::read_dir(run.path(folder)).unwrap().flatten();
        entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect()
    };
    let files = ".rangehound estimate.csv estimate.ticks fusion.checkpoint logs picture.svg ranges.csv report.html report.json run.sealed scenario.toml \
         sim.checkpoint truth.csv world.ticks";
    assert!(listing("out").iter().map(String::as_str).eq(words(files)), "{:?}", listing("out"));
    let logs = "fusion.log robot-0.log robot-1.log robot-2.log sim.log";
    assert!(listing("out/logs").iter().map(String::as_str).eq(words(logs)), "{:?}", listing("out/logs"));

    let estimate_header = "time_s,x_m,y_m,vx_mps,vy_mps,var_x_m2,cov_xy_m2,var_y_m2";
    let estimates = rows(&run.read("estimate.csv"), estimate_header);
    assert_eq!(estimates.len(), 61);
    assert!(estimates.iter().enumerate().all(|(tick, row)| (row[0] - 0.1 * tick as f64).abs() < 1e-9));
    let last = &estimates[60];
    let trace_m2 = run.report()["position_trace_m2"]["final"].as_f64().unwrap();
    assert!((last[5] + last[7] - trace_m2).abs() < 1e-9 * trace_m2, "{last:?} {trace_m2}");
    assert_eq!(rows(&run.read("truth.csv"), "time_s,x_m,y_m").len(), 61);
    let ranges = rows(&run.read("ranges.csv"), "time_s,sensor_id,sensor_x_m,sensor_y_m,range_m");
    assert_eq!(ranges.len(), 3 * 60);

    let tracked = Run::new();
    for file in ["ranges.csv", "truth.csv"] {
        tracked.write(file, run.read(file));
    }
    let track = "track ranges.csv --range-std 1.0 --accel-psd 10 --truth truth.csv";
    tracked.command(track).finish().succeeded();
    assert_eq!(rows(&tracked.read("estimate.csv"), estimate_header).len(), 60);
    assert_eq!(tracked.report()["robots"], 3);
    assert!(tracked.report()["position_rmse_m"].as_f64().is_some());
    tracked.assert_nothing_left();
}

#[test]
fn the_scenario_in_the_run_folder_leads_to_the_same_run() {
    let run = Run::new();
    run.lockstep("--ticks 40 --robots 2 --seed 5 --planner random").finish().succeeded();
    let again = Run::new();
    again.write("again.toml", run.read("scenario.toml"));
    again.command("run again.toml").finish().succeeded();
    assert_eq!(again.digest(), run.digest());
}
