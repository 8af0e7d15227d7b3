//! Fusion before it leads, in simulated time: it stands by, takes the lead, and reads what its predecessor left.

use rangehound_fusion::leader::{Leader, Saved};
use rangehound_fusion::standby::{LOOK, Standby};
use rangehound_node::rendezvous::tenure::needs_own_checkpoint;
use rangehound_shared::protocol::wake::{Event, WaitGroup};
use rangehound_shared::sealed::slots::Turns;

use crate::study::explore::cluster::{Cluster, Happening, Violation};
use crate::study::explore::lead::Lease;
use crate::study::explore::process::{Fate, Process};
use crate::study::explore::witness::succession;

/// A process that is ready to lead.
pub(in crate::study::explore) struct StandingBy {
    standby: Standby<u64, u64>,
    /// The lock that the kernel will give it.
    pub(in crate::study::explore) waits_for: u64,
    since_ns: u64,
    looks_at_ns: u64,
    /// It is about to depose whoever gave this sign last.
    deposes: Option<u64>,
}

/// A process that has taken the lead and does not lead yet.
pub(in crate::study::explore) struct Heir {
    pub(in crate::study::explore) lease: Lease,
    /// What it goes on from, once it has read that.
    read: Option<(Leader, Turns)>,
}

/// A process that leads.
pub(in crate::study::explore) struct Leading {
    pub(in crate::study::explore) machine: Leader,
    pub(in crate::study::explore) lease: Lease,
    /// Its checkpoint file, if it has one.
    pub(in crate::study::explore) disk: Option<usize>,
    pub(in crate::study::explore) turns: Turns,
    pub(in crate::study::explore) since_ns: u64,
    /// When the first range of a tick came, by its own clock, if neither it nor the simulator was stopped since.
    pub(in crate::study::explore) first_range: Option<(u64, u64)>,
    /// The same in time for which it ran, whoever was stopped.
    pub(in crate::study::explore) ran_at_first_ns: Option<(u64, u64)>,
    /// It has made sure that it leads since it last commanded.
    pub(in crate::study::explore) has_looked: bool,
    /// The newest tick of which a range came.
    pub(in crate::study::explore) newest_heard: u64,
}

