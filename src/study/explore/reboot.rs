//! The run's host is rebooted, and its run is resumed from the checkpoints. Robots on other hosts live on.

use rand::RngExt as _;

use super::cluster::{Cluster, GroupState};
use super::lead::Lead;
use super::node::Process;
use super::supervisor::Supervisor;
use crate::run::supervisor::deaths::End;

/// Longest time that the start of a process takes, ns.
const START_NS: u64 = 20_000_000;

impl Cluster<'_> {
    /// All processes of the run's host die, with their supervisor and whatever was in shared memory; later all are started
    /// again.
    pub(super) fn reboot(&mut self, index: usize) {
        let reboot = self.plan.links.as_ref().and_then(|links| links.reboots.get(index).copied());
        let Some(reboot) = reboot.filter(|_| !self.is_finished) else { return };
        self.counts.faults += 1;
        self.trace(None, || "the run's host is rebooted".to_owned());
        for node in self.plan.all_nodes().filter(|node| !self.plan.is_remote_node(*node)) {
            if !matches!(self.nodes[node].process, Process::None) {
                self.die(node, End::Killed);
            }
            // Roles are counted in shared memory.
            self.nodes[node].incarnation = 0;
        }
        self.forget_messages();
        self.lead = Lead::default();
        self.sim_starts = 0;
        self.groups = [GroupState::default(); 3];
        self.gateway.forget_roles();
        self.incarnation += 1;
        self.checker.robots.iter_mut().for_each(|robot| robot.starts_anew());
        self.supervisor = Supervisor::new(self.plan);
        self.supervisor.looked_ns = self.now_ns;
        for node in self.plan.all_nodes() {
            self.supervisor.machine.on_start(node, self.now_ns);
            if matches!(self.nodes[node].process, Process::None) {
                let soon_ns = self.random.random_range(0..START_NS);
                self.spawn(node, reboot.for_ns + soon_ns);
            }
        }
    }
}
