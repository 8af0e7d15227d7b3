//! Runs whose processes are ended, stopped, or crowded by another run of their name.

use rustix::process::{Pid, Signal};

use crate::support::{Run, digest_in_process, is_alive, signal};

const ROLES: [&str; 5] = ["sim", "fusion", "robot-0", "robot-1", "robot-2"];

/// A run longer than any test.
const ENDLESS: &str = "--ticks 100000000 --timeout forever";

fn pids(run: &Run) -> Vec<Pid> {
    ROLES.iter().map(|role| run.pid_of(role, 1)).collect()
}

#[test]
fn a_second_run_of_a_living_name_is_refused_and_the_first_goes_on() {
    let words = "--ticks 20000 --timeout forever";
    let run = Run::new();
    let first = run.lockstep(words);
    // Suspended, so that it lives until the second has noticed it.
    let robot = run.pid_of("robot-0", 1);
    signal(robot, Signal::STOP);
    let refused = run.start(&["run", "--clock", "lockstep", "--name", &run.name, "--out", "elsewhere"]).finish();
    signal(robot, Signal::CONT);
    assert_eq!(refused.code, Some(2), "{refused:#?}");
    assert_eq!((refused.stdout.as_str(), refused.stderr.lines().count()), ("", 1), "{refused:#?}");
    assert!(refused.stderr.contains(&run.name), "{refused:#?}");
    first.finish().succeeded();
    assert_eq!(run.digest(), digest_in_process(words));
    run.assert_nothing_left();
}

#[test]
fn a_refused_run_does_not_change_the_folder_of_the_living_one() {
    let run = Run::new();
    let first = run.lockstep("--ticks 50 --timeout forever");
    let robot = run.pid_of("robot-0", 1);
    signal(robot, Signal::STOP);
    let before = run.read("scenario.toml");
    let refused = run.lockstep("--ticks 7 --seed 9").finish();
    signal(robot, Signal::CONT);
    assert_eq!(refused.code, Some(2), "{refused:#?}");
    assert_eq!(run.read("scenario.toml"), before);
    first.finish().succeeded();
}

#[test]
fn an_interrupt_ends_every_process_and_still_reports() {
    let run = Run::new();
    let supervisor = run.command(&format!("run --clock realtime {ENDLESS}"));
    let nodes = pids(&run);
    run.wait_for_ticks(3);
    supervisor.signal(Signal::INT);
    let outcome = supervisor.finish();
    assert_eq!(outcome.code, Some(1), "{outcome:#?}");
    assert_eq!(outcome.complaints().len(), 1, "{outcome:#?}");
    assert!(!nodes.iter().any(|pid| is_alive(*pid)));
    let report = run.report();
    assert!(report["ticks"].as_u64().unwrap() >= 1, "{report}");
    for node in report["nodes"].as_array().unwrap() {
        assert_eq!((&node["starts"], &node["kills"]), (&1.into(), &0.into()), "{report}");
    }
    run.assert_nothing_left();
}

#[test]
fn an_interrupt_ends_even_nodes_that_cannot_hear_it() {
    let run = Run::new();
    let supervisor = run.lockstep(ENDLESS);
    let nodes = pids(&run);
    run.wait_for_ticks(3);
    for deaf in [nodes[0], nodes[2]] {
        signal(deaf, Signal::STOP);
    }
    supervisor.signal(Signal::INT);
    assert_eq!(supervisor.finish().code, Some(1));
    assert!(!nodes.iter().any(|pid| is_alive(*pid)));
    run.assert_nothing_left();
}

#[test]
fn killed_nodes_of_every_role_are_started_again_and_change_nothing() {
    let words = "--ticks 60000 --timeout forever";
    let run = Run::new();
    let supervisor = run.lockstep(words);
    run.wait_for_ticks(200);
    // The second process of a role is killed as soon as it takes the role, during its start.
    for (role, start) in
        [("robot-1", 1), ("robot-1", 2), ("robot-0", 1), ("fusion", 1), ("fusion", 2), ("sim", 1), ("sim", 2)]
    {
        signal(run.pid_of(role, start), Signal::KILL);
    }
    let ticks = run.ticks_done();
    run.wait_for_ticks(ticks + 200);
    // All at once.
    for (role, start) in [("sim", 3), ("fusion", 3), ("robot-0", 2), ("robot-1", 3), ("robot-2", 1)] {
        signal(run.pid_of(role, start), Signal::KILL);
    }
    supervisor.finish().succeeded();
    assert_eq!(run.digest(), digest_in_process(words));
    let report = run.report();
    let counts = |key: &str| -> Vec<u64> {
        report["nodes"].as_array().unwrap().iter().filter_map(|node| node[key].as_u64()).collect()
    };
    assert_eq!(counts("starts"), [4, 4, 3, 4, 2]);
    assert_eq!(counts("kills"), [3, 3, 2, 3, 1]);
    assert_eq!(counts("exits"), [0; 5]);
    assert_eq!(report["ranges"]["published"], 3 * 60_000);
    assert_eq!(report["ranges"]["fused"], 3 * 60_000);
    run.assert_nothing_left();
}

