//! How a recording gets into a run: read once from wherever it comes, then played from the run's own copy.

use std::fmt::Write as _;

use serde_json::Value;

use crate::support::Run;

/// A target that stands at (3, 4), and four sensors round it. One of them is wrong from a tick on, if asked.
fn recording(ticks: usize, wrong_from: usize) -> String {
    let mut csv = "time_s,sensor_id,sensor_x_m,sensor_y_m,range_m\n".to_owned();
    for tick in 1..=ticks {
        for (name, x, y) in [("40223", 0.0, 0.0), ("2938", 10.0, 0.0), ("B", 10.0, 8.0), ("C", 0.0, 8.0)] {
            let bias = if name == "2938" && tick >= wrong_from { 6.0 } else { 0.0 };
            let range = f64::hypot(3.0 - x, 4.0 - y) + bias;
            let _ = writeln!(csv, "{:.1},{name},{x},{y},{range:.3}", 0.1 * tick as f64);
        }
    }
    csv
}

fn digest(run: &Run) -> String {
    let report: Value = serde_json::from_str(&run.read("report.json")).unwrap();
    report["digest"].as_str().unwrap().to_owned()
}

/// Shell words that track in one process, with the program as `"$0"`.
fn shell(run: &Run, words: &str) -> std::process::Output {
    std::process::Command::new("bash")
        .args(["-c", words, crate::support::PROGRAM])
        .current_dir(run.path("."))
        .output()
        .unwrap()
}

#[test]
fn a_pipe_a_fifo_and_standard_input_are_read_once_and_give_the_same() {
    let flags = "--in-process --no-record --range-std 0.1 --accel-psd 0.1";
    let mut digests = Vec::new();
    for input in ["r.csv", "<(cat r.csv)", "- < r.csv", "/dev/stdin < <(cat r.csv)", "fifo"] {
        let run = Run::new();
        run.write("r.csv", recording(50, usize::MAX));
        let words =
            format!("mkfifo fifo; [ {input:?} = fifo ] && cat r.csv > fifo & \"$0\" track {input} --out out {flags}");
        let output = shell(&run, &words);
        assert!(output.status.success(), "{input}: {output:?}");
        digests.push(digest(&run));
    }
    assert!(digests.iter().all(|other| *other == digests[0]), "{digests:?}");
}

#[test]
fn the_run_folder_repeats_the_run() {
    let run = Run::new();
    run.write("r.csv", recording(50, usize::MAX).replace("range_m", "dist").replace("time_s", "t"));
    let columns = "--columns time=t:s,range=dist:m";
    let output = shell(&run, &format!("\"$0\" track r.csv {columns} --in-process --no-record --out out"));
    assert!(output.status.success(), "{output:?}");
    let first = digest(&run);
    std::fs::rename(run.path("out"), run.path("moved")).unwrap();
    let output = shell(&run, "rm r.csv; \"$0\" run moved/scenario.toml --in-process --no-record --out out");
    assert!(output.status.success(), "{output:?}");
    assert_eq!(first, digest(&run));
}

#[test]
fn a_changed_copy_is_refused_in_one_line() {
    let run = Run::new();
    run.write("r.csv", recording(50, usize::MAX));
    let output = shell(&run, "\"$0\" track r.csv --in-process --no-record --out out");
    assert!(output.status.success(), "{output:?}");
    let copy = run.read("recording.csv");
    std::fs::write(run.path("out/recording.csv"), copy.replace(",10,8,", ",60,8,")).unwrap();
    let name = &run.name;
    let words =
        format!("rm -f out/*.checkpoint out/*.ticks; \"$0\" resume out --name {name} --no-record --restart never");
    let output = shell(&run, &words);
    assert!(!output.status.success(), "{output:?}");
    let said = String::from_utf8_lossy(&output.stderr).into_owned()
        + &std::fs::read_to_string(run.path("out/logs/sim.log")).unwrap_or_default();
    assert!(said.contains("recording.csv: it has changed since the run began"), "{said}");
}

#[test]
fn a_sensor_is_called_by_its_name() {
    let run = Run::new();
    run.write("r.csv", recording(200, 100));
    let output = shell(&run, "\"$0\" track r.csv --in-process --no-record --out out --range-std 0.1 --accel-psd 0.1");
    let printed = String::from_utf8_lossy(&output.stdout);
    assert!(printed.contains("sensor 2938 from tick"), "{output:?}");
    let report: Value = serde_json::from_str(&run.read("report.json")).unwrap();
    assert_eq!(report["distrusted"][0]["sensor"], "2938");
    assert_eq!(report["recording"]["rows"], 800);
    assert!(run.read("report.html").contains("sensor 2938 distrusted"));
}

#[test]
fn one_sensor_and_a_known_start_are_a_recording() {
    let run = Run::new();
    let mut csv = "time_s,sensor_id,sensor_x_m,sensor_y_m,range_m\n".to_owned();
    for tick in 0..200 {
        let angle = 0.05 * f64::from(tick);
        let (x, y) = (6.0 * angle.cos(), 6.0 * angle.sin());
        let _ = writeln!(csv, "{},b,{x},{y},{}", 0.1 * f64::from(tick), f64::hypot(3.0 - x, 4.0 - y));
    }
    run.write("r.csv", csv);
    let flags = "--start 3,4 --start-std 0.2 --range-std 0.1 --accel-psd 0.01";
    let output = shell(&run, &format!("\"$0\" track r.csv {flags} --in-process --no-record --out out"));
    assert!(output.status.success(), "{output:?}");
    let first = run.read("estimate.csv");
    let fields: Vec<f64> = first.lines().nth(1).unwrap().split(',').map(|field| field.parse().unwrap()).collect();
    assert!((fields[1] - 3.0).abs() < 0.2 && (fields[2] - 4.0).abs() < 0.2, "{fields:?}");
}

#[test]
fn what_is_no_recording_is_refused_in_one_line() {
    for input in ["/dev/zero", ".", "empty", "r.csv --target-height 1", "r.csv --start-std 1"] {
        let run = Run::new();
        run.write("r.csv", recording(5, usize::MAX));
        run.write("empty", "");
        let output = shell(&run, &format!("\"$0\" track {input} --in-process --no-record --out out"));
        assert_eq!(output.status.code(), Some(2), "{input}: {output:?}");
        assert!(!run.path("out").exists(), "{input}");
    }
}
