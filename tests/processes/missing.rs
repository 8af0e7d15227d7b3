//! The behaviour of the other nodes while a node is missing: the rows of the table in docs/recover.md.

use std::time::Duration;

use rangehound_node::bus::{Bus, WaitGroup};
use rangehound_node::logs;
use rangehound_node::rendezvous::{Rendezvous, RunDescription};
use rangehound_shared::record::{Heading, RobotRecord, WorldRecord};
use rangehound_shared::scenario::{Scenario, ScenarioFile};
use rustix::process::{Pid, Signal};

use crate::support::{Process, Run, comm, digest_in_process, is_alive, signal};

const ROLES: [&str; 5] = ["sim", "fusion", "robot-0", "robot-1", "robot-2"];

/// Flags for both clocks.
const CLOCKS: [&str; 2] = ["--clock lockstep", "--clock realtime"];

fn start(run: &Run, words: &str) -> Process {
    run.write("slow.toml", "dt_s = 0.05\nticks = 100000000\n");
    run.command(&format!("run slow.toml {words}"))
}

/// All ticks that the simulator has recorded.
fn worlds(run: &Run) -> Vec<WorldRecord> {
    let sealed = std::fs::read(run.path("out/run.sealed")).unwrap();
    let description = RunDescription::open(&sealed).unwrap();
    let mut log = logs::read_worlds(&description).unwrap();
    let mut records = Vec::new();
    while let Some(Ok((_, record))) = log.next() {
        records.push(record.clone());
    }
    records
}

/// One robot's record at each tick.
fn robot(run: &Run, id: usize) -> Vec<RobotRecord> {
    worlds(run).iter().map(|world| world.robots[id]).collect()
}

fn wait_for_more_ticks(run: &Run, more: u64) -> usize {
    let ticks = run.ticks_done();
    run.wait_for_ticks(ticks + more);
    (ticks + more) as usize
}

fn interrupt(supervisor: Process) -> String {
    supervisor.signal(Signal::INT);
    let outcome = supervisor.finish();
    assert_eq!(outcome.code, Some(1), "{outcome:#?}");
    outcome.stderr
}

fn counts(run: &Run, key: &str) -> Vec<u64> {
    run.report()["nodes"].as_array().unwrap().iter().map(|node| node[key].as_u64().unwrap()).collect()
}

/// The JSON of `status`.
fn status(run: &Run) -> serde_json::Value {
    serde_json::from_str(&run.node("status --json").finish().succeeded().stdout).unwrap()
}

/// Time since the last heartbeat of a node, by its place in the list of `status`, s.
fn silent_s(status: &serde_json::Value, node: usize) -> f64 {
    status["nodes"][node]["silent_s"].as_f64().unwrap()
}

fn has_moved(robots: &[RobotRecord]) -> bool {
    robots.windows(2).any(|pair| pair[0].pose != pair[1].pose)
}

#[test]
fn a_robot_that_left_for_good_stands_still_and_the_others_go_on() {
    for clock in CLOCKS {
        let run = Run::new();
        let supervisor = start(&run, &format!("{clock} --timeout 0.3 --restart robot=never"));
        run.wait_for_ticks(10);
        signal(run.pid_of("robot-1", 1), Signal::KILL);
        // Its last drive may have been for the next tick.
        let gone = wait_for_more_ticks(&run, 3);
        wait_for_more_ticks(&run, 20);
        interrupt(supervisor);
        let [other, dead] = [0, 1].map(|id| robot(&run, id).split_off(gone));
        assert!(!has_moved(&dead), "{clock}: {dead:?}");
        assert!(dead.iter().all(|robot| robot.heading == Heading::Unknown && robot.range_sent_ns.is_none()), "{clock}");
        assert!(has_moved(&other) && other.iter().any(|robot| robot.heading == Heading::Fresh), "{clock}");
        assert_eq!(counts(&run, "starts"), [1; 5], "{clock}");
        run.assert_nothing_left();
    }
}

