//! The processes of a reference: start, common release, collection of stamps, end.

use std::fs::File;
use std::io::{BufReader, Read, Write};
use std::os::fd::AsFd;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, anyhow};
use rangehound_node::rendezvous::{Rendezvous, Role};
use rangehound_node::system::clock::monotonic_ns;
use rangehound_node::system::signal::Termination;
use rangehound_shared::scenario::Scenario;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, Signal, kill_process};

use super::node::READY;
use super::{Reference, WAIT, futex};
use crate::failure::Failure;
use crate::files::out_folder;
use crate::run::experiment::Experiment;
use crate::run::gateway;
use crate::run::node::{input_or_running, this_program};
use crate::study::hosts::{Hosts, RUN_HOST};
use crate::study::latency::dt_ns;
use crate::study::latency::samples::Exchange;

/// From the start message to the start, so that all nodes have received it.
const LEAD: Duration = Duration::from_millis(20);

/// Most time for nodes to end.
const GRACE: Duration = Duration::from_secs(3);

/// Runs a reference on an experiment's robots, ticks and clock, and passes each robot's ticks to `robot`, in order.
///
/// # Errors
/// [`Failure`], with the first message of a node if one failed.
pub(in crate::study::latency) fn measure(
    reference: Reference,
    experiment: &Experiment,
    log: &Path,
    termination: &Termination,
    hosts: Option<&Hosts>,
    mut robot: impl FnMut(&mut dyn Iterator<Item = anyhow::Result<Exchange>>) -> anyhow::Result<()>,
) -> Result<(), Failure> {
    let run = Rendezvous::create(&experiment.name, experiment.description.clone()).map_err(input_or_running)?;
    if reference == Reference::Futex {
        futex::create(&run)?;
    }
    let scenario = &experiment.description.scenario;
    let log_file = out_folder::append(log).with_context(|| log.display().to_string())?;
    let mut team = Team { nodes: Vec::new(), log: log.to_owned() };
    for role in std::iter::once(Role::Fusion).chain((0..scenario.robots.len()).map(Role::Robot)) {
        let command = match hosts {
            None => on_this_host(reference, role, &run),
            Some(hosts) => on_its_host(reference, role, scenario, hosts)?,
        };
        team.nodes.push(Node::start(command, role, log_file.try_clone()?, termination)?);
    }
    let exchanged = team.exchange(scenario.ticks, &mut robot).map_err(|error| team.explain(reference, error));
    // The log is read; it is no longer needed.
    let _ = std::fs::remove_file(log);
    Ok(exchanged?)
}

/// A node of a reference that needs shared memory.
fn on_this_host(reference: Reference, role: Role, run: &Rendezvous) -> Command {
    let mut command = this_program();
    command.args(["latency-node", "--reference", reference.name(), "--role", &role.to_string()]).args([
        "--name",
        &run.name().to_string(),
        "--end-with",
        &std::process::id().to_string(),
    ]);
    command
}

/// A node of a reference that needs a network: the centre is on the run's host.
fn on_its_host(reference: Reference, role: Role, scenario: &Scenario, hosts: &Hosts) -> Result<Command, Failure> {
    let host = role.robot().map_or(RUN_HOST, |robot| hosts.host_of(robot));
    let mut command = hosts.command(host, &gateway::program()?);
    command
        .args(["latency-node", "--transport", reference.name(), "--address", &hosts.gateway().to_string(), "--keys"])
        .arg(hosts.keys(host))
        .args(["--ticks", &scenario.ticks.to_string(), "--dt-ns", &dt_ns(scenario).unwrap_or(0).to_string()]);
    match role.robot() {
        Some(robot) => command.args(["--robot", &robot.to_string()]),
        None => command.args(["--robots", &scenario.robots.len().to_string()]),
    };
    Ok(command)
}

struct Team<'a> {
    nodes: Vec<Node<'a>>,
    log: PathBuf,
}

struct Node<'a> {
    role: Role,
    child: Child,
    output: BufReader<Output<'a>>,
}