impl Cluster<'_> {
    /// Where others can lead, one that is started as fusion stands by too.
    pub(in crate::study::explore) fn start_fusion(&mut self, node: usize) -> Process {
        if self.plan.standbys == 0 && self.lead.is_free(self.lead.lock) {
            self.inherit(node, None)
        } else {
            self.stand_by()
        }
    }

    pub(in crate::study::explore) fn stand_by(&mut self) -> Process {
        let standby = Standby::new(self.scenario, self.lead.renew(), Some(self.lead.lock));
        let (waits_for, looks_at_ns) = (self.lead.lock, self.now_ns + LOOK.as_nanos() as u64);
        Process::Standby(Box::new(StandingBy { standby, waits_for, since_ns: self.now_ns, looks_at_ns, deposes: None }))
    }

    pub(in crate::study::explore) fn run_standby(
        &mut self,
        node: usize,
        mut standing_by: Box<StandingBy>,
    ) -> Result<Process, Violation> {
        match self.meet_doom(node)? {
            Fate::Dies { .. } => return Ok(Process::None),
            Fate::Stops => return Ok(Process::Standby(standing_by)),
            Fate::Lives => {}
        }
        let stood_by_ns = self.nodes[node].well_for_ns(self.now_ns).min(self.now_ns - standing_by.since_ns);
        let waited = succession::waits(&self.lead, &self.nodes, stood_by_ns, self.now_ns);
        waited.map_err(|what| self.violation(Some(node), what))?;
        let StandingBy { standby, waits_for, looks_at_ns, deposes, .. } = &mut *standing_by;
        if self.lead.is_free(*waits_for) {
            return Ok(self.inherit(node, None));
        }
        if *looks_at_ns <= self.now_ns {
            *looks_at_ns = self.now_ns + LOOK.as_nanos() as u64;
            *deposes = standby.look(self.lead.renew());
            if deposes.is_some() {
                match self.meet_doom(node)? {
                    Fate::Dies { .. } => return Ok(Process::None),
                    Fate::Stops => return Ok(Process::Standby(standing_by)),
                    Fate::Lives => {}
                }
            }
        }
        if let Some(silent_since) = deposes.take() {
            let deposed = self.lead.holder;
            let life = self.nodes[node].life;
            if let Some(lease) = self.lead.depose(silent_since, node, life, self.now_ns) {
                let is_right = succession::deposes(&self.nodes, deposed, self.now_ns);
                is_right.map_err(|what| self.violation(Some(node), what))?;
                return Ok(self.inherit(node, Some(lease)));
            }
        }
        if standby.waits_anew(Some(self.lead.lock)) {
            *waits_for = self.lead.lock;
            if self.lead.is_free(*waits_for) {
                return Ok(self.inherit(node, None));
            }
        }
        let left_ns = looks_at_ns.saturating_sub(self.now_ns).max(1);
        self.sleep(node, left_ns);
        Ok(Process::Standby(standing_by))
    }

    /// The process of a node that takes the lead, or has just taken it by deposing the predecessor.
    fn inherit(&mut self, node: usize, lease: Option<Lease>) -> Process {
        let life = self.nodes[node].life;
        let lease = lease.unwrap_or_else(|| self.lead.take(node, life, self.now_ns));
        self.counts.successions += u64::from(lease.incarnation > 1);
        self.nodes[node].incarnation = lease.incarnation;
        self.tell(Some(node), || format!("takes the lead as incarnation {}", lease.incarnation));
        self.doom_heir(node);
        self.after(0, Happening::Wakes { node, event: Some(Event::Range) });
        Process::Heir(Box::new(Heir { lease, read: None }))
    }

    /// It reads the checkpoint, and then gives it a file of its own.
    pub(in crate::study::explore) fn run_heir(
        &mut self,
        node: usize,
        mut heir: Box<Heir>,
    ) -> Result<Process, Violation> {
        let fate = self.meet_doom(node)?;
        if let Fate::Dies { .. } = fate {
            return Ok(Process::None);
        }
        self.after(0, Happening::Wakes { node, event: Some(Event::Range) });
        let Heir { lease, read } = &mut *heir;
        let Some((machine, turns)) = read.take() else {
            *read = Some(self.read_checkpoint(node)?);
            return Ok(Process::Heir(heir));
        };
        // Deposed itself: the file is its successor's.
        let mut disk = Some(self.disks.len() - 1);
        if needs_own_checkpoint(lease.incarnation) {
            disk = self.lead.is_current(*lease).then_some(self.disks.len());
            if disk.is_some() {
                let moved = self.disks[self.disks.len() - 1].moved(&turns);
                self.disks.push(moved);
            }
        }
        let tick = machine.centre().next_tick();
        self.tell(Some(node), || format!("leads from tick {tick}"));
        let is_behind = self.lead.is_current(*lease) && tick <= self.witness.newest_headings().unwrap_or(0);
        if is_behind && self.witness.newest_headings().is_some() {
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
            turns,
            first_range,
            since_ns: self.now_ns,
            ran_at_first_ns: None,
            has_looked: false,
            newest_heard,
        };
        Ok(Process::Leader(Box::new(leading)))
    }

    fn read_checkpoint(&mut self, node: usize) -> Result<(Leader, Turns), Violation> {
        let newest = &self.disks[self.disks.len() - 1];
        let (saved, turns) = newest.read::<Saved<'static>>().map_err(|what| self.violation(Some(node), what))?;
        let mut machine = Leader::new(self.scenario).map_err(|error| self.violation(Some(node), error.to_string()))?;
        match saved {
            Some(saved) => {
                let restored = machine.restore(saved, self.local_ns(node));
                restored.map_err(|error| self.violation(Some(node), error.to_string()))?;
            }
            None if self.witness.newest_headings().is_some() => {
                return Err(self.violation(Some(node), "the state of ticks that were published is lost".to_owned()));
            }
            None => {}
        }
        Ok((machine, turns))
    }

    /// The tick that is gathered is held for as long as somebody stood still.
    pub(in crate::study::explore) fn forget_first_range(&mut self) {
        for node in &mut self.nodes {
            if let Process::Leader(leading) = &mut node.process {
                leading.first_range = None;
            }
        }
    }
}