#[test]
fn a_hung_node_is_killed_after_the_timeout_and_replaced() {
    for clock in CLOCKS {
        let run = Run::new();
        let supervisor = start(&run, &format!("{clock} --timeout 0.5"));
        run.wait_for_ticks(10);
        for role in ["robot-1", "fusion", "sim"] {
            let hung = run.pid_of(role, 1);
            signal(hung, Signal::STOP);
            run.pid_of(role, 2);
            assert!(!is_alive(hung));
            wait_for_more_ticks(&run, 5);
        }
        let stderr = interrupt(supervisor);
        assert_eq!(counts(&run, "hangs"), [1, 1, 0, 1, 0], "{clock}: {stderr}");
        assert_eq!(counts(&run, "kills"), [1, 1, 0, 1, 0], "{clock}: {stderr}");
        assert!(stderr.contains("robot-1 sent no heartbeat for 500ms"), "{stderr}");
        run.assert_nothing_left();
    }
}

/// The other nodes wait for simulator and fusion, so nothing is lost.
#[test]
fn in_lock_step_hangs_of_simulator_and_fusion_change_nothing() {
    let words = "--ticks 60000 --timeout 2";
    let run = Run::new();
    let supervisor = run.lockstep(words);
    for role in ["fusion", "sim"] {
        wait_for_more_ticks(&run, 50);
        signal(run.pid_of(role, 1), Signal::STOP);
        run.pid_of(role, 2);
    }
    supervisor.finish().succeeded();
    assert_eq!(run.digest(), digest_in_process(words));
    assert_eq!(counts(&run, "hangs"), [1, 1, 0, 0, 0]);
    run.assert_nothing_left();
}

/// Before it has taken its role a node sends no heartbeat at all.
#[test]
fn a_node_that_hangs_while_it_starts_is_replaced() {
    let run = Run::new();
    let supervisor = start(&run, "--clock realtime --timeout 0.5");
    run.wait_for_ticks(5);
    // While the membership lock is held, no new member can join; the others have joined.
    let lock = std::fs::File::open(run.shared_folder().join("membership.lock")).unwrap();
    lock.lock().unwrap();
    signal(run.pid_of("robot-1", 1), Signal::KILL);
    run.wait_until("the start is given up", || supervisor.stderr().contains("robot-1 sent no heartbeat"));
    drop(lock);
    run.pid_of("robot-1", 2);
    interrupt(supervisor);
    assert!(counts(&run, "hangs")[3] >= 1);
    run.assert_nothing_left();
}

#[test]
fn without_a_timeout_no_node_is_killed_for_hanging() {
    for clock in CLOCKS {
        let run = Run::new();
        let supervisor = start(&run, &format!("{clock} --timeout forever"));
        run.wait_for_ticks(10);
        let robot_1 = run.pid_of("robot-1", 1);
        signal(robot_1, Signal::STOP);
        run.wait_until("robot 1 is silent for longer than a hang takes", || silent_s(&status(&run), 3) > 3.0);
        signal(robot_1, Signal::CONT);
        let back = wait_for_more_ticks(&run, 20);
        interrupt(supervisor);
        assert!(
            robot(&run, 1)[back..]
                .iter()
                .chain(&robot(&run, 1)[back - 10..])
                .any(|robot| robot.range_sent_ns.is_some())
        );
        assert_eq!(counts(&run, "starts"), [1; 5], "{clock}");
        assert_eq!(counts(&run, "hangs"), [0; 5], "{clock}");
        run.assert_nothing_left();
    }
}

/// The rest of a wait may be shorter than the kernel's unit of time. Rounded down to zero it would be a wait without
/// end.
#[test]
fn a_very_short_sleep_ends() {
    let run = Run::new();
    let (name, out_dir) = (run.name.parse().unwrap(), run.path("out"));
    let (send, ended) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        let scenario = Scenario::from_file(&ScenarioFile::default(), "default").unwrap();
        let rendezvous = Rendezvous::create(&name, RunDescription::new(scenario, out_dir)).unwrap();
        let waiter = Bus::connect(&rendezvous, "observer").unwrap().waiter_of(WaitGroup::Sim);
        for nanoseconds in [0, 1, 999, 1_000] {
            waiter.sleep(Duration::from_nanos(nanoseconds));
        }
        drop(waiter);
        send.send(()).unwrap();
    });
    ended.recv_timeout(Duration::from_secs(60)).unwrap();
    run.wait_until("the run is gone", || !run.shared_folder().exists());
}

