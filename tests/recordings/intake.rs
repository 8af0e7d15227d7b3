//! Input of a recording into a run: read once from any source, then played from the run's own copy.

use std::fmt::Write as _;

use rustix::process::Signal;
use serde_json::Value;

use crate::support::{Run, is_alive, signal};

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
    let output_text = String::from_utf8_lossy(&output.stderr).into_owned()
        + &std::fs::read_to_string(run.path("out/logs/sim.log")).unwrap_or_default();
    assert!(output_text.contains("recording.csv has changed since the run began"), "{output_text}");
}

/// The original may change, grow or disappear.
#[test]
fn a_run_that_is_resumed_plays_its_own_copy_whatever_has_become_of_the_original() {
    let csv = recording(20_000, usize::MAX);
    let flags = "--range-std 0.1 --accel-psd 0.1 --no-record --out out";
    let undisturbed = Run::new();
    undisturbed.write("r.csv", &csv);
    undisturbed.start(&format!("track r.csv --in-process {flags}").split(' ').collect::<Vec<_>>()).finish().succeeded();
    for change in ["changed", "appended to", "deleted"] {
        let run = Run::new();
        run.write("r.csv", &csv);
        let words = format!("track r.csv {flags} --name {}", run.name);
        let supervisor = run.start(&words.split(' ').collect::<Vec<_>>());
        run.wait_for_ticks(100);
        let nodes = ["sim", "fusion", "robot-0", "robot-1", "robot-2", "robot-3"].map(|role| run.pid_of(role, 1));
        supervisor.signal(Signal::KILL);
        nodes.iter().for_each(|pid| signal(*pid, Signal::KILL));
        supervisor.finish();
        run.wait_until("all are gone", || !nodes.iter().any(|pid| is_alive(*pid)));
        match change {
            "changed" => run.write("r.csv", csv.replace(",10,", ",60,")),
            "appended to" => run.write("r.csv", format!("{csv}90000,B,10,8,7\n")),
            _ => std::fs::remove_file(run.path("r.csv")).unwrap(),
        }
        let resumed = run.start(&["resume", "out", "--name", &run.name, "--no-record"]).finish();
        assert_eq!(resumed.code, Some(0), "{change}: {resumed:#?}");
        assert_eq!(run.digest(), undisturbed.digest(), "{change}");
        run.assert_nothing_left();
    }
}

/// No process writes to the pipe: the wait is reported, and can be ended.
#[test]
fn a_wait_for_a_pipes_writer_is_reported_and_ends_when_asked() {
    for words in ["track fifo --range-std 0.1", "run waits.toml", "sim waits.toml"] {
        for asked in [Signal::INT, Signal::TERM] {
            let run = Run::new();
            assert!(std::process::Command::new("mkfifo").arg(run.path("fifo")).status().unwrap().success());
            run.write("waits.toml", "[recording]\nranges = \"fifo\"\n");
            let waits = run.command(words);
            run.wait_until("it is reported", || waits.stderr().contains("waiting for the writer of"));
            waits.signal(asked);
            let ended = waits.finish();
            assert!(ended.code != Some(0) && ended.stderr.contains("fifo"), "{ended:#?}");
            assert!(!run.path("out").exists() && !run.shared_folder().exists());
        }
    }
}

/// In all output for people, and in JSON beside the node's own name.
#[test]
fn a_node_of_a_recording_is_shown_with_its_sensors_name() {
    let run = Run::new();
    run.write("r.csv", recording(20_000, usize::MAX));
    let supervisor = run.command("track r.csv --range-std 0.1 --accel-psd 0.1");
    run.wait_for_ticks(50);
    signal(run.pid_of("robot-0", 1), Signal::KILL);
    run.pid_of("robot-0", 2);
    let table = run.node("status").finish().succeeded().stdout;
    let line = table.lines().find(|line| line.starts_with("robot-0 ")).unwrap();
    assert!(line.ends_with("  2938") && table.contains(" sensor\n"), "{table}");
    let status: Value = serde_json::from_str(&run.node("status --json").finish().succeeded().stdout).unwrap();
    let robot = status["nodes"].as_array().unwrap().iter().find(|node| node["name"] == "robot-0").unwrap();
    assert_eq!(robot["sensor"], "2938");
    let outcome = supervisor.finish().succeeded();
    assert!(outcome.stderr.contains("robot-0 (2938) was killed by signal 9; it is started again"), "{outcome:#?}");
    assert!(outcome.stdout.contains("robot-0 (2938)"), "{outcome:#?}");
    let nodes = run.report()["nodes"].clone();
    assert_eq!((&nodes[2]["name"], &nodes[2]["sensor"]), (&"robot-0".into(), &"2938".into()), "{nodes}");
    assert!(run.read("report.html").contains("robot-0 (2938) killed"));
    run.assert_nothing_left();
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
fn files_that_are_no_recordings_are_refused_in_one_line() {
    for input in ["/dev/zero", ".", "empty", "r.csv --target-height 1", "r.csv --start-std 1"] {
        let run = Run::new();
        run.write("r.csv", recording(5, usize::MAX));
        run.write("empty", "");
        let output = shell(&run, &format!("\"$0\" track {input} --in-process --no-record --out out"));
        assert_eq!(output.status.code(), Some(2), "{input}: {output:?}");
        assert!(!run.path("out").exists(), "{input}");
    }
}
