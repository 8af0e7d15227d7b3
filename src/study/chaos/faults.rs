//! The faults of a campaign, as a pure function of its seed.

use std::time::Duration;

use rangehound_node::rendezvous::Role;
use rangehound_shared::draws::{Draws, Stream};
use serde::Serialize;

use crate::study::hosts::link::Conditions;

/// A kind of fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// One node is killed.
    Kill,
    /// One node is stopped for a while.
    Stop,
    /// One node is killed, and its successors during their start.
    CrashLoop,
    /// Several nodes are killed at once.
    Several,
    /// All processes are killed at once, including the supervisor, and the run is resumed.
    TotalOutage,
    /// The link of a host is cut for a while.
    Cut,
    /// The link of a host loses all packets in one direction for a while.
    OneWay,
    /// A host loses its robots and its network, and starts again after a while.
    Reboot,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 8] = [
        Self::Kill,
        Self::Stop,
        Self::CrashLoop,
        Self::Several,
        Self::TotalOutage,
        Self::Cut,
        Self::OneWay,
        Self::Reboot,
    ];

    /// True if it hits a host, and not a process.
    #[must_use]
    pub fn is_of_hosts(self) -> bool {
        matches!(self, Self::Cut | Self::OneWay | Self::Reboot)
    }
}

/// The target of a fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Target {
    /// The process in a role.
    Node(Role),
    /// A robots' host, by its number.
    Host(usize),
}

impl std::fmt::Display for Target {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Node(role) => role.fmt(f),
            Self::Host(host) => write!(f, "host-{host}"),
        }
    }
}

/// A kind of node that faults hit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Victim {
    /// The simulator.
    Sim,
    /// The leading fusion.
    Fusion,
    /// Any robot.
    Robot,
    /// Any standby fusion.
    Standby,
    /// The gateway to robots on other hosts.
    Gateway,
}

impl Victim {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Sim, Self::Fusion, Self::Robot, Self::Standby, Self::Gateway];
}

/// A team on several hosts.
#[derive(Debug, Clone, Copy)]
pub struct OnHosts {
    /// Number of hosts, the run's included.
    pub count: usize,
    /// The permanent conditions of their links.
    pub conditions: Conditions,
    /// Longest time for which a link is cut or a host is down, s.
    pub longest_cut_s: f64,
}

/// The parameters of a campaign.
#[derive(Debug, Clone)]
pub struct Asked {
    /// Number of faults.
    pub faults: u64,
    /// Their kinds; `None` for all that are possible, without total outage unless simulator, fusion and robots are to be hit.
    pub kinds: Option<Vec<Kind>>,
    /// The kinds of nodes to hit.
    pub victims: Vec<Victim>,
    /// Standby fusions in its runs.
    pub standbys: usize,
    /// Longest stop, s.
    pub longest_stop_s: f64,
    /// Mean faults per second.
    pub rate_per_s: f64,
    /// Seed of the faults.
    pub seed: u64,
    /// The hosts, if there are several.
    pub hosts: Option<OnHosts>,
}

/// One fault.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct PlannedFault {
    /// Time since the previous fault.
    pub(super) gap: Duration,
    /// The kind.
    pub(super) kind: Kind,
    /// The target: one, except for [`Kind::Several`]; unused for [`Kind::TotalOutage`].
    pub(super) targets: Vec<Target>,
    /// How long a stop, a cut or a reboot lasts.
    pub(super) lasts: Duration,
    /// The direction of a cut in one direction: true if packets from the host are lost.
    pub(super) is_up: bool,
    /// Number of kills of a crash loop.
    pub(super) kills: u32,
}

/// The faults of a seed: each depends on its number, not on the faults before.
#[derive(Debug, Clone)]
pub(super) struct Faults {
    draws: Draws,
    kinds: Vec<Kind>,
    /// Chosen by kind of node, so that the simulator is hit in a large team too.
    nodes: Vec<Vec<Target>>,
    hosts: Vec<Target>,
    rate_per_s: f64,
    longest_stop_s: f64,
    longest_cut_s: f64,
}

/// Shortest stop, s.
pub const STOP_MIN_S: f64 = 0.010;

/// Uniform numbers that a fault uses before those that choose among several nodes.
const FIXED_DRAWS: usize = 5;

