//! In lock step without a time-out no fault of link, gateway or robots changes a bit.

use std::time::Duration;

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rustix::process::{Pid, Signal, kill_process};

use crate::support::{Faults, Link, Process, Run};

const LOCKSTEP: &str = "--clock lockstep --timeout forever --seed 3";

/// A run with these robots behind a link, to its end; `disturb` gets the robots' processes.
fn digest_over(
    words: &str,
    ids: &[usize],
    faults: Faults,
    disturb: impl FnOnce(&Run, &Link, &mut Vec<Process>),
) -> String {
    let run = Run::new();
    let remote: Vec<String> = ids.iter().map(ToString::to_string).collect();
    let (supervisor, gateway) = run.run(&format!("{LOCKSTEP} {words} --remote {}", remote.join(",")));
    let link = Link::new(gateway, 7, faults);
    let mut robots: Vec<Process> = ids.iter().map(|id| run.robot(*id, link.address)).collect();
    disturb(&run, &link, &mut robots);
    supervisor.succeeds();
    let robots: Vec<(Option<i32>, String)> = robots.into_iter().map(Process::finish).collect();
    assert!(robots.iter().all(|(code, _)| *code == Some(0)), "{robots:?}");
    let report = run.report();
    let [published, fused] = ["published", "fused"].map(|key| report["ranges"][key].as_u64());
    assert_eq!(published, fused, "no measurement is lost");
    run.assert_nothing_left();
    run.digest()
}

#[test]
fn loss_delay_and_doubling_change_nothing() {
    let words = "--ticks 300 --robots 4";
    let oracle = Run::digest_in_process(&format!("{LOCKSTEP} {words}"));
    let ms = Duration::from_millis;
    for faults in [
        Faults::default(),
        Faults { loss: 0.05, ..Faults::default() },
        Faults { loss: 0.2, duplicates: 0.1, jitter: ms(3), ..Faults::default() },
    ] {
        // Local and remote robots mix.
        assert_eq!(digest_over(words, &[0, 2, 3], faults, |_, _, _| {}), oracle, "{faults:?}");
    }
}

/// A round trip of 0.6 s, as over a satellite: robots join, go on after a cut, and change no bit.
#[test]
fn a_slow_link_changes_nothing() {
    let words = "--ticks 12 --robots 3";
    let oracle = Run::digest_in_process(&format!("{LOCKSTEP} {words}"));
    let faults = Faults { loss: 0.02, delay: Duration::from_millis(300), ..Faults::default() };
    let digest = digest_over(words, &[0, 2], faults, |run, link, _| {
        run.wait_until_tick(4);
        link.cut(true, true);
        // Longer than a link with this round trip may be silent.
        std::thread::sleep(Duration::from_secs(3));
        link.cut(false, false);
    });
    assert_eq!(digest, oracle);
}

#[test]
fn cuts_of_either_direction_change_nothing() {
    let words = "--ticks 400 --robots 3";
    let oracle = Run::digest_in_process(&format!("{LOCKSTEP} {words}"));
    let digest = digest_over(words, &[0, 1, 2], Faults::default(), |run, link, _| {
        for (tick, up, down) in [(30, true, true), (80, true, false), (130, false, true)] {
            run.wait_until_tick(tick);
            link.cut(up, down);
            std::thread::sleep(Duration::from_millis(1_500));
            link.cut(false, false);
        }
    });
    assert_eq!(digest, oracle);
}

#[test]
fn kills_of_gateway_and_robots_change_nothing() {
    let words = "--ticks 1000 --robots 3";
    let oracle = Run::digest_in_process(&format!("{LOCKSTEP} {words}"));
    let digest = digest_over(words, &[0, 1, 2], Faults { loss: 0.02, ..Faults::default() }, |run, link, robots| {
        let mut random = ChaCha8Rng::seed_from_u64(11);
        run.wait_until_tick(10);
        for kill in 0..12 {
            std::thread::sleep(Duration::from_millis(random.random_range(20..150)));
            match kill % 4 {
                0 => {
                    let gateway = run.wait_for("the gateway's note", || run.gateway());
                    let _ = kill_process(gateway, Signal::KILL);
                }
                1 => {
                    for role in ["sim", "fusion"] {
                        if let Some(pid) = run.pid_of(role) {
                            let _ = kill_process(pid, Signal::KILL);
                        }
                    }
                }
                _ => {
                    // The host is rebooted: its robot starts anew.
                    let id = random.random_range(0..robots.len());
                    let fresh = run.robot(id, link.address);
                    std::mem::replace(&mut robots[id], fresh).kill();
                }
            }
        }
    });
    assert_eq!(digest, oracle);
}

