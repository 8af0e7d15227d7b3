//! The plan of an exploration, drawn from a seed: team, network and faults.

use std::ops::Range;

use rand::RngExt as _;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rangehound_node::rendezvous::Role;
use rangehound_shared::scenario::Clock;

use super::faults::{self, Fault, Team};
use super::links::Links;

/// The simulator's node.
pub(super) const SIM: usize = 0;

/// How far the clocks of two hosts can be apart, ns.
const CLOCKS_APART_NS: u64 = 2 * 3_600 * 1_000_000_000;

/// One exploration.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Plan {
    /// The seed of all random values.
    pub(super) seed: u64,
    /// Lock step or real time.
    pub(super) clock: Clock,
    /// Lock step waits for silent robots for ever.
    pub(super) is_endless: bool,
    /// Robots.
    pub(super) robots: usize,
    /// Their sensors.
    pub(super) equipment: Equipment,
    /// Standbys of fusion.
    pub(super) standbys: usize,
    /// True if robots that end are not started again.
    pub(super) leaves_robots: bool,
    /// True if a robot that is started again within a tick has another range than before.
    pub(super) measures_anew: bool,
    /// Ticks after tick 0.
    pub(super) ticks: u64,
    /// How messages travel.
    pub(super) network: Network,
    /// Each node's clock.
    pub(super) clocks: Vec<LocalClock>,
    /// The faults, in order of time.
    pub(super) faults: Vec<Fault>,
    /// Robots on other hosts, if there are any.
    pub(super) links: Option<Links>,
}

/// The sensors of the robots, and how well they know where they are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Equipment {
    /// Ranges, from exact poses.
    Ranges,
    /// Ranges, bearings or both, from uncertain poses.
    Mixed,
}

/// How messages travel until the faults are over; after that none is lost.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Network {
    /// Share of messages that are lost.
    pub(super) loss: f64,
    /// Share that arrive twice.
    pub(super) duplicates: f64,
    /// Share that are slow, and so may be overtaken.
    pub(super) slow: f64,
    /// Longest delay of a slow message, ns.
    pub(super) slow_max_ns: u64,
    /// Share that are followed by an invalid copy.
    pub(super) garbled: f64,
    /// True if a message wakes its receiver; otherwise only a notification does.
    pub(super) wakes_on_arrival: bool,
}

impl Network {
    /// The longest delay of a message, ns.
    pub(super) fn slowest_ns(&self) -> u64 {
        if self.slow > 0.0 { self.slow_max_ns } else { 0 }
    }
}

/// A node's monotonic clock. Fusion and its standbys share a host; each other node has one of its own.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LocalClock {
    /// Its seconds in a true second.
    pub(super) rate: f64,
    /// Its time at true time 0, ns.
    pub(super) ahead_ns: u64,
}

impl Default for LocalClock {
    fn default() -> Self {
        Self { rate: 1.0, ahead_ns: 0 }
    }
}

impl LocalClock {
    /// Its time at a true time, ns.
    pub(super) fn local_ns(self, now_ns: u64) -> u64 {
        self.ahead_ns + (now_ns as f64 * self.rate) as u64
    }

    /// The true time at which it shows this, ns; 0 before it started.
    pub(super) fn global_ns(self, local_ns: u64) -> u64 {
        (local_ns.saturating_sub(self.ahead_ns) as f64 / self.rate) as u64
    }
}

