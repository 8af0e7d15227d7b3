//! The processes of a run: started, watched, started again, ended.

use std::ffi::OsStr;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::PathBuf;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant, SystemTime};

use anyhow::{Context, anyhow};
use rangehound_fusion::standby::STANDBYS_MAX;
use rangehound_node::rendezvous::{Inspection, Rendezvous, Role, RoleLease, Roster};
use rangehound_node::system::clock::{monotonic_ns, until};
use rangehound_node::system::signal::Termination;
use rangehound_shared::scenario::Scenario;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, PidfdFlags, Signal, kill_process, pidfd_open};

use super::cleaner::Cleaner;
use super::deaths::End;
use super::machine::{Action, Machine, Seen};
use super::restart::Policies;
use super::silence;
use super::{Gateway, Supervision};
use crate::failure::{Failure, with_causes};
use crate::files::out_folder;
use crate::results::report::{Incident, NodeSummary};
use crate::run::node::{command_line, of_run, this_program};
use crate::run::watch;

/// Time in which nodes must end by themselves once the run is over, and once they are asked to.
const GRACE: Duration = Duration::from_secs(3);

/// The same for the gateway, which tells the robots of other hosts that the run is over: those whose links are lost connect again first.
const GATEWAY_GRACE: Duration = Duration::from_secs(8);

/// For this long after a death, unfinished shared memory of dead processes is removed. It takes several tries, because
/// a process that waits for it sometimes holds it open, like its maker would.
const HALF_MADE: Duration = Duration::from_secs(1);

/// The processes of a run.
pub(super) struct Nodes<'a> {
    rendezvous: &'a Rendezvous,
    /// The supervisor's lease, which this renews.
    lease: &'a RoleLease,
    machine: Machine<SystemTime>,
    cleaner: Cleaner,
    nodes: Vec<Node>,
    last_death: Option<Instant>,
    inspection: Inspection,
    /// How often the lead has been taken.
    leads: u64,
}

/// Why the nodes of a run have ended.
#[derive(Debug)]
pub(super) enum Ended {
    /// The run is complete.
    Finished,
    /// The run's shared memory was removed: this file of it, or more.
    Removed(PathBuf),
}

/// The process of one role, and the history of its predecessors.
struct Node {
    role: Role,
    /// True if there are standbys. Then fusion is started as a standby too, because another may lead when it comes
    /// back.
    has_standbys: bool,
    /// How a gateway is started: by a program of its own.
    gateway: Option<Gateway>,
    running: Option<Running>,
    summary: NodeSummary,
    /// How its last process ended.
    last_end: String,
    /// True if its process led when it was last seen alive.
    leads: bool,
}

struct Running {
    child: Child,
    /// Readable once the process has ended; `None` if the kernel has no such descriptor.
    ended: Option<OwnedFd>,
}

impl<'a> Nodes<'a> {
    pub(super) fn start(
        rendezvous: &'a Rendezvous,
        lease: &'a RoleLease,
        (supervision, gateway): (&Supervision, Option<&Gateway>),
        cleaner: Cleaner,
        before: Vec<NodeSummary>,
    ) -> Result<Self, Failure> {
        let scenario = &rendezvous.description().scenario;
        let roles = watch::roles(scenario.robots.len()).filter(|role| !supervision.leaves_to_others(*role));
        let roles = roles.chain((1..=supervision.standbys).map(Role::Standby));
        let mut nodes: Vec<Node> = roles.map(|role| Node::new(role, scenario, supervision.standbys > 0)).collect();
        nodes.extend(
            gateway.map(|gateway| Node { gateway: Some(gateway.clone()), ..Node::new(Role::Gateway, scenario, false) }),
        );
        let machine = Machine::new(nodes.iter().map(|node| node.role), &Policies::new(&supervision.rules));
        // The history of each node continues.
        nodes.iter_mut().zip(before).for_each(|(node, before)| node.summary = before);
        let inspection = rendezvous.inspection();
        let mut all = Self { rendezvous, lease, machine, cleaner, nodes, last_death: None, inspection, leads: 0 };
        for index in 0..all.nodes.len() {
            if let Err(error) = all.nodes[index].start(rendezvous) {
                all.end(false);
                return Err(Failure::Running(error));
            }
            all.machine.on_start(index, monotonic_ns());
        }
        Ok(all)
    }

