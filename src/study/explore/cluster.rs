//! The whole team in one process on simulated time: the roles' machines, a bus that loses and delays, disks that
//! are torn, and the supervisor's decisions. All that is random comes from the plan's seed.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::rc::Rc;

use rand::RngExt as _;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rangehound_fusion::leader::{self, Leader, Notice};
use rangehound_fusion::standby::{self, Standby};
use rangehound_node::world::world_of;
use rangehound_robot::machine as robot;
use rangehound_robot::sensor::{Sensor, measure};
use rangehound_shared::message::{Command, Drive, Header, Outgoing, Range, WorldEntry};
use rangehound_shared::protocol::wake::{Call, Notification, Sleeper, When};
use rangehound_shared::scenario::{Clock, Scenario};
use rangehound_sim::machine as sim;

use super::disk::Disk;
use super::plan::{FaultKind, Plan};
use super::witness::{RobotWitness, Witness};
use crate::run::supervisor::silence::{self, Silence};

/// Node of the simulator, and of the fusion centre that is started as such.
const SIM: usize = 0;
const FUSION: usize = 1;

/// When the team is started: late enough for clocks that go wrong to have gone apart.
const START_NS: u64 = 1_000_000_000;

/// A process looks at everything once in so long, called or not.
const IDLE_NS: u64 = 100_000_000;

/// What a message takes at least, and what a wake-up takes.
const MESSAGE_NS: u64 = 2_000;
const WAKE_NS: u64 = 5_000;

/// Messages that wait for a process; the newest displace the oldest.
const INBOX: usize = 64;

/// How late a node that runs may see a deadline pass.
const LATE_NS: u64 = 1_000_000;

/// Longest time that the supervisor takes to start a node again which has ended by itself.
const RESTART_NS: u64 = 10_000_000;

/// Time in which a run must end once faults have ceased, beside its ticks.
const CALM_NS: u64 = 60_000_000_000;

/// What was seen to be wrong.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Violation {
    /// When, ns since the start.
    pub(super) at_ns: u64,
    /// The node.
    pub(super) node: usize,
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

/// A line of a story.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Event {
    /// When, ns since the start.
    pub(super) at_ns: u64,
    /// The node.
    pub(super) node: usize,
    /// What it did, or what was done to it.
    pub(super) what: String,
}

#[derive(Debug, Clone)]
enum Message {
    World(Header, Rc<[WorldEntry]>),
    Range(Header, Range),
    Heading(Header, Rc<[Command]>),
    Drive(u64, Drive),
}

#[derive(Debug)]
enum Happening {
    Arrives { to: usize, message: Message },
    Wakes { node: usize, call: Option<Call> },
    Begins(usize),
    Starts { node: usize, life: u32 },
    Continues { node: usize, life: u32 },
    Heals(usize),
    Supervises,
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

/// What runs on a node.
enum Process {
    None,
    Sim(Box<sim::Machine>),
    Leader(Box<Leader>, Lead),
    Standby(Standby<u64>),
    Robot(Box<robot::Machine>, Box<Sensor>, RobotWitness),
}

/// What a process that leads holds.
#[derive(Debug, Clone, Copy)]
struct Lead {
    incarnation: u64,
    /// Its checkpoint file.
    disk: usize,
    /// When the first range of a tick came, by its own clock, if neither it nor the simulator was stopped since.
    first_range: Option<(u64, u64)>,
}

struct Node {
    clock_rate: f64,
    process: Process,
    /// Counts its processes.
    life: u32,
    is_stopped: bool,
    /// It was stopped between two actions: as a process does, it does what it has to do before it looks at what has come.
    is_interrupted: bool,
    /// What becomes of it after some more actions.
    doom: Option<Doom>,
    inbox: Vec<Message>,
    wakes_at_ns: u64,
    incarnation: u64,
    last_sign_ns: Option<u64>,
    silence: Silence<u64>,
}

#[derive(Debug, Clone, Copy)]
struct Doom {
    after_actions: u32,
    fault: usize,
}

/// Who leads, as the roster of a run knows it.
#[derive(Debug, Clone, Copy, Default)]
struct Roster {
    starts: u64,
    holder: Option<usize>,
    signed_ns: u64,
}

/// One group of sleepers: who waits for how many answers.
#[derive(Debug, Clone, Copy, Default)]
struct Words {
    expected: usize,
    tick: Option<u64>,
    answers: usize,
}

/// A team under exploration.
pub(super) struct Cluster<'a> {
    plan: &'a Plan,
    scenario: &'a Scenario,
    random: ChaCha8Rng,
    now_ns: u64,
    calm_from_ns: u64,
    order: u64,
    due: BinaryHeap<Reverse<Due>>,
    nodes: Vec<Node>,
    partitions: Vec<(usize, u64)>,
    sim_starts: u64,
    roster: Roster,
    sim_disk: Disk,
    disks: Vec<Disk>,
    words: [Words; 3],
    is_finished: bool,
    witness: Witness,
    counts: Counts,
    story: Option<Vec<Event>>,
}