impl Plan {
    /// The plan of a seed.
    pub(super) fn new(seed: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let clock = if random.random_bool(0.6) { Clock::Lockstep } else { Clock::Realtime };
        // Mostly small teams: they are enough for most faults, and faster.
        let robots = if random.random_bool(0.8) { random.random_range(1..=4) } else { random.random_range(1..=20) };
        let standbys = random.random_range(0..=2);
        let nodes = 2 + standbys + robots;
        // A stream of its own, so that a seed has the faults that it had when all teams measured ranges.
        let mut later_random = ChaCha8Rng::seed_from_u64(!seed);
        let is_mixed = later_random.random_bool(0.2);
        let equipment = if is_mixed { Equipment::Mixed } else { Equipment::Ranges };
        let ticks = random.random_range(4..=16);
        let is_quiet = random.random_bool(0.3);
        let network = Network {
            loss: if is_quiet { 0.0 } else { random.random_range(0.0..0.3) },
            duplicates: if is_quiet { 0.0 } else { random.random_range(0.0..0.3) },
            slow: if is_quiet { 0.0 } else { random.random_range(0.0..0.3) },
            slow_max_ns: random.random_range(1_000_000..200_000_000),
            garbled: if is_quiet { 0.0 } else { random.random_range(0.0..0.1) },
            wakes_on_arrival: random.random_bool(0.5),
        };
        let mut clocks = vec![LocalClock::default(); nodes];
        for clock in &mut clocks {
            clock.rate = if is_quiet { 1.0 } else { random.random_range(0.995..1.005) };
            clock.ahead_ns = later_random.random_range(0..CLOCKS_APART_NS);
        }
        let fusion_ahead_ns = clocks[1].ahead_ns;
        clocks[1..2 + standbys].iter_mut().for_each(|clock| clock.ahead_ns = fusion_ahead_ns);
        // A tick of lock step takes some milliseconds, or the time until a repeat; one of real time takes its fixed
        // time.
        let span_ns = match clock {
            Clock::Lockstep => ticks * random.random_range(1_000_000..40_000_000),
            Clock::Realtime => (ticks + 1) * 100_000_000,
        };
        let is_endless = random.random_bool(0.7);
        let leaves_robots = (clock == Clock::Realtime || !is_endless) && random.random_bool(0.1);
        let measures_anew = random.random_bool(0.2);
        let faults = faults::draw(&mut random, Team { nodes, standbys, is_endless }, span_ns);
        // A broken node that waits out a time-out for a lost robot lives too long to be given up.
        let leaves_robots = leaves_robots && !faults.iter().any(Fault::is_break);
        let links = Links::draw(&mut later_random, robots, span_ns);
        Self {
            seed,
            clock,
            is_endless,
            robots,
            equipment,
            standbys,
            leaves_robots,
            measures_anew,
            ticks,
            network,
            clocks,
            faults,
            links,
        }
    }

    /// Number of nodes: sim, fusion, standbys, robots.
    pub(super) fn nodes(&self) -> usize {
        2 + self.standbys + self.robots
    }

    /// The robots' nodes.
    pub(super) fn robot_nodes(&self) -> Range<usize> {
        2 + self.standbys..self.nodes()
    }

    /// The nodes that can lead.
    pub(super) fn fusion_nodes(&self) -> Range<usize> {
        1..2 + self.standbys
    }

    /// All nodes: those that faults hit, and the gateway.
    pub(super) fn all_nodes(&self) -> Range<usize> {
        0..self.nodes() + usize::from(self.links.is_some())
    }

    /// A node's role.
    pub(super) fn role_of(&self, node: usize) -> Role {
        match node {
            node if node == self.gateway() => Role::Gateway,
            0 => Role::Sim,
            1 => Role::Fusion,
            node if node < 2 + self.standbys => Role::Standby(node - 1),
            node => Role::Robot(node - 2 - self.standbys),
        }
    }

    /// The gateway, which follows the other nodes, if there are robots on other hosts.
    pub(super) fn gateway(&self) -> usize {
        self.nodes()
    }

    /// The robots by id.
    pub(super) fn robot_ids(&self) -> Range<usize> {
        0..self.robots
    }

    /// True if a robot is on another host.
    pub(super) fn is_remote(&self, robot: usize) -> bool {
        self.links.as_ref().is_some_and(|links| links.has(robot))
    }

    /// True if a node is a robot on another host.
    pub(super) fn is_remote_node(&self, node: usize) -> bool {
        self.robot_nodes().contains(&node) && self.is_remote(node - self.robot_nodes().start)
    }

    /// The nodes of the robots on the run's host.
    pub(super) fn local_robot_nodes(&self) -> impl Iterator<Item = usize> + use<'_> {
        self.robot_nodes().filter(|node| !self.is_remote_node(*node))
    }

    /// The receivers of worlds and headings: the robots on the run's host, and the gateway of the others.
    pub(super) fn commanded(&self) -> impl Iterator<Item = usize> + use<'_> {
        self.local_robot_nodes().chain(self.links.as_ref().map(|_| self.gateway()))
    }

    /// A node's name.
    pub(super) fn name_of(&self, node: usize) -> String {
        self.role_of(node).to_string()
    }

    /// Time at which the last fault is over, ns.
    pub(super) fn calm_from_ns(&self) -> u64 {
        let links_ns = self.links.as_ref().map_or(0, Links::calm_from_ns);
        self.faults.iter().map(Fault::ends_ns).max().unwrap_or(0).max(links_ns)
    }

    /// True if all clocks run at one rate.
    pub(super) fn has_one_rate(&self) -> bool {
        self.clocks.iter().all(|clock| clock.rate == 1.0)
    }

    /// True if there are no faults, no message is lost, slow, doubled or garbled, and all clocks agree.
    pub(super) fn is_undisturbed(&self) -> bool {
        let Network { loss, duplicates, slow, garbled, .. } = self.network;
        let has_good_links = self.links.as_ref().is_none_or(Links::is_undisturbed);
        self.faults.is_empty() && has_good_links && [loss, duplicates, slow, garbled] == [0.0; 4] && self.has_one_rate()
    }
}
