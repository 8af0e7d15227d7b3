//! Memory: after its start a node allocates nothing itself, and a robot has little private memory.

use std::io::Read;
use std::process::{Child, Command, Stdio};

use rangehound_node::rendezvous::{Rendezvous, Role, RunDescription};
use rangehound_node::system::signal::Termination;
use rangehound_shared::run_name::RunName;
use rangehound_shared::scenario::{Scenario, ScenarioFile};
use rustix::process::Signal;

use crate::support::Run;

/// Environment variables with the run and the role of a node.
const RUN: &str = "RANGEHOUND_TEST_NODE_RUN";
const ROLE: &str = "RANGEHOUND_TEST_NODE_ROLE";

/// A node of the run, killed with its test.
struct Node(Child);

impl Drop for Node {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Not a test: a node's process, started by the test below.
#[test]
#[ignore = "the main function of a node"]
fn node() {
    let (Ok(name), Ok(role)) = (std::env::var(RUN), std::env::var(ROLE)) else { return };
    let name: RunName = name.parse().unwrap();
    let termination = Termination::listen().unwrap();
    let run = Rendezvous::join(&name, &termination, || {}).unwrap();
    let counted = allocation_counter::measure(|| match role.parse().unwrap() {
        Role::Sim => rangehound_node::sim::run(&run, &termination).unwrap(),
        Role::Fusion => rangehound_node::fusion::run(&run, &termination).unwrap(),
        Role::Robot(id) => rangehound_node::robot::run(&run, id, &termination).unwrap(),
        other => panic!("{other}"),
    });
    println!("allocations {}", counted.count_total);
}

/// Allocations of simulator, fusion and a robot in a run of `ticks` ticks, including start and end.
fn allocations(ticks: u64) -> Vec<u64> {
    let run = Run::new();
    let text = format!("clock = \"lockstep\"\ntimeout_s = \"forever\"\nticks = {ticks}\n[robots]\ncount = 2\n");
    let file = ScenarioFile::parse(&text, "test").unwrap();
    let scenario = Scenario::from_file(&file, "test").unwrap();
    std::fs::create_dir(run.path("out")).unwrap();
    let created =
        Rendezvous::create(&run.name.parse().unwrap(), RunDescription::new(scenario, run.path("out"))).unwrap();
    let nodes = ["sim", "fusion", "robot-0", "robot-1"].map(|role| {
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.args(["--exact", "processes::memory::node", "--ignored", "--nocapture"]);
        Node(command.envs([(RUN, run.name.as_str()), (ROLE, role)]).stdout(Stdio::piped()).spawn().unwrap())
    });
    run.wait_until("the run has ended", || created.is_finished());
    let counted = nodes.map(|mut node| {
        let mut output = String::new();
        node.0.stdout.take().unwrap().read_to_string(&mut output).unwrap();
        let count = output.lines().find_map(|line| line.split_once("allocations ")?.1.parse().ok());
        count.unwrap_or_else(|| panic!("{output}"))
    });
    drop(created);
    run.assert_nothing_left();
    counted[..3].to_vec()
}

/// Messages that each node sends in a tick. For each, iceoryx2 has a state on the heap from the loan until the message
/// is sent.
const MESSAGES: u64 = 2;

#[test]
fn a_tick_allocates_nothing_but_the_state_of_each_message_that_is_sent() {
    let ticks = [1_000, 101_000];
    let [short, long] = ticks.map(allocations);
    for (role, (short, long)) in ["sim", "fusion", "robot"].iter().zip(short.into_iter().zip(long)) {
        println!("{role}: {short} allocations in {} ticks, {long} in {}", ticks[0], ticks[1]);
        // The allocations at the start differ by some thousand from run to run; one in each tick would add 100 000.
        let more_ticks = ticks[1] - ticks[0];
        assert!(long.saturating_sub(short) < MESSAGES * more_ticks + more_ticks / 25, "{role}: {short}, then {long}");
    }
}

#[test]
fn a_robot_has_at_most_3_mb_of_its_own() {
    let run = Run::new();
    let process = run.command("run --clock realtime --robots 2 --ticks 1000");
    run.wait_for_ticks(20);
    let status = std::fs::read_to_string(format!("/proc/{}/status", run.pid_of("robot-1", 1))).unwrap();
    // All nodes share the pages of program and libraries, and the team shares those of messages.
    let private =
        status.lines().find_map(|line| line.strip_prefix("RssAnon:")?.trim().strip_suffix(" kB")?.parse().ok());
    let private_kib: u64 = private.unwrap_or_else(|| panic!("{status}"));
    println!("{private_kib} KiB");
    assert!(private_kib * 1024 <= 3_000_000, "{private_kib} KiB");
    process.signal(Signal::INT);
    process.finish();
    run.assert_nothing_left();
}