/// The simulator keeps the errors of poses and biases over its kills, and fusion what it knows of them.
#[test]
fn kills_change_nothing_whatever_the_robots_measure() {
    let run = Run::new();
    run.write("mixed.toml", MIXED);
    let words = "run mixed.toml --clock lockstep --record --timeout forever";
    let supervisor = run.command(words);
    let mut starts = std::collections::BTreeMap::new();
    for role in ["fusion", "sim", "robot-1", "sim", "fusion", "robot-3"] {
        let ticks = run.ticks_done();
        run.wait_for_ticks(ticks + 100);
        let start = starts.entry(role).or_insert(0);
        *start += 1;
        signal(run.pid_of(role, *start), Signal::KILL);
    }
    supervisor.finish().succeeded();
    let alone = Run::new();
    alone.write("mixed.toml", MIXED);
    alone.command("run mixed.toml --clock lockstep --in-process").finish().succeeded();
    assert_eq!(run.digest(), alone.digest());
    let replayed = run.start(&["replay", "out/run.mcap", "--json"]).finish();
    assert_eq!(replayed.code, Some(0), "{replayed:#?}");
    run.assert_nothing_left();
}

/// Ranges, bearings and both, from poses with errors of each kind.
const MIXED: &str = "ticks = 6000\n[target]\nnoise_psd = 0.1\n[planner]\nname = \"greedy\"\nstand_off_m = 5.0\n\
    [sensor.radio]\nrange_std_m = 1.0\nrange_bias_std_m = 0.2\n\
    [sensor.camera]\nbearing_std_rad = 0.05\nmax_range_m = 60.0\nfield_of_view_rad = 3.0\n\
    [sensor.both]\nrange_std_m = 0.5\nrange_std_per_m = 0.02\nbearing_std_rad = 0.1\n\
    [localiser.gps]\nstd_m = 0.5\ncorrelation_s = 5.0\nheading_std_rad = 0.02\n\
    [localiser.odometry]\nstd_m = 0.1\ndrift_m = 0.02\n\
    [[robot]]\nsensor = \"radio\"\nlocaliser = \"gps\"\n[[robot]]\nsensor = \"camera\"\nlocaliser = \"odometry\"\n\
    [[robot]]\nsensor = \"both\"\n[[robot]]\nsensor = \"radio\"\nlocaliser = \"odometry\"\n";

/// Including the supervisor, so that no process restarts the nodes.
#[test]
fn a_run_whose_processes_are_all_killed_goes_on_from_its_checkpoints() {
    let words = "--ticks 60000 --timeout forever";
    let run = Run::new();
    let mut supervisor = run.lockstep(words);
    for ticks in [500, 15_000, 30_000] {
        run.wait_for_ticks(ticks);
        let nodes: Vec<Pid> = ROLES.iter().map(|role| run.pid_of(role, 1)).collect();
        supervisor.signal(Signal::KILL);
        nodes.iter().for_each(|pid| signal(*pid, Signal::KILL));
        supervisor.finish();
        // A busy machine may take a while to end them.
        run.wait_until("all are gone", || !nodes.iter().any(|pid| is_alive(*pid)));
        supervisor = run.start(&["resume", "out", "--name", &run.name]);
    }
    supervisor.finish().succeeded();
    assert_eq!(run.digest(), digest_in_process(words));
    assert_eq!(run.report()["ranges"]["fused"], 3 * 60_000);
    run.assert_nothing_left();

    let refused = run.start(&["resume", "nowhere"]).finish();
    assert_eq!((refused.code, refused.stderr.lines().count()), (Some(2), 1), "{refused:#?}");
}