impl Faults {
    /// The requested faults, for a team of this many robots.
    pub(super) fn new(asked: &Asked, robots: usize) -> Self {
        let hits_all = [Victim::Sim, Victim::Fusion, Victim::Robot].iter().all(|victim| asked.victims.contains(victim));
        let is_asked = |kind: &Kind| match &asked.kinds {
            Some(kinds) => kinds.contains(kind),
            None => (*kind != Kind::TotalOutage || hits_all) && (!kind.is_of_hosts() || asked.hosts.is_some()),
        };
        let nodes_of = |victim: Victim| match victim {
            Victim::Sim => vec![Target::Node(Role::Sim)],
            Victim::Fusion => vec![Target::Node(Role::Fusion)],
            Victim::Robot => (0..robots).map(|robot| Target::Node(Role::Robot(robot))).collect(),
            Victim::Standby => (1..=asked.standbys).map(|number| Target::Node(Role::Standby(number))).collect(),
            Victim::Gateway => vec![Target::Node(Role::Gateway)],
        };
        Self {
            draws: Draws::new(asked.seed, Stream::Faults),
            kinds: Kind::ALL.into_iter().filter(is_asked).collect(),
            nodes: Victim::ALL.into_iter().filter(|victim| asked.victims.contains(victim)).map(nodes_of).collect(),
            hosts: asked.hosts.iter().flat_map(|hosts| (1..hosts.count).map(Target::Host)).collect(),
            rate_per_s: asked.rate_per_s,
            longest_stop_s: asked.longest_stop_s,
            longest_cut_s: asked.hosts.map_or(0.0, |hosts| hosts.longest_cut_s),
        }
    }

    /// The fault of this number.
    pub(super) fn at(&mut self, index: u64) -> PlannedFault {
        let all: Vec<Target> = self.nodes.concat();
        let mut uniform = vec![0.0; FIXED_DRAWS + all.len()];
        self.draws.uniform(index, &mut uniform);
        let (fixed, by_node) = uniform.split_at(FIXED_DRAWS);
        let kind = self.kinds[below(self.kinds.len(), fixed[1])];
        let targets = if kind == Kind::Several {
            let at_least = all.len().min(2);
            let count = at_least + below(all.len() - at_least + 1, fixed[2]);
            let mut order: Vec<(Target, f64)> = all.into_iter().zip(by_node.iter().copied()).collect();
            order.sort_by(|a, b| a.1.total_cmp(&b.1));
            order.into_iter().take(count).map(|(target, _)| target).collect()
        } else {
            let targets = match kind.is_of_hosts() {
                true => &self.hosts,
                false => &self.nodes[below(self.nodes.len(), fixed[2])],
            };
            vec![targets[below(targets.len(), fixed[3])]]
        };
        let longest_s = if kind.is_of_hosts() { self.longest_cut_s } else { self.longest_stop_s };
        PlannedFault {
            // The draw is below 1, so this is at most 37 times the mean.
            gap: Duration::from_secs_f64(-(1.0 - fixed[0]).ln() / self.rate_per_s),
            kind,
            targets,
            lasts: Duration::from_secs_f64(STOP_MIN_S + (longest_s - STOP_MIN_S) * fixed[4]),
            // A draw that no fault of hosts uses otherwise.
            is_up: fixed[2] < 0.5,
            kills: 3 + below(3, fixed[4]) as u32,
        }
    }
}

