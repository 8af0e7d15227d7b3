//! Real time: lost frames are repeated within the tick, and robots that are cut off stop and come back by themselves.

use std::time::Duration;

use rustix::process::{Signal, kill_process};

use crate::support::{Faults, Link, Process, Run};

/// Of all headings, the part that came in time.
fn fresh(run: &Run) -> f64 {
    let headings = &run.report()["headings"];
    let count = |key: &str| headings[key].as_u64().unwrap() as f64;
    count("fresh") / (count("fresh") + count("late") + count("none"))
}

#[test]
fn headings_stay_fresh_over_a_link_that_loses_and_jitters() {
    let run = Run::new();
    let (supervisor, gateway) = run.run("--clock realtime --ticks 100 --robots 3");
    let jitter = Duration::from_millis(5);
    let link = Link::new(gateway, 3, Faults { loss: 0.1, jitter, ..Faults::default() });
    let robots = [0, 1, 2].map(|id| run.robot(id, link.address));
    supervisor.succeeds();
    robots.into_iter().for_each(Process::succeeds);
    // The repeats mend almost all; without them a quarter of the ticks would fail for a robot, and more for the team.
    assert!(fresh(&run) > 0.85, "{}", run.report()["headings"]);
    run.assert_nothing_left();
}

/// The link is cut for seconds, and the gateway is killed: no robot's process ends, and each has fresh headings again.
#[test]
fn robots_come_back_after_a_cut_and_after_a_lost_gateway() {
    let run = Run::new();
    let (supervisor, gateway) = run.run("--clock realtime --ticks 150 --robots 2");
    let link = Link::new(gateway, 3, Faults::default());
    let mut robots = [0, 1].map(|id| run.robot(id, link.address));
    run.wait_until_tick(10);
    link.cut(true, true);
    std::thread::sleep(Duration::from_millis(2_000));
    link.cut(false, false);
    run.wait_until_tick(80);
    let pid = run.wait_for("the gateway's note", || run.gateway());
    let _ = kill_process(pid, Signal::KILL);
    assert!(robots.iter_mut().all(Process::is_running));
    supervisor.succeeds();
    robots.into_iter().for_each(Process::succeeds);
    let report = run.report();
    let none = report["headings"]["none"].as_u64().unwrap() + report["ranges"]["missing"].as_u64().unwrap();
    assert!(none > 0, "the cut was felt");
    assert!(fresh(&run) > 0.5, "{}", report["headings"]);
    run.assert_nothing_left();
}

/// Frames to the gateway are cut, frames from it are not: measurements come late and are fused at their own time.
#[test]
fn measurements_of_a_cut_come_late_and_are_fused() {
    let run = Run::new();
    let (supervisor, gateway) = run.run("--clock realtime --ticks 80 --robots 2 --remote 1");
    let link = Link::new(gateway, 3, Faults::default());
    let robot = run.robot(1, link.address);
    run.wait_until_tick(20);
    link.cut(true, false);
    std::thread::sleep(Duration::from_millis(400));
    link.cut(false, false);
    supervisor.succeeds();
    robot.succeeds();
    let report = run.report();
    assert!(report["ranges"]["late"].as_u64().unwrap() >= 1, "{}", report["ranges"]);
}

#[test]
fn a_robot_waits_for_its_gateway_and_ends_when_asked() {
    let run = Run::new();
    let mut robot = run.start("robot --id 0 --connect 127.0.0.1:9");
    run.wait_for("its message", || robot.stderr().contains("no link to the gateway").then_some(()));
    assert!(robot.is_running());
    robot.signal(Signal::TERM);
    let (code, text) = robot.finish();
    assert_eq!((code, text.lines().count()), (Some(0), 1), "{text}");
}
