//! Real time: lost frames are repeated within the tick, and robots that are cut off stop and come back by themselves.

use std::time::Duration;

use rangehound_shared::record::Heading;
use rustix::process::{Signal, kill_process};

use crate::own_robot::{self, Asked, asked};
use crate::support::{Faults, Link, Process, Run};

/// Ticks in which headings are back after a fault: a promise of ten is measured by `chaos` and printed here, but a busy machine
/// needs more.
const BACK_TICKS: u64 = 30;

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

/// After a cut of seconds each robot soon has fresh headings again.
#[test]
fn headings_are_fresh_again_soon_after_a_cut() {
    let run = Run::new();
    let (supervisor, gateway) = run.run("--clock realtime --ticks 240 --robots 2");
    let link = Link::new(gateway, 3, Faults::default());
    let robots = [0, 1].map(|id| run.robot(id, link.address));
    let mut cuts = Vec::new();
    for (tick, cut_s) in [(20, 2), (80, 10)] {
        run.wait_until_tick(tick);
        link.cut(true, true);
        let from = run.tick();
        std::thread::sleep(Duration::from_secs(cut_s));
        let to = run.tick();
        link.cut(false, false);
        cuts.push((cut_s, from, to));
    }
    supervisor.succeeds();
    robots.into_iter().for_each(Process::ends);
    let worlds = run.worlds();
    for (cut_s, from, to) in cuts {
        let mut fresh =
            worlds.iter().filter(|(_, world)| world.robots.iter().all(|robot| robot.heading == Heading::Fresh));
        assert!(!fresh.clone().any(|(tick, _)| (from + 3..to).contains(tick)), "the cut was felt");
        let ticks = fresh.find(|(tick, _)| *tick >= to).map(|(tick, _)| tick - to);
        println!("after a cut of {cut_s} s, in ticks {from} to {to}: fresh headings {ticks:?} ticks later");
        assert!(ticks.is_some_and(|ticks| ticks <= BACK_TICKS), "{ticks:?}");
    }
    run.assert_nothing_left();
}

/// The links of robots are lost when their run ends: they connect again, and hear it. Over a slow link the last packets take longer.
#[test]
fn robots_that_are_cut_off_when_their_run_ends_hear_of_it() {
    for delay in [Duration::ZERO, Duration::from_millis(100)] {
        let run = Run::new();
        let (supervisor, gateway) = run.run("--clock realtime --ticks 60 --robots 2 --remote 0,1");
        let link = Link::new(gateway, 3, Faults { delay, ..Faults::default() });
        let robots = [0, 1].map(|id| run.robot(id, link.address));
        run.wait_until_tick(50);
        link.cut(true, true);
        // Until some time after the end of the run: both ends have given the connection up.
        std::thread::sleep(Duration::from_secs(2));
        link.cut(false, false);
        supervisor.succeeds();
        for robot in robots {
            let (code, text) = robot.finish();
            assert!(code == Some(0) && text.contains("no link to the gateway"), "{code:?}: {text}");
        }
        run.assert_nothing_left();
    }
}

/// A robot whose host was rebooted has its first heading soon after its process has started.
#[test]
fn a_robot_whose_host_was_rebooted_is_soon_led_again() {
    let run = Run::with_ticks_of(0.1);
    let (_supervisor, gateway) = run.run("slow.toml --ticks 10000 --robots 2 --remote 0,1");
    let _other = run.robot(1, gateway);
    for life in 1..=3 {
        let before = run.tick();
        let robot = own_robot::start(&run, 0, Some(gateway), "");
        let is_led = |(asked, _): &(Asked, u64)| matches!(asked, Asked::Drive(speed_mps) if *speed_mps > 0.0);
        let all = run.wait_for("its heading", || Some(asked(&robot)).filter(|all| all.iter().any(is_led)));
        let led = all.iter().position(is_led).unwrap();
        let ticks = run.tick() - before;
        let ms = (all[led].1 - all[0].1) as f64 * 1e-6;
        println!(
            "start {life}: its first heading comes {ms:.0} ms after its process has started, at most {ticks} ticks later"
        );
        assert!(all[0].0 == Asked::Start && ticks <= BACK_TICKS, "{all:?}");
        let tick = run.tick();
        run.wait_until_tick(tick + 20);
        robot.kill();
        // A host that boots takes longer than the silence after which its robot's role can be taken.
        std::thread::sleep(Duration::from_secs(1));
    }
}

/// A link that is cut for good costs the run one robot. The robot lives on, and stands.
#[test]
fn a_link_that_is_cut_for_good_costs_one_robot() {
    let words = ["slow.toml --ticks 80", "--clock lockstep --timeout 1 --ticks 2000"];
    for words in words {
        let run = Run::with_ticks_of(0.1);
        let (supervisor, gateway) = run.run(&format!("{words} --robots 2 --remote 1"));
        let link = Link::new(gateway, 3, Faults::default());
        let mut robot = own_robot::start(&run, 1, Some(link.address), "");
        run.wait_until_tick(20);
        link.cut(true, true);
        supervisor.succeeds();
        assert!(run.report()["ranges"]["missing"].as_u64() > Some(0), "{}", run.report()["ranges"]);
        let worlds = run.worlds();
        let last =
            worlds.last().map(|(tick, world)| (*tick, world.robots[0].heading, world.robots[1].driven.speed_mps));
        let ticks = run.report()["ticks"].as_u64().unwrap();
        assert_eq!(last, Some((ticks, Heading::Fresh, 0.0)), "{words}");
        if words.starts_with("slow") {
            let is_stop = |(asked, _): &(Asked, u64)| *asked == Asked::Drive(0.0);
            run.wait_for("its stop", || asked(&robot).last().is_some_and(is_stop).then_some(()));
        }
        assert!(robot.is_running(), "{}", robot.stderr());
        run.assert_nothing_left();
    }
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
