//! A robot with equipment of its own, in a process of its own: it prints what its equipment is asked for and when, on its own
//! clock. The tests read its output.

use std::fmt::Write as _;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::AtomicUsize;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

use rangehound_gateway::robot::{Equipment, Target, run_with};
use rangehound_node::rendezvous::Rendezvous;
use rangehound_node::system::clock::monotonic_ns;
use rangehound_node::system::signal::Termination;
use rangehound_robot::drive::Actuator;
use rangehound_robot::pose;
use rangehound_robot::sensor::{Sensed, Sensor};
use rangehound_shared::message::{Command, WorldEntry};
use rangehound_shared::run_name::RunName;
use rangehound_shared::scenario::Scenario;
use rustix::process::{Signal, kill_process};

use crate::support::{Faults, Link, Process, Run};

/// Environment variables with its number in the team, and with the gateway's address or, on the run's host, the run's name.
const ID: &str = "RANGEHOUND_TEST_ROBOT";
const GATEWAY: &str = "RANGEHOUND_TEST_GATEWAY";
const NAME: &str = "RANGEHOUND_TEST_RUN";

/// Environment variable with the interval at which it counts the time of its own clock, s, if it does.
pub(crate) const CLOCK_INTERVAL: &str = "RANGEHOUND_TEST_CLOCK_INTERVAL";

/// The range that its radio reads at a tick, m.
pub(crate) fn range_m(tick: u64) -> f64 {
    30.0 + 0.25 * tick as f64
}

/// Its standard deviation, m: so large that it hardly matters that the readings are made up.
const STD_M: f64 = 100.0;

/// The part of the commanded speed that its wheels reach.
pub(crate) const WHEEL_SLIP: f64 = 0.5;

#[derive(Debug)]
struct Radio;

impl Sensor for Radio {
    fn sense(&mut self, tick: u64, _entry: &WorldEntry) -> Sensed {
        println!("tick {tick} {}", monotonic_ns());
        Sensed::range(range_m(tick), STD_M)
    }
}

struct Wheels;

impl Actuator for Wheels {
    fn carry_out(&mut self, command: Command) -> Command {
        println!("drive {} {}", command.speed_mps, monotonic_ns());
        Command { speed_mps: WHEEL_SLIP * command.speed_mps, ..command }
    }
}

/// Not a test: the robot's process, started by the tests.
#[test]
#[ignore = "the main function of a robot with equipment of its own"]
fn own_robot() {
    let Ok(id) = std::env::var(ID) else { return };
    let id = id.parse().unwrap();
    println!("start 0 {}", monotonic_ns());
    let termination = Termination::listen().unwrap();
    if let Ok(interval_s) = std::env::var(CLOCK_INTERVAL) {
        let interval = Duration::from_secs_f64(interval_s.parse().unwrap());
        // Never sooner than this after the last one, however long the process was kept from running.
        std::thread::spawn(move || {
            loop {
                std::thread::sleep(interval);
                println!("beat 0 {}", monotonic_ns());
            }
        });
    }
    if let Ok(gateway) = std::env::var(GATEWAY) {
        let equipment = |scenario: &Scenario| -> Option<Equipment> {
            Some((Box::new(Radio), pose::of_scenario(scenario, id)?, Box::new(Wheels)))
        };
        let target = Target { gateway, keys: None, run: None, allows_control: false };
        return run_with(&target, id, equipment, &termination).unwrap();
    }
    let name: RunName = std::env::var(NAME).unwrap().parse().unwrap();
    let run = Rendezvous::join(&name, &termination, || {}).unwrap();
    let mut poses = pose::of_scenario(&run.description().scenario, id).unwrap();
    rangehound_node::robot::run_with(&run, id, (&mut Radio, poses.as_mut(), &mut Wheels), &termination).unwrap();
}

/// Starts the robot on another host, or on the run's if no gateway is given. `before` are words in front of its program.
pub(crate) fn start(run: &Run, id: usize, gateway: Option<SocketAddr>, before: &str) -> Process {
    let mut script = format!("export {ID}={id} {NAME}={}\n", run.name);
    if let Some(gateway) = gateway {
        let _ = writeln!(script, "export {GATEWAY}={gateway}");
    }
    let program = std::env::current_exe().unwrap();
    let _ = write!(script, "exec {before} '{}' --exact own_robot::own_robot --ignored --nocapture", program.display());
    run.start_by(&script, &format!("own robot {id}"))
}

/// Something that its equipment was asked for, and when on its own clock, ns.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Asked {
    /// The process has started.
    Start,
    /// For the range of a tick.
    Tick(u64),
    /// For a motion with this speed, m/s.
    Drive(f64),
    /// Nothing: an interval of its own clock has passed.
    Beat,
}