/// How an exploration ended.
pub(super) struct Outcome {
    /// What was wrong, if anything.
    pub(super) violation: Option<Violation>,
    /// What it went through.
    pub(super) counts: Counts,
    /// Its story, if that was asked for.
    pub(super) story: Vec<Event>,
}

impl<'a> Cluster<'a> {
    /// A team before its start; `undisturbed` has the digests that it must come to.
    pub(super) fn new(
        plan: &'a Plan,
        scenario: &'a Scenario,
        undisturbed: Option<Rc<Vec<[u64; 2]>>>,
        tells_story: bool,
    ) -> Self {
        let nodes = plan.clock_rates.iter().map(|clock_rate| Node {
            clock_rate: *clock_rate,
            process: Process::None,
            life: 0,
            is_stopped: false,
            is_interrupted: false,
            doom: None,
            inbox: Vec::new(),
            wakes_at_ns: u64::MAX,
            incarnation: 0,
            last_sign_ns: None,
            silence: Silence::default(),
        });
        Self {
            plan,
            scenario,
            random: ChaCha8Rng::seed_from_u64(!plan.seed),
            now_ns: START_NS,
            calm_from_ns: START_NS + plan.calm_from_ns(),
            order: 0,
            due: BinaryHeap::new(),
            nodes: nodes.collect(),
            partitions: Vec::new(),
            sim_starts: 0,
            roster: Roster::default(),
            sim_disk: Disk::default(),
            disks: vec![Disk::default()],
            words: [Words::default(); 3],
            is_finished: false,
            witness: Witness::new(undisturbed),
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
        for node in 0..self.nodes.len() {
            let late_ns = self.random.random_range(0..20_000_000);
            self.after(late_ns, Happening::Starts { node, life: 0 });
        }
        for (index, fault) in self.plan.faults.iter().enumerate() {
            self.after(fault.at_ns, Happening::Begins(index));
        }
        self.after(silence::LOOK.as_nanos() as u64, Happening::Supervises);
        let ends_ns = self.calm_from_ns + CALM_NS + self.plan.ticks * 2 * (self.scenario.dt_s * 1e9) as u64;
        while !self.has_ended() {
            let Some(Reverse(Due { at_ns, happening, .. })) = self.due.pop() else { break };
            self.now_ns = at_ns;
            if at_ns > ends_ns {
                let tick = self.witness.last_estimate().map_or(0, |tick| tick + 1);
                return Err(
                    self.violation(SIM, format!("the run did not end once faults ceased: no estimate of tick {tick}"))
                );
            }
            self.happen(happening)?;
        }
        Ok(())
    }

    /// The simulator has ended, and every tick has its estimate.
    fn has_ended(&self) -> bool {
        self.is_finished && self.witness.last_estimate() == Some(self.plan.ticks)
    }

    fn happen(&mut self, happening: Happening) -> Result<(), Violation> {
        match happening {
            Happening::Arrives { to, message } => {
                let inbox = &mut self.nodes[to].inbox;
                if inbox.len() == INBOX {
                    inbox.remove(0);
                }
                inbox.push(message);
                // A standby leaves what comes where it is.
                let is_woken =
                    self.plan.network.wakes_on_arrival && !matches!(self.nodes[to].process, Process::Standby(_));
                if is_woken { self.run(to) } else { Ok(()) }
            }
            Happening::Wakes { node, call } => {
                if let (Some(Call::Hello), Process::Sim(machine)) = (call, &mut self.nodes[node].process) {
                    machine.on_hello();
                }
                if call.is_none() && self.nodes[node].wakes_at_ns != self.now_ns {
                    return Ok(());
                }
                self.run(node)
            }
            Happening::Begins(fault) => {
                match self.plan.faults[fault].kind {
                    FaultKind::Kill { node, after_actions, .. } | FaultKind::Stop { node, after_actions, .. } => {
                        self.nodes[node].doom = Some(Doom { after_actions, fault });
                    }
                    FaultKind::Partition { nodes, for_ns } => {
                        self.counts.faults += 1;
                        self.partitions.push((fault, nodes));
                        self.tell(SIM, || format!("network: nodes {nodes:#b} are cut off"));
                        self.after(for_ns, Happening::Heals(fault));
                    }
                }
                Ok(())
            }
            Happening::Heals(fault) => {
                self.partitions.retain(|(index, _)| *index != fault);
                self.tell(SIM, || "network: whole again".to_owned());
                Ok(())
            }
            Happening::Starts { node, life } if self.nodes[node].life == life => self.start(node),
            Happening::Continues { node, life } if self.nodes[node].life == life => {
                self.nodes[node].is_stopped = false;
                self.tell(node, || "continues".to_owned());
                self.forget_first_range();
                self.run(node)
            }
            Happening::Starts { .. } | Happening::Continues { .. } => Ok(()),
            Happening::Supervises => {
                self.supervise();
                self.after(silence::LOOK.as_nanos() as u64, Happening::Supervises);
                Ok(())
            }
        }
    }

    /// The supervisor's look: who hangs is killed and started again.
    fn supervise(&mut self) {
        let mut anybody = false;
        for node in &mut self.nodes {
            anybody |= node.silence.hear(node.last_sign_ns);
        }
        if !anybody {
            return;
        }
        for node in 0..self.nodes.len() {
            self.nodes[node].silence.count();
            if matches!(self.nodes[node].process, Process::None) {
                continue;
            }
            let silence = &self.nodes[node].silence;
            let limit = silence::limit(self.scenario, self.plan.nodes(), silence.has_started(), false);
            if limit.is_some_and(|limit| silence.is_longer_than(limit)) {
                self.tell(node, || "hangs: killed by the supervisor".to_owned());
                self.die(node, RESTART_NS);
            }
        }
    }

    fn start(&mut self, node: usize) -> Result<(), Violation> {
        let robots_from = 2 + self.plan.standbys;
        self.nodes[node].life += 1;
        self.nodes[node].silence = Silence::default();
        self.nodes[node].last_sign_ns = Some(self.now_ns);
        self.nodes[node].process = match node {
            SIM => self.start_sim()?,
            FUSION if self.roster.holder.is_none() => self.lead(node, false)?,
            node if node < robots_from => Process::Standby(Standby::new(self.scenario, self.sign_of_lead())),
            node => {
                let id = node - robots_from;
                let started =
                    (robot::Machine::new(self.scenario, id, self.roster.starts), Sensor::new(self.scenario, id));
                let (Some(machine), Some(sensor)) = started else { return Ok(()) };
                let witness = RobotWitness::new(self.roster.starts);
                Process::Robot(Box::new(machine), Box::new(sensor), witness)
            }
        };
        self.tell(node, || "starts".to_owned());
        self.run(node)
    }

    fn start_sim(&mut self) -> Result<Process, Violation> {
        let world = world_of(self.scenario, std::path::Path::new(""));
        let world = world.map_err(|error| self.violation(SIM, error.to_string()))?;
        let mut machine = sim::Machine::new(self.scenario, world);
        let saved = self.sim_disk.read::<sim::Saved<'static>>().map_err(|what| self.violation(SIM, what))?;
        if let Some(saved) = saved {
            machine.restore(saved).map_err(|error| self.violation(SIM, error.to_string()))?;
        }
        self.sim_starts += 1;
        // The tick begins once more.
        self.forget_first_range();
        self.nodes[SIM].incarnation = self.sim_starts;
        Ok(Process::Sim(Box::new(machine)))
    }

    /// The tick that is gathered is held for as long as somebody stood still.
    fn forget_first_range(&mut self) {
        for node in &mut self.nodes {
            if let Process::Leader(_, lead) = &mut node.process {
                lead.first_range = None;
            }
        }
    }

    /// The process of a node that takes the lead, from a holder that may yet wake up if `by_force`.
    fn lead(&mut self, node: usize, by_force: bool) -> Result<Process, Violation> {
        self.roster = Roster { starts: self.roster.starts + 1, holder: Some(node), signed_ns: self.now_ns };
        self.counts.successions += u64::from(self.roster.starts > 1);
        let incarnation = self.roster.starts;
        self.nodes[node].incarnation = incarnation;
        let newest = self.disks.len() - 1;
        let saved = self.disks[newest].read::<leader::Saved<'static>>().map_err(|what| self.violation(node, what))?;
        if by_force {
            // Whatever the predecessor still writes goes to a file that has no name any more.
            let moved = self.disks[newest].clone();
            self.disks.push(moved);
        }
        let machine = Leader::new(self.scenario).map_err(|error| self.violation(node, error.to_string()))?;
        let mut machine = Box::new(machine);
        match saved {
            Some(saved) => {
                let now_ns = self.local_ns(node);
                machine.restore(saved, now_ns).map_err(|error| self.violation(node, error.to_string()))?;
            }
            None if self.witness.last_estimate().is_some() => {
                return Err(self.violation(node, "the state of ticks that were published is lost".to_owned()));
            }
            None => {}
        }
        let tick = machine.centre().next_tick();
        self.tell(node, || format!("leads as incarnation {incarnation} from tick {tick}"));
        self.words[Sleeper::Fusion as usize].expected = machine.expected();
        Ok(Process::Leader(machine, Lead { incarnation, disk: self.disks.len() - 1, first_range: None }))
    }

    fn sign_of_lead(&self) -> Option<u64> {
        (self.roster.starts > 0).then_some(self.roster.signed_ns)
    }

    /// Lets a process look at what has come, and do all that it has to do.
    fn run(&mut self, node: usize) -> Result<(), Violation> {
        if self.nodes[node].is_stopped {
            return Ok(());
        }
        let process = std::mem::replace(&mut self.nodes[node].process, Process::None);
        let life = self.nodes[node].life;
        if !matches!(process, Process::None) {
            self.nodes[node].last_sign_ns = Some(self.now_ns);
        }
        let process = match process {
            Process::None => Process::None,
            Process::Sim(machine) => self.run_sim(machine)?,
            Process::Leader(machine, lead) => self.run_leader(node, machine, lead)?,
            Process::Standby(standby) => self.run_standby(node, standby)?,
            Process::Robot(machine, sensor, witness) => self.run_robot(node, machine, sensor, witness)?,
        };
        // It has died meanwhile.
        if self.nodes[node].life == life {
            self.nodes[node].process = process;
        }
        Ok(())
    }

    fn run_sim(&mut self, mut machine: Box<sim::Machine>) -> Result<Process, Violation> {
        for message in self.take_inbox(SIM) {
            if let Message::Drive(tick, drive) = message {
                machine.on_drive(tick, &drive);
            }
        }
        let now_ns = self.local_ns(SIM);
        while let Some(action) = machine.next_action(now_ns) {
            let is_save = action == sim::Action::Save;
            match self.meet_doom(SIM) {
                Fate::Lives => {}
                Fate::Stops => {
                    self.act_sim(&mut machine, action)?;
                    return Ok(Process::Sim(machine));
                }
                Fate::Dies { is_torn } => {
                    if is_save && is_torn {
                        self.save_sim(&mut machine, true)?;
                    }
                    return Ok(Process::None);
                }
            }
            self.act_sim(&mut machine, action)?;
        }
        self.sleep_until(SIM, machine.wakes_at_ns())?;
        Ok(Process::Sim(machine))
    }

    fn act_sim(&mut self, machine: &mut sim::Machine, action: sim::Action) -> Result<(), Violation> {
        match action {
            sim::Action::Save => self.save_sim(machine, false)?,
            sim::Action::SendWorld => {
                let (tick, world) = (machine.tick(), machine.world());
                self.witness.world(tick, world.entries()).map_err(|what| self.violation(SIM, what))?;
                self.words[Sleeper::Sim as usize].expected = machine.expected();
                self.tell(SIM, || format!("world({tick})"));
                let header = self.header(SIM, tick, world.time_s());
                let entries: Rc<[WorldEntry]> = world.entries().into();
                for robot in 2 + self.plan.standbys..self.plan.nodes() {
                    self.send(SIM, robot, || Message::World(header, Rc::clone(&entries)));
                }
            }
            sim::Action::Notify(notification) => self.notify(SIM, notification),
            sim::Action::TellSilent(id) => self.tell(SIM, || format!("goes on without robot-{id}")),
            sim::Action::Finish => {
                self.is_finished = true;
                self.tell(SIM, || "the run is over".to_owned());
            }
            sim::Action::Record | sim::Action::SendTruth => {}
        }
        Ok(())
    }

    fn save_sim(&mut self, machine: &mut sim::Machine, is_torn: bool) -> Result<(), Violation> {
        let saved = machine.saved().map_err(|error| self.violation(SIM, error.to_string()))?;
        self.sim_disk.write(&saved, is_torn).map_err(|what| Violation { at_ns: self.now_ns, node: SIM, what })
    }

    fn run_standby(&mut self, node: usize, mut standby: Standby<u64>) -> Result<Process, Violation> {
        if self.is_finished && self.has_ended() {
            return Ok(Process::None);
        }
        if let Fate::Dies { .. } = self.meet_doom(node) {
            return Ok(Process::None);
        }
        if self.nodes[node].is_stopped {
            return Ok(Process::Standby(standby));
        }
        let is_time = self.nodes[node].wakes_at_ns <= self.now_ns || self.nodes[node].wakes_at_ns == u64::MAX;
        let takes = match self.roster.holder {
            None => Some(false),
            Some(_) if is_time => standby.look(self.sign_of_lead()).is_some().then_some(true),
            Some(_) => None,
        };
        if let Some(by_force) = takes {
            let process = self.lead(node, by_force)?;
            self.after(0, Happening::Wakes { node, call: Some(Call::Range) });
            return Ok(process);
        }
        if is_time {
            self.look_after_a_while(node);
        }
        Ok(Process::Standby(standby))
    }

    fn look_after_a_while(&mut self, node: usize) {
        let look_ns = standby::LOOK.as_nanos() as u64;
        self.nodes[node].wakes_at_ns = self.now_ns + look_ns;
        self.after(look_ns, Happening::Wakes { node, call: None });
    }

    /// A process that was deposed stands by.
    fn stand_by(&mut self, node: usize) -> Process {
        self.tell(node, || "sees that it was deposed; stands by".to_owned());
        self.look_after_a_while(node);
        Process::Standby(Standby::new(self.scenario, self.sign_of_lead()))
    }

    fn run_leader(&mut self, node: usize, mut machine: Box<Leader>, mut lead: Lead) -> Result<Process, Violation> {
        let now_ns = self.local_ns(node);
        for message in self.take_inbox(node) {
            if let Message::Range(header, range) = message {
                if lead.first_range.is_none_or(|(tick, _)| tick != header.tick)
                    && header.tick == machine.centre().next_tick()
                {
                    lead.first_range = Some((header.tick, now_ns));
                }
                machine.on_range(&header, &[range], now_ns);
            }
        }
        let began_at = machine.centre().next_tick();
        let mut finishes = self.is_finished;
        loop {
            let action = machine.next_action(now_ns).map_err(|error| self.violation(node, error.to_string()))?;
            let Some(action) = action else {
                if !std::mem::take(&mut finishes) {
                    break;
                }
                machine.finish();
                continue;
            };
            let fate = self.meet_doom(node);
            if let Fate::Dies { is_torn } = fate {
                if action == leader::Action::Save && is_torn {
                    self.save_leader(node, &mut machine, lead, true)?;
                }
                return Ok(Process::None);
            }
            if action == leader::Action::RequireLead && !self.holds_lead(node, lead) {
                return Ok(self.stand_by(node));
            }
            self.act_leader(node, &mut machine, lead, action)?;
            if let Fate::Stops = fate {
                return Ok(Process::Leader(machine, lead));
            }
        }
        if machine.centre().next_tick() == began_at && !self.holds_lead(node, lead) {
            return Ok(self.stand_by(node));
        }
        self.sleep_until(node, machine.wakes_at_ns())?;
        Ok(Process::Leader(machine, lead))
    }

    /// True while nobody has taken the lead from it; gives a sign of life.
    fn holds_lead(&mut self, node: usize, lead: Lead) -> bool {
        let holds = self.roster.holder == Some(node) && self.roster.starts == lead.incarnation;
        if holds {
            self.roster.signed_ns = self.now_ns;
        }
        holds
    }

    fn act_leader(
        &mut self,
        node: usize,
        machine: &mut Leader,
        lead: Lead,
        action: leader::Action,
    ) -> Result<(), Violation> {
        let tick = machine.centre().next_tick().saturating_sub(1);
        match action {
            leader::Action::Continue | leader::Action::RequireLead => {}
            leader::Action::Save => self.save_leader(node, machine, lead, false)?,
            leader::Action::SendHeadings => {
                let commands = machine.centre().commands();
                let is_current = self.roster.starts == lead.incarnation;
                let witnessed = self.witness.headings(tick, commands, is_current);
                witnessed.map_err(|what| self.violation(node, what))?;
                self.tell(node, || format!("heading({tick})"));
                let header = self.header(node, tick, machine.centre().time_s());
                let commands: Rc<[Command]> = commands.into();
                for robot in 2 + self.plan.standbys..self.plan.nodes() {
                    self.send(node, robot, || Message::Heading(header, Rc::clone(&commands)));
                }
            }
            leader::Action::Notify(notification) => self.notify(node, notification),
            leader::Action::SendEstimate => {
                let estimate = machine.estimate();
                self.witness.estimate(tick, estimate).map_err(|what| self.violation(node, what))?;
                let held_ns = lead
                    .first_range
                    .filter(|(first, _)| *first == tick)
                    .map(|(_, first_ns)| estimate.stages.began_ns.saturating_sub(first_ns));
                let longest_ns = (1.5 * self.scenario.dt_s * 1e9) as u64 + LATE_NS;
                if self.plan.clock == Clock::Realtime && tick > 0 && held_ns.is_some_and(|held_ns| held_ns > longest_ns)
                {
                    return Err(self.violation(node, format!("tick {tick} was held beyond its deadline")));
                }
            }
            leader::Action::Record => {
                self.witness.record(tick, machine).map_err(|what| self.violation(node, what))?;
                self.words[Sleeper::Fusion as usize].expected = machine.expected();
            }
            leader::Action::Tell(notice) => {
                if let Notice::Missed { first, last } = notice {
                    self.tell(node, || format!("missed ticks {first} to {last}"));
                }
            }
        }
        Ok(())
    }

    fn save_leader(&mut self, node: usize, machine: &mut Leader, lead: Lead, is_torn: bool) -> Result<(), Violation> {
        let saved = machine.saved().map_err(|error| self.violation(node, error.to_string()))?;
        self.disks[lead.disk].write(&saved, is_torn).map_err(|what| Violation { at_ns: self.now_ns, node, what })
    }

    fn run_robot(
        &mut self,
        node: usize,
        mut machine: Box<robot::Machine>,
        mut sensor: Box<Sensor>,
        mut witness: RobotWitness,
    ) -> Result<Process, Violation> {
        let id = node - 2 - self.plan.standbys;
        for message in self.take_inbox(node) {
            match message {
                Message::World(header, entries) => {
                    machine.on_world(&header, &entries);
                    witness.world(header.incarnation);
                }
                Message::Heading(header, commands) => {
                    machine.on_heading(&header, &commands);
                    witness.heading(header.incarnation, header.tick, commands[id]);
                }
                Message::Range(..) | Message::Drive(..) => {}
            }
        }
        let now_ns = self.local_ns(node);
        let (mut carried, mut provides) = (Command::default(), true);
        loop {
            let Some(action) = machine.next_action(now_ns) else {
                if !std::mem::take(&mut provides) {
                    break;
                }
                machine.before_sleep();
                continue;
            };
            let fate = self.meet_doom(node);
            if let Fate::Dies { .. } = fate {
                return Ok(Process::None);
            }
            match action {
                robot::Action::Measure { tick, entry } => {
                    let told = witness.measures(tick);
                    told.map_err(|what| self.violation(node, what))?;
                    let (range_m, std_m) = measure(sensor.as_mut(), tick, &entry);
                    machine.measured(range_m, std_m, now_ns);
                }
                robot::Action::CarryOut(command) => {
                    carried = command;
                    machine.carried_out(command);
                }
                robot::Action::SendRange(Outgoing { tick, valid_at_s, entry }) => {
                    self.witness.range(tick, &entry).map_err(|what| self.violation(node, what))?;
                    let header = self.header(node, tick, valid_at_s);
                    for fusion in FUSION..2 + self.plan.standbys {
                        self.send(node, fusion, || Message::Range(header, entry));
                    }
                }
                robot::Action::SendDrive(Outgoing { tick, entry, .. }) => {
                    if entry.heading_held_ns == now_ns && std::mem::take(&mut carried) != Command::default() {
                        let command = Command { heading_rad: entry.heading_rad, speed_mps: entry.speed_mps };
                        witness.obeys(tick, command).map_err(|what| self.violation(node, what))?;
                        self.tell(node, || format!("obeys heading({tick})"));
                    }
                    self.send(node, SIM, || Message::Drive(tick, entry));
                }
                robot::Action::Notify(notification) => self.notify(node, notification),
            }
            if let Fate::Stops = fate {
                return Ok(Process::Robot(machine, sensor, witness));
            }
        }
        self.sleep_until(node, machine.wakes_at_ns())?;
        Ok(Process::Robot(machine, sensor, witness))
    }

    /// Counts an action of a node, and says what becomes of it before that.
    fn meet_doom(&mut self, node: usize) -> Fate {
        let Some(doom) = &mut self.nodes[node].doom else { return Fate::Lives };
        if let Some(fewer) = doom.after_actions.checked_sub(1) {
            doom.after_actions = fewer;
            return Fate::Lives;
        }
        let fault = doom.fault;
        self.nodes[node].doom = None;
        self.counts.faults += 1;
        match self.plan.faults[fault].kind {
            FaultKind::Kill { is_torn, down_ns, .. } => {
                self.tell(node, || "is killed".to_owned());
                self.die(node, down_ns);
                Fate::Dies { is_torn }
            }
            FaultKind::Stop { for_ns, .. } => {
                self.tell(node, || "is stopped".to_owned());
                (self.nodes[node].is_stopped, self.nodes[node].is_interrupted) = (true, true);
                let life = self.nodes[node].life;
                self.after(for_ns, Happening::Continues { node, life });
                Fate::Stops
            }
            FaultKind::Partition { .. } => Fate::Lives,
        }
    }

    fn die(&mut self, node: usize, down_ns: u64) {
        let dead = &mut self.nodes[node];
        dead.process = Process::None;
        dead.life += 1;
        (dead.is_stopped, dead.is_interrupted) = (false, false);
        dead.doom = None;
        dead.inbox.clear();
        dead.wakes_at_ns = u64::MAX;
        let life = dead.life;
        if self.roster.holder == Some(node) {
            self.roster.holder = None;
        }
        self.after(down_ns, Happening::Starts { node, life });
        // The lock that a standby waits for is free.
        for standby in FUSION..2 + self.plan.standbys {
            self.after(WAKE_NS, Happening::Wakes { node: standby, call: Some(Call::Range) });
        }
    }

    /// What has come; nothing yet for a process that was interrupted, which looks again at once.
    fn take_inbox(&mut self, node: usize) -> Vec<Message> {
        if std::mem::take(&mut self.nodes[node].is_interrupted) {
            self.after(0, Happening::Wakes { node, call: Some(Call::World) });
            return Vec::new();
        }
        std::mem::take(&mut self.nodes[node].inbox)
    }

    fn send(&mut self, from: usize, to: usize, message: impl Fn() -> Message) {
        let cut = |(_, nodes): &(usize, u64)| (nodes >> from & 1) != (nodes >> to & 1);
        if self.partitions.iter().any(cut) {
            return;
        }
        let network = &self.plan.network;
        let is_calm = self.now_ns >= self.calm_from_ns;
        if !is_calm && self.random.random_bool(network.loss) {
            return;
        }
        let copies = if !is_calm && self.random.random_bool(network.duplicates) { 2 } else { 1 };
        for _ in 0..copies {
            let is_slow = !is_calm && self.random.random_bool(network.slow);
            let late_ns = if is_slow { self.random.random_range(0..network.slow_max_ns) } else { 0 };
            self.after(MESSAGE_NS + late_ns, Happening::Arrives { to, message: message() });
        }
    }

    fn notify(&mut self, from: usize, Notification { to, call, when }: Notification) {
        if let When::LastAnswer { tick, or_first } = when {
            let words = &mut self.words[to as usize];
            if words.tick.is_some_and(|newest| newest > tick) {
                // Of a tick that is over: whoever needs it waits for nothing else.
            } else {
                words.answers = if words.tick == Some(tick) { words.answers + 1 } else { 1 };
                words.tick = Some(tick);
                if words.answers < words.expected && !(or_first && words.answers == 1) {
                    return;
                }
            }
        }
        let robots_from = 2 + self.plan.standbys;
        let sleepers = match to {
            Sleeper::Sim => SIM..FUSION,
            Sleeper::Fusion => FUSION..robots_from,
            Sleeper::Robots => robots_from..self.plan.nodes(),
        };
        for node in sleepers.filter(|node| *node != from) {
            // What arrives wakes its receiver anyway.
            let is_needed = matches!(call, Call::Hello | Call::Finished) || !self.plan.network.wakes_on_arrival;
            // A standby is woken by nobody.
            if is_needed && !matches!(self.nodes[node].process, Process::Standby(_)) {
                self.after(WAKE_NS, Happening::Wakes { node, call: Some(call) });
            }
        }
    }

    /// Sleeps until a time by its own clock, or for a while.
    fn sleep_until(&mut self, node: usize, local_ns: Option<u64>) -> Result<(), Violation> {
        let now_local_ns = self.local_ns(node);
        let left_ns = local_ns.map_or(IDLE_NS, |local_ns| local_ns.saturating_sub(now_local_ns));
        if left_ns == 0 {
            return Err(self
                .violation(node, "it is past the time at which it had something to do, and does nothing".to_owned()));
        }
        let left_ns = ((left_ns as f64 / self.nodes[node].clock_rate) as u64 + 1).min(IDLE_NS);
        let wakes_at_ns = self.now_ns + left_ns;
        // A sooner one, or one of a process before it, is looked at when it comes.
        if wakes_at_ns < self.nodes[node].wakes_at_ns || self.nodes[node].wakes_at_ns <= self.now_ns {
            self.nodes[node].wakes_at_ns = wakes_at_ns;
            self.after(left_ns, Happening::Wakes { node, call: None });
        }
        Ok(())
    }

    fn after(&mut self, after_ns: u64, happening: Happening) {
        self.order += 1;
        self.due.push(Reverse(Due { at_ns: self.now_ns + after_ns, order: self.order, happening }));
    }

    fn header(&self, node: usize, tick: u64, valid_at_s: f64) -> Header {
        let incarnation = self.nodes[node].incarnation;
        Header { run_id: 1, incarnation, tick, valid_at_s, sent_ns: self.local_ns(node) }
    }

    /// The time by a node's own clock, ns.
    fn local_ns(&self, node: usize) -> u64 {
        (self.now_ns as f64 * self.nodes[node].clock_rate) as u64
    }

    fn violation(&self, node: usize, what: String) -> Violation {
        Violation { at_ns: self.now_ns - START_NS, node, what }
    }

    fn tell(&mut self, node: usize, what: impl FnOnce() -> String) {
        if let Some(story) = &mut self.story {
            story.push(Event { at_ns: self.now_ns - START_NS, node, what: what() });
        }
    }
}

/// What becomes of a node at an action.
enum Fate {
    Lives,
    /// It does this action still, and is stopped then.
    Stops,
    /// It does not do it, or half of it.
    Dies {
        is_torn: bool,
    },
}
