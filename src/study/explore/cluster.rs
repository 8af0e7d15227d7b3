//! The whole team in one process on simulated time: what happens next, and who is told. All that is random comes from the
//! plan's seed.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::rc::Rc;

use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rangehound_shared::protocol::wake::Event;
use rangehound_shared::scenario::{Clock, Scenario};
use rangehound_shared::sealed::slots::Turns;

use super::disk::Disk;
use super::lead::Lead;
use super::network::{GroupState, Message};
use super::plan::Plan;
use super::process::{Node, Process};
use super::roles::sim::SIM;
use super::story::StoryLine;
use super::supervisor::Supervisor;
use super::witness::Witness;
use crate::run::supervisor::silence;

/// When the team is started: late enough for clocks that go wrong to have gone apart.
const START_NS: u64 = 1_000_000_000;

/// Time in which a run must end once faults have ceased, beside its ticks.
const CALM_NS: u64 = 60_000_000_000;

/// Most happenings without any time between.
const AT_ONCE_MAX: u32 = 100_000;

/// Time in which an undisturbed run in lock step ends: for the start, and for each tick.
const SMOOTH_START_NS: u64 = 40_000_000;
const SMOOTH_TICK_NS: u64 = 500_000;

/// What was seen to be wrong.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Violation {
    /// When, ns since the start.
    pub(super) at_ns: u64,
    /// The node, if it is one's.
    pub(super) node: Option<usize>,
    /// What.
    pub(super) what: String,
}

/// What an exploration went through.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Counts {
    /// Ticks, times the nodes that took part in them.
    pub(super) node_ticks: u64,
    /// Faults that took effect.
    pub(super) faults: u64,
    /// Times that another process took the lead.
    pub(super) successions: u64,
}

/// What happens at a time.
#[derive(Debug)]
pub(super) enum Happening {
    Arrives { to: usize, message: Message, is_garbled: bool },
    Wakes { node: usize, event: Option<Event> },
    Begins(usize),
    ComesUp { node: usize, life: u32 },
    Continues { node: usize, life: u32 },
    Heals(usize),
    Looks,
    Supervises,
    SupervisorContinues,
}

struct Due {
    at_ns: u64,
    order: u64,
    happening: Happening,
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

/// A team under exploration.
pub(super) struct Cluster<'a> {
    pub(super) plan: &'a Plan,
    pub(super) scenario: &'a Scenario,
    pub(super) random: ChaCha8Rng,
    pub(super) now_ns: u64,
    pub(super) calm_from_ns: u64,
    order: u64,
    /// Happenings without any time between.
    at_once: u32,
    due: BinaryHeap<Reverse<Due>>,
    pub(super) nodes: Vec<Node>,
    pub(super) partitions: Vec<(usize, u64)>,
    pub(super) sim_starts: u64,
    pub(super) lead: Lead,
    /// What is to become of those who take the lead, by fault.
    pub(super) heirs_dooms: Vec<usize>,
    pub(super) sim_disk: Disk,
    pub(super) sim_turns: Turns,
    /// Fusion's checkpoint files; the last one has the name.
    pub(super) disks: Vec<Disk>,
    /// By [`WaitGroup`](rangehound_shared::protocol::wake::WaitGroup).
    pub(super) groups: [GroupState; 3],
    pub(super) supervisor: Supervisor,
    pub(super) is_finished: bool,
    pub(super) witness: Witness,
    pub(super) counts: Counts,
    story: Option<Vec<StoryLine>>,
}

/// How an exploration ended.
pub(super) struct Outcome {
    /// What was wrong, if anything.
    pub(super) violation: Option<Violation>,
    /// What it went through.
    pub(super) counts: Counts,
    /// Its story, if that was asked for.
    pub(super) story: Vec<StoryLine>,
}

impl<'a> Cluster<'a> {
    /// A team before its start; `undisturbed` has the digests of a run to which nothing happens.
    pub(super) fn new(
        plan: &'a Plan,
        scenario: &'a Scenario,
        undisturbed: Rc<Vec<[u64; 2]>>,
        tells_story: bool,
    ) -> Self {
        Self {
            plan,
            scenario,
            random: ChaCha8Rng::seed_from_u64(!plan.seed),
            now_ns: START_NS,
            calm_from_ns: START_NS + plan.calm_from_ns(),
            order: 0,
            at_once: 0,
            due: BinaryHeap::new(),
            nodes: plan.clock_rates.iter().map(|clock_rate| Node::new(*clock_rate)).collect(),
            partitions: Vec::new(),
            sim_starts: 0,
            lead: Lead::default(),
            heirs_dooms: Vec::new(),
            sim_disk: Disk::default(),
            sim_turns: Turns::default(),
            disks: vec![Disk::default()],
            groups: [GroupState::default(); 3],
            supervisor: Supervisor::new(plan),
            is_finished: false,
            witness: Witness::new(scenario, undisturbed, plan),
            counts: Counts::default(),
            story: tells_story.then(Vec::new),
        }
    }