/// The requests to its equipment so far.
pub(crate) fn asked(robot: &Process) -> Vec<(Asked, u64)> {
    let text = robot.stdout();
    // A line that is being written has no end yet.
    let complete = text.rsplit_once('\n').map_or("", |(complete, _)| complete);
    let read = |line: &str| {
        let mut words = line.split(' ');
        let (what, value, at_ns) = (words.next()?, words.next()?, words.next()?.parse().ok()?);
        Some((
            match what {
                "start" => Asked::Start,
                "beat" => Asked::Beat,
                "tick" => Asked::Tick(value.parse().ok()?),
                "drive" => Asked::Drive(value.parse().ok()?),
                _ => return None,
            },
            at_ns,
        ))
    };
    complete.lines().filter_map(read).collect()
}

/// Its ranges are fused, its body moves as its wheels do, and its last command is to stop.
#[test]
fn a_robot_with_equipment_of_its_own_takes_part_over_a_link() {
    let (run, ticks) = (Run::new(), 60);
    let (supervisor, gateway) =
        run.run(&format!("--clock lockstep --timeout forever --ticks {ticks} --robots 2 --remote 0"));
    let link = Link::new(gateway, 5, Faults { loss: 0.1, duplicates: 0.1, ..Faults::default() });
    let robot = start(&run, 0, Some(link.address), "");
    supervisor.succeeds();
    let is_over = |all: &Vec<(Asked, u64)>| all.last().is_some_and(|(asked, _)| *asked == Asked::Drive(0.0));
    let all = run.wait_for("its stop", || Some(asked(&robot)).filter(is_over));
    robot.succeeds();
    let sensed: Vec<u64> =
        all.iter().filter_map(|(asked, _)| if let Asked::Tick(tick) = asked { Some(*tick) } else { None }).collect();
    assert!(sensed.iter().copied().eq(1..=ticks), "each tick is measured once: {sensed:?}");
    for (tick, record) in run.estimates() {
        let range = record.exchanges[0].heard.and_then(|heard| heard.measurement.range());
        assert_eq!(range, (tick > 0).then(|| (range_m(tick), STD_M)), "tick {tick}");
    }
    let mut commanded =
        all.iter().filter_map(|(asked, _)| if let Asked::Drive(speed_mps) = asked { Some(*speed_mps) } else { None });
    for (tick, record) in run.worlds() {
        assert_eq!(
            Some(record.robots[0].driven.speed_mps),
            commanded.next().map(|speed_mps| WHEEL_SLIP * speed_mps),
            "{tick}"
        );
    }
    assert!(commanded.eq([0.0]) && run.worlds().iter().any(|(_, record)| record.robots[0].driven.speed_mps > 0.0));
    run.assert_nothing_left();
}

/// A robot that has taken part lives on if a later run has no place for it, and tries again.
#[test]
fn a_robot_that_has_taken_part_outlives_a_run_without_a_place_for_it() {
    let port = std::net::UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let termination = Termination::by_request();
    let places = Arc::new(AtomicUsize::new(1));
    let robot = {
        let (termination, places) = (termination.clone(), Arc::clone(&places));
        std::thread::spawn(move || {
            let equipment = |scenario: &Scenario| -> Option<Equipment> {
                places.fetch_update(Relaxed, Relaxed, |left| left.checked_sub(1)).ok()?;
                Some((Box::new(Radio), pose::of_scenario(scenario, 0)?, Box::new(Wheels)))
            };
            let target = Target { gateway: port.to_string(), keys: None, run: None, allows_control: false };
            run_with(&target, 0, equipment, &termination).map_err(|error| error.to_string())
        })
    };
    let words = "--clock lockstep --timeout forever --robots 1 --ticks 100000000";
    for has_place in [true, false] {
        let run = Run::new();
        let mut supervisor =
            run.start(&format!("run --no-record --name {} --out out --listen {port} {words}", run.name));
        assert_eq!(run.listens(&supervisor), port);
        if has_place {
            run.wait_until_tick(10);
        } else {
            let leaves = || supervisor.stderr().matches("robot-0 of 127.0.0.1 has left").count();
            // It tries again and again. Then it has a place.
            run.wait_for("its attempts", || (leaves() >= 2).then_some(()));
            assert!(!robot.is_finished() && supervisor.is_running());
            places.store(1, Relaxed);
            run.wait_until_tick(10);
        }
        // The run is lost: nobody tells the robot of an end.
        supervisor.signal(Signal::STOP);
        let _ = run.gateway().map(|gateway| kill_process(gateway, Signal::KILL));
        supervisor.kill();
        run.assert_nothing_left();
    }
    termination.request();
    assert_eq!(robot.join().unwrap(), Ok(()));
}
