//! Fusion before it leads, in simulated time: it stands by, takes the lead, and reads its predecessor's checkpoint.

use rangehound_fusion::leader::{Leader, Saved};
use rangehound_fusion::standby::{POLL_INTERVAL, Standby};
use rangehound_node::rendezvous::tenure::needs_own_checkpoint;
use rangehound_shared::protocol::wake::{Event, WaitGroup};
use rangehound_shared::sealed::slots::SlotWriter;

use crate::study::explore::checker::succession;
use crate::study::explore::cluster::{Cluster, SimEvent, Violation};
use crate::study::explore::lead::Lease;
use crate::study::explore::node::{FaultEffect, Leading, Process, StandingBy, Successor};

impl Cluster<'_> {
    /// If there are standbys, fusion is started as a standby too.
    pub(in crate::study::explore) fn start_fusion(&mut self, node: usize) -> Process {
        if self.plan.standbys == 0 && self.lead.is_free(self.lead.lock) {
            self.take_lead(node, None)
        } else {
            self.stand_by()
        }
    }

    pub(in crate::study::explore) fn stand_by(&mut self) -> Process {
        let standby = Standby::new(self.scenario, self.lead.heartbeat(), Some(self.lead.lock));
        let (waits_for, looks_at_ns) = (self.lead.lock, self.now_ns + POLL_INTERVAL.as_nanos() as u64);
        Process::Standby(Box::new(StandingBy { standby, waits_for, since_ns: self.now_ns, looks_at_ns, deposes: None }))
    }

    pub(in crate::study::explore) fn run_standby(
        &mut self,
        node: usize,
        mut standing_by: Box<StandingBy>,
    ) -> Result<Process, Violation> {
        match self.before_action(node)? {
            FaultEffect::Dies { .. } => return Ok(Process::None),
            FaultEffect::Stops => return Ok(Process::Standby(standing_by)),
            FaultEffect::Lives => {}
        }
        let stood_by_ns = self.nodes[node].well_for_ns(self.now_ns).min(self.now_ns - standing_by.since_ns);
        let waited = succession::waits(&self.lead, &self.nodes, stood_by_ns, self.now_ns);
        waited.map_err(|what| self.violation(Some(node), what))?;
        let StandingBy { standby, waits_for, looks_at_ns, deposes, .. } = &mut *standing_by;
        if self.lead.is_free(*waits_for) {
            return Ok(self.take_lead(node, None));
        }
        if *looks_at_ns <= self.now_ns {
            *looks_at_ns = self.now_ns + POLL_INTERVAL.as_nanos() as u64;
            *deposes = standby.look(self.lead.heartbeat());
            if deposes.is_some() {
                match self.before_action(node)? {
                    FaultEffect::Dies { .. } => return Ok(Process::None),
                    FaultEffect::Stops => return Ok(Process::Standby(standing_by)),
                    FaultEffect::Lives => {}
                }
            }
        }
        if let Some(silent_since) = deposes.take() {
            let deposed = self.lead.holder;
            let life = self.nodes[node].life;
            if let Some(lease) = self.lead.depose(silent_since, node, life, self.now_ns) {
                let is_right = succession::deposes(&self.nodes, deposed, self.now_ns);
                is_right.map_err(|what| self.violation(Some(node), what))?;
                return Ok(self.take_lead(node, Some(lease)));
            }
        }
        if standby.restart_wait(Some(self.lead.lock)) {
            *waits_for = self.lead.lock;
            if self.lead.is_free(*waits_for) {
                return Ok(self.take_lead(node, None));
            }
        }
        let left_ns = looks_at_ns.saturating_sub(self.now_ns).max(1);
        self.sleep(node, left_ns);
        Ok(Process::Standby(standing_by))
    }

    /// Takes the lead, unless `lease` says that it was just taken by deposing the predecessor.
    fn take_lead(&mut self, node: usize, lease: Option<Lease>) -> Process {
        let life = self.nodes[node].life;
        let lease = lease.unwrap_or_else(|| self.lead.take(node, life, self.now_ns));
        self.counts.successions += u64::from(lease.incarnation > 1);
        self.nodes[node].incarnation = lease.incarnation;
        self.trace(Some(node), || format!("takes the lead as incarnation {}", lease.incarnation));
        self.apply_successor_fault(node);
        self.after(0, SimEvent::Wakes { node, event: Some(Event::Range) });
        Process::Successor(Box::new(Successor { lease, read: None }))
    }

    /// Reads the checkpoint, and then moves it to a new file.
    pub(in crate::study::explore) fn run_successor(
        &mut self,
        node: usize,
        mut successor: Box<Successor>,
    ) -> Result<Process, Violation> {
        let effect = self.before_action(node)?;
        if let FaultEffect::Dies { .. } = effect {
            return Ok(Process::None);
        }
        self.after(0, SimEvent::Wakes { node, event: Some(Event::Range) });
        let Successor { lease, read } = &mut *successor;
        let Some((machine, writer)) = read.take() else {
            *read = Some(self.read_checkpoint(node)?);
            return Ok(Process::Successor(successor));
        };
        // If it has been deposed meanwhile, the file is its successor's.
        let mut disk = Some(self.disks.len() - 1);
        if needs_own_checkpoint(lease.incarnation) {
            disk = self.lead.is_current(*lease).then_some(self.disks.len());
            if disk.is_some() {
                let moved = self.disks[self.disks.len() - 1].moved(&writer);
                self.disks.push(moved);
            }
        }
        let tick = machine.centre().next_tick();
        self.trace(Some(node), || format!("leads from tick {tick}"));
        let is_behind = self.lead.is_current(*lease) && tick <= self.checker.newest_headings().unwrap_or(0);
        if is_behind && self.checker.newest_headings().is_some() {
            return Err(
                self.violation(Some(node), format!("it goes back to tick {tick}, whose headings were published"))
            );
        }
        self.groups[WaitGroup::Fusion as usize].expected = machine.expected();
        let (lease, first_range, newest_heard) = (*lease, None, 0);
        self.nodes[node].first_arrival = None;
        let leading = Leading {
            machine,
            lease,
            disk,
            writer,
            first_range,
            since_ns: self.now_ns,
            ran_at_first_ns: None,
            has_looked: false,
            newest_heard,
        };
        Ok(Process::Leader(Box::new(leading)))
    }

    fn read_checkpoint(&mut self, node: usize) -> Result<(Leader, SlotWriter), Violation> {
        let newest = &self.disks[self.disks.len() - 1];
        let (saved, writer) = newest.read::<Saved<'static>>().map_err(|what| self.violation(Some(node), what))?;
        let mut machine = Leader::new(self.scenario).map_err(|error| self.violation(Some(node), error.to_string()))?;
        match saved {
            Some(saved) => {
                let restored = machine.restore(saved, self.local_ns(node));
                restored.map_err(|error| self.violation(Some(node), error.to_string()))?;
            }
            None if self.checker.newest_headings().is_some() => {
                return Err(self.violation(Some(node), "the state of ticks that were published is lost".to_owned()));
            }
            None => {}
        }
        Ok((machine, writer))
    }

    /// After a stop, the time since the first range no longer limits how long fusion may gather the tick.
    pub(in crate::study::explore) fn forget_first_range(&mut self) {
        for node in &mut self.nodes {
            if let Process::Leader(leading) = &mut node.process {
                leading.first_range = None;
            }
        }
    }
}
