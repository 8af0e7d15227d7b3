//! The whole team in one process on simulated time: handles events in order. All randomness comes from the plan's seed.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::rc::Rc;

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rangehound_shared::protocol::wake::{Answers, Event};
use rangehound_shared::scenario::{Clock, Scenario};
use rangehound_shared::sealed::slots::SlotWriter;

use super::checker::Checker;
use super::disk::Disk;
use super::gateway::Gateway;
use super::lead::Lead;
use super::message::Message;
use super::node::{Node, Process};
use super::plan::{Plan, SIM};
use super::supervisor::Supervisor;
use super::trace::TraceLine;

/// Time at which the team is started: late enough for clocks of different rates to have diverged.
const START_NS: u64 = 1_000_000_000;

/// Time within which a run must end after the last fault, in addition to its ticks.
const CALM_NS: u64 = 60_000_000_000;

/// Most events at one time.
const AT_ONCE_MAX: u32 = 100_000;

/// Time within which an undisturbed run in lock step ends: for the start, and for each tick.
const SMOOTH_START_NS: u64 = 40_000_000;
const SMOOTH_TICK_NS: u64 = 500_000;

/// The additional time for the start if robots are on other hosts: they may ask for a gateway that has not started, ns.
const SMOOTH_JOIN_NS: u64 = 120_000_000;

/// A broken invariant.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Violation {
    /// When, ns since the start.
    pub(super) at_ns: u64,
    /// The node that broke it, if any.
    pub(super) node: Option<usize>,
    /// Description.
    pub(super) what: String,
}

/// Counts of an exploration.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Counts {
    /// Ticks times nodes.
    pub(super) node_ticks: u64,
    /// Faults that took effect.
    pub(super) faults: u64,
    /// How often another process took the lead.
    pub(super) successions: u64,
}

/// An event in simulated time.
#[derive(Debug)]
pub(super) enum SimEvent {
    Arrival { to: usize, message: Message, is_garbled: bool },
    Wakes { node: usize, event: Option<Event> },
    FaultBegins(usize),
    ProcessStarts { node: usize, life: u32 },
    ProcessContinues { node: usize, life: u32 },
    PartitionEnds(usize),
    GatewayKillBegins(usize),
    GatewayStops(usize),
    Reboots(usize),
    CutBegins(usize),
    SupervisorLooks,
    SupervisorActs,
    SupervisorContinues,
}

struct Due {
    at_ns: u64,
    order: u64,
    sim_event: SimEvent,
}

impl PartialEq for Due {
    fn eq(&self, other: &Self) -> bool {
        (self.at_ns, self.order) == (other.at_ns, other.order)
    }
}

impl Eq for Due {}

impl PartialOrd for Due {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Due {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        (self.at_ns, self.order).cmp(&(other.at_ns, other.order))
    }
}

/// One wait group: how many answers it waits for, and how many have come.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct GroupState {
    pub(super) expected: usize,
    pub(super) answers: Answers,
}

/// A team under exploration.
pub(super) struct Cluster<'a> {
    pub(super) plan: &'a Plan,
    pub(super) scenario: &'a Scenario,
    pub(super) random: ChaCha8Rng,
    pub(super) now_ns: u64,
    pub(super) calm_from_ns: u64,
    order: u64,
    /// Events at the present time.
    events_at_once: u32,
    due: BinaryHeap<Reverse<Due>>,
    pub(super) nodes: Vec<Node>,
    pub(super) partitions: Vec<(usize, u64)>,
    pub(super) sim_starts: u64,
    pub(super) lead: Lead,
    /// Faults of processes that will take the lead.
    pub(super) successor_faults: Vec<usize>,
    pub(super) sim_disk: Disk,
    pub(super) sim_writer: SlotWriter,
    /// Fusion's checkpoint files; the last one is the one with the name.
    pub(super) disks: Vec<Disk>,
    /// By [`WaitGroup`](rangehound_shared::protocol::wake::WaitGroup).
    pub(super) groups: [GroupState; 3],
    pub(super) supervisor: Supervisor,
    pub(super) gateway: Gateway,
    /// How often the run was resumed.
    pub(super) incarnation: u64,
    pub(super) is_finished: bool,
    pub(super) checker: Checker,
    pub(super) counts: Counts,
    trace: Option<Vec<TraceLine>>,
}