#[test]
fn other_terminals_can_look_at_a_run_and_act_on_it() {
    let run = Run::new();
    let supervisor = run.lockstep(ENDLESS);
    run.wait_for_ticks(10);
    let status = || -> serde_json::Value {
        serde_json::from_str(&run.node("status --json").finish().succeeded().stdout).unwrap()
    };
    let states = |status: &serde_json::Value| -> Vec<String> {
        status["nodes"].as_array().unwrap().iter().map(|node| node["state"].as_str().unwrap().to_owned()).collect()
    };
    let before = status();
    assert!(before["tick"].as_u64().unwrap() >= 9 && before["ticks"] == 100_000_000_u64, "{before}");
    assert_eq!(states(&before), ["running"; 6], "{before}");
    assert!(run.node("status").finish().succeeded().stdout.contains("robot-2"));

    let robot = run.pid_of("robot-2", 1);
    run.node("kill robot-2").finish().succeeded();
    assert_ne!(run.pid_of("robot-2", 2), robot);
    run.node("restart fusion").finish().succeeded();
    run.pid_of("fusion", 2);
    let ticks = run.ticks_done();
    run.wait_for_ticks(ticks + 10);
    signal(run.pid_of("robot-0", 1), Signal::STOP);
    assert_eq!(states(&status())[2], "stopped");
    signal(run.pid_of("robot-0", 1), Signal::CONT);

    let refused = run.node("kill robot-7").finish();
    assert_eq!(refused.code, Some(2), "{refused:#?}");
    run.node("stop").finish().succeeded();
    assert_eq!(supervisor.finish().code, Some(1), "ended before its last tick");
    let gone = run.node("status").finish();
    assert_eq!((gone.code, gone.stderr.lines().count()), (Some(2), 1), "{gone:#?}");
    run.assert_nothing_left();
}

/// An unfinished object of a killed process has length zero, and iceoryx2 would wait for it.
#[test]
fn unfinished_shared_memory_of_dead_processes_is_removed_and_of_living_ones_is_kept() {
    let run = Run::new();
    let supervisor = run.lockstep(ENDLESS);
    run.wait_for_ticks(3);
    let prefix = run.shared_memory_prefix();
    let half_made = |name: &str| std::path::Path::new("/dev/shm").join(format!("{prefix}{name}"));
    let of_the_dead = half_made("half_made.connection");
    let of_the_living = half_made("being_made.connection");
    std::fs::write(&of_the_dead, b"").unwrap();
    let held_open = std::fs::File::create(&of_the_living).unwrap();
    signal(run.pid_of("robot-1", 1), Signal::KILL);
    run.wait_until("what was half-made is gone", || !of_the_dead.exists());
    run.pid_of("robot-1", 2);
    assert!(of_the_living.exists());
    drop(held_open);
    supervisor.signal(Signal::INT);
    supervisor.finish();
    run.assert_nothing_left();
}

#[test]
fn without_a_restart_of_simulator_or_fusion_a_run_ends_with_the_cause() {
    for role in ["fusion", "sim"] {
        let run = Run::new();
        let supervisor = run.lockstep(&format!("{ENDLESS} --restart {role}=never"));
        let nodes = pids(&run);
        run.wait_for_ticks(10);
        signal(run.pid_of(role, 1), Signal::KILL);
        let outcome = supervisor.finish();
        assert_eq!(outcome.code, Some(1), "{outcome:#?}");
        let [complaint] = outcome.complaints()[..] else { panic!("{outcome:#?}") };
        assert!(complaint.contains(&format!("{role} was killed by signal 9")), "{complaint}");
        assert!(!nodes.iter().any(|pid| is_alive(*pid)));
        run.assert_nothing_left();
    }
}

#[test]
fn the_nodes_of_a_killed_supervisor_end_and_its_name_is_free_again() {
    let run = Run::new();
    let supervisor = run.lockstep(ENDLESS);
    let nodes = pids(&run);
    run.wait_for_ticks(10);
    supervisor.signal(Signal::KILL);
    assert_eq!(supervisor.finish().code, None);
    run.wait_until("all nodes have ended", || !nodes.iter().any(|pid| is_alive(*pid)));
    let words = "--ticks 30";
    run.lockstep(words).finish().succeeded();
    assert_eq!(run.digest(), digest_in_process(words));
    run.assert_nothing_left();
}

/// Stops robot 1 in a run with a short time-out, lets the others continue for a while, lets it rejoin,
/// and ends the run.
fn run_with_robot_1_stopped_for_a_while(run: &Run) {
    // A node without restarts is not killed for hanging either.
    let supervisor = run.lockstep("--ticks 100000000 --timeout 0.2 --restart robot=never");
    let is_heard = || run.last_world().is_some_and(|(tick, world)| tick > 0 && world.robots[1].range_sent_ns.is_some());
    run.wait_until("robot 1 is heard", is_heard);
    let robot = run.pid_of("robot-1", 1);
    signal(robot, Signal::STOP);
    run.wait_until("the simulator goes on without robot 1", || !is_heard());
    // Fusion may have received its range at that tick, but at none of the next.
    let ticks = run.ticks_done();
    run.wait_for_ticks(ticks + 50);
    signal(robot, Signal::CONT);
    run.wait_until("robot 1 is heard again", is_heard);
    supervisor.signal(Signal::INT);
    assert_eq!(supervisor.finish().code, Some(1));
}

