//! Faults of a team, drawn from a seed.

use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;

/// A hang that only the supervisor ends, ns.
const FOR_EVER_NS: u64 = 1_000_000_000_000;

/// Longest time until a hung process is started again: silence of 2 s, 0.1 s for each node, and some looks, ns.
const HANG_MAX_NS: u64 = 5_000_000_000;

/// A fault.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Fault {
    /// When, ns.
    pub(super) at_ns: u64,
    /// Kind of fault.
    pub(super) kind: FaultKind,
}

/// A kind of fault.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum FaultKind {
    /// A node is killed after some actions, and so are its next processes, `times` in all.
    Kill {
        /// The node.
        node: usize,
        /// Number of actions before that.
        after_actions: u32,
        /// If that action is to write the checkpoint, this share of it is written.
        written: f64,
        /// It is not a kill but a failure of its own.
        is_own: bool,
        /// Number of processes.
        times: u32,
        /// Time that the next process takes to start, ns.
        up_ns: u64,
    },
    /// The next process that takes the lead is killed after some actions.
    KillSuccessor {
        /// Number of actions before that.
        after_actions: u32,
    },
    /// A node is stopped after some actions, and continued later.
    Stop {
        /// The node.
        node: usize,
        /// Number of actions before that.
        after_actions: u32,
        /// Duration, ns.
        for_ns: u64,
    },
    /// The leader is stopped in the same way.
    StopLeader {
        /// Number of actions before that.
        after_actions: u32,
        /// Duration, ns.
        for_ns: u64,
    },
    /// All nodes are stopped at once, with or without the supervisor.
    StopAll {
        /// The supervisor is stopped too.
        with_supervisor: bool,
        /// Duration, ns.
        for_ns: u64,
    },
    /// The supervisor is stopped.
    StopSupervisor {
        /// Duration, ns.
        for_ns: u64,
    },
    /// The system refuses to start processes.
    RefuseStarts {
        /// Number of starts.
        times: u32,
    },
    /// From now on each process of a node fails some actions after its start.
    Break {
        /// The node.
        node: usize,
        /// Number of actions before that.
        after_actions: u32,
    },
    /// No message passes between these nodes and the others.
    Partition {
        /// Bit i for node i.
        nodes: u64,
        /// Duration, ns.
        for_ns: u64,
    },
}

impl Fault {
    /// Time at which its effects are over, ns.
    pub(super) fn ends_ns(&self) -> u64 {
        let lasts_ns = match self.kind {
            FaultKind::Kill { times, up_ns, .. } => u64::from(times) * (up_ns + 20_000_000),
            FaultKind::Stop { for_ns, .. }
            | FaultKind::StopLeader { for_ns, .. }
            | FaultKind::StopAll { for_ns, .. }
            | FaultKind::StopSupervisor { for_ns }
            | FaultKind::Partition { for_ns, .. } => for_ns.min(HANG_MAX_NS),
            FaultKind::KillSuccessor { .. } | FaultKind::RefuseStarts { .. } | FaultKind::Break { .. } => 0,
        };
        self.at_ns + lasts_ns
    }

    /// How many failures of a node's own it causes: a refused start counts as one.
    fn own_failures(&self) -> u32 {
        match self.kind {
            FaultKind::Kill { is_own: true, times, .. } | FaultKind::RefuseStarts { times } => times,
            _ => 0,
        }
    }

    pub(super) fn is_break(&self) -> bool {
        matches!(self.kind, FaultKind::Break { .. })
    }

    fn is_hang(&self) -> bool {
        matches!(
            self.kind,
            FaultKind::Stop { for_ns: FOR_EVER_NS, .. } | FaultKind::StopLeader { for_ns: FOR_EVER_NS, .. }
        )
    }
}

/// Largest number of own failures in a run that must not end because of them.
const OWN_FAILURES_MAX: u32 = 4;

/// The parameters of faults.
#[derive(Debug, Clone, Copy)]
pub(super) struct Team {
    /// Number of nodes: sim, fusion, standbys, robots.
    pub(super) nodes: usize,
    /// Number of standbys.
    pub(super) standbys: usize,
    /// True if no robot is ever left out.
    pub(super) is_endless: bool,
}

/// The faults of a plan, in order of time.
pub(super) fn draw(random: &mut ChaCha8Rng, team: Team, span_ns: u64) -> Vec<Fault> {
    let mut faults: Vec<Fault> = Vec::new();
    for _ in 0..random.random_range(0..=6) {
        let fault = Fault { at_ns: random.random_range(0..span_ns), kind: kind(random, team) };
        let own_failures: u32 = faults.iter().map(Fault::own_failures).sum::<u32>() + fault.own_failures();
        // At most one hang and one broken node: a second one might leave no node that can take its place.
        let is_twice = |is: fn(&Fault) -> bool| is(&fault) && faults.iter().any(is);
        if own_failures <= OWN_FAILURES_MAX && !is_twice(Fault::is_hang) && !is_twice(Fault::is_break) {
            faults.push(fault);
        }
    }
    // A node whose every process fails is given up, and that must have no other cause.
    if faults.iter().any(Fault::is_break) {
        faults.retain(|fault| fault.own_failures() == 0 && !fault.is_hang());
    }
    faults.sort_by_key(|fault| fault.at_ns);
    faults
}

fn kind(random: &mut ChaCha8Rng, team: Team) -> FaultKind {
    let (nodes, can_lead) = (team.nodes, 2 + team.standbys);
    // Half of all faults concern the nodes that have state, or may get it.
    let node = if random.random_bool(0.5) { random.random_range(0..can_lead) } else { random.random_range(0..nodes) };
    let after_actions = random.random_range(0..24);
    let few_actions = random.random_range(0..6);
    let short_ns = random.random_range(0..300_000_000);
    // Long enough for a leader to be deposed.
    let long_ns = random.random_range(300_000_000..2_000_000_000);
    let slow_ns = random.random_range(300_000_000..2_600_000_000);
    let up_ns = if random.random_bool(0.8) { short_ns / 10 } else { slow_ns };
    let for_ns = if random.random_bool(0.5) { short_ns } else { long_ns };
    let written = if random.random_bool(0.5) { random.random_range(0.0..1.0) } else { 0.0 };
    match random.random_range(0..100) {
        0..34 => {
            let is_own = random.random_bool(0.1);
            FaultKind::Kill { node, after_actions, written, is_own, times: 1, up_ns }
        }
        34..39 => {
            let times = random.random_range(2..=9);
            FaultKind::Kill { node, after_actions: few_actions, written, is_own: false, times, up_ns: short_ns / 100 }
        }
        39..45 => FaultKind::KillSuccessor { after_actions: few_actions },
        45..62 => FaultKind::Stop { node, after_actions, for_ns },
        62..74 => FaultKind::StopLeader { after_actions, for_ns },
        74..80 if !team.is_endless => FaultKind::Stop { node, after_actions, for_ns: FOR_EVER_NS },
        74..80 if team.standbys > 0 => FaultKind::StopLeader { after_actions, for_ns: FOR_EVER_NS },
        80..85 => FaultKind::StopAll { with_supervisor: random.random_bool(0.5), for_ns: 2 * for_ns },
        85..88 => FaultKind::StopSupervisor { for_ns },
        88..90 => FaultKind::RefuseStarts { times: random.random_range(1..=OWN_FAILURES_MAX) },
        90..91 => FaultKind::Break { node, after_actions: few_actions },
        _ => FaultKind::Partition { nodes: random.random_range(1..1_u64 << nodes.min(60)), for_ns: short_ns },
    }
}