/// An index below `count` from a uniform draw.
fn below(count: usize, uniform: f64) -> usize {
    ((uniform * count as f64) as usize).min(count.saturating_sub(1))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The parameters of a campaign with faults of all kinds, after `change`.
    fn asked(change: impl Fn(&mut Asked)) -> Asked {
        let mut asked = Asked {
            faults: 50,
            kinds: None,
            victims: vec![Victim::Sim, Victim::Fusion, Victim::Robot],
            standbys: 0,
            longest_stop_s: 0.5,
            rate_per_s: 10.0,
            seed: 1,
            hosts: None,
        };
        change(&mut asked);
        asked
    }

    fn faults(robots: usize, change: impl Fn(&mut Asked)) -> Vec<PlannedFault> {
        let mut faults = Faults::new(&asked(change), robots);
        (0..2_000).map(|index| faults.at(index)).collect()
    }

    #[test]
    fn the_seed_decides_the_faults() {
        assert_eq!(faults(3, |_| ()), faults(3, |_| ()));
        assert_ne!(faults(3, |_| ()), faults(3, |asked| asked.seed = 2));
    }

    #[test]
    fn gaps_have_the_mean_that_the_rate_asks_for() {
        let mean_s = |rate_per_s| {
            let faults = faults(3, |asked| asked.rate_per_s = rate_per_s);
            faults.iter().map(|fault| fault.gap.as_secs_f64()).sum::<f64>() / 2_000.0
        };
        assert!((mean_s(10.0) - 0.1).abs() < 0.01);
        assert!((mean_s(100.0) - 0.01).abs() < 0.001);
    }

    #[test]
    fn every_kind_hits_every_role_and_nobody_else() {
        let all = faults(2, |_| ());
        for kind in Kind::ALL.into_iter().filter(|kind| !kind.is_of_hosts()) {
            for role in [Role::Sim, Role::Fusion, Role::Robot(0), Role::Robot(1)].map(Target::Node) {
                assert!(all.iter().any(|fault| fault.kind == kind && fault.targets.contains(&role)), "{kind:?} {role}");
            }
        }
        assert!(all.iter().all(|fault| (3..=5).contains(&fault.kills)));
        assert!(all.iter().all(|fault| fault.lasts.as_millis() >= 10 && fault.lasts.as_millis() <= 500));
        let without_fusion = faults(2, |asked| asked.victims = vec![Victim::Sim, Victim::Robot]);
        assert!(without_fusion.iter().all(|fault| fault.kind != Kind::TotalOutage));
        let standbys = faults(2, |asked| (asked.victims, asked.standbys) = (vec![Victim::Standby], 2));
        assert!(standbys.iter().any(|fault| fault.targets == [Target::Node(Role::Standby(2))]));
        let only = faults(256, |asked| {
            asked.kinds = Some(vec![Kind::Kill, Kind::Stop]);
            asked.victims = vec![Victim::Robot];
        });
        assert!(only.iter().all(|fault| matches!(fault.kind, Kind::Kill | Kind::Stop)));
        assert!(only.iter().all(|fault| matches!(fault.targets[..], [Target::Node(Role::Robot(_))])));
    }

    #[test]
    fn a_fault_of_several_nodes_hits_at_least_two_different_ones() {
        for fault in faults(3, |asked| asked.kinds = Some(vec![Kind::Several])) {
            let mut targets = fault.targets.clone();
            targets.sort();
            targets.dedup();
            assert!(targets.len() == fault.targets.len() && (2..=5).contains(&targets.len()), "{fault:?}");
        }
        let one = faults(3, |asked| (asked.kinds, asked.victims) = (Some(vec![Kind::Several]), vec![Victim::Sim]));
        assert!(one.iter().all(|fault| fault.targets == [Target::Node(Role::Sim)]));
    }
    #[test]
    fn with_several_hosts_links_are_cut_and_hosts_restart_for_the_time_asked() {
        let conditions = Conditions::GOOD;
        let all = faults(4, |asked| {
            asked.hosts = Some(OnHosts { count: 3, conditions, longest_cut_s: 2.0 });
            asked.victims = vec![Victim::Sim, Victim::Fusion, Victim::Robot, Victim::Gateway];
        });
        for kind in [Kind::Cut, Kind::OneWay, Kind::Reboot] {
            let of_kind = || all.iter().filter(|fault| fault.kind == kind);
            assert!(
                [1, 2].into_iter().all(|host| of_kind().any(|fault| fault.targets == [Target::Host(host)])),
                "{kind:?}"
            );
            assert!(of_kind().all(|fault| matches!(fault.targets[..], [Target::Host(1 | 2)])), "{kind:?}");
            assert!(of_kind().all(|fault| fault.lasts.as_millis() >= 10 && fault.lasts.as_secs_f64() <= 2.0));
            assert!(of_kind().any(|fault| fault.lasts.as_secs_f64() > 1.5), "{kind:?}");
        }
        let one_way = || all.iter().filter(|fault| fault.kind == Kind::OneWay);
        assert!(one_way().any(|fault| fault.is_up) && one_way().any(|fault| !fault.is_up));
        assert!(all.iter().any(|fault| fault.kind == Kind::Kill && fault.targets == [Target::Node(Role::Gateway)]));
        let stops = all.iter().filter(|fault| fault.kind == Kind::Stop);
        assert!(stops.clone().count() > 0 && stops.clone().all(|fault| fault.lasts.as_millis() <= 500));
    }
}
