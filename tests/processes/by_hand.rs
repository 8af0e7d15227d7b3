//! Nodes started one by one, each as if in its own terminal.

use rustix::process::Signal;

use crate::support::{Process, Run, digest_in_process, is_alive, signal};

const SIM: &str = "sim mine.toml";

const SCENARIO: &str = "clock = \"lockstep\"\nticks = 200\nseed = 3\ntimeout_s = \"forever\"\n";

/// Starts one node and waits until it has joined the run or reports that it waits for it.
fn start(run: &Run, words: &str) -> Process {
    let process = if words == SIM { run.command(words) } else { run.node(words) };
    run.wait_until(words, || process.has_joined() || process.stderr().contains("waiting for run"));
    process
}

#[test]
fn in_any_order_of_starting_the_run_is_the_same() {
    let robots = ["robot --id 0", "robot --id 1", "robot --id 2"];
    let [robot_0, robot_1, robot_2] = robots;
    let orders = [
        [SIM, "fusion", "watch", robot_0, robot_1, robot_2],
        [robot_2, robot_1, robot_0, "watch", "fusion", SIM],
        ["watch", robot_1, SIM, robot_0, robot_2, "fusion"],
        ["fusion", robot_2, "watch", SIM, robot_0, robot_1],
    ];
    let oracle = Run::new();
    oracle.write("mine.toml", SCENARIO);
    oracle.command("run mine.toml --in-process").finish().succeeded();

    for order in orders {
        let run = Run::new();
        run.write("mine.toml", SCENARIO);
        let (last, first) = order.split_last().unwrap();
        let mut nodes: Vec<Process> = first.iter().map(|words| start(&run, words)).collect();
        // Fusion, or the last node to start, delays the run until the watch has joined.
        let held = if *last == SIM { first.iter().position(|words| *words == "fusion") } else { None };
        let watch = first.iter().position(|words| *words == "watch").unwrap();
        if let Some(held) = held {
            nodes[held].signal(Signal::STOP);
            nodes.push(start(&run, last));
        }
        run.wait_until("the watch has joined", || nodes[watch].has_joined());
        match held {
            Some(held) => nodes[held].signal(Signal::CONT),
            None => nodes.push(start(&run, last)),
        }
        for node in nodes {
            node.finish().succeeded();
        }
        assert_eq!(run.digest(), oracle.digest(), "{order:?}");
        let report = run.report();
        assert!(report["nodes"].as_array().unwrap().iter().all(|node| node["starts"] == 1), "{report}");
        assert_eq!(report["ranges"]["fused"], 600, "{report}");
        assert_eq!(run.read("estimate.csv").lines().count(), 202);
        run.assert_nothing_left();
    }
}

#[test]
fn overrides_of_a_simulator_started_by_hand_reach_the_others() {
    let run = Run::new();
    let words = "--ticks 30 --robots 1 --seed 4 --planner standard";
    let sim = run.command(&format!("sim --clock lockstep {words}"));
    let watch = run.node("watch");
    run.wait_until("the watch has joined", || watch.has_joined());
    let nodes = [run.node("robot --id 0"), run.node("fusion")];
    for node in nodes.into_iter().chain([sim, watch]) {
        node.finish().succeeded();
    }
    assert_eq!(run.digest(), digest_in_process(words));
}

#[test]
fn a_role_that_is_taken_or_does_not_exist_is_refused() {
    let run = Run::new();
    let sim = run.command("sim --clock lockstep --ticks 30");
    let fusion = run.node("fusion");
    run.pid_of("sim", 1);
    run.pid_of("fusion", 1);
    let refusals = [
        ("fusion", "fusion of run"),
        ("robot --id 3", "(--id) is not in this run: expected 0 to 2"),
        ("restart fusion", "expected a run with a supervisor"),
    ]
    .map(|(words, names)| (names, run.node(words).finish()));
    let robots = ["robot --id 0", "robot --id 1", "robot --id 2"].map(|words| run.node(words));
    for node in robots.into_iter().chain([sim, fusion]) {
        node.finish().succeeded();
    }
    run.assert_nothing_left();
    for (names, refusal) in &refusals {
        assert!(refusal.stderr.lines().count() == 1 && refusal.stderr.contains(names), "{refusal:#?}");
    }
    assert_eq!(refusals.map(|(_, refusal)| refusal.code), [Some(2); 3]);
}

