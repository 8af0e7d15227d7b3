//! The lead, as in the roster of a run: one lock with a name, and the nameless locks of deposed leaders.

use rangehound_node::rendezvous::tenure::Tenure;

/// Least time between two heartbeats of the leader, ns.
pub(super) const HEARTBEAT_NS: u64 = 50_000_000;

/// The lead of a run.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Lead {
    /// How often it was taken, and its holder's last heartbeat.
    tenure: Tenure<u64>,
    /// The lock with the name: counts depositions.
    pub(super) lock: u64,
    /// The node whose process has that lock.
    pub(super) holder: Option<usize>,
    /// The process that took it last: its node and that node's life.
    pub(super) last: Option<(usize, u32)>,
    /// Time since which nobody holds it, ns.
    pub(super) free_since_ns: Option<u64>,
}

/// One process's lease of the lead.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Lease {
    pub(super) incarnation: u64,
    pub(super) lock: u64,
}

impl Lead {
    pub(super) fn starts(&self) -> u64 {
        self.tenure.starts
    }

    pub(super) fn heartbeat(&self) -> Option<u64> {
        self.tenure.heartbeat
    }

    /// True if a process that waits for this lock gets it at once.
    pub(super) fn is_free(&self, lock: u64) -> bool {
        self.holder.is_none() && self.lock == lock
    }

    /// Takes the free lead.
    pub(super) fn take(&mut self, node: usize, life: u32, now_ns: u64) -> Lease {
        let incarnation = self.tenure.next_incarnation();
        self.tenure = Tenure { starts: incarnation, heartbeat: Some(now_ns) };
        (self.holder, self.last, self.free_since_ns) = (Some(node), Some((node, life)), None);
        Lease { incarnation, lock: self.lock }
    }

    /// Takes it from a holder that has sent no heartbeat since this one.
    pub(super) fn depose(&mut self, silent_since: u64, node: usize, life: u32, now_ns: u64) -> Option<Lease> {
        self.tenure.is_silent_since(&silent_since).then(|| {
            self.lock += 1;
            self.take(node, life, now_ns)
        })
    }

    /// False once another has taken it.
    pub(super) fn is_current(&self, lease: Lease) -> bool {
        self.lock == lease.lock && self.tenure.starts == lease.incarnation
    }

    /// A heartbeat of the holder.
    pub(super) fn send_heartbeat(&mut self, now_ns: u64) {
        if self.tenure.heartbeat.is_none_or(|heartbeat_ns| now_ns >= heartbeat_ns + HEARTBEAT_NS) {
            self.tenure.heartbeat = Some(now_ns);
        }
    }

    /// A process has ended; true if it held the lead.
    pub(super) fn release(&mut self, node: usize, now_ns: u64) -> bool {
        let led = self.holder == Some(node);
        if led {
            (self.holder, self.free_since_ns) = (None, Some(now_ns));
        }
        led
    }
}