    /// Watches the nodes until the run is complete, its shared memory is removed, a node that the run needs is given
    /// up, or termination is requested.
    pub(super) fn supervise(&mut self, termination: &Termination, mut look: impl FnMut()) -> anyhow::Result<Ended> {
        let mut looked = Instant::now();
        let mut listened = Instant::now();
        while !self.rendezvous.is_complete() {
            if termination.requested() {
                let last = if self.rendezvous.is_finished() { "estimate" } else { "tick" };
                return Err(anyhow!(
                    "the run was stopped before its last {last}: `rangehound resume {}` continues it",
                    self.rendezvous.description().out_dir.display()
                ));
            }
            self.lease.renew(monotonic_ns());
            let to_look = watch::POLL_INTERVAL.saturating_sub(looked.elapsed());
            self.wait_for_a_death(to_look.min(silence::POLL_INTERVAL.saturating_sub(listened.elapsed())));
            if looked.elapsed() >= watch::POLL_INTERVAL {
                look();
                looked = Instant::now();
            }
            if listened.elapsed() >= silence::POLL_INTERVAL {
                if let Some(removed) = self.inspect() {
                    return Ok(Ended::Removed(removed));
                }
                self.leads = self.leads.max(self.rendezvous.roster().starts(Role::Fusion));
                self.listen();
                // On a schedule, because each time counts as one interval of silence. After a pause none is made up for.
                let due = listened + silence::POLL_INTERVAL;
                listened = if due.elapsed() < silence::POLL_INTERVAL { due } else { Instant::now() };
            }
            if let Some(removed) = self.reap()? {
                return Ok(Ended::Removed(removed));
            }
            if let Some(removed) = self.act()? {
                return Ok(Ended::Removed(removed));
            }
        }
        look();
        Ok(Ended::Finished)
    }

    /// A file of the run's shared memory that was removed, if one look finds one.
    fn inspect(&mut self) -> Option<PathBuf> {
        let nodes = self.pids();
        self.inspection.removed(&nodes)
    }

    fn pids(&self) -> Vec<Pid> {
        self.nodes.iter().filter_map(|node| node.running.as_ref()).map(Running::pid).collect()
    }

    /// Sleeps until a process ends, the next restart is due, or time is up.
    fn wait_for_a_death(&self, at_most: Duration) {
        let wait = self.machine.wakes_at_ns().map_or(at_most, |due_ns| at_most.min(until(due_ns)));
        let ended = self.nodes.iter().filter_map(|node| node.running.as_ref()?.ended.as_ref());
        let mut watched: Vec<PollFd<'_>> =
            ended.map(|fd| PollFd::from_borrowed_fd(fd.as_fd(), PollFlags::IN)).collect();
        let timeout = Timespec { tv_sec: wait.as_secs().cast_signed(), tv_nsec: wait.subsec_nanos().into() };
        // An error means that a signal came: the loop checks everything anyway.
        let _ = poll(&mut watched, Some(&timeout));
    }

    /// Reports each process's newest heartbeat to the machine.
    fn listen(&mut self) {
        let Self { rendezvous, nodes, machine, .. } = self;
        machine.look(&rendezvous.description().scenario, |index| {
            let seen = nodes[index].see(rendezvous.roster());
            // One that has ended just now may have a successor already.
            let node = &mut nodes[index];
            if node.can_lead() && node.is_running() {
                node.leads = seen.leads;
            }
            seen
        });
    }

    /// Reports nodes that have ended to the machine. If the run's shared memory was removed, that is why they ended,
    /// and the removed file is returned instead.
    fn reap(&mut self) -> anyhow::Result<Option<PathBuf>> {
        for index in 0..self.nodes.len() {
            let Some(status) = self.nodes[index].reap(self.rendezvous)? else { continue };
            if let Some(removed) = self.inspect() {
                return Ok(Some(removed));
            }
            self.last_death = Some(Instant::now());
            self.rendezvous.remove_incomplete();
            self.cleaner.request();
            let node = &mut self.nodes[index];
            node.last_end = format!("{} {}", node.summary.title(), describe(status));
            // If a process that was started by hand has taken the role meanwhile, the node waits until the role is
            // free.
            let is_taken = self.rendezvous.roster().is_held(node.role);
            self.machine.on_end(index, end_of(status), is_taken, monotonic_ns());
        }
        Ok(None)
    }

