//! The supervisor's decisions as a state machine: no process, port, clock, file or log line.
//!
//! A driver reports what it sees ([`Machine::look`], [`Machine::on_end`]), asks for the next [`Action`], carries it
//! out, and asks again until there is none. After [`Action::Start`] it calls [`Machine::on_start`] or
//! [`Machine::on_refusal`]. Time is an argument: monotonic, ns. A node's number is its place in the list of roles.

use std::collections::VecDeque;
use std::time::Duration;

use rangehound_node::rendezvous::Role;
use rangehound_shared::scenario::Scenario;

use super::deaths::{Deaths, End, Need, Next};
use super::restart::{Policies, Policy};
use super::silence::{self, Silence};

/// The driver's next action.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Action {
    /// Start the process of a node.
    Start(usize),
    /// Kill the process of a node: it hangs.
    Kill {
        /// The node.
        node: usize,
        /// It has sent no heartbeat for longer than this while others have.
        silence: Duration,
    },
    /// Report to the user that a node has ended and is started again.
    ReportRestart(usize),
    /// Report to the user that a node has ended and the others go on without it.
    ReportLoss(usize),
    /// End the run: it cannot go on without a node that has ended.
    EndRun {
        /// The node.
        node: usize,
        /// It ended by itself, and not because another process has its role.
        is_own: bool,
    },
}

/// The observed state of a node's process. `S` is a heartbeat, of which only changes matter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Seen<S> {
    /// Its newest heartbeat.
    pub(crate) heartbeat: Option<S>,
    /// True if it is the process that took the lead last.
    pub(crate) leads: bool,
}

/// The supervisor of a run.
#[derive(Debug)]
pub(crate) struct Machine<S> {
    nodes: Vec<Node<S>>,
    actions: VecDeque<Action>,
}

#[derive(Debug)]
struct Node<S> {
    role: Role,
    policy: Policy,
    life: Option<Life<S>>,
    /// The end of its last process, until it is decided what is done.
    death: Option<Death>,
    deaths: Deaths,
    restart_at_ns: Option<u64>,
}

/// A process that runs.
#[derive(Debug)]
struct Life<S> {
    since_ns: u64,
    silence: Silence<S>,
    has_led: bool,
    is_deposed: bool,
}

#[derive(Debug, Clone, Copy)]
struct Death {
    end: End,
    lived: Duration,
    is_taken: bool,
}

impl<S: PartialEq> Machine<S> {
    /// The supervisor of nodes with these roles, none of which has been started.
    pub(crate) fn new(roles: impl Iterator<Item = Role>, policies: &Policies) -> Self {
        let node = |role| Node {
            role,
            policy: policies.of(role),
            life: None,
            death: None,
            deaths: Deaths::default(),
            restart_at_ns: None,
        };
        Self { nodes: roles.map(node).collect(), actions: VecDeque::new() }
    }

    /// A node's process has been started.
    pub(crate) fn on_start(&mut self, node: usize, now_ns: u64) {
        let life = Life { since_ns: now_ns, silence: Silence::default(), has_led: false, is_deposed: false };
        self.nodes[node].life = Some(life);
    }

    /// The system has refused to start a node's process. False after too many refusals.
    #[must_use]
    pub(crate) fn on_refusal(&mut self, node: usize, now_ns: u64) -> bool {
        let node = &mut self.nodes[node];
        node.restart_at_ns = node.deaths.after_failed_start().map(|wait| after(now_ns, wait));
        node.restart_at_ns.is_some()
    }

    /// A node's process has ended; `is_taken` means that another process has its role by now. The machine decides what
    /// is done once all ends that were seen together are reported.
    pub(crate) fn on_end(&mut self, node: usize, end: End, is_taken: bool, now_ns: u64) {
        let node = &mut self.nodes[node];
        let Some(life) = node.life.take() else { return };
        let lived = Duration::from_nanos(now_ns.saturating_sub(life.since_ns));
        node.death = Some(Death { end, lived, is_taken });
    }

    /// Looks at every running process, once every [`silence::POLL_INTERVAL`]. A process that has been silent for too long is
    /// killed, and then started again. A node that would not be started again is not killed: it may recover by itself.
    pub(crate) fn look(&mut self, scenario: &Scenario, mut see: impl FnMut(usize) -> Seen<S>) {
        let count = self.nodes.len();
        let mut has_any_heartbeat = false;
        for (index, node) in self.nodes.iter_mut().enumerate() {
            let Some(life) = &mut node.life else { continue };
            let Seen { heartbeat, leads } = see(index);
            life.has_led |= leads;
            life.is_deposed = life.has_led && !leads;
            has_any_heartbeat |= life.silence.hear(heartbeat);
        }
        if !has_any_heartbeat {
            return;
        }
        for (index, node) in self.nodes.iter_mut().enumerate() {
            let Some(life) = &mut node.life else { continue };
            life.silence.count();
            let limit = silence::limit(scenario, count, life.silence.has_started(), life.is_deposed);
            if let Some(limit) = limit
                && node.policy != Policy::Never
                && life.silence.is_longer_than(limit)
            {
                life.silence = Silence::default();
                self.actions.push_back(Action::Kill { node: index, silence: limit });
            }
        }
    }

    /// The next action; `None` until something happens or [`Self::wakes_at_ns`].
    pub(crate) fn next_action(&mut self, now_ns: u64) -> Option<Action> {
        if let Some(action) = self.actions.pop_front() {
            return Some(action);
        }
        for index in 0..self.nodes.len() {
            if let Some(death) = self.nodes[index].death.take() {
                return Some(self.follow(index, death, now_ns));
            }
        }
        let due = self.nodes.iter().position(|node| node.restart_at_ns.is_some_and(|at_ns| at_ns <= now_ns))?;
        self.nodes[due].restart_at_ns = None;
        Some(Action::Start(due))
    }

