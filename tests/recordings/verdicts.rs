//! The credibility of a recording: the verdict on a track, and the findings of `calibrate`.

use std::fmt::Write as _;
use std::process::Output;

use rangehound_shared::draws::{Draws, Stream};
use serde_json::Value;

use crate::support::{PROGRAM, Run};

const ANCHORS: [(&str, f64, f64); 4] = [("A1", 0.0, 0.0), ("B2", 12.0, 0.0), ("C3", 12.0, 9.0), ("4", 0.0, 9.0)];

/// The target's position in a hall at a time; it stands still if its speed is 0.
fn place(time_s: f64, speed: f64) -> (f64, f64) {
    let angle = 0.3 * speed * time_s;
    (6.0 + 3.0 * angle.cos(), 4.5 + 2.5 * (1.3 * angle).sin())
}

/// Ranges with noise of 0.05 m and a bias for each anchor, and the true track.
fn recording(speed: f64, biases_m: [f64; 4]) -> (String, String) {
    let mut draws = Draws::new(3, Stream::RangeNoise { robot: 0 });
    let mut ranges = "time_s,sensor_id,sensor_x_m,sensor_y_m,range_m\n".to_owned();
    let mut truth = "time_s,x_m,y_m\n".to_owned();
    for tick in 1..=600_u64 {
        let time_s = 0.1 * tick as f64;
        let (x_m, y_m) = place(time_s, speed);
        let _ = writeln!(truth, "{time_s:.1},{x_m:.4},{y_m:.4}");
        let mut noise = [0.0; ANCHORS.len()];
        draws.standard_normal(tick, &mut noise);
        for ((name, ax, ay), (bias_m, noise)) in ANCHORS.into_iter().zip(biases_m.into_iter().zip(noise)) {
            let range_m = (x_m - ax).hypot(y_m - ay) + bias_m + 0.05 * noise;
            let _ = writeln!(ranges, "{time_s:.1},{name},{ax},{ay},{range_m:.4}");
        }
    }
    (ranges, truth)
}

fn program(run: &Run, words: &str) -> Output {
    let words: Vec<&str> = words.split_whitespace().collect();
    std::process::Command::new(PROGRAM).args(words).current_dir(run.path(".")).output().unwrap()
}

fn report(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{error}: {output:?}"))
}

const TRACK: &str = "--in-process --no-record --json --accel-psd 0.3 --range-std 0.05";

#[test]
fn a_good_track_is_valid_and_one_in_a_wrong_unit_or_with_another_clocks_truth_is_not() {
    let run = Run::new();
    let (ranges, truth) = recording(1.0, [0.0; 4]);
    run.write("r.csv", &ranges);
    run.write("truth.csv", &truth);
    let good = program(&run, &format!("track r.csv --truth truth.csv --strict --out good {TRACK}"));
    let verdict = &report(&good)["verdict"];
    assert!(good.status.success() && verdict["valid"] == true && verdict["sound"] == true, "{verdict}");

    // Millimetres in a column that is named for metres.
    let in_mm: Vec<String> = ranges
        .lines()
        .enumerate()
        .map(|(line, text)| match text.rsplit_once(',') {
            Some((before, range)) if line > 0 => format!("{before},{:.0}", 1e3 * range.parse::<f64>().unwrap()),
            _ => text.to_owned(),
        })
        .collect();
    run.write("mm.csv", in_mm.join("\n"));
    let invalid = program(&run, &format!("track mm.csv --strict --out mm {TRACK}"));
    let verdict = &report(&invalid)["verdict"];
    assert!(invalid.status.code() == Some(1) && verdict["valid"] == false, "{invalid:?}");
    assert!(verdict["reasons"][0].as_str().unwrap().contains("range=range_m:mm"), "{verdict}");
    // With the columns that the reason suggests.
    let columns = format!("track mm.csv --columns range=range_m:mm --strict --out again {TRACK}");
    assert!(program(&run, &columns).status.success());

    let later: Vec<String> = truth.lines().skip(1).map(|line| format!("17000{line}")).collect();
    run.write("later.csv", format!("time_s,x_m,y_m\n{}\n", later.join("\n")));
    let lost = program(&run, &format!("track r.csv --truth later.csv --out lost {TRACK}"));
    let verdict = &report(&lost)["verdict"];
    assert!(lost.status.success() && verdict["valid"] == false, "{verdict}");
    assert!(verdict["reasons"][0].as_str().unwrap().contains("does not overlap"), "{verdict}");
}