/// They hold their headings for three ticks and then stop, whether fusion hangs or is dead.
#[test]
fn without_fusion_robots_hold_their_course_and_then_stop() {
    let check = |run: &Run| {
        for id in 0..3 {
            let records = robot(run, id);
            let is_led = |robot: &RobotRecord| matches!(robot.heading, Heading::Fresh | Heading::Late);
            let is_without = |at: usize| !records[at..at + 10].iter().any(is_led);
            let first = (1..records.len() - 10).find(|at| is_without(*at)).expect("ten ticks without a heading");
            assert!(records[first..first + 10].iter().any(|robot| robot.heading == Heading::None), "{records:?}");
            assert!(has_moved(&records[first..first + 4]), "{id}: {:?}", &records[first..]);
            assert!(!has_moved(&records[first + 3..first + 10]), "{id}: {:?}", &records[first..]);
        }
    };
    let hung = Run::new();
    let supervisor = start(&hung, "--clock realtime --timeout forever");
    hung.wait_for_ticks(10);
    let fusion = hung.pid_of("fusion", 1);
    signal(fusion, Signal::STOP);
    wait_for_more_ticks(&hung, 20);
    signal(fusion, Signal::CONT);
    let is_led = || worlds(&hung).last().is_some_and(|world| world.robots[0].heading == Heading::Fresh);
    hung.wait_until("robots are led again", is_led);
    interrupt(supervisor);
    check(&hung);
    hung.assert_nothing_left();

    let dead = Run::new();
    dead.write("slow.toml", "dt_s = 0.05\nticks = 100000000\nclock = \"realtime\"\n");
    let mut nodes = vec![dead.command("sim slow.toml")];
    nodes.extend(["fusion", "robot --id 0", "robot --id 1", "robot --id 2"].map(|words| dead.node(words)));
    dead.wait_for_ticks(10);
    nodes[1].signal(Signal::KILL);
    wait_for_more_ticks(&dead, 20);
    let successor = dead.node("fusion");
    let is_led = || worlds(&dead).last().is_some_and(|world| world.robots[0].heading == Heading::Fresh);
    dead.wait_until("robots are led again", is_led);
    check(&dead);
    for node in nodes.into_iter().chain([successor]) {
        node.signal(Signal::TERM);
        node.finish();
    }
    dead.assert_nothing_left();
}

#[test]
fn in_real_time_dead_nodes_are_replaced_and_ticks_stay_on_their_grid() {
    let run = Run::new();
    run.write("fast.toml", "dt_s = 0.02\n");
    let supervisor = run.command("run fast.toml --clock realtime --ticks 400");
    for role in ["sim", "fusion", "robot-1"] {
        wait_for_more_ticks(&run, 20);
        signal(run.pid_of(role, 1), Signal::KILL);
        run.pid_of(role, 2);
    }
    supervisor.finish().succeeded();
    assert_eq!(run.report()["ticks"], 400);
    assert_eq!(counts(&run, "starts"), [2, 2, 1, 2, 1]);
    assert_eq!(worlds(&run).len(), 401);
    run.assert_nothing_left();
}

/// It is started by hand, later than all others, and again after a kill.
#[test]
fn a_robot_that_comes_late_takes_part_from_then_on() {
    let run = Run::new();
    run.write("slow.toml", "dt_s = 0.05\nticks = 100000000\nclock = \"realtime\"\n");
    let mut nodes = vec![run.command("sim slow.toml")];
    nodes.extend(["fusion", "robot --id 0", "robot --id 2"].map(|words| run.node(words)));
    run.pid_of("robot-2", 1);
    assert_eq!(run.ticks_done(), 0, "the run waits for its whole team");
    nodes.push(run.node("robot --id 1"));
    run.wait_for_ticks(10);
    nodes[4].signal(Signal::KILL);
    wait_for_more_ticks(&run, 10);
    nodes.push(run.node("robot --id 1"));
    let is_back = || worlds(&run).last().is_some_and(|world| world.robots[1].heading == Heading::Fresh);
    run.pid_of("robot-1", 2);
    run.wait_until("robot 1 is led again", is_back);
    for node in nodes {
        node.signal(Signal::TERM);
        node.finish();
    }
    run.assert_nothing_left();
}