    /// When it must act even if nothing happens, monotonic ns.
    pub(crate) fn wakes_at_ns(&self) -> Option<u64> {
        self.nodes.iter().filter_map(|node| node.restart_at_ns).min()
    }

    fn follow(&mut self, index: usize, death: Death, now_ns: u64) -> Action {
        let Death { end, lived, is_taken } = death;
        let need = self.need(index);
        let node = &mut self.nodes[index];
        match node.deaths.after(end, lived, node.policy, is_taken, need) {
            Next::StartAgain(wait) => {
                node.restart_at_ns = Some(after(now_ns, wait));
                Action::ReportRestart(index)
            }
            Next::GoOnWithout => Action::ReportLoss(index),
            Next::EndRun => Action::EndRun { node: index, is_own: end != End::Killed && !is_taken },
        }
    }

    /// How much the run needs a node that has ended.
    fn need(&self, index: usize) -> Need {
        let can_lead = |role| matches!(role, Role::Fusion | Role::Standby(_));
        let role = self.nodes[index].role;
        match role {
            Role::Robot(_) => Need::Can,
            Role::Gateway => Need::Spare,
            role if can_lead(role) && self.nodes.iter().any(|node| can_lead(node.role) && node.life.is_some()) => {
                Need::Spare
            }
            _ => Need::Cannot,
        }
    }
}

fn after(now_ns: u64, wait: Duration) -> u64 {
    now_ns.saturating_add(wait.as_nanos() as u64)
}

#[cfg(test)]
mod tests {
    use rangehound_shared::scenario::ScenarioFile;

    use super::*;

    fn scenario(timeout: &str) -> Scenario {
        let file = ScenarioFile::parse(&format!("timeout_s = {timeout}\n[robots]\ncount = 1\n"), "test").unwrap();
        Scenario::from_file(&file, "test").unwrap()
    }

    /// sim, fusion, standby-1 and robot-0, all running.
    fn machine(rules: &[&str]) -> Machine<u64> {
        let rules: Vec<_> = rules.iter().map(|rule| rule.parse().unwrap()).collect();
        let roles = [Role::Sim, Role::Fusion, Role::Standby(1), Role::Robot(0)];
        let mut machine = Machine::new(roles.into_iter(), &Policies::new(&rules));
        (0..roles.len()).for_each(|node| machine.on_start(node, 0));
        machine
    }

    fn actions(machine: &mut Machine<u64>, now_ns: u64) -> Vec<Action> {
        std::iter::from_fn(|| machine.next_action(now_ns)).collect()
    }

    #[test]
    fn a_node_that_ended_is_reported_and_started_again() {
        let mut machine = machine(&[]);
        machine.on_end(0, End::Killed, false, 10);
        assert_eq!(actions(&mut machine, 10), [Action::ReportRestart(0), Action::Start(0)]);
        machine.on_start(0, 20);
        // The second restart in a row waits.
        machine.on_end(0, End::Killed, false, 30);
        assert_eq!(actions(&mut machine, 30), [Action::ReportRestart(0)]);
        let at_ns = machine.wakes_at_ns().unwrap();
        assert_eq!((actions(&mut machine, at_ns), machine.wakes_at_ns()), (vec![Action::Start(0)], None));
        assert!(machine.on_refusal(0, at_ns) && machine.wakes_at_ns().unwrap() > at_ns);
    }

    #[test]
    fn all_but_one_of_the_fusion_nodes_are_spare_even_if_they_end_together() {
        let mut machine = machine(&["never"]);
        machine.on_end(1, End::Failed, false, 10);
        assert_eq!(actions(&mut machine, 10), [Action::ReportLoss(1)]);
        machine.on_end(2, End::Failed, false, 20);
        assert_eq!(actions(&mut machine, 20), [Action::EndRun { node: 2, is_own: true }]);

        let mut machine = self::machine(&["never"]);
        machine.on_end(1, End::Killed, false, 10);
        machine.on_end(2, End::Killed, false, 10);
        assert_eq!(actions(&mut machine, 10)[0], Action::EndRun { node: 1, is_own: false });
    }

    #[test]
    fn a_hung_node_is_killed_if_it_is_replaced() {
        let limit = Duration::from_secs(1);
        for (rules, killed) in [(&[][..], vec![Action::Kill { node: 3, silence: limit }]), (&["robot=never"], vec![])] {
            let (mut machine, scenario) = (machine(rules), scenario("1.0"));
            for look in 0..13 {
                machine.look(&scenario, |node| Seen {
                    heartbeat: Some(if node == 3 { 0 } else { look }),
                    leads: node == 1,
                });
            }
            assert_eq!(actions(&mut machine, 0), killed, "{rules:?}");
        }
    }

    #[test]
    fn a_hung_deposed_fusion_is_killed_whatever_the_timeout() {
        let (mut machine, scenario) = (machine(&[]), scenario("\"forever\""));
        for look in 0..23 {
            machine.look(&scenario, |node| Seen {
                heartbeat: Some(if node == 1 { 0 } else { look }),
                leads: node == if look == 0 { 1 } else { 2 },
            });
        }
        assert_eq!(actions(&mut machine, 0), [Action::Kill { node: 1, silence: Duration::from_secs(2) }]);
    }
}