impl Team<'_> {
    fn exchange(
        &mut self,
        ticks: u64,
        robot: &mut impl FnMut(&mut dyn Iterator<Item = anyhow::Result<Exchange>>) -> anyhow::Result<()>,
    ) -> anyhow::Result<()> {
        for node in &mut self.nodes {
            if node.read_word()? != READY {
                return Err(anyhow!("{} did not report that it is ready", node.role));
            }
        }
        let start_ns = monotonic_ns() + LEAD.as_nanos() as u64;
        for node in &mut self.nodes {
            let input = node.child.stdin.as_mut().context("a node has no standard input")?;
            input.write_all(&start_ns.to_le_bytes())?;
        }
        for node in self.nodes.iter_mut().filter(|node| matches!(node.role, Role::Robot(_))) {
            let mut exchange = || {
                let (sent_ns, held_ns) = (Some(node.read_word()?), Some(node.read_word()?));
                Ok(Exchange { sent_ns, held_ns })
            };
            robot(&mut (0..ticks).map(|_| exchange()))?;
        }
        Ok(())
    }

    /// An error with the nodes' first message: one node that fails ends the others.
    fn explain(&self, reference: Reference, error: anyhow::Error) -> anyhow::Error {
        let messages = std::fs::read_to_string(&self.log).unwrap_or_default();
        match messages.lines().next() {
            Some(first) => {
                let first = first.trim_start_matches("rangehound: ");
                anyhow!("a node of the {} reference failed: {first}", reference.name())
            }
            None => error.context(format!("the {} reference failed", reference.name())),
        }
    }
}

impl Drop for Team<'_> {
    /// Nodes that are finished end by themselves; others are asked to end, and finally killed.
    fn drop(&mut self) {
        for node in &mut self.nodes {
            // A node that has not started yet waits for its input.
            drop(node.child.stdin.take());
            if matches!(node.child.try_wait(), Ok(None)) {
                let _ = kill_process(Pid::from_child(&node.child), Signal::TERM);
            }
        }
        let began = Instant::now();
        for node in &mut self.nodes {
            while matches!(node.child.try_wait(), Ok(None)) && began.elapsed() < GRACE {
                std::thread::sleep(Duration::from_millis(1));
            }
            let _ = node.child.kill();
            let _ = node.child.wait();
        }
    }
}

impl<'a> Node<'a> {
    fn start(mut command: Command, role: Role, log: File, termination: &'a Termination) -> anyhow::Result<Self> {
        let mut child = command
            // Own process group: Ctrl-C reaches this process only, which ends the nodes in order.
            .process_group(0)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(log)
            .spawn()
            .with_context(|| format!("cannot start {role}"))?;
        let pipe = child.stdout.take().with_context(|| format!("cannot read the output of {role}"))?;
        Ok(Self { role, child, output: BufReader::new(Output { pipe, termination }) })
    }

    fn read_word(&mut self) -> anyhow::Result<u64> {
        let mut word = [0; 8];
        self.output.read_exact(&mut word).with_context(|| format!("{} ended early", self.role))?;
        Ok(u64::from_le_bytes(word))
    }
}

/// A node's output; reading ends when this process is asked to end.
struct Output<'a> {
    pipe: ChildStdout,
    termination: &'a Termination,
}

impl Read for Output<'_> {
    fn read(&mut self, bytes: &mut [u8]) -> std::io::Result<usize> {
        let at_most = Timespec { tv_sec: 0, tv_nsec: WAIT.subsec_nanos().into() };
        while !self.termination.requested() {
            let mut pipe = [PollFd::from_borrowed_fd(self.pipe.as_fd(), PollFlags::IN)];
            // A signal interrupts the wait with an error.
            if poll(&mut pipe, Some(&at_most)).unwrap_or(0) > 0 {
                return self.pipe.read(bytes);
            }
        }
        Err(std::io::Error::other("not waited for any more"))
    }
}
