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
    let told = |what: &str| outcome.stderr.lines().filter(|line| line.contains(what)).count();
    assert_eq!((told("expected lines like"), told("port: the stream has ended")), (1, 1), "{outcome:#?}");
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
    run.wait_until("the run is founded", || sim.has_joined());
    let refusal =
        |id: &str, port: &str| run.start_program(&example, &["--name", &run.name, "--id", id, "--port", port]).finish();
    for (refused, names) in [(refusal("0", "/dev/no-such-port"), "/dev/no-such-port"), (refusal("9", "-"), "--id")] {
        assert!(refused.code == Some(1) && refused.stderr.contains(names), "{refused:#?}");
    }
    sim.signal(Signal::INT);
    sim.finish();
    run.assert_nothing_left();
}
