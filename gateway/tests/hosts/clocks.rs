//! Each host on its own clock: time namespaces, in which the clock is an hour ahead or behind, or was suspended.

use std::time::Duration;

use rangehound_node::system::clock::monotonic_ns;
use rangehound_shared::record::{FusionRecord, Heading};
use rustix::process::Signal;

use crate::own_robot::{self, Asked, CLOCK_INTERVAL, asked};
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

/// How far the clock of each robot is ahead, s: two robots over links and two on the run's host are an hour ahead and behind.
fn ahead_s(id: usize) -> i64 {
    [APART_S, behind_s(), APART_S, behind_s(), 0, 0][id]
}

/// True if a robot is on another host.
fn is_remote(id: usize) -> bool {
    [true, true, false, false, true, false][id]
}

/// The robot of the same kind whose clock is right: the control.
fn control_of(id: usize) -> usize {
    if is_remote(id) { 4 } else { 5 }
}

/// Six robots: four with other clocks, and two with the right one. Each counts the ticks of its own clock.
fn robots_with_other_clocks(run: &Run, gateway: std::net::SocketAddr) -> [Process; 6] {
    std::array::from_fn(|id| {
        let before = format!("env {CLOCK_INTERVAL}={DT_S} {}", shifted(ahead_s(id)));
        own_robot::start(run, id, is_remote(id).then_some(gateway), &before)
    })
}

/// Headings that a robot may miss more than its control, on a busy machine: a wrong clock misses them all.
const MISSED_MORE_MAX: usize = 4;

/// Robots whose clocks are an hour ahead and behind measure each tick, have each heading in time and miss no command: they do as
/// those do whose clock is right, in the same run.
#[test]
#[cfg_attr(not(namespaces), ignore = "needs time namespaces: root, iproute2 and util-linux")]
fn clocks_an_hour_apart_make_no_heading_late() {
    let (run, ticks) = (Run::with_ticks_of(DT_S), 16);
    let (supervisor, gateway) = run.run(&format!("slow.toml --ticks {ticks} --robots 6 --remote 0-5"));
    let robots = robots_with_other_clocks(&run, gateway);
    supervisor.succeeds();
    robots.into_iter().for_each(Process::ends);
    let (worlds, estimates) = (run.worlds(), run.estimates());
    let headings = |robot: usize, is: &dyn Fn(Heading) -> bool| {
        worlds.iter().filter(|(_, world)| is(world.robots[robot].heading)).count()
    };
    let lacks = |robot: usize| headings(robot, &|heading| heading != Heading::Fresh);
    let is_unheard =
        |(tick, record): &&(u64, FusionRecord), robot: usize| *tick > 0 && record.exchanges[robot].heard.is_none();
    let unheard = |robot: usize| estimates.iter().filter(|record| is_unheard(record, robot)).count();
    for robot in 0..6 {
        let control = control_of(robot);
        println!("robot-{robot}: {} headings not in time, {} ranges missing", lacks(robot), unheard(robot));
        assert!(lacks(robot) <= lacks(control) + MISSED_MORE_MAX, "robot-{robot}: {} of {ticks}", lacks(robot));
        assert!(unheard(robot) <= unheard(control) + MISSED_MORE_MAX, "robot-{robot}: {} of {ticks}", unheard(robot));
        assert!(2 * lacks(robot) < ticks, "robot-{robot}: {} of {ticks} headings not in time", lacks(robot));
    }
    run.assert_nothing_left();
}

/// In lock step not a bit depends on what the robots' clocks show.
#[test]
#[cfg_attr(not(namespaces), ignore = "needs time namespaces: root, iproute2 and util-linux")]
fn in_lock_step_clocks_an_hour_apart_change_no_bit() {
    let run = Run::new();
    let words = "--clock lockstep --timeout forever --ticks 300 --robots 6 --seed 3";
    let (supervisor, gateway) = run.run(&format!("{words} --remote 0-5"));
    let robots: [Process; 6] = std::array::from_fn(|id| {
        let to = if is_remote(id) { format!("--connect {gateway}") } else { format!("--name {}", run.name) };
        run.start_by(&format!("exec {} \"$@\"", shifted(ahead_s(id))), &format!("robot --id {id} {to}"))
    });
    supervisor.succeeds();
    robots.into_iter().for_each(Process::succeeds);
    assert_eq!(run.digest(), Run::digest_in_process(words));
    run.assert_nothing_left();
}

/// Whatever their clocks show, robots stop four ticks after the last one, when simulator and fusion have died.
#[test]
#[cfg_attr(not(namespaces), ignore = "needs time namespaces: root, iproute2 and util-linux")]
fn a_robot_with_another_clock_stops_when_nobody_leads_it() {
    let run = Run::with_ticks_of(DT_S);
    let (supervisor, gateway) = run.run("slow.toml --ticks 10000 --robots 6 --remote 0-5 --restart never");
    let robots = robots_with_other_clocks(&run, gateway);
    run.wait_until_tick(6);
    supervisor.kill();
    for (id, robot) in robots.into_iter().enumerate() {
        let is_tick = |(asked, _): &(Asked, u64)| matches!(asked, Asked::Tick(_));
        let is_stop = |(asked, _): &(Asked, u64)| *asked == Asked::Drive(0.0);
        // The requests to it from its last tick until it stopped.
        let all = run.wait_for("its stop", || {
            let mut all = asked(&robot);
            let last = all.iter().rposition(is_tick)?;
            let stop = last + all[last..].iter().position(is_stop)?;
            all.truncate(stop + 1);
            Some(all.split_off(last))
        });
        let ticks = (all.last().unwrap().1 - all[0].1) as f64 * 1e-9 / DT_S;
        let beats = all.iter().filter(|(asked, _)| *asked == Asked::Beat).count();
        println!("robot-{id} stops {ticks:.3} ticks after the last one, after {beats} beats of its clock");
        // It holds its heading for the tick and three more. By another clock it would stop at once or never. Its beats, the first of
        // which may come at once, are counted in the same process: what delays the one delays the others.
        assert!(ticks > 3.5 && beats <= 5, "robot-{id}: {ticks} ticks, {beats} beats: {all:?}");
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