#[test]
fn a_supervised_run_leaves_robots_to_others() {
    let words = "--ticks 60 --robots 3 --seed 4 --planner standard";
    let run = Run::new();
    let supervisor = run.lockstep(&format!("--timeout forever {words} --external 0,2"));
    let [first, other] = ["robot --id 0", "robot --id 2"].map(|words| run.node(words));
    for process in [first, other, supervisor] {
        process.finish().succeeded();
    }
    assert_eq!(run.digest(), digest_in_process(words));
    let nodes = run.report()["nodes"].clone();
    let names: Vec<&str> = nodes.as_array().unwrap().iter().filter_map(|node| node["name"].as_str()).collect();
    assert!(names.contains(&"robot-1") && !names.contains(&"robot-0"), "{names:?}");
    run.assert_nothing_left();
    for (flags, names) in
        [("--external 3", "robot 3 (--external)"), ("--external 1 --in-process", "cannot be used with")]
    {
        let refusal = Run::new().command(&format!("run {words} {flags}")).finish();
        assert!(refusal.code == Some(2) && refusal.stderr.contains(names), "{refusal:#?}");
    }
}

#[test]
fn a_supervised_run_leaves_fusion_to_others() {
    let words = "--ticks 60 --robots 3 --seed 4 --planner standard";
    let run = Run::new();
    let supervisor = run.lockstep(&format!("--timeout forever {words} --external fusion,1"));
    for process in [run.node("robot --id 1"), run.node("fusion"), supervisor] {
        process.finish().succeeded();
    }
    assert_eq!(run.digest(), digest_in_process(words));
    let nodes = run.report()["nodes"].clone();
    let names: Vec<&str> = nodes.as_array().unwrap().iter().filter_map(|node| node["name"].as_str()).collect();
    assert_eq!(names, ["sim", "robot-0", "robot-2"]);
    run.assert_nothing_left();
}

#[test]
fn nodes_that_others_have_started_end_with_a_run_that_is_stopped() {
    for is_by_command in [true, false] {
        let run = Run::new();
        let words = "--timeout forever --ticks 1000000 --robots 2 --planner greedy --external fusion,1";
        let supervisor = run.lockstep(words);
        let [robot, fusion] = ["robot --id 1", "fusion"].map(|words| run.node(words));
        run.wait_for_ticks(50);
        // Only now: whoever is first leads.
        let others = [robot, fusion, run.node("fusion --standby")];
        run.wait_until("a standby is there", || run.starts("standby-1") == 1);
        if is_by_command {
            run.node("stop").finish().succeeded();
        } else {
            supervisor.signal(Signal::INT);
        }
        let stopped = supervisor.finish();
        assert!(stopped.code == Some(1) && stopped.stderr.contains("rangehound resume"), "{stopped:#?}");
        for other in others {
            let ended = other.finish();
            assert!(ended.code == Some(0) && ended.stderr.contains("was ended before its last tick"), "{ended:#?}");
        }
        run.assert_nothing_left();
    }
}

#[test]
fn a_resumed_run_leaves_the_same_robots_to_others() {
    let words = "--ticks 20000 --robots 3 --seed 4 --planner standard";
    let run = Run::new();
    let supervisor = run.lockstep(&format!("--timeout forever {words} --external 0,2"));
    let others = || ["robot --id 0", "robot --id 2"].map(|words| run.node(words));
    let killed = others();
    run.wait_for_ticks(50);
    let nodes = ["sim", "fusion", "robot-0", "robot-1", "robot-2"].map(|role| run.pid_of(role, 1));
    supervisor.signal(Signal::KILL);
    nodes.iter().for_each(|pid| signal(*pid, Signal::KILL));
    killed.into_iter().chain([supervisor]).for_each(|process| drop(process.finish()));
    run.wait_until("all are gone", || !nodes.iter().any(|pid| is_alive(*pid)));

    let resume = || run.start(&["resume", "out", "--name", &run.name]);
    let supervisor = resume();
    run.pid_of("robot-1", 1);
    for process in others().into_iter().chain([supervisor]) {
        process.finish().succeeded();
    }
    assert_eq!(run.digest(), digest_in_process(words));
    let nodes = run.report()["nodes"].clone();
    let names: Vec<&str> = nodes.as_array().unwrap().iter().filter_map(|node| node["name"].as_str()).collect();
    assert_eq!(names, ["sim", "fusion", "robot-1"]);
    run.assert_nothing_left();

    run.write("out/external.json", "[0, \"two\"]");
    let refused = resume().finish();
    assert!(refused.code == Some(2) && refused.stderr.contains("external.json"), "{refused:#?}");
    assert_eq!(refused.stderr.lines().count(), 1, "{refused:#?}");
}

#[test]
fn a_node_that_waits_for_its_run_ends_when_asked() {
    for words in ["fusion", "robot --id 0", "watch"] {
        let run = Run::new();
        let node = start(&run, words);
        node.signal(Signal::INT);
        assert!(node.finish().code.is_some(), "{words}");
        assert!(!run.shared_folder().exists(), "{words}");
    }
}