#[test]
fn a_stopped_robot_is_left_out_after_the_timeout_and_taken_back() {
    let run = Run::new();
    run_with_robot_1_stopped_for_a_while(&run);
    let report = run.report();
    assert!(report["ranges"]["missing"].as_u64().unwrap() >= 48, "{report}");
    assert_eq!(report["nodes"][3]["starts"], 1, "{report}");
    run.assert_nothing_left();
}

#[test]
fn only_the_stopped_robot_is_left_out() {
    let run = Run::new();
    run_with_robot_1_stopped_for_a_while(&run);
    let log = run.read("logs/sim.log");
    let left_out: Vec<&str> = log.lines().filter(|line| line.contains("continues without")).collect();
    assert!(!left_out.is_empty(), "{log}");
    assert!(left_out.iter().all(|line| line.contains("without robot 1,")), "{left_out:#?}");
}

/// Two runs would overwrite each other's logs and checkpoints.
#[test]
fn a_folder_in_which_a_run_goes_on_is_refused_to_another() {
    let words = "--ticks 40000 --timeout forever";
    let run = Run::new();
    let first = run.lockstep(words);
    let robot = run.pid_of("robot-0", 1);
    signal(robot, Signal::STOP);
    let other = format!("{}-other", run.name);
    let run_into = ["run", "--clock", "lockstep", "--seed", "9", "--name", &other, "--out", "out"];
    let resume_in = ["resume", "out", "--name", &other];
    let sim_into = ["sim", "--name", &other, "--out", "out"];
    let refusals = [&run_into[..], &resume_in, &sim_into].map(|args| run.start(args).finish());
    signal(robot, Signal::CONT);
    for refused in refusals {
        assert_eq!((refused.code, refused.stderr.lines().count()), (Some(2), 1), "{refused:#?}");
        assert!(refused.stderr.contains("a run is using"), "{refused:#?}");
    }
    first.finish().succeeded();
    assert_eq!(run.digest(), digest_in_process(words));
    run.assert_nothing_left();
}

/// It cannot receive the request to end until it is continued: the next creator of the name continues it.
#[test]
fn a_node_that_was_stopped_when_its_supervisor_was_killed_does_not_keep_the_name() {
    let run = Run::new();
    let supervisor = run.lockstep(ENDLESS);
    let robot = run.pid_of("robot-1", 1);
    run.wait_for_ticks(3);
    signal(robot, Signal::STOP);
    supervisor.signal(Signal::KILL);
    assert_eq!(supervisor.finish().code, None);
    let words = "--ticks 50 --timeout forever";
    run.lockstep(words).finish().succeeded();
    assert!(!is_alive(robot));
    assert_eq!(run.digest(), digest_in_process(words));
    run.assert_nothing_left();
}

/// A build during a long run does this.
#[test]
fn a_run_whose_program_file_is_replaced_goes_on() {
    let words = "--ticks 40000 --timeout forever";
    let run = Run::new();
    let program = run.path("program");
    std::fs::copy(env!("CARGO_BIN_EXE_rangehound"), &program).unwrap();
    let out = run.path("out");
    let args = ["run", "--clock", "lockstep", "--name", &run.name, "--out"];
    let mut supervisor = std::process::Command::new(&program)
        .args(args)
        .arg(&out)
        .args(words.split(' '))
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .spawn()
        .unwrap();
    run.wait_for_ticks(100);
    std::fs::remove_file(&program).unwrap();
    signal(run.pid_of("robot-0", 1), Signal::KILL);
    run.pid_of("robot-0", 2);
    run.wait_until("the run has ended", || supervisor.try_wait().unwrap().is_some());
    assert_eq!(supervisor.wait().unwrap().code(), Some(0));
    assert_eq!(run.digest(), digest_in_process(words));
    run.assert_nothing_left();
}

/// A process that is stopped while it holds the membership lock of one run does not block another run.
#[test]
fn the_membership_lock_of_one_run_does_not_block_another() {
    let run = Run::new();
    let first = run.lockstep(ENDLESS);
    run.wait_for_ticks(3);
    let lock = std::fs::File::open(run.shared_folder().join("membership.lock")).unwrap();
    lock.lock().unwrap();
    let other = Run::new();
    other.lockstep("--ticks 20 --timeout forever").finish().succeeded();
    drop(lock);
    first.signal(Signal::INT);
    assert_eq!(first.finish().code, Some(1));
    run.assert_nothing_left();
}