#[test]
fn a_calibration_without_truth_makes_the_track_better() {
    let run = Run::new();
    let biases_m = [0.45, 0.1, 0.35, -0.2];
    let (ranges, truth) = recording(1.0, biases_m);
    run.write("r.csv", &ranges);
    run.write("truth.csv", &truth);
    let found = program(&run, "calibrate r.csv --out cal --json");
    assert!(found.status.success(), "{found:?}");
    let rmse_m = |flags: &str, out: &str| {
        let output = program(
            &run,
            &format!("track r.csv --truth truth.csv --in-process --no-record --json --out {out} {flags}"),
        );
        report(&output)["position_rmse_m"].as_f64().unwrap()
    };
    let (raw_m, calibrated_m) = (rmse_m("", "raw"), rmse_m("--calibration cal/calibration.toml", "calibrated"));
    assert!(calibrated_m < 0.5 * raw_m, "{calibrated_m} of {raw_m}");
    let text = std::fs::read_to_string(run.path("cal/calibration.toml")).unwrap();
    assert!(ANCHORS.iter().all(|(name, ..)| text.contains(&format!("id = \"{name}\""))), "{text}");
}

#[test]
fn calibrate_uses_the_ranges_of_a_recording_with_bearings_and_refuses_one_without_ranges() {
    let run = Run::new();
    let (ranges, truth) = recording(1.0, [0.3; 4]);
    // The last sensor has bearings alone.
    let rows = ranges.lines().skip(1).map(|row| match row.rsplit_once(',') {
        Some((start, _)) if start.contains(",4,") => format!("{start},,0.5\n"),
        _ => format!("{row},0.5\n"),
    });
    let both = "time_s,sensor_id,sensor_x_m,sensor_y_m,range_m,bearing_rad\n".to_owned() + &rows.collect::<String>();
    run.write("both.csv", &both);
    run.write("bearings.csv", both.replace("range_m", "rssi"));
    run.write("truth.csv", &truth);
    for (flags, folder) in [("", "alone"), ("--truth truth.csv", "truth")] {
        let found = program(&run, &format!("calibrate both.csv --out {folder} {flags}"));
        assert!(found.status.success(), "{found:?}");
        let text = std::fs::read_to_string(run.path(&format!("{folder}/calibration.toml"))).unwrap();
        let has = |name: &str| text.contains(&format!("id = \"{name}\""));
        assert!(has("A1") && has("B2") && has("C3") && !has("4"), "{text}");
    }
    let refused = program(&run, "calibrate bearings.csv --out none");
    assert_eq!(refused.status.code(), Some(2), "{refused:?}");
    let complaint = "rangehound: no range in bearings.csv: expected ranges: bearings cannot be calibrated\n";
    assert_eq!(String::from_utf8_lossy(&refused.stderr), complaint);
}

#[test]
fn track_tells_how_many_ranges_and_bearings_it_has_read() {
    let run = Run::new();
    let header = "time_s,sensor_id,sensor_x_m,sensor_y_m,range_m,bearing_rad\n";
    for (rows, reported) in [
        ("0,A,0,0,5,\n0,B,9,0,5,0.5\n1,A,0,0,,0.5\n", "recording: 2 ranges and 2 bearings of 2 sensors; read as"),
        ("0,A,0,0,,0.6\n0,B,9,0,,2\n", "recording: 2 bearings of 2 sensors; read as"),
        ("0,A,0,0,5,\n0,B,9,0,5,\n", "recording: 2 ranges of 2 sensors; read as"),
    ] {
        run.write("r.csv", format!("{header}{rows}"));
        let tracked = program(&run, "track r.csv --in-process --no-record --out out");
        assert!(tracked.status.success(), "{tracked:?}");
        assert!(String::from_utf8_lossy(&tracked.stderr).contains(reported), "{tracked:?}");
    }
}

#[test]
fn a_target_that_stands_still_calibrates_nothing() {
    let run = Run::new();
    run.write("r.csv", recording(0.0, [0.3; 4]).0);
    let found = program(&run, "calibrate r.csv --out cal");
    assert_eq!(found.status.code(), Some(1), "{found:?}");
    assert!(String::from_utf8_lossy(&found.stderr).contains("cannot determine"), "{found:?}");
}