/// The successor of a killed node, also started by hand, continues from the checkpoint.
#[test]
fn killed_nodes_are_replaced_by_hand_and_change_nothing() {
    let scenario = SCENARIO.replace("200", "4000");
    let oracle = Run::new();
    oracle.write("mine.toml", &scenario);
    oracle.command("run mine.toml --in-process").finish().succeeded();
    let run = Run::new();
    run.write("mine.toml", &scenario);
    let mut nodes: Vec<Process> =
        [SIM, "robot --id 0", "robot --id 1", "robot --id 2", "watch"].map(|words| start(&run, words)).into();
    nodes.push(start(&run, "fusion"));
    for (role, words) in [("fusion", "fusion"), ("sim", SIM), ("robot-1", "robot --id 1"), ("fusion", "fusion")] {
        let ticks = run.ticks_done();
        run.wait_for_ticks(ticks + 100);
        let starts = run.starts(role);
        signal(run.pid_of(role, starts), Signal::KILL);
        nodes.push(start(&run, words));
    }
    let codes: Vec<Option<i32>> = nodes.into_iter().map(|node| node.finish().code).collect();
    assert_eq!(codes.iter().filter(|code| code.is_none()).count(), 4, "the killed: {codes:?}");
    assert_eq!(codes.iter().filter(|code| **code == Some(0)).count(), 6, "{codes:?}");
    assert_eq!(run.digest(), oracle.digest());
    assert_eq!(run.report()["ranges"]["missing"], 0);
    run.assert_nothing_left();
}

/// The first checkpoint is written before the first tick is logged: a simulator killed between a tick's
/// record and the checkpoint after it is replaced too.
#[test]
fn a_simulator_killed_after_its_first_record_is_replaced() {
    let run = Run::new();
    run.write("mine.toml", SCENARIO);
    // Without the team, tick 0 never ends.
    let sim = start(&run, SIM);
    let checkpoint = run.path("out/sim.checkpoint");
    run.wait_until("the first checkpoint", || std::fs::metadata(&checkpoint).is_ok_and(|file| file.len() > 0));
    let robots = ["robot --id 0", "robot --id 1", "robot --id 2"].map(|words| start(&run, words));
    sim.signal(Signal::KILL);
    sim.finish();
    // As if tick 0 had been logged: longer than its header.
    let log = std::fs::OpenOptions::new().append(true).open(run.path("out/world.ticks")).unwrap();
    log.set_len(24 + 8 * 19).unwrap();
    let nodes = [start(&run, SIM), start(&run, "watch"), start(&run, "fusion")];
    for node in robots.into_iter().chain(nodes) {
        node.finish().succeeded();
    }
    assert_eq!(run.report()["ranges"]["fused"], 600);
    run.assert_nothing_left();
}

/// Without a usable state a successor would start from the prior and overwrite the logs.
#[test]
fn a_damaged_checkpoint_is_refused_and_kept() {
    let run = Run::new();
    run.write("mine.toml", SCENARIO.replace("200", "100000000"));
    let mut nodes: Vec<Process> =
        [SIM, "robot --id 0", "robot --id 1", "robot --id 2"].map(|words| start(&run, words)).into();
    let fusion = start(&run, "fusion");
    run.wait_for_ticks(10);
    fusion.signal(Signal::KILL);
    assert_eq!(fusion.finish().code, None);
    run.write("out/fusion.checkpoint", vec![7_u8; 5_000]);
    let refused = run.node("fusion").finish();
    assert_eq!((refused.code, refused.stderr.lines().count()), (Some(2), 1), "{refused:#?}");
    assert!(refused.stderr.contains("fusion.checkpoint") && refused.stderr.contains("kept as"), "{refused:#?}");
    assert!(run.path("out/fusion.checkpoint.refused").exists());
    // The checkpoint is gone, but the next node must not start from the prior either.
    let refused = run.node("fusion").finish();
    assert_eq!(refused.code, Some(2), "{refused:#?}");
    assert!(refused.stderr.contains("fusion of run") && refused.stderr.contains("start a new run"), "{refused:#?}");
    for node in nodes.drain(..) {
        node.signal(Signal::INT);
        node.finish();
    }
    run.assert_nothing_left();
}

#[test]
fn a_watch_reports_that_its_run_was_stopped() {
    let run = Run::new();
    let supervisor = run.command("run --clock realtime --ticks 100000");
    run.wait_for_ticks(2);
    let watch = run.node("watch");
    run.wait_until("it watches", || watch.has_joined());
    run.node("stop").finish().succeeded();
    let outcome = watch.finish();
    assert!(outcome.code == Some(1) && outcome.stderr.contains("before its last tick"), "{outcome:?}");
    assert_eq!(supervisor.finish().code, Some(1));
    run.assert_nothing_left();
}
