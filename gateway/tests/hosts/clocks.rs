//! Each host on its own clock: time namespaces, in which the clock is an hour ahead or behind, or was suspended.

use std::time::Duration;

use rangehound_node::system::clock::monotonic_ns;
use rangehound_shared::record::Heading;
use rustix::process::Signal;

use crate::own_robot::{self, Asked, asked};
use crate::support::{Process, Run};

/// How far clocks are apart, s.
const APART_S: i64 = 3_600;

/// A tick so long that no busy machine is late for it, s.
const DT_S: f64 = 0.5;

/// The words before a program that gives it a clock: its readings without and with the time of suspensions are ahead by these, s.
fn clock(monotonic_s: i64, boottime_s: i64) -> String {
    format!("unshare -T --monotonic {monotonic_s} --boottime {boottime_s}")
}

fn shifted(by_s: i64) -> String {
    clock(by_s, by_s)
}

/// How far a clock can be behind: no clock shows a time before the start of the machine.
fn behind_s() -> i64 {
    let uptime_s = (monotonic_ns() / 1_000_000_000).cast_signed();
    -APART_S.min(uptime_s - 10)
}

/// Four robots whose clocks are an hour ahead and behind, two over links and two on the run's host.
fn robots_with_other_clocks(run: &Run, gateway: std::net::SocketAddr) -> [Process; 4] {
    let of = |id, gateway, by_s| own_robot::start(run, id, gateway, &shifted(by_s));
    [of(0, Some(gateway), APART_S), of(1, Some(gateway), behind_s()), of(2, None, APART_S), of(3, None, behind_s())]
}

/// Robots whose clocks are an hour ahead and behind measure each tick and have each heading in time.
#[test]
#[cfg_attr(not(namespaces), ignore = "needs time namespaces: root, iproute2 and util-linux")]
fn clocks_an_hour_apart_make_no_heading_late() {
    let (run, ticks) = (Run::with_ticks_of(DT_S), 16);
    let (supervisor, gateway) = run.run(&format!("slow.toml --ticks {ticks} --robots 4 --remote 0-3"));
    let robots = robots_with_other_clocks(&run, gateway);
    supervisor.succeeds();
    robots.into_iter().for_each(Process::ends);
    println!("{} {}", run.report()["headings"], run.report()["ranges"]);
    // With nothing else on the machine all of them; a wrong clock would be late at every tick of its robot.
    let worlds = run.worlds();
    for robot in 0..4 {
        let fresh = worlds.iter().filter(|(_, world)| world.robots[robot].heading == Heading::Fresh).count() as u64;
        assert!(2 * fresh > ticks, "robot-{robot}: {fresh} of {} headings in time", ticks + 1);
    }
    run.assert_nothing_left();
}

/// Whatever their clocks show, robots stop four ticks after the last one, when simulator and fusion have died.
#[test]
#[cfg_attr(not(namespaces), ignore = "needs time namespaces: root, iproute2 and util-linux")]
fn a_robot_with_another_clock_stops_when_nobody_leads_it() {
    let run = Run::with_ticks_of(DT_S);
    let (supervisor, gateway) = run.run("slow.toml --ticks 10000 --robots 4 --remote 0-3 --restart never");
    let robots = robots_with_other_clocks(&run, gateway);
    run.wait_until_tick(6);
    supervisor.kill();
    for (id, robot) in robots.into_iter().enumerate() {
        let stop = |asked: &(Asked, u64)| asked.0 == Asked::Drive(0.0);
        let all = run.wait_for("its stop", || Some(asked(&robot)).filter(|all| all.last().is_some_and(stop)));
        let is_tick = |asked: &&(Asked, u64)| matches!(asked.0, Asked::Tick(_));
        let (last, began_ns) = *all.iter().rev().find(is_tick).unwrap();
        let ticks = (all.last().unwrap().1 - began_ns) as f64 * 1e-9 / DT_S;
        println!("robot-{id} stops {ticks:.3} ticks after the last one, {last:?}");
        // It holds its heading for the tick and three more: with nothing else on the machine 4.00 ticks. By another clock it would
        // stop at once or never.
        assert!(ticks > 3.5, "robot-{id}: {ticks} ticks: {all:?}");
        robot.ends();
    }
    run.assert_nothing_left();
}

/// A machine that was suspended for two hours: the clock of headings and stops has counted them.
#[test]
#[cfg_attr(not(namespaces), ignore = "needs time namespaces: root, iproute2 and util-linux")]
fn the_time_for_which_a_host_was_suspended_counts() {
    let suspended_s = 7_200;
    let run = Run::with_ticks_of(DT_S);
    let (_supervisor, gateway) = run.run("slow.toml --ticks 10000 --robots 2 --remote 0-1");
    let before_ns = monotonic_ns();
    let of = |id, gateway| own_robot::start(&run, id, gateway, &clock(0, suspended_s));
    for robot in [of(0, Some(gateway)), of(1, None)] {
        let is_driven = |all: &Vec<(Asked, u64)>| all.iter().any(|(asked, _)| matches!(asked, Asked::Drive(_)));
        let all = run.wait_for("its drive", || Some(asked(&robot)).filter(is_driven));
        let here_ns = [before_ns, monotonic_ns()].map(|here_ns| here_ns + suspended_s.unsigned_abs() * 1_000_000_000);
        assert!(all.iter().all(|(_, at_ns)| (here_ns[0]..here_ns[1]).contains(at_ns)), "{here_ns:?}: {all:?}");
    }
}

/// A robot that has slept stops before it looks at the headings that came meanwhile, and then goes on with the present tick.
#[test]
fn a_robot_that_wakes_up_stops_first() {
    let run = Run::with_ticks_of(0.1);
    let (_supervisor, gateway) = run.run("slow.toml --ticks 10000 --robots 2 --remote 0-1");
    let robots = [own_robot::start(&run, 0, Some(gateway), ""), own_robot::start(&run, 1, None, "")];
    run.wait_until_tick(10);
    for robot in robots {
        robot.signal(Signal::STOP);
        // Ten times as long as it may drive blindly.
        std::thread::sleep(Duration::from_secs(4));
        let woken_ns = monotonic_ns();
        robot.signal(Signal::CONT);
        let after = run.wait_for("its headings", || {
            let after: Vec<_> = asked(&robot).into_iter().filter(|(_, at_ns)| *at_ns > woken_ns).collect();
            after.iter().any(|(asked, _)| matches!(asked, Asked::Drive(speed_mps) if *speed_mps > 0.0)).then_some(after)
        });
        assert_eq!(after[0].0, Asked::Drive(0.0), "{after:?}");
        let missed = run.tick();
        assert!(after.iter().any(|(asked, _)| matches!(asked, Asked::Tick(tick) if *tick + 20 > missed)), "{after:?}");
        robot.ends();
    }
}