    /// Carries out the machine's actions.
    fn act(&mut self) -> anyhow::Result<Option<PathBuf>> {
        while let Some(action) = self.machine.next_action(monotonic_ns()) {
            match action {
                Action::Start(index) => {
                    if let Err(error) = self.nodes[index].start(self.rendezvous) {
                        if !self.machine.on_refusal(index, monotonic_ns()) {
                            return Err(error);
                        }
                        log::warn!("{}; it is tried again", with_causes(&error));
                    } else {
                        self.machine.on_start(index, monotonic_ns());
                    }
                }
                Action::Kill { node, silence } => self.nodes[node].kill_as_hung(silence),
                Action::ReportRestart(index) => {
                    let successor = self.successor_of(index).unwrap_or_default();
                    log::warn!("{}{successor}; it is started again", self.nodes[index].last_end);
                }
                Action::ReportLoss(index) => log::warn!("{}; the others go on without it", self.nodes[index].last_end),
                Action::EndRun { node, is_own } => {
                    let nodes = self.pids();
                    // Before a failing node is given up, a removal is looked for more thoroughly.
                    if is_own && let Some(removed) = self.inspection.removed_of_any(&nodes) {
                        return Ok(Some(removed));
                    }
                    let node = &self.nodes[node];
                    let log = std::fs::read_to_string(node.log_path(self.rendezvous)).unwrap_or_default();
                    let last = log.lines().last().map_or(String::new(), |line| format!(": {line}"));
                    return Err(anyhow!("{}{last}", node.last_end));
                }
            }
        }
        if self.last_death.is_some_and(|at| at.elapsed() < HALF_MADE) {
            self.rendezvous.remove_incomplete();
        }
        Ok(None)
    }