/// How an exploration ended.
pub(super) struct Outcome {
    /// The broken invariant, if any.
    pub(super) violation: Option<Violation>,
    /// Its counts.
    pub(super) counts: Counts,
    /// Its trace, if it was kept.
    pub(super) trace: Vec<TraceLine>,
}

impl<'a> Cluster<'a> {
    /// A team before its start; `undisturbed` has the digests of a run without faults.
    pub(super) fn new(
        plan: &'a Plan,
        scenario: &'a Scenario,
        undisturbed: Rc<Vec<[u64; 2]>>,
        keeps_trace: bool,
    ) -> Self {
        Self {
            plan,
            scenario,
            random: ChaCha8Rng::seed_from_u64(!plan.seed),
            now_ns: START_NS,
            calm_from_ns: START_NS + plan.calm_from_ns(),
            order: 0,
            events_at_once: 0,
            due: BinaryHeap::new(),
            nodes: plan.all_nodes().map(|node| Node::new(plan.clocks.get(node).copied().unwrap_or_default())).collect(),
            partitions: Vec::new(),
            sim_starts: 0,
            lead: Lead::default(),
            successor_faults: Vec::new(),
            sim_disk: Disk::default(),
            sim_writer: SlotWriter::default(),
            disks: vec![Disk::default()],
            groups: [GroupState::default(); 3],
            supervisor: Supervisor::new(plan),
            gateway: Gateway::default(),
            incarnation: 0,
            is_finished: false,
            checker: Checker::new(scenario, undisturbed, plan),
            counts: Counts::default(),
            trace: keeps_trace.then(Vec::new),
        }
    }

    /// Runs the team to its end.
    pub(super) fn explore(mut self) -> Outcome {
        let violation = self.go_on().err();
        self.counts.node_ticks = (self.checker.last_estimate().unwrap_or(0) + 1) * self.plan.nodes() as u64;
        Outcome { violation, counts: self.counts, trace: self.trace.unwrap_or_default() }
    }

    fn go_on(&mut self) -> Result<(), Violation> {
        self.start_all();
        self.start_links();
        for (index, fault) in self.plan.faults.iter().enumerate() {
            self.after(fault.at_ns, SimEvent::FaultBegins(index));
        }
        let ends_ns = self.calm_from_ns + CALM_NS + self.plan.ticks * 2 * (self.scenario.dt_s * 1e9) as u64;
        while !self.has_ended() {
            let Some(Reverse(Due { at_ns, sim_event, .. })) = self.due.pop() else { break };
            self.events_at_once = if at_ns == self.now_ns { self.events_at_once + 1 } else { 0 };
            if self.events_at_once > AT_ONCE_MAX {
                return Err(self.violation(None, "simulated time does not advance".to_owned()));
            }
            self.now_ns = at_ns;
            if at_ns > ends_ns {
                let tick = self.checker.last_estimate().map_or(0, |tick| tick + 1);
                let what = format!("the run did not end once faults ceased: no estimate of tick {tick}");
                return Err(self.violation(None, what));
            }
            self.handle(sim_event)?;
        }
        self.check_smoothness()
    }

    /// True if the simulator has ended and every tick has its estimate, or if the supervisor has given up.
    fn has_ended(&self) -> bool {
        self.supervisor.has_given_up || self.is_finished && self.checker.last_estimate() == Some(self.plan.ticks)
    }

