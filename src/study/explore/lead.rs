//! Who leads, as the roster of a run knows it: a lock with a name, and locks of deposed ones, which have none.

use rangehound_node::rendezvous::tenure::Tenure;

/// How often the leader sends a heartbeat at most, ns.
pub(super) const SIGN_NS: u64 = 50_000_000;

/// The lead of a run.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Lead {
    /// How often it was taken, and when its holder last gave a sign.
    tenure: Tenure<u64>,
    /// Which lock has the name: counts depositions.
    pub(super) lock: u64,
    /// The node whose process has that lock.
    pub(super) holder: Option<usize>,
    /// The process that took it last, by node and life.
    pub(super) last: Option<(usize, u32)>,
    /// Since when nobody holds it, ns.
    pub(super) free_since_ns: Option<u64>,
}

/// One process's hold on the lead.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Lease {
    pub(super) incarnation: u64,
    pub(super) lock: u64,
}

impl Lead {
    pub(super) fn starts(&self) -> u64 {
        self.tenure.starts
    }

    pub(super) fn renew(&self) -> Option<u64> {
        self.tenure.heartbeat
    }

    /// True if a process that waits for this lock has it at once.
    pub(super) fn is_free(&self, lock: u64) -> bool {
        self.holder.is_none() && self.lock == lock
    }

    /// Takes it from nobody.
    pub(super) fn take(&mut self, node: usize, life: u32, now_ns: u64) -> Lease {
        let incarnation = self.tenure.next_incarnation();
        self.tenure = Tenure { starts: incarnation, heartbeat: Some(now_ns) };
        (self.holder, self.last, self.free_since_ns) = (Some(node), Some((node, life)), None);
        Lease { incarnation, lock: self.lock }
    }

    /// Takes it from a holder that has given no sign since this one.
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

    /// A heartbeat of one who holds it.
    pub(super) fn sign_at(&mut self, now_ns: u64) {
        if self.tenure.heartbeat.is_none_or(|heartbeat_ns| now_ns >= heartbeat_ns + SIGN_NS) {
            self.tenure.heartbeat = Some(now_ns);
        }
    }

    /// A process is gone; true if it led.
    pub(super) fn let_go(&mut self, node: usize, now_ns: u64) -> bool {
        let led = self.holder == Some(node);
        if led {
            (self.holder, self.free_since_ns) = (None, Some(now_ns));
        }
        led
    }
}
