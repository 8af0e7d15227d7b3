//! The processes of nodes: started, stopped, killed between two actions, or asleep.

use rand::RngExt as _;
use rangehound_shared::protocol::timing::ROUND_MAX_NS;
use rangehound_shared::protocol::wake::Event;

use super::cluster::{Cluster, SimEvent, Violation};
use super::faults::FaultKind;
use super::lead::HEARTBEAT_NS;
use super::network::WAKE_NS;
use super::node::{FaultEffect, PendingFault, Process};
use crate::run::supervisor::deaths::End;

/// Interval in which a process checks everything even if nothing wakes it.
const IDLE_NS: u64 = 100_000_000;

/// Largest number of actions of a process before it sleeps.
const ACTIONS_MAX: u32 = 10_000;

impl Cluster<'_> {
    /// Spawns a process, which starts after a delay.
    pub(super) fn spawn(&mut self, node: usize, soon_ns: u64) {
        let up_ns = soon_ns + std::mem::take(&mut self.nodes[node].up_ns);
        let spawned = &mut self.nodes[node];
        spawned.life += 1;
        spawned.process = Process::Starting;
        (spawned.heartbeat_ns, spawned.state_since_ns) = (None, self.now_ns);
        if spawned.pending_fault.is_none() {
            spawned.pending_fault = spawned.later_faults.pop();
        }
        let life = spawned.life;
        self.after(up_ns, SimEvent::ProcessStarts { node, life });
    }

    /// A fault begins: it takes effect now or after some actions.
    pub(super) fn begin(&mut self, fault: usize) -> Result<(), Violation> {
        match self.plan.faults[fault].kind {
            FaultKind::Kill { node, after_actions, times, .. } => {
                self.nodes[node].pending_fault = Some(PendingFault { after_actions, fault });
                self.nodes[node].later_faults.extend((1..times).map(|_| PendingFault { after_actions, fault }));
            }
            FaultKind::Break { node, after_actions } | FaultKind::Stop { node, after_actions, .. } => {
                self.nodes[node].pending_fault = Some(PendingFault { after_actions, fault });
            }
            FaultKind::StopLeader { after_actions, .. } => {
                let Some(node) = self.lead.holder else { return Ok(()) };
                self.nodes[node].pending_fault = Some(PendingFault { after_actions, fault });
            }
            FaultKind::KillSuccessor { .. } => self.successor_faults.push(fault),
            FaultKind::RefuseStarts { times } => self.supervisor.refusals += times,
            FaultKind::StopSupervisor { for_ns } => {
                self.counts.faults += 1;
                self.stop_supervisor(for_ns);
            }
            FaultKind::StopAll { for_ns, with_supervisor } => {
                self.counts.faults += 1;
                if with_supervisor {
                    self.stop_supervisor(for_ns);
                }
                for node in 0..self.plan.nodes() {
                    if !matches!(self.nodes[node].process, Process::None | Process::Starting) {
                        let later_ns = self.random.random_range(0..1_000_000);
                        self.stop(node, for_ns + later_ns);
                    }
                }
            }
            FaultKind::Partition { nodes, for_ns } => {
                self.counts.faults += 1;
                self.partitions.push((fault, nodes));
                self.trace(None, || format!("nodes {nodes:#b} are cut off"));
                self.after(for_ns, SimEvent::PartitionEnds(fault));
            }
        }
        Ok(())
    }

    /// A process has taken the lead: gives it the fault that is planned for the next leader.
    pub(super) fn apply_successor_fault(&mut self, node: usize) {
        if let Some(fault) = self.successor_faults.pop()
            && let FaultKind::KillSuccessor { after_actions } = self.plan.faults[fault].kind
        {
            self.nodes[node].pending_fault = Some(PendingFault { after_actions, fault });
        }
    }

    /// Counts an action of a node, and returns what a fault does to the node at it.
    pub(super) fn before_action(&mut self, node: usize) -> Result<FaultEffect, Violation> {
        self.nodes[node].actions += 1;
        if self.nodes[node].actions > ACTIONS_MAX {
            return Err(self.violation(Some(node), "it acts again and again without a sleep".to_owned()));
        }
        Ok(self.fault_effect(node))
    }

    fn fault_effect(&mut self, node: usize) -> FaultEffect {
        let Some(pending_fault) = &mut self.nodes[node].pending_fault else { return FaultEffect::Lives };
        if let Some(fewer) = pending_fault.after_actions.checked_sub(1) {
            pending_fault.after_actions = fewer;
            return FaultEffect::Lives;
        }
        let fault = pending_fault.fault;
        if self.plan.leaves_robots && !self.may_leave(node) {
            return FaultEffect::Lives;
        }
        self.nodes[node].pending_fault = None;
        self.counts.faults += 1;
        match self.plan.faults[fault].kind {
            FaultKind::Kill { written, is_own, up_ns, .. } => {
                self.nodes[node].up_ns = up_ns;
                self.die(node, if is_own { End::Failed } else { End::Killed });
                FaultEffect::Dies { written }
            }
            FaultKind::KillSuccessor { .. } => {
                self.die(node, End::Killed);
                FaultEffect::Dies { written: 0.0 }
            }
            FaultKind::Break { after_actions, .. } => {
                self.nodes[node].later_faults.push(PendingFault { after_actions, fault });
                self.die(node, End::Failed);
                FaultEffect::Dies { written: 0.0 }
            }
            FaultKind::Stop { for_ns, .. } | FaultKind::StopLeader { for_ns, .. } => {
                self.stop(node, for_ns);
                FaultEffect::Stops
            }
            _ => FaultEffect::Lives,
        }
    }

    /// Robots that are not started again may end once the whole team has taken part; the first one stays.
    fn may_leave(&self, node: usize) -> bool {
        let robots = self.plan.robot_nodes();
        !robots.contains(&node) || node != robots.start && self.checker.newest_world() > 0
    }

    /// Stops a process for a time.
    pub(super) fn stop(&mut self, node: usize, for_ns: u64) {
        self.trace(Some(node), || "is stopped".to_owned());
        let stopped = &mut self.nodes[node];
        if !std::mem::replace(&mut stopped.is_stopped, true) {
            stopped.state_since_ns = self.now_ns;
        }
        stopped.is_interrupted = true;
        let life = stopped.life;
        self.after(for_ns, SimEvent::ProcessContinues { node, life });
    }

    /// A stopped process continues.
    pub(super) fn continue_process(&mut self, node: usize) -> Result<(), Violation> {
        let stopped = &mut self.nodes[node];
        if std::mem::take(&mut stopped.is_stopped) {
            let stopped_ns = self.now_ns - stopped.state_since_ns;
            stopped.stopped_ns += stopped_ns;
            stopped.suspended_ns += stopped_ns.saturating_sub(ROUND_MAX_NS);
            stopped.state_since_ns = self.now_ns;
            self.trace(Some(node), || "continues".to_owned());
            self.forget_first_range();
            if node == self.plan.gateway() {
                let now_ns = self.now_ns;
                self.gateway.remote_robots.values_mut().for_each(|remote| remote.checker.continued(now_ns));
            }
            self.run(node)?;
        }
        Ok(())
    }

    /// A process ends.
    pub(super) fn die(&mut self, node: usize, end: End) {
        self.trace(Some(node), || if end == End::Killed { "is killed".to_owned() } else { "fails".to_owned() });
        let dead = &mut self.nodes[node];
        dead.life += 1;
        (dead.takes_part, dead.is_stopped, dead.is_interrupted) = (false, false, false);
        dead.pending_fault = None;
        dead.inbox.clear();
        dead.wakes_at_ns = u64::MAX;
        if node == self.plan.gateway() {
            self.gateway.die();
        }
        let dead = &mut self.nodes[node];
        let lock = match std::mem::replace(&mut dead.process, Process::None) {
            Process::Leader(leading) => Some(leading.lease.lock),
            Process::Successor(successor) => Some(successor.lease.lock),
            _ => None,
        };
        let lock = if self.lead.release(node, self.now_ns) { Some(self.lead.lock) } else { lock };
        if let Some(lock) = lock {
            self.free(lock);
        }
        self.supervisor.ends.push((node, end));
        self.after(WAKE_NS, SimEvent::SupervisorActs);
    }

    /// A lock is free: the standbys that wait for it wake up. If it is a deposed leader's lock, they then wait for the
    /// current one.
    pub(super) fn free(&mut self, lock: u64) {
        for node in self.plan.fusion_nodes() {
            if let Process::Standby(standing_by) = &mut self.nodes[node].process
                && standing_by.waits_for == lock
            {
                standing_by.waits_for = self.lead.lock;
                self.after(WAKE_NS, SimEvent::Wakes { node, event: Some(Event::Range) });
            }
        }
    }

    /// Lets a process read its messages and do all of its actions.
    pub(super) fn run(&mut self, node: usize) -> Result<(), Violation> {
        let running = &self.nodes[node];
        if running.is_stopped || matches!(running.process, Process::None | Process::Starting) {
            return Ok(());
        }
        self.check_arrivals(node)?;
        let running = &mut self.nodes[node];
        let process = std::mem::replace(&mut running.process, Process::None);
        let life = running.life;
        running.actions = 0;
        // A leader sends its heartbeats for the lead instead.
        if !matches!(process, Process::Successor(_) | Process::Leader(_))
            && running.heartbeat_ns.is_none_or(|heartbeat_ns| self.now_ns >= heartbeat_ns + HEARTBEAT_NS)
        {
            running.heartbeat_ns = Some(self.now_ns);
        }
        let process = match process {
            Process::None | Process::Starting => process,
            Process::Sim(machine) => self.run_sim(machine)?,
            Process::Standby(standing_by) => self.run_standby(node, standing_by)?,
            Process::Successor(successor) => self.run_successor(node, successor)?,
            Process::Leader(leading) => self.run_leader(node, leading)?,
            Process::Robot(robot) => self.run_robot(node, robot)?,
            Process::Gateway => self.run_gateway(node)?,
        };
        // Unless it has died meanwhile.
        if self.nodes[node].life == life {
            self.nodes[node].process = process;
        }
        Ok(())
    }

    /// Sleeps until a time of its own clock, at most for [`IDLE_NS`].
    pub(super) fn sleep_until(&mut self, node: usize, local_ns: Option<u64>) -> Result<(), Violation> {
        let now_local_ns = self.local_ns(node);
        let left_ns = local_ns.map_or(IDLE_NS, |local_ns| local_ns.saturating_sub(now_local_ns));
        if left_ns == 0 {
            let what = "it had something to do before now, and does nothing";
            return Err(self.violation(Some(node), what.to_owned()));
        }
        let left_ns = ((left_ns as f64 / self.nodes[node].clock.rate) as u64 + 1).min(IDLE_NS);
        self.sleep(node, left_ns);
        Ok(())
    }

    /// Sleeps for a time.
    pub(super) fn sleep(&mut self, node: usize, left_ns: u64) {
        let wakes_at_ns = self.now_ns + left_ns;
        // An earlier wake-up stays scheduled; one that has passed is replaced.
        if wakes_at_ns < self.nodes[node].wakes_at_ns || self.nodes[node].wakes_at_ns <= self.now_ns {
            self.nodes[node].wakes_at_ns = wakes_at_ns;
            self.after(left_ns, SimEvent::Wakes { node, event: None });
        }
    }

    /// The time of a node's own clock, ns.
    pub(super) fn local_ns(&self, node: usize) -> u64 {
        self.nodes[node].clock.local_ns(self.now_ns)
    }

    /// How far clocks may have diverged, and how late a running node may notice that a deadline has passed, ns.
    pub(super) fn late_ns(&self) -> u64 {
        let has_clocks_apart = !self.plan.has_one_rate();
        1_000_000 + if has_clocks_apart { self.now_ns / 80 } else { 0 }
    }
}
