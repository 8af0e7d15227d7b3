//! The supervisor's machine in simulated time: it notices ends and hangs of processes, starts them and kills them.

use rand::RngExt as _;

use crate::run::supervisor::deaths::End;
use crate::run::supervisor::machine::{Action, Seen};
use crate::run::supervisor::silence;
use crate::study::explore::cluster::{Cluster, SimEvent, Violation};
use crate::study::explore::node::Process;

/// Interval between two looks at the heartbeats, ns.
const POLL_INTERVAL_NS: u64 = silence::POLL_INTERVAL.as_nanos() as u64;

/// Longest time that the start of a process takes, ns.
const START_NS: u64 = 5_000_000;

impl Cluster<'_> {
    /// Starts the team, each node within some milliseconds.
    pub(in crate::study::explore) fn start_all(&mut self) {
        for node in self.plan.all_nodes() {
            self.supervisor.machine.on_start(node, self.now_ns);
            let soon_ns = self.random.random_range(0..20_000_000);
            self.spawn(node, soon_ns);
        }
        self.supervisor.looked_ns = self.now_ns;
        self.after(POLL_INTERVAL_NS, SimEvent::SupervisorLooks);
    }

    pub(in crate::study::explore) fn stop_supervisor(&mut self, for_ns: u64) {
        self.trace(None, || "the supervisor is stopped".to_owned());
        self.supervisor.is_stopped = true;
        self.after(for_ns, SimEvent::SupervisorContinues);
    }

    pub(in crate::study::explore) fn continue_supervisor(&mut self) -> Result<(), Violation> {
        self.trace(None, || "the supervisor continues".to_owned());
        self.supervisor.is_stopped = false;
        if self.now_ns < self.supervisor.looked_ns + POLL_INTERVAL_NS {
            self.supervise()
        } else {
            self.check_heartbeats()
        }
    }

    /// Its timer for the next look: a supervisor that was stopped may have looked since it was set.
    pub(in crate::study::explore) fn look_when_due(&mut self) -> Result<(), Violation> {
        let due_ns = self.supervisor.looked_ns + POLL_INTERVAL_NS;
        let is_due = due_ns <= self.now_ns;
        self.after(if is_due { POLL_INTERVAL_NS } else { due_ns - self.now_ns }, SimEvent::SupervisorLooks);
        if is_due { self.check_heartbeats() } else { Ok(()) }
    }

    /// Checks every process's heartbeat.
    fn check_heartbeats(&mut self) -> Result<(), Violation> {
        if self.supervisor.is_stopped {
            return Ok(());
        }
        self.supervisor.looked_ns = self.now_ns;
        let Self { supervisor, nodes, lead, scenario, .. } = self;
        supervisor.machine.look(scenario, |node| {
            let leads = lead.last == Some((node, nodes[node].life));
            Seen { leads, heartbeat: if leads { lead.heartbeat() } else { nodes[node].heartbeat_ns } }
        });
        let looked = supervisor.checker.looks(nodes, lead, self.now_ns);
        looked.map_err(|(node, what)| self.violation(Some(node), what))?;
        self.supervise()
    }

    /// Reports ends to the machine, and carries out its actions.
    pub(in crate::study::explore) fn supervise(&mut self) -> Result<(), Violation> {
        if self.supervisor.is_stopped {
            return Ok(());
        }
        for (node, end) in std::mem::take(&mut self.supervisor.ends) {
            self.supervisor.checker.ends(node, end, self.now_ns);
            self.supervisor.machine.on_end(node, end, false, self.now_ns);
        }
        while let Some(action) = self.supervisor.machine.next_action(self.now_ns) {
            match action {
                Action::Start(node) => self.start_again(node)?,
                Action::Kill { node, .. } => {
                    let killed = self.supervisor.checker.kills(&self.nodes, &self.lead, node, self.now_ns);
                    killed.map_err(|what| self.violation(Some(node), what))?;
                    if !matches!(self.nodes[node].process, Process::None) {
                        self.trace(Some(node), || "hangs".to_owned());
                        self.die(node, End::Killed);
                    }
                }
                Action::ReportRestart(_) => {}
                Action::ReportLoss(node) => {
                    self.trace(Some(node), || "is not started again".to_owned());
                    let lost = self.supervisor.checker.loses(node);
                    lost.map_err(|what| self.violation(Some(node), what))?;
                }
                Action::EndRun { node, .. } => {
                    self.trace(Some(node), || "is given up: the run ends".to_owned());
                    let given_up = self.supervisor.checker.gives_up(&self.nodes, node);
                    given_up.map_err(|what| self.violation(Some(node), what))?;
                    self.supervisor.has_given_up = true;
                    return Ok(());
                }
            }
        }
        if let Some(at_ns) = self.supervisor.machine.wakes_at_ns() {
            self.after(at_ns.saturating_sub(self.now_ns).max(1), SimEvent::SupervisorActs);
        }
        Ok(())
    }

    fn start_again(&mut self, node: usize) -> Result<(), Violation> {
        if let Some(fewer) = self.supervisor.refusals.checked_sub(1) {
            self.counts.faults += 1;
            self.supervisor.refusals = fewer;
            self.trace(Some(node), || "the system refuses to start it".to_owned());
            self.supervisor.checker.refused(node, self.now_ns);
            if !self.supervisor.machine.on_refusal(node, self.now_ns) {
                return Err(self.violation(Some(node), "it was given up, though the system had room again".to_owned()));
            }
            return Ok(());
        }
        let started = self.supervisor.checker.starts(&self.nodes, node, self.now_ns);
        started.map_err(|what| self.violation(Some(node), what))?;
        self.supervisor.machine.on_start(node, self.now_ns);
        let soon_ns = self.random.random_range(0..START_NS);
        self.spawn(node, soon_ns);
        Ok(())
    }
}