    /// Lets it go on to its end.
    pub(super) fn explore(mut self) -> Outcome {
        let violation = self.go_on().err();
        self.counts.node_ticks = (self.witness.last_estimate().unwrap_or(0) + 1) * self.nodes.len() as u64;
        Outcome { violation, counts: self.counts, story: self.story.unwrap_or_default() }
    }

    fn go_on(&mut self) -> Result<(), Violation> {
        self.start_all();
        for (index, fault) in self.plan.faults.iter().enumerate() {
            self.after(fault.at_ns, Happening::Begins(index));
        }
        let ends_ns = self.calm_from_ns + CALM_NS + self.plan.ticks * 2 * (self.scenario.dt_s * 1e9) as u64;
        while !self.has_ended() {
            let Some(Reverse(Due { at_ns, happening, .. })) = self.due.pop() else { break };
            self.at_once = if at_ns == self.now_ns { self.at_once + 1 } else { 0 };
            if self.at_once > AT_ONCE_MAX {
                return Err(self.violation(None, "time stands still".to_owned()));
            }
            self.now_ns = at_ns;
            if at_ns > ends_ns {
                let tick = self.witness.last_estimate().map_or(0, |tick| tick + 1);
                let what = format!("the run did not end once faults ceased: no estimate of tick {tick}");
                return Err(self.violation(None, what));
            }
            self.happen(happening)?;
        }
        self.check_smoothness()
    }

    /// The simulator has ended, and every tick has its estimate; or the supervisor has given up.
    fn has_ended(&self) -> bool {
        self.supervisor.has_given_up || self.is_finished && self.witness.last_estimate() == Some(self.plan.ticks)
    }

    /// To an undisturbed team nothing happens that a repeat or a look must mend.
    fn check_smoothness(&self) -> Result<(), Violation> {
        if !self.plan.is_undisturbed() {
            return Ok(());
        }
        let longest_ns = SMOOTH_START_NS + (self.plan.ticks + 1) * SMOOTH_TICK_NS;
        if self.plan.clock == Clock::Lockstep && self.now_ns - START_NS > longest_ns {
            return Err(self.violation(None, "an undisturbed run waited for repeats".to_owned()));
        }
        if !self.witness.is_complete() {
            return Err(self.violation(None, "in an undisturbed run somebody was missing".to_owned()));
        }
        Ok(())
    }

    fn happen(&mut self, happening: Happening) -> Result<(), Violation> {
        match happening {
            Happening::Arrives { to, message, is_garbled } => {
                let is_woken = self.arrive(to, message, is_garbled);
                if is_woken { self.run(to) } else { Ok(()) }
            }
            Happening::Wakes { node, event } => {
                if let (Some(Event::Hello), Process::Sim(machine)) = (event, &mut self.nodes[node].process) {
                    machine.on_hello();
                    self.witness.timing.hello_ns = self.now_ns;
                }
                if event.is_none() && self.nodes[node].wakes_at_ns != self.now_ns {
                    return Ok(());
                }
                self.run(node)
            }
            Happening::Begins(fault) => self.begin(fault),
            Happening::Heals(fault) => {
                self.partitions.retain(|(index, _)| *index != fault);
                self.tell(None, || "the network is whole again".to_owned());
                Ok(())
            }
            Happening::ComesUp { node, life } if self.nodes[node].life == life => self.come_up(node),
            Happening::Continues { node, life } if self.nodes[node].life == life => self.carry_on(node),
            Happening::ComesUp { .. } | Happening::Continues { .. } => Ok(()),
            Happening::Looks => {
                self.after(silence::LOOK.as_nanos() as u64, Happening::Looks);
                self.look_for_signs()
            }
            Happening::Supervises => self.supervise(),
            Happening::SupervisorContinues => self.continue_supervisor(),
        }
    }

    /// A process comes up and takes its role.
    fn come_up(&mut self, node: usize) -> Result<(), Violation> {
        self.tell(Some(node), || "starts".to_owned());
        let process = if node == SIM {
            self.start_sim()?
        } else if self.plan.fusion_nodes().contains(&node) {
            self.start_fusion(node)
        } else {
            self.start_robot(node)
        };
        let now_ns = self.now_ns;
        self.nodes[node].come_up(process, now_ns);
        self.run(node)
    }

    /// Something happens after a time.
    pub(super) fn after(&mut self, after_ns: u64, happening: Happening) {
        self.order += 1;
        self.due.push(Reverse(Due { at_ns: self.now_ns + after_ns, order: self.order, happening }));
    }

    /// What is wrong, now.
    pub(super) fn violation(&self, node: Option<usize>, what: String) -> Violation {
        Violation { at_ns: self.now_ns - START_NS, node, what }
    }

    /// Tells a line of the story, if it is told.
    pub(super) fn tell(&mut self, node: Option<usize>, what: impl FnOnce() -> String) {
        if let Some(story) = &mut self.story {
            story.push(StoryLine { at_ns: self.now_ns - START_NS, node, what: what() });
        }
    }
}