    /// What becomes of the lead of a node that has ended, as far as it is known.
    fn successor_of(&mut self, index: usize) -> Option<&'static str> {
        let has_led = std::mem::take(&mut self.nodes[index].leads);
        let mut others = self.nodes.iter().filter(|node| node.can_lead() && node.running.is_some()).peekable();
        if !has_led || others.peek().is_none() {
            return None;
        }
        let leader = self.rendezvous.roster().holder(Role::Fusion);
        let leads = others.any(|node| node.running.as_ref().map(Running::pid) == leader);
        Some(if leads { "; a standby leads now" } else { "; a standby takes over" })
    }

    /// Kills all nodes at once, and waits until they are gone: only then may others go on from their checkpoints.
    pub(super) fn kill(&mut self) -> anyhow::Result<()> {
        for node in &mut self.nodes {
            if let Some(running) = &mut node.running {
                // A node that noticed the removal first has ended by itself.
                let is_killed = running.signal(Signal::KILL);
                node.note(if is_killed { Incident::Killed } else { Incident::Exited });
            }
        }
        self.wait_for_all();
        let left = self.nodes.iter_mut().find_map(|node| node.is_running().then_some(node.role));
        match left {
            Some(role) => Err(anyhow!(
                "{role} was killed but has not ended: its process may be stuck in the kernel; see `rangehound status`"
            )),
            None => Ok(()),
        }
    }

    /// Lets the nodes end by themselves if the run is over, then asks the others to end, and kills those that do not.
    pub(super) fn end(&mut self, finished: bool) {
        if finished {
            self.wait_for_all();
        }
        self.signal(Signal::TERM);
        self.wait_for_all();
        self.signal(Signal::KILL);
        self.wait_for_all();
        self.rendezvous.remove_incomplete();
        self.cleaner.request();
    }

    fn wait_for_all(&mut self) {
        let began = Instant::now();
        let is_awaited = |node: &mut Node| {
            let grace = if node.role == Role::Gateway { GATEWAY_GRACE } else { GRACE };
            node.is_running() && began.elapsed() < grace
        };
        while self.nodes.iter_mut().any(is_awaited) {
            self.lease.renew(monotonic_ns());
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    fn signal(&mut self, signal: Signal) {
        for running in self.nodes.iter_mut().filter_map(|node| node.running.as_mut()) {
            running.signal(signal);
        }
    }

    pub(super) fn into_summaries(self) -> Vec<NodeSummary> {
        self.nodes.into_iter().map(|node| node.summary).collect()
    }

    /// How often the lead has been taken, as of the last look.
    pub(super) fn leads(&self) -> u64 {
        self.leads
    }
}

impl Running {
    fn pid(&self) -> Pid {
        Pid::from_child(&self.child)
    }

    /// False if it has ended: only a running child still has its pid.
    fn signal(&mut self, signal: Signal) -> bool {
        matches!(self.child.try_wait(), Ok(None)) && kill_process(self.pid(), signal).is_ok()
    }
}

impl Node {
    fn new(role: Role, scenario: &Scenario, has_standbys: bool) -> Self {
        let summary = NodeSummary::new(role, scenario, 0);
        Self { role, has_standbys, gateway: None, running: None, summary, last_end: String::new(), leads: false }
    }

    /// Any of these may lead, whatever role it was started with.
    fn can_lead(&self) -> bool {
        matches!(self.role, Role::Fusion | Role::Standby(_))
    }

    fn log_path(&self, rendezvous: &Rendezvous) -> std::path::PathBuf {
        rendezvous.description().out_dir.join("logs").join(format!("{}.log", self.role))
    }

    fn start(&mut self, rendezvous: &Rendezvous) -> anyhow::Result<()> {
        // If there are standbys, fusion is started as one too: another may lead by then.
        let role = if self.role == Role::Fusion && self.has_standbys { Role::Standby(1) } else { self.role };
        let mut command = this_program();
        // If its log cannot be written, the user sees the node's messages; those of a gateway always, as hosts come and go.
        let mut stderr = Stdio::inherit();
        if let Some(Gateway { program, listen, keys }) = &self.gateway {
            command = Command::new(program);
            command.args(["gateway", "--listen", &listen.to_string()]);
            command.args(keys.iter().flat_map(|keys| [OsStr::new("--keys"), keys.as_os_str()]));
            command.args(of_run(rendezvous.name()));
        } else {
            command.args(command_line(role, rendezvous.name()));
            stderr = out_folder::append(&self.log_path(rendezvous)).map_or(stderr, Stdio::from);
        }
        command
            // Its own process group: Ctrl-C reaches the supervisor, which ends the nodes in order.
            .process_group(0)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(stderr);
        let child = command.spawn().with_context(|| format!("cannot start {}", self.summary.title()))?;
        let ended = pidfd_open(Pid::from_child(&child), PidfdFlags::empty()).ok();
        self.running = Some(Running { child, ended });
        self.note(Incident::Started);
        Ok(())
    }

    /// The observed state of its process.
    fn see(&self, roster: &Roster) -> Seen<SystemTime> {
        let pid = self.running.as_ref().map(Running::pid);
        let heartbeat =
            |role| roster.heartbeat_of(role).filter(|(signer, _)| Some(*signer) == pid).map(|(_, heartbeat)| heartbeat);
        match self.role {
            _ if self.can_lead() => {
                let lead = heartbeat(Role::Fusion);
                let standing_by = || (1..=STANDBYS_MAX).filter_map(|number| heartbeat(Role::Standby(number))).max();
                Seen { leads: lead.is_some(), heartbeat: lead.or_else(standing_by) }
            }
            role => Seen { heartbeat: heartbeat(role), leads: false },
        }
    }

    /// Kills its process, unless it has ended just now.
    fn kill_as_hung(&mut self, silence: Duration) {
        if self.running.as_mut().is_some_and(|running| running.signal(Signal::KILL)) {
            log::warn!("{} sent no heartbeat for {silence:?} while others did: it is killed", self.summary.title());
            self.note(Incident::Hung);
        }
    }

    fn is_running(&mut self) -> bool {
        self.running.as_mut().is_some_and(|running| matches!(running.child.try_wait(), Ok(None)))
    }

    /// The end of the process before the end of the run; returned once.
    fn reap(&mut self, rendezvous: &Rendezvous) -> anyhow::Result<Option<ExitStatus>> {
        let Some(running) = &mut self.running else { return Ok(None) };
        let Some(status) = running.child.try_wait()? else { return Ok(None) };
        self.running = None;
        // The run is marked as finished before any node ends by itself, so the mark is read afterwards.
        if status.success() && rendezvous.is_finished() {
            return Ok(None);
        }
        self.note(if status.signal().is_some() { Incident::Killed } else { Incident::Exited });
        Ok(Some(status))
    }

    /// Counts an incident and records its time.
    fn note(&mut self, incident: Incident) {
        let NodeSummary { starts, kills, exits, hangs, incidents, .. } = &mut self.summary;
        *match incident {
            Incident::Started => starts,
            Incident::Killed => kills,
            Incident::Exited => exits,
            Incident::Hung => hangs,
        } += 1;
        incidents.push((monotonic_ns(), incident));
    }
}

fn end_of(status: ExitStatus) -> End {
    match (status.signal(), status.code()) {
        (Some(signal), _) if signal == Signal::KILL.as_raw() => End::Killed,
        (None, Some(0)) => End::InOrder,
        (None, Some(2)) => End::Refused,
        _ => End::Failed,
    }
}

pub(super) fn describe(status: ExitStatus) -> String {
    match (status.signal(), status.code()) {
        (Some(signal), _) if signal == Signal::BUS.as_raw() => {
            format!("was killed by signal {signal}: /dev/shm is full or has failed: make room there")
        }
        (Some(signal), _) => format!("was killed by signal {signal}"),
        (None, Some(code)) => format!("exited with code {code}"),
        (None, None) => "ended".to_owned(),
    }
}
