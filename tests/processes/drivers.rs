//! A robot whose range sensor and drive are on a port: the example's own process, fed through a FIFO.

use std::fs::File;
use std::io::Write;
use std::os::unix::fs::OpenOptionsExt;
use std::path::PathBuf;

use rangehound_node::logs;
use rangehound_node::rendezvous::RunDescription;
use rustix::fs::{CWD, FileType, Mode, OFlags, mknodat};
use rustix::process::Signal;

use crate::support::Run;

const STOP: &str = "0.000000,0.000000";

/// The example beside this binary: built by `cargo test`, but not by `cargo test --test integration`.
fn example() -> PathBuf {
    let this = std::env::current_exe().unwrap();
    let example = this.ancestors().nth(2).unwrap().join("examples/serial_range");
    assert!(example.exists(), "`cargo build -p rangehound-node --example serial_range` makes what is tested");
    example
}

#[test]
fn a_robot_on_a_port_takes_part_in_a_run() {
    let example = example();
    let run = Run::new();
    run.write("mine.toml", "clock = \"realtime\"\ndt_s = 0.02\nticks = 200\n[robots]\ncount = 1\n");
    let port = run.path("port");
    mknodat(CWD, &port, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).unwrap();

    let sim = run.command("sim mine.toml");
    let watch = run.node("watch");
    run.wait_until("the watch has joined", || watch.has_joined());
    let fusion = run.node("fusion");
    let robot = run.start_program(&example, &["--name", &run.name, "--id", "0", "--port", port.to_str().unwrap()]);

    // Open for reading and writing, and not blocking: this test never waits for it.
    let flags = OFlags::NONBLOCK.bits().cast_signed();
    let mut radio = File::options().read(true).write(true).custom_flags(flags).open(&port).unwrap();
    let mut write_until_tick = |line: &str, tick: u64| {
        run.wait_until(&format!("tick {tick}"), || {
            let _ = radio.write(line.as_bytes());
            run.ticks_done() >= tick
        });
    };
    write_until_tick("A,15.0\n", 50);
    let endless = format!("nonsense\nnan\n{}\n", "1".repeat(10_000));
    write_until_tick(&endless, 55);
    // A number, but not a possible range: fusion refuses it.
    write_until_tick("1e13\n", 100);

    let moving = |line: &&str| !line.ends_with(",0.000000");
    assert!(robot.stdout().lines().any(|line| moving(&line)), "{}", robot.stdout());
    sim.signal(Signal::STOP);
    run.wait_until("the robot without ticks has stopped", || robot.stdout().lines().next_back() == Some(STOP));
    sim.signal(Signal::CONT);
    drop(radio);
    run.wait_until("the robot has seen the end of the stream", || {
        robot.stderr().contains("port: the stream has ended")
    });

    let outcome = robot.finish().succeeded();
    for node in [sim, fusion, watch] {
        node.finish().succeeded();
    }
    let lines_with = |what: &str| outcome.stderr.lines().filter(|line| line.contains(what)).count();
    assert_eq!((lines_with("expected lines like"), lines_with("port: the stream has ended")), (1, 1), "{outcome:#?}");
    assert_eq!(outcome.stdout.lines().next_back(), Some(STOP));
    for line in outcome.stdout.lines() {
        let (heading_rad, speed_mps) = line.split_once(',').unwrap();
        assert!(heading_rad.parse::<f64>().unwrap().abs() < 7.0, "{line}");
        assert!((0.0..=10.0).contains(&speed_mps.parse::<f64>().unwrap()), "{line}");
    }
    let report = run.report();
    let count = |key: &str| report["ranges"][key].as_u64().unwrap();
    assert!(count("fused") > 0 && count("missing") > 0, "{report}");
    assert!(report["refused"]["malformed"].as_u64().unwrap() > 0, "{report}");
    run.assert_nothing_left();
}

fn description(run: &Run) -> RunDescription {
    RunDescription::open(&std::fs::read(run.path("out/run.sealed")).unwrap()).unwrap()
}

