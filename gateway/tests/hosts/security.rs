//! Who may take part, and what strangers can do: nothing.

use std::net::UdpSocket;
use std::time::{Duration, Instant};

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;

use crate::support::{Faults, Link, Process, Run};

fn with_keys() -> Run {
    let run = Run::new();
    let (code, text) = run.finish("keys --out keys --gateway station --host alice=0,1 --host bob=2");
    assert_eq!(code, Some(0), "{text}");
    let (code, text) = run.finish("keys --out other --gateway station --host alice=0-5");
    assert_eq!(code, Some(0), "{text}");
    run
}

#[test]
fn an_address_that_others_can_reach_demands_keys() {
    let run = Run::new();
    let (code, text) = run.finish("run --listen 0.0.0.0:0 --out out");
    assert!(code == Some(2) && text.lines().count() == 1 && text.contains("--keys is missing"), "{text}");
    let (code, text) = run.finish("run --in-process --listen 127.0.0.1:0 --out out");
    assert!(code == Some(2) && text.lines().count() == 1 && text.contains("--listen"), "{text}");
    let (code, text) = run.finish("robot --id 0 --connect 192.0.2.1:7447");
    assert!(code == Some(2) && text.lines().count() == 1 && text.contains("--keys is missing"), "{text}");
    let (code, text) = run.finish("robot --id 0 --connect 127.0.0.1");
    assert!(code == Some(2) && text.lines().count() == 1 && text.contains("expected HOST:PORT"), "{text}");
    let (code, text) = run.finish("run --listen 127.0.0.1:0 --keys nowhere --out out");
    assert!(code == Some(2) && text.lines().count() == 1 && text.contains("nowhere"), "{text}");
    assert!(!run.path("out").exists());
    let run = with_keys();
    let (code, text) = run.finish("run --listen 127.0.0.1:0 --keys keys/alice --out out");
    assert!(code == Some(2) && text.lines().count() == 1 && text.contains("a host of robots"), "{text}");
}

/// Each is refused with one line at both ends, and the run goes on.
#[test]
fn wrong_foreign_and_missing_certificates_are_refused_at_both_ends() {
    let run = with_keys();
    let words = "--clock lockstep --timeout forever --ticks 200 --robots 3 --keys keys/station";
    let (supervisor, gateway) = run.run(words);
    let connect = |id: usize, keys: &str| run.finish(&format!("robot --id {id} --connect {gateway} {keys}"));
    for (id, keys, robot_says, gateway_says) in [
        (
            2,
            "--keys keys/alice",
            "the certificate of alice does not name it",
            "the certificate of alice does not name it",
        ),
        (0, "--keys other/alice", "another authority", "another authority"),
        (0, "", "no certificate", "no certificate"),
        (9, "--keys keys/alice", "(--id) is not in this run", "(--id) is not in this run"),
        (0, "--keys keys/alice --name another", "this is the gateway of run", "this is the gateway of run"),
    ] {
        let (code, text) = connect(id, keys);
        assert_eq!(code, Some(2), "{keys}: {text}");
        assert!(text.lines().count() == 1 && text.contains(robot_says), "{keys}: {text}");
        run.wait_for("the gateway's line", || supervisor.stderr().contains(gateway_says).then_some(()));
    }
    let robots = [(0, "alice"), (1, "alice"), (2, "bob")]
        .map(|(id, host)| run.start(&format!("robot --id {id} --connect {gateway} --keys keys/{host}")));
    supervisor.succeeds();
    for robot in robots {
        robot.succeeds();
    }
    run.assert_nothing_left();
}

/// Between the hosts somebody sends old packets again, and damaged copies, both ways.
#[test]
fn replayed_and_damaged_packets_change_nothing() {
    let run = Run::new();
    let words = "--clock lockstep --timeout forever --ticks 600 --robots 3 --seed 3";
    let (supervisor, gateway) = run.run(words);
    let link = Link::new(gateway, 7, Faults { replayed: 0.5, damaged: 0.5, ..Faults::default() });
    let robots = [0, 1, 2].map(|id| run.robot(id, link.address));
    supervisor.succeeds();
    robots.into_iter().for_each(Process::succeeds);
    assert!(link.hostile().iter().all(|count| *count >= 1_000), "{:?}", link.hostile());
    assert_eq!(run.digest(), Run::digest_in_process(words));
    run.assert_nothing_left();
}

/// Random packets cost the run nothing and the gateway no memory.
#[test]
fn a_strangers_flood_changes_nothing() {
    let run = Run::new();
    let words = "--clock lockstep --timeout forever --ticks 600 --robots 2 --seed 3";
    let (supervisor, gateway) = run.run(words);
    let robots = [0, 1].map(|id| run.robot(id, gateway));
    let stranger = UdpSocket::bind("127.0.0.1:0").unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let began = Instant::now();
    let mut sent = 0;
    run.wait_until_tick(1);
    while sent < 5_000 && began.elapsed() < Duration::from_secs(30) {
        let mut packet: Vec<u8> = (0..random.random_range(1..1_400)).map(|_| random.random()).collect();
        if sent % 2 == 0 {
            // It looks like the first packet of a connection.
            packet[0] |= 0xc0;
        }
        let _ = stranger.send_to(&packet, gateway);
        sent += 1;
    }
    supervisor.succeeds();
    for robot in robots {
        robot.succeeds();
    }
    assert_eq!(run.digest(), Run::digest_in_process(words));
}

/// Its link is cut during the handshake: nobody has refused it.
#[test]
fn a_peer_that_goes_away_is_no_refusal() {
    let run = Run::new();
    let (supervisor, gateway) = run.run("--clock lockstep --timeout forever --robots 1");
    let link = Link::new(gateway, 3, Faults::default());
    link.cut(false, true);
    let robot = run.robot(0, link.address);
    run.wait_for("its message", || robot.stderr().contains("no answer").then_some(()));
    robot.kill();
    // The gateway gives up a handshake after three seconds, and writes its note each half second.
    std::thread::sleep(Duration::from_millis(4_000));
    let refusals = run.wait_for("the note", || Some(run.status()?["gateway"]["refusals"].as_object()?.len()));
    assert_eq!(refusals, 0, "{:?}", run.status());
    run.finish_ok(&format!("stop --name {}", run.name));
    drop(supervisor);
}
