//! Standby fusions: leadership, take-over, and that no robot obeys two fusions.

use std::time::Duration;

use rustix::process::Signal;

use crate::support::{Run, digest_in_process, is_alive, signal};

/// Waits until the lead has been taken this many times, and the run continues under it.
fn wait_for_lead(run: &Run, start: u64) {
    run.pid_of("fusion", start);
    let ticks = run.ticks_done();
    run.wait_for_ticks(ticks + 20);
}

#[test]
fn a_killed_fusion_is_succeeded_by_its_standby_and_nothing_changes() {
    let words = "--ticks 80000 --timeout forever";
    let run = Run::new();
    let supervisor = run.lockstep(&format!("{words} --standby 2"));
    run.wait_for_ticks(50);
    for start in 1..=6 {
        let leader = run.pid_of("fusion", start);
        // So that another fusion can take the lead before the killed one is restarted.
        run.wait_until("a standby is there", || run.is_held("standby-1") || run.is_held("standby-2"));
        signal(leader, Signal::KILL);
        wait_for_lead(&run, start + 1);
    }
    // The supervisor looks several times a second who leads.
    std::thread::sleep(Duration::from_millis(500));
    run.wait_until("a standby is there", || run.is_held("standby-1") || run.is_held("standby-2"));
    let reports = || supervisor.stderr().lines().filter(|line| line.contains("; a standby ")).count();
    let before = reports();
    signal(run.pid_of("fusion", 7), Signal::KILL);
    run.wait_until("the supervisor tells who leads", || reports() > before);
    supervisor.finish().succeeded();
    assert_eq!(run.digest(), digest_in_process(words));
    let report = run.report();
    assert_eq!(report["ranges"]["fused"], 240_000, "{report}");
    let names: Vec<&str> =
        report["nodes"].as_array().unwrap().iter().filter_map(|node| node["name"].as_str()).collect();
    assert!(names.ends_with(&["standby-1", "standby-2"]), "{names:?}");
    run.assert_nothing_left();
}

/// Stopped at any moment, it is deposed; continued, it commands no robot and becomes a standby.
#[test]
fn a_hung_fusion_is_deposed_and_its_commands_are_not_obeyed() {
    let words = "--ticks 600000 --timeout forever";
    let run = Run::new();
    let supervisor = run.lockstep(&format!("{words} --standby 1"));
    run.wait_for_ticks(50);
    for start in 1..=4 {
        let leader = run.pid_of("fusion", start);
        run.wait_until("a standby is there", || run.is_held("standby-1"));
        signal(leader, Signal::STOP);
        wait_for_lead(&run, start + 1);
        assert!(is_alive(leader));
        signal(leader, Signal::CONT);
        run.wait_until("the deposed stands by", || run.is_held("standby-1"));
    }
    supervisor.finish().succeeded();
    assert_eq!(run.digest(), digest_in_process(words));
    assert_eq!(run.report()["ranges"]["fused"], 1_800_000);
    run.assert_nothing_left();
}

/// In real time robots keep their headings without a leader: with a standby for one tick at most each time.
#[test]
fn in_real_time_a_standby_leaves_no_robot_long_without_a_heading() {
    let run = Run::new();
    run.write("mine.toml", "ticks = 300\ndt_s = 0.02\nclock = \"realtime\"\n");
    let supervisor = run.command("run mine.toml --standby 1");
    run.wait_for_ticks(20);
    let kills = 5;
    for start in 1..=kills {
        let leader = run.pid_of("fusion", start);
        run.wait_until("a standby is there", || run.is_held("standby-1"));
        signal(leader, Signal::KILL);
        wait_for_lead(&run, start + 1);
    }
    supervisor.finish().succeeded();
    let held = run.report()["headings"]["none"].as_u64().unwrap();
    // A loaded machine may add a tick or two of its own; without a take-over each kill would cost several.
    assert!(held <= 3 * 3 * kills, "{held} times a robot had no heading");
    run.assert_nothing_left();
}

/// The simulator has ended by then, and the last ticks have no estimate yet.
#[test]
fn a_fusion_killed_after_the_last_tick_is_replaced_and_estimates_it() {
    for standbys in ["", "--standby 1"] {
        let run = Run::new();
        run.write("mine.toml", "ticks = 100\ndt_s = 0.02\nclock = \"realtime\"\n");
        let supervisor = run.command(&format!("run mine.toml {standbys}"));
        run.wait_for_ticks(20);
        let leader = run.pid_of("fusion", 1);
        run.wait_until("a standby is there", || standbys.is_empty() || run.is_held("standby-1"));
        run.wait_for_ticks(95);
        signal(leader, Signal::STOP);
        run.wait_until("the simulator has ended", || run.shared_folder().join("finished").exists());
        signal(leader, Signal::KILL);
        supervisor.finish().succeeded();
        assert_eq!(run.report()["ticks"], 100);
        run.assert_nothing_left();
    }
}

#[test]
fn a_standby_started_by_hand_leads_if_there_is_no_leader() {
    let run = Run::new();
    let sim = run.command("sim --clock lockstep --ticks 30000 --timeout forever");
    let mut nodes: Vec<_> = (0..3).map(|id| run.node(&format!("robot --id {id}"))).collect();
    let first = run.node("fusion --standby");
    run.wait_for_ticks(5);
    let second = run.node("fusion --standby");
    run.wait_until("the second stands by", || run.is_held("standby-1"));
    first.signal(Signal::KILL);
    assert_eq!(first.finish().code, None);
    nodes.extend([sim, second]);
    for node in nodes {
        node.finish().succeeded();
    }
    run.assert_nothing_left();
}

/// A step of the grid search takes longer than the silence for which another planner's fusion is deposed.
#[test]
fn a_fusion_that_searches_a_grid_is_not_deposed_for_it() {
    let run = Run::new();
    let near = "dt_s = 3.0\nclock = \"lockstep\"\nticks = 1\ntimeout_s = \"forever\"\n[target]\nstart = [15.3, 0.2, 0.0, 0.0]\n";
    run.write("mine.toml", format!("{near}[robots]\ncount = 4\n[planner]\nname = \"grid\"\nstand_off_m = 0\n"));
    run.command("run mine.toml --standby 1").finish().succeeded();
    assert!(run.report()["nodes"].as_array().unwrap().iter().all(|node| node["starts"] == 1));
    assert_eq!(run.report()["headings"]["refused"], 0);
    run.assert_nothing_left();
}