    /// An undisturbed team never depends on a repeat or a time-out.
    fn check_smoothness(&self) -> Result<(), Violation> {
        if !self.plan.is_undisturbed() {
            return Ok(());
        }
        let join_ns = if self.plan.links.is_some() { SMOOTH_JOIN_NS } else { 0 };
        let longest_ns = SMOOTH_START_NS + join_ns + (self.plan.ticks + 1) * SMOOTH_TICK_NS;
        if self.plan.clock == Clock::Lockstep && self.now_ns - START_NS > longest_ns {
            return Err(self.violation(None, "an undisturbed run waited for repeats".to_owned()));
        }
        if !self.checker.is_complete() {
            return Err(self.violation(None, "in an undisturbed run a robot was missing".to_owned()));
        }
        Ok(())
    }

    fn handle(&mut self, sim_event: SimEvent) -> Result<(), Violation> {
        match sim_event {
            SimEvent::Arrival { to, message, is_garbled } => {
                if self.arrive(to, message, is_garbled) {
                    self.run(to)
                } else {
                    Ok(())
                }
            }
            SimEvent::Wakes { node, event } => {
                if let (Some(Event::Hello), Process::Sim(machine)) = (event, &mut self.nodes[node].process) {
                    machine.on_hello();
                    self.checker.timing.hello_ns = self.now_ns;
                }
                if event.is_none() && self.nodes[node].wakes_at_ns != self.now_ns {
                    return Ok(());
                }
                self.run(node)
            }
            SimEvent::FaultBegins(fault) => self.begin(fault),
            SimEvent::PartitionEnds(fault) => {
                self.partitions.retain(|(index, _)| *index != fault);
                self.trace(None, || "the network is connected again".to_owned());
                Ok(())
            }
            SimEvent::ProcessStarts { node, life } if self.nodes[node].life == life => self.start_process(node),
            SimEvent::ProcessContinues { node, life } if self.nodes[node].life == life => self.continue_process(node),
            SimEvent::ProcessStarts { .. } | SimEvent::ProcessContinues { .. } => Ok(()),
            SimEvent::GatewayStops(stop) => {
                self.stop_gateway(stop);
                Ok(())
            }
            SimEvent::GatewayKillBegins(kill) => {
                self.begin_gateway_kill(kill);
                Ok(())
            }
            SimEvent::Reboots(reboot) => {
                self.reboot(reboot);
                Ok(())
            }
            SimEvent::CutBegins(cut) => {
                self.begin_cut(cut);
                Ok(())
            }
            SimEvent::SupervisorLooks => self.look_when_due(),
            SimEvent::SupervisorActs => self.supervise(),
            SimEvent::SupervisorContinues => self.continue_supervisor(),
        }
    }

    /// A process starts and takes its role.
    fn start_process(&mut self, node: usize) -> Result<(), Violation> {
        self.trace(Some(node), || "starts".to_owned());
        let process = if node == SIM {
            self.start_sim()?
        } else if self.plan.fusion_nodes().contains(&node) {
            self.start_fusion(node)
        } else if node == self.plan.gateway() {
            Process::Gateway
        } else {
            self.start_robot(node)
        };
        let now_ns = self.now_ns;
        self.nodes[node].start_process(process, now_ns);
        self.run(node)
    }

    /// Schedules an event.
    pub(super) fn after(&mut self, after_ns: u64, sim_event: SimEvent) {
        self.order += 1;
        self.due.push(Reverse(Due { at_ns: self.now_ns + after_ns, order: self.order, sim_event }));
    }

    /// Messages on the run's host that are under way are lost.
    pub(super) fn forget_messages(&mut self) {
        self.due
            .retain(|Reverse(due)| !matches!(&due.sim_event, SimEvent::Arrival { message, .. } if !message.is_frame()));
    }

    /// Time since the start, ns.
    pub(super) fn since_start_ns(&self) -> u64 {
        self.now_ns - START_NS
    }

    /// A violation at the present time.
    pub(super) fn violation(&self, node: Option<usize>, what: String) -> Violation {
        Violation { at_ns: self.now_ns - START_NS, node, what }
    }

    /// Adds a line to the trace, if one is kept.
    pub(super) fn trace(&mut self, node: Option<usize>, what: impl FnOnce() -> String) {
        if let Some(trace) = &mut self.trace {
            trace.push(TraceLine { at_ns: self.now_ns - START_NS, node, what: what() });
        }
    }
}