/// Like a suspended machine, with and without the supervisor.
#[test]
fn a_run_that_was_stopped_as_a_whole_goes_on_with_all_nodes() {
    let words = "--ticks 60000 --timeout 1";
    let oracle = digest_in_process(words);
    for is_supervisor_stopped in [true, false] {
        for clock in CLOCKS {
            let run = Run::new();
            let is_lockstep = clock == CLOCKS[0];
            let supervisor =
                if is_lockstep { run.lockstep(words) } else { start(&run, "--clock realtime --timeout 1") };
            run.wait_for_ticks(20);
            let nodes: Vec<Pid> = ROLES.iter().map(|role| run.pid_of(role, 1)).collect();
            let mut stopped = nodes.clone();
            stopped.extend(is_supervisor_stopped.then(|| supervisor.pid()));
            stopped.iter().for_each(|pid| signal(*pid, Signal::STOP));
            let is_silent = |node| silent_s(&status(&run), node) > 2.5;
            run.wait_until("every node is silent for longer than the time-out", || (0..ROLES.len()).all(is_silent));
            stopped.iter().for_each(|pid| signal(*pid, Signal::CONT));
            if is_lockstep {
                supervisor.finish().succeeded();
                assert_eq!(run.digest(), oracle);
                assert_eq!(run.report()["ranges"]["missing"], 0);
            } else {
                wait_for_more_ticks(&run, 20);
                assert!(nodes.iter().all(|pid| is_alive(*pid)));
                interrupt(supervisor);
            }
            assert_eq!(counts(&run, "starts"), [1; 5], "{clock}");
            run.assert_nothing_left();
        }
    }
}

/// A deposed fusion that stays stopped is killed even without a time-out.
#[test]
fn a_deposed_fusion_that_stays_stopped_is_replaced() {
    let words = "--ticks 200000 --timeout forever";
    let run = Run::new();
    let supervisor = run.lockstep(&format!("{words} --standby 1"));
    run.wait_for_ticks(20);
    let leader = run.pid_of("fusion", 1);
    signal(leader, Signal::STOP);
    let successor = run.pid_of("fusion", 2);
    assert_ne!(successor, leader);
    run.wait_until("the deposed is gone", || !is_alive(leader));
    assert_eq!(comm(successor), "rh-fusion");
    let status = status(&run);
    assert_eq!((&status["leader"], &status["leads"]), (&successor.as_raw_pid().into(), &2.into()), "{status}");
    wait_for_more_ticks(&run, 100);
    interrupt(supervisor);
    assert_eq!(counts(&run, "hangs").iter().sum::<u64>(), 1, "{}", run.report());
    run.assert_nothing_left();
}

/// The supervisor does not know a standby that was started by hand, and must not end a run that this standby leads.
#[test]
fn a_run_goes_on_with_a_standby_started_by_hand_and_again_without() {
    let run = Run::new();
    let supervisor = run.lockstep("--ticks 100000000 --timeout forever");
    run.wait_for_ticks(20);
    let by_hand = run.node("fusion --standby");
    run.wait_until("a standby is there", || run.starts("standby-1") == 1);
    let first = run.pid_of("fusion", 1);
    signal(first, Signal::STOP);
    run.wait_until("the standby leads", || run.starts("fusion") == 2);
    signal(first, Signal::CONT);
    run.wait_until("a successor finds its place taken", || supervisor.stderr().contains("fusion exited with code 2"));
    wait_for_more_ticks(&run, 100);
    by_hand.signal(Signal::KILL);
    by_hand.finish();
    run.wait_until("the supervisor's leads again", || run.starts("fusion") == 3);
    wait_for_more_ticks(&run, 100);
    interrupt(supervisor);
    run.assert_nothing_left();
}

#[test]
fn status_reports_silent_nodes() {
    let run = Run::new();
    let supervisor = start(&run, "--clock realtime --timeout forever");
    run.wait_for_ticks(5);
    let robot_0 = run.pid_of("robot-0", 1);
    signal(robot_0, Signal::STOP);
    run.wait_until("robot 0 is silent", || silent_s(&status(&run), 2) > 1.0);
    let now = status(&run);
    assert!(silent_s(&now, 2) > silent_s(&now, 3), "{now}");
    assert_eq!(now["nodes"][5]["name"], "run", "{now}");
    assert_eq!(now["leader"], run.pid_of("fusion", 1).as_raw_pid(), "{now}");
    let text = run.node("status").finish().succeeded().stdout;
    assert!(text.contains("leads (leader 1 of this run); 0 on standby"), "{text}");
    signal(robot_0, Signal::CONT);
    interrupt(supervisor);
    run.assert_nothing_left();
}
