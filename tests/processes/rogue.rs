//! A process of the same user that joins a run and sends invalid messages as fast as it can.

use std::fs::File;
use std::path::Path;
use std::process::{Child, Command};
use std::time::{Duration, Instant};

use rangehound_node::bus::{Bus, Event, WaitGroup};
use rangehound_node::rendezvous::Rendezvous;
use rangehound_shared::measurement::{Measurement, Pose};
use rangehound_shared::message::{Command as Heading, Drive, Range, WorldEntry};
use rangehound_shared::run_name::RunName;
use rustix::process::Signal;

use crate::support::{Run, digest_in_process, signal};

/// Environment variable with the run of the rogue.
const RUN: &str = "RANGEHOUND_TEST_ROGUE";

/// Longest time for which the rogue runs if it is not killed.
const LIMIT: Duration = Duration::from_secs(100);

/// Not a test: the rogue's process, started by the tests below.
#[test]
#[ignore = "the main function of the rogue process"]
fn rogue() {
    let Ok(name) = std::env::var(RUN) else { return };
    let name: RunName = name.parse().unwrap();
    let Some(run) = Rendezvous::join_if_alive(&name).unwrap() else { return };
    let bus = Bus::connect(&run, "rogue").unwrap();
    let robots = run.description().scenario.robots.len();
    let ranges = bus.publisher::<Range>(1).unwrap();
    let headings = bus.publisher::<Heading>(robots).unwrap();
    let drives = bus.publisher::<Drive>(1).unwrap();
    let worlds = bus.publisher::<WorldEntry>(robots).unwrap();
    let notifiers = [WaitGroup::Sim, WaitGroup::Fusion, WaitGroup::Robots].map(|group| bus.notifier_of(group));
    // It claims a greater incarnation than any node has.
    bus.mark_messages(1_000);
    println!("joined");
    let began = Instant::now();
    let mut round = 0_u64;
    while !run.is_finished() && began.elapsed() < LIMIT {
        for _ in 0..1_000 {
            round += 1;
            let robot = round % (robots as u64 + 2);
            let tick = round % 5_000;
            let range_m = [1.0, f64::NAN, -1.0, f64::INFINITY][(round / 7 % 4) as usize];
            let measurement = Measurement::new(Pose::default(), Some((range_m, 1e-3)));
            let range = Range { robot, measurement };
            ranges.send(tick, 0.1 * tick as f64, &[range]).unwrap();
            let heading = Heading { heading_rad: 1.0, speed_mps: 10.0 };
            headings.send(tick, 0.0, &vec![heading; robots]).unwrap();
            let drive = Drive { robot, heading_rad: 1.0, speed_mps: 1e9, heading_held_ns: 1, ..Drive::default() };
            drives.send(tick, 0.0, &[drive]).unwrap();
            worlds
                .send(tick, 0.0, &vec![WorldEntry { range_m: 3.0, kinds: 1, ..WorldEntry::default() }; robots])
                .unwrap();
        }
        for notifier in &notifiers {
            for event in [Event::World, Event::Range, Event::Heading, Event::Drive, Event::Hello] {
                notifier.signal(event);
            }
        }
    }
    println!("sent {} messages in {:?}", 4 * round, began.elapsed());
}

fn start_rogue(run: &Run, output: &Path) -> Child {
    let words = ["--exact", "processes::rogue::rogue", "--ignored", "--nocapture"];
    Command::new(std::env::current_exe().unwrap())
        .args(words)
        .env(RUN, &run.name)
        .stdout(File::create(output).unwrap())
        .spawn()
        .unwrap()
}

#[test]
fn a_rogue_at_full_speed_changes_nothing() {
    let words = "--ticks 20000 --timeout forever";
    let run = Run::new();
    let supervisor = run.lockstep(words);
    // Before that, a topic may be half created, and would stay so.
    run.wait_for_ticks(5);
    let robot = run.pid_of("robot-0", 1);
    signal(robot, Signal::STOP);
    let output = run.path("rogue.out");
    let mut rogue = start_rogue(&run, &output);
    // The run goes on only while the rogue sends.
    run.wait_until("the rogue has joined", || {
        std::fs::read_to_string(&output).is_ok_and(|output| output.contains("joined"))
    });
    signal(robot, Signal::CONT);
    let outcome = supervisor.finish();
    let _ = rogue.kill();
    rogue.wait().unwrap();
    outcome.succeeded();
    assert_eq!(run.digest(), digest_in_process(words));
    let report = run.report();
    assert_eq!(report["ranges"]["fused"], 60_000, "{report}");
    assert!(report["refused"]["impostor"].as_u64().unwrap() > 0, "{report}");
    run.assert_nothing_left();
}
