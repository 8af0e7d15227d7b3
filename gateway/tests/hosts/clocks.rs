//! Each host on its own clock: time namespaces, in which the monotonic clock is an hour ahead or behind.

use std::process::Command;
use std::time::Duration;

use rustix::process::Signal;

use crate::support::{Process, Run};

/// How far clocks are apart, s.
const APART_S: i64 = 3_600;

/// True if this system makes time namespaces; else it says why not.
fn has_time_namespaces() -> bool {
    let made = Command::new("unshare").args(["-T", "--monotonic", "3600", "true"]).output();
    let works = made.as_ref().is_ok_and(|output| output.status.success());
    if !works {
        eprintln!("NOT TESTED: clocks: no time namespaces here (root and unshare are needed): {made:?}");
    }
    works
}

fn shifted(by_s: i64) -> String {
    // A process cannot have a clock before the start of the machine.
    format!("exec unshare -T --monotonic {by_s} \"$@\"")
}

/// How far a clock can be behind: no clock shows a time before the start of the machine.
fn behind_s() -> i64 {
    let text = std::fs::read_to_string("/proc/uptime").unwrap();
    let uptime_s: f64 = text.split(' ').next().unwrap().parse().unwrap();
    -APART_S.min(uptime_s as i64 - 10)
}

/// Robots whose clocks are an hour ahead and behind are in time at every tick, through the gateway and over shared memory.
#[test]
fn clocks_an_hour_apart_make_no_heading_late() {
    if !has_time_namespaces() {
        return;
    }
    let run = Run::new();
    let (supervisor, gateway) = run.run("--clock realtime --ticks 60 --robots 4 --remote 0-3");
    let robots = [
        run.start_by(&shifted(APART_S), &format!("robot --id 0 --connect {gateway}")),
        run.start_by(&shifted(behind_s()), &format!("robot --id 1 --connect {gateway}")),
        run.start_by(&shifted(APART_S), &format!("robot --id 2 --name {}", run.name)),
        run.start_by(&shifted(behind_s()), &format!("robot --id 3 --name {}", run.name)),
    ];
    supervisor.succeeds();
    robots.into_iter().for_each(Process::succeeds);
    let headings = &run.report()["headings"];
    let [fresh, late, none] = ["fresh", "late", "none"].map(|key| headings[key].as_u64().unwrap());
    // A busy machine may be late now and then; a wrong clock would be late at every tick of its robot.
    assert!(fresh >= 4 * 45 && late + none <= 60, "{headings}");
    run.assert_nothing_left();
}

/// A robot whose clock is behind stops when simulator and fusion have died, as any other.
#[test]
fn a_robot_with_another_clock_stops_when_nobody_leads_it() {
    if !has_time_namespaces() {
        return;
    }
    for by_s in [APART_S, behind_s()] {
        let run = Run::new();
        let (mut supervisor, gateway) = run.run("--clock realtime --ticks 100000 --robots 1 --restart never");
        let words = format!("robot --id 0 --connect {gateway}");
        let robot = run.start_by(&format!("RUST_LOG=rangehound_gateway=debug {}", shifted(by_s)), &words);
        run.wait_until_tick(10);
        supervisor.signal(Signal::KILL);
        run.wait_for("its stop", || robot.stderr().contains("stands still").then_some(()));
        std::thread::sleep(Duration::from_millis(10));
        assert!(!supervisor.is_running());
        robot.kill();
    }
}