/// The ranges that fusion received from robot 0, m.
fn heard_m(run: &Run) -> Vec<f64> {
    let mut log = logs::read_estimates(&description(run)).unwrap();
    let mut heard = Vec::new();
    while let Some(Ok((_, record))) = log.next() {
        heard.extend(record.exchanges.iter().filter_map(|robot| robot.heard?.measurement.range()));
    }
    heard.into_iter().map(|(range_m, _)| range_m).collect()
}

/// A DWM1001 lists its anchors in any order, cuts lines, and adds its own estimate and its quality.
#[test]
fn a_robot_with_a_radio_takes_the_ranges_of_its_anchor() {
    let example = example();
    let run = Run::new();
    run.write("mine.toml", "clock = \"realtime\"\ndt_s = 0.02\nticks = 100\n[robots]\ncount = 1\n");
    let port = run.path("port");
    mknodat(CWD, &port, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).unwrap();
    let nodes = [run.command("sim mine.toml"), run.node("fusion")];
    let words = ["--name", &run.name, "--id", "0", "--port", port.to_str().unwrap(), "--format", "dwm1001"];
    let missing = run.start_program(&example, &words).finish();
    assert!(missing.code == Some(2) && missing.stderr.contains("--anchor is missing"), "{missing:#?}");
    let robot = run.start_program(&example, &[&words[..], &["--anchor", "022e"]].concat());

    let flags = OFlags::NONBLOCK.bits().cast_signed();
    let mut radio = File::options().read(true).write(true).custom_flags(flags).open(&port).unwrap();
    let lines = "dwm> lec\r\n\
                 DIST,2,AN0,15BA,0.00,8.03,0.00,900.00,AN1,022E,7.94,8.03,0.00,15.00,POS,6.95,5.37,-1.97,52\r\n\
                 DIST,2,AN0,022E,7.94,8.03,0.00,800.00,AN1,022E,7.94,8.03,0.00\r\n\
                 DIST,1,AN0,15BA,0.00,8.03,0.00,700.00,POS,6.95,5.37,-1.97,52\r\n";
    run.wait_until("the run is over", || {
        let _ = radio.write(lines.as_bytes());
        run.ticks_done() >= 101
    });
    drop(radio);
    let outcome = robot.finish().succeeded();
    assert_eq!(outcome.stderr.matches("expected lines like DIST").count(), 1, "{outcome:#?}");
    // Two lines of three are valid; a read may end anywhere.
    let (refused, taken) = first_counts(&outcome.stderr);
    assert!(refused >= 10 && taken.abs_diff(2 * refused) <= 2, "{outcome:#?}");
    for node in nodes {
        node.finish().succeeded();
    }
    let heard = heard_m(&run);
    assert!(!heard.is_empty() && heard.iter().all(|range_m| *range_m == 15.0), "{heard:?}");
    // The run as a recording has the radio's ranges, not a simulated sensor's.
    rangehound::results::tables::write_recording(&description(&run)).unwrap();
    let ranges = run.read("ranges.csv");
    assert_eq!(ranges.lines().skip(1).filter(|row| row.ends_with(",15.0000")).count(), heard.len(), "{ranges}");
    run.assert_nothing_left();
}

/// Refused and accepted lines, from the driver's first report with counts.
fn first_counts(stderr: &str) -> (u64, u64) {
    let counts = |line: &str| {
        let (refused, taken) = line.split_once("port: ")?.1.split_once(" lines or frames refused, ")?;
        Some((refused.parse().ok()?, taken.strip_suffix(" accepted")?.parse().ok()?))
    };
    stderr.lines().find_map(counts).unwrap_or_else(|| panic!("no counts in {stderr}"))
}

#[test]
fn a_port_or_robot_that_is_not_there_is_refused() {
    let example = example();
    let run = Run::new();
    let sim = run.command("sim --clock realtime --ticks 1000");
    run.wait_until("the run is created", || sim.has_joined());
    let refusal =
        |id: &str, port: &str| run.start_program(&example, &["--name", &run.name, "--id", id, "--port", port]).finish();
    for (refused, names) in [(refusal("0", "/dev/no-such-port"), "/dev/no-such-port"), (refusal("9", "-"), "--id")] {
        assert!(refused.code == Some(1) && refused.stderr.contains(names), "{refused:#?}");
    }
    sim.signal(Signal::INT);
    sim.finish();
    run.assert_nothing_left();
}

