//! What happens to a team, drawn from a seed: its size, its network, its faults.

use rand::RngExt as _;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rangehound_shared::scenario::Clock;

/// One exploration.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Plan {
    /// The seed of all that is random in it.
    pub(super) seed: u64,
    /// The team's clock.
    pub(super) clock: Clock,
    /// Lock step waits for silent robots for ever.
    pub(super) is_endless: bool,
    /// Robots.
    pub(super) robots: usize,
    /// Standbys of fusion.
    pub(super) standbys: usize,
    /// Ticks after tick 0.
    pub(super) ticks: u64,
    /// How messages travel.
    pub(super) network: Network,
    /// How fast each node's clock goes.
    pub(super) clock_rates: Vec<f64>,
    /// What goes wrong, in order of time.
    pub(super) faults: Vec<Fault>,
}

/// How messages travel until the faults cease; after that none is lost.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Network {
    /// Share of messages that are lost.
    pub(super) loss: f64,
    /// Share that come twice.
    pub(super) duplicates: f64,
    /// Share that take long, and so may be overtaken.
    pub(super) slow: f64,
    /// Longest time that a slow one takes, ns.
    pub(super) slow_max_ns: u64,
    /// What arrives wakes its receiver; otherwise only a notification does.
    pub(super) wakes_on_arrival: bool,
}

/// Something that goes wrong.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Fault {
    /// When, ns.
    pub(super) at_ns: u64,
    /// What.
    pub(super) kind: FaultKind,
}

/// A kind of fault.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum FaultKind {
    /// A node is killed once it has done so many more actions, and started again later.
    Kill {
        /// Which.
        node: usize,
        /// Actions before that.
        after_actions: u32,
        /// If that action is to write the checkpoint, half of it is written.
        is_torn: bool,
        /// Until it is started again, ns.
        down_ns: u64,
    },
    /// A node is stopped once it has done so many more actions, and continued later.
    Stop {
        /// Which.
        node: usize,
        /// Actions before that.
        after_actions: u32,
        /// For how long, ns.
        for_ns: u64,
    },
    /// Nothing gets from these nodes to the others, or from those to these.
    Partition {
        /// Bit i for node i.
        nodes: u64,
        /// For how long, ns.
        for_ns: u64,
    },
}

impl Fault {
    /// When its effects are over, ns.
    pub(super) fn ends_ns(&self) -> u64 {
        let lasts_ns = match self.kind {
            FaultKind::Kill { down_ns, .. } => down_ns,
            FaultKind::Stop { for_ns, .. } | FaultKind::Partition { for_ns, .. } => for_ns,
        };
        self.at_ns + lasts_ns
    }
}

impl Plan {
    /// The plan of a seed.
    pub(super) fn new(seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let clock = if random.random_bool(0.6) { Clock::Lockstep } else { Clock::Realtime };
        // Small teams mostly: most faults need no more, and are seen sooner.
        let robots = if random.random_bool(0.8) { random.random_range(1..=4) } else { random.random_range(1..=20) };
        let standbys = random.random_range(0..=2);
        let nodes = 2 + standbys + robots;
        let ticks = random.random_range(4..=16);
        let is_quiet = random.random_bool(0.3);
        let network = Network {
            loss: if is_quiet { 0.0 } else { random.random_range(0.0..0.3) },
            duplicates: if is_quiet { 0.0 } else { random.random_range(0.0..0.3) },
            slow: if is_quiet { 0.0 } else { random.random_range(0.0..0.3) },
            slow_max_ns: random.random_range(1_000_000..200_000_000),
            wakes_on_arrival: random.random_bool(0.5),
        };
        let mut clock_rate = || if is_quiet { 1.0 } else { random.random_range(0.995..1.005) };
        let clock_rates = (0..nodes).map(|_| clock_rate()).collect();
        // Lock step takes some milliseconds a tick, or the time of a repeat; real time its own.
        let span_ns = match clock {
            Clock::Lockstep => ticks * random.random_range(1_000_000..40_000_000),
            Clock::Realtime => (ticks + 1) * 100_000_000,
        };
        let mut faults: Vec<Fault> = (0..random.random_range(0..=6))
            .map(|_| Fault { at_ns: random.random_range(0..span_ns), kind: fault(&mut random, nodes, standbys) })
            .collect();
        faults.sort_by_key(|fault| fault.at_ns);
        let is_endless = random.random_bool(0.8);
        Self { seed, clock, is_endless, robots, standbys, ticks, network, clock_rates, faults }
    }

    /// How many nodes there are: sim, fusion, standbys, robots.
    pub(super) fn nodes(&self) -> usize {
        2 + self.standbys + self.robots
    }

    /// What a node is called.
    pub(super) fn name_of(&self, node: usize) -> String {
        match node {
            0 => "sim".to_owned(),
            1 => "fusion".to_owned(),
            node if node < 2 + self.standbys => format!("standby-{}", node - 1),
            node => format!("robot-{}", node - 2 - self.standbys),
        }
    }

    /// When the last fault is over, ns.
    pub(super) fn calm_from_ns(&self) -> u64 {
        self.faults.iter().map(Fault::ends_ns).max().unwrap_or(0)
    }
}

fn fault(random: &mut ChaCha8Rng, nodes: usize, standbys: usize) -> FaultKind {
    // Half of all faults at the two that have a state, or may come to have it.
    let node =
        if random.random_bool(0.5) { random.random_range(0..2 + standbys) } else { random.random_range(0..nodes) };
    let after_actions = random.random_range(0..24);
    let short_ns = random.random_range(0..300_000_000);
    // Long enough to be deposed.
    let long_ns = random.random_range(300_000_000..2_000_000_000);
    match random.random_range(0..10) {
        0..5 => {
            let down_ns = if random.random_bool(0.8) { short_ns } else { long_ns };
            FaultKind::Kill { node, after_actions, is_torn: random.random_bool(0.5), down_ns }
        }
        5..9 => {
            let for_ns = if random.random_bool(0.5) { short_ns } else { long_ns };
            FaultKind::Stop { node, after_actions, for_ns }
        }
        _ => FaultKind::Partition { nodes: random.random_range(1..1_u64 << nodes.min(60)), for_ns: short_ns },
    }
}