/// The run's host loses everything and the run is resumed: the robots of the other hosts live on, and take part.
#[test]
fn robots_go_on_with_a_run_that_is_resumed() {
    let words = "--ticks 5000 --robots 2";
    let run = Run::new();
    let (supervisor, gateway) = run.run(&format!("{LOCKSTEP} {words} --remote 1"));
    let mut robot = run.robot(1, gateway);
    run.wait_until_tick(20);
    // More starts than the resumed run will have.
    for role in ["sim", "fusion"] {
        let tick = run.tick();
        let _ = kill_process(run.wait_for("its process", || run.pid_of(role)), Signal::KILL);
        run.wait_until_tick(tick + 20);
    }
    supervisor.signal(Signal::STOP);
    for role in ["sim", "fusion", "robot-0"] {
        let _ = kill_process(run.wait_for("its process", || run.pid_of(role)), Signal::KILL);
    }
    let _ = kill_process(run.wait_for("the gateway's note", || run.gateway()), Signal::KILL);
    supervisor.kill();
    assert!(robot.is_running());
    // It listens again where it did, and does not start the robot of the other host.
    run.finish_ok(&format!("resume out --no-record --name {}", run.name));
    robot.succeeds();
    assert_eq!(run.digest(), Run::digest_in_process(&format!("{LOCKSTEP} {words}")));
    run.assert_nothing_left();
}

/// The run's host sleeps for longer than its gateway keeps a silent robot's role, and so does a robot's host.
#[test]
fn hosts_that_wake_up_change_nothing() {
    let words = "--ticks 4000 --robots 2";
    let oracle = Run::digest_in_process(&format!("{LOCKSTEP} {words}"));
    let digest = digest_over(&format!("{words} --standby 1"), &[1], Faults::default(), |run, _, robots| {
        run.wait_until_tick(20);
        let roles = ["run", "sim", "fusion", "standby-1", "robot-0", "gateway"];
        let of_run: Vec<Pid> = roles.iter().filter_map(|role| run.pid_of(role)).collect();
        assert_eq!(of_run.len(), roles.len());
        for host in [of_run, vec![robots[0].pid()]] {
            let signal = |signal| host.iter().for_each(|pid| kill_process(*pid, signal).unwrap());
            signal(Signal::STOP);
            std::thread::sleep(Duration::from_secs(4));
            signal(Signal::CONT);
            let tick = run.tick();
            run.wait_until_tick(tick + 20);
        }
    });
    assert_eq!(digest, oracle);
}

/// Two hosts claim one robot: the one that is connected keeps it. When it is gone, the other takes its place.
#[test]
fn of_two_hosts_that_claim_a_robot_one_has_it() {
    let words = "--ticks 1000 --robots 2";
    let oracle = Run::digest_in_process(&format!("{LOCKSTEP} {words}"));
    let digest = digest_over(words, &[0, 1], Faults::default(), |run, link, robots| {
        run.wait_until_tick(20);
        let other = run.robot(1, link.address);
        run.wait_for("the refusal", || other.stderr().contains("already runs this robot").then_some(()));
        assert_eq!(other.stderr().lines().count(), 1, "{}", other.stderr());
        let first = std::mem::replace(&mut robots[1], other);
        first.kill();
        let tick = run.tick();
        run.wait_until_tick(tick + 10);
    });
    assert_eq!(digest, oracle);
}

/// A robot that leaves in order frees its role at once, for a process of the run's host too.
#[test]
fn a_role_that_was_left_can_be_taken_by_a_local_process() {
    let run = Run::new();
    let (supervisor, gateway) = run.run(&format!("{LOCKSTEP} --ticks 400 --robots 2 --remote 1"));
    // Both ends say so.
    let waits = format!("waits for robot-1 from other hosts: `rangehound robot --id 1 --connect {gateway}`");
    run.wait_for("its message", || supervisor.stderr().contains(&waits).then_some(()));
    let robot = run.robot(1, gateway);
    let joined = format!("robot-1 has joined the run through {gateway}");
    run.wait_for("its message", || robot.stderr().contains(&joined).then_some(()));
    run.wait_until_tick(10);
    robot.signal(Signal::TERM);
    robot.succeeds();
    let local = run.start(&format!("robot --id 1 --name {}", run.name));
    supervisor.succeeds();
    local.succeeds();
    assert_eq!(run.digest(), Run::digest_in_process(&format!("{LOCKSTEP} --ticks 400 --robots 2")));
    run.assert_nothing_left();
}

/// A gateway without heartbeats is replaced, as any other node is.
#[test]
fn a_gateway_that_hangs_is_replaced() {
    let run = Run::new();
    let (supervisor, gateway) = run.run("--clock lockstep --timeout 1 --ticks 100000 --robots 2");
    let robots = [0, 1].map(|id| run.robot(id, gateway));
    run.wait_until_tick(10);
    let hung = run.wait_for("the gateway", || run.gateway());
    let _ = kill_process(hung, Signal::STOP);
    let state = || {
        let status = run.status()?;
        let nodes = status["nodes"].as_array()?;
        nodes.iter().find(|node| node["name"] == "gateway")?["state"].as_str().map(str::to_owned)
    };
    run.wait_for("its state", || (state()? == "stopped").then_some(()));
    run.wait_for("its successor", || run.gateway().filter(|pid| *pid != hung));
    assert!(supervisor.stderr().contains("gateway sent no heartbeat"), "{}", supervisor.stderr());
    let tick = run.tick();
    run.wait_until_tick(tick + 50);
    run.finish_ok(&format!("stop --name {}", run.name));
    robots.into_iter().for_each(Process::succeeds);
    run.assert_nothing_left();
}