/// Three radios that do not move measure a target at rest, which no simulator knows.
#[test]
fn a_real_target_is_tracked_by_real_robots_alone_and_nobody_claims_to_know_the_truth() {
    const TARGET_M: [f64; 2] = [3.0, 4.0];
    const RADIOS_M: [[f64; 2]; 3] = [[0.0, 0.0], [20.0, 0.0], [0.0, 20.0]];
    let example = example();
    let run = Run::new();
    let robots =
        RADIOS_M.map(|at| format!("[[robot]]\nstart_m = {at:?}\nspeed_mps = 0.001\nrange_std_m = 0.1\n")).concat();
    let scenario = |target: &str, prior: &str| {
        format!(
            "clock = \"realtime\"\ndt_s = 0.02\nticks = 150\n[target]\nstart = [8.0, 8.0, 0.0, 0.0]\nnoise_psd = 0.1\n{target}\
             [prior]\ncovariance = [100.0, 100.0, 1.0, 1.0]\n{prior}{robots}"
        )
    };
    run.write("drawn.toml", scenario("real = true\n", "mean = \"drawn\"\n"));
    run.write("mine.toml", scenario("real = true\n", ""));
    for (words, why) in [
        ("run drawn.toml --external 0-2", "prior.mean"),
        ("run mine.toml --external 0,2", "robot 1 would be simulated"),
        ("run mine.toml --in-process", "target.real"),
        ("compare mine.toml --runs 2", "target.real"),
    ] {
        let name = if words.starts_with("run") { format!(" --name {}", run.name) } else { String::new() };
        let words: Vec<&str> = words.split(' ').chain(name.split_whitespace()).collect();
        let refused = run.start(&words).finish();
        assert!(refused.code == Some(2) && refused.stderr.contains(why), "{words:?}: {refused:#?}");
        assert_eq!(refused.stderr.lines().count(), 1, "{words:?}: {refused:#?}");
    }

    let supervisor = run.command("run mine.toml --external 0-2 --write-recording");
    let robots: Vec<_> = RADIOS_M
        .iter()
        .enumerate()
        .map(|(id, at_m)| {
            let port = run.path(&format!("port-{id}"));
            mknodat(CWD, &port, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).unwrap();
            let flags = OFlags::NONBLOCK.bits().cast_signed();
            let radio = File::options().read(true).write(true).custom_flags(flags).open(&port).unwrap();
            let words = ["--name", &run.name, "--id", &id.to_string(), "--port", port.to_str().unwrap()];
            let range_m = (TARGET_M[0] - at_m[0]).hypot(TARGET_M[1] - at_m[1]);
            (run.start_program(&example, &words), radio, format!("A,{range_m:.3}\n"))
        })
        .collect();
    let mut radios: Vec<_> = robots.iter().map(|(_, radio, line)| (radio, line)).collect();
    run.wait_until("the run is over", || {
        radios.iter_mut().for_each(|(radio, line)| _ = radio.write(line.as_bytes()));
        run.ticks_done() >= 151
    });
    supervisor.finish().succeeded();
    robots.into_iter().for_each(|(robot, ..)| _ = robot.finish().succeeded());

    let estimates = std::fs::read_to_string(run.path("out/estimate.csv")).unwrap();
    let last: Vec<f64> = estimates.lines().next_back().unwrap().split(',').map(|cell| cell.parse().unwrap()).collect();
    let off_m = (last[1] - TARGET_M[0]).hypot(last[2] - TARGET_M[1]);
    assert!(off_m < 0.3, "{off_m} m: {last:?}");
    let report = run.report();
    assert!(report["position_rmse_m"].is_null() && report["anees"].is_null(), "{report}");
    assert!(report["verdict"]["valid"].as_bool().unwrap(), "{report}");
    assert!(run.path("out/ranges.csv").exists() && !run.path("out/truth.csv").exists());
    run.assert_nothing_left();
}
