//! The processes of nodes: started, stopped, killed between two actions, asleep.

use rand::RngExt as _;
use rangehound_robot::sensor::Sensor;
use rangehound_shared::protocol::timing::ROUND_MAX_NS;
use rangehound_shared::protocol::wake::Event;
use rangehound_sim::machine as sim;

use super::cluster::{Cluster, Happening, Violation};
use super::faults::FaultKind;
use super::lead::SIGN_NS;
use super::network::{Message, WAKE_NS};
use super::roles::fusion::{Heir, Leading, StandingBy};
use super::witness::robot::RobotWitness;
use crate::run::supervisor::deaths::End;

/// A process looks at everything once in so long, called or not.
const IDLE_NS: u64 = 100_000_000;

/// Most actions of a process before it sleeps.
const ACTIONS_MAX: u32 = 10_000;

/// A machine in its part of a robot.
pub(super) struct Robot {
    pub(super) machine: rangehound_robot::machine::Machine,
    pub(super) sensor: Sensor,
    pub(super) witness: RobotWitness,
}

/// What runs on a node.
pub(super) enum Process {
    None,
    /// It has not taken its role yet.
    Starting,
    Sim(Box<sim::Machine>),
    Standby(Box<StandingBy>),
    Heir(Box<Heir>),
    Leader(Box<Leading>),
    Robot(Box<Robot>),
}

impl Process {
    /// False for one that leaves what comes where it is.
    pub(super) fn is_woken(&self) -> bool {
        matches!(self, Self::Sim(_) | Self::Leader(_) | Self::Robot(_))
    }
}

/// A node, whatever process runs on it.
pub(super) struct Node {
    pub(super) clock_rate: f64,
    pub(super) process: Process,
    /// Counts its processes, and their ends.
    pub(super) life: u32,
    pub(super) is_stopped: bool,
    /// It was stopped between two actions: as a process does, it does what it has to do before it looks at what has come.
    pub(super) is_interrupted: bool,
    /// Its process has come up, and has not ended.
    takes_part: bool,
    /// What becomes of its process after some more actions.
    doom: Option<Doom>,
    /// What is to become of processes that follow.
    dooms_to_come: Vec<Doom>,
    /// What has come, and whether it is garbled.
    pub(super) inbox: Vec<(Message, bool)>,
    /// The newest tick of which a range came, when the first one did, and from which node.
    pub(super) first_arrival: Option<(u64, u64, usize)>,
    /// What it has done since it last slept.
    actions: u32,
    pub(super) wakes_at_ns: u64,
    pub(super) incarnation: u64,
    /// Its process's last heartbeat, in a role of its own.
    pub(super) heartbeat_ns: Option<u64>,
    /// Since when its process has been in its state: taking part, stopped, starting.
    pub(super) state_since_ns: u64,
    /// Time for which its process was stopped.
    pub(super) stopped_ns: u64,
    /// The part of that which it can notice: a process that runs may be asleep for as long as the rest.
    pub(super) suspended_ns: u64,
    /// What its next process takes to come up.
    pub(super) up_ns: u64,
}

#[derive(Debug, Clone, Copy)]
struct Doom {
    after_actions: u32,
    fault: usize,
}

/// What becomes of a node at an action.
pub(super) enum Fate {
    Lives,
    /// It does this action still, and is stopped then.
    Stops,
    /// It does not do it; or this share of it, if it is to write a checkpoint.
    Dies {
        written: f64,
    },
}

impl Node {
    pub(super) fn new(clock_rate: f64) -> Self {
        Self {
            clock_rate,
            process: Process::None,
            life: 0,
            is_stopped: false,
            is_interrupted: false,
            takes_part: false,
            doom: None,
            dooms_to_come: Vec::new(),
            inbox: Vec::new(),
            first_arrival: None,
            actions: 0,
            wakes_at_ns: u64::MAX,
            incarnation: 0,
            heartbeat_ns: None,
            state_since_ns: 0,
            stopped_ns: 0,
            suspended_ns: 0,
            up_ns: 0,
        }
    }

    /// For how long its process has taken part undisturbed, ns.
    pub(super) fn well_for_ns(&self, now_ns: u64) -> u64 {
        if self.takes_part && !self.is_stopped { now_ns - self.state_since_ns } else { 0 }
    }

    /// For how long its process has been stopped, ns.
    pub(super) fn stopped_for_ns(&self, now_ns: u64) -> u64 {
        if self.is_stopped { now_ns - self.state_since_ns } else { 0 }
    }

    /// Its process has come up.
    pub(super) fn come_up(&mut self, process: Process, now_ns: u64) {
        self.process = process;
        (self.takes_part, self.heartbeat_ns, self.state_since_ns) = (true, Some(now_ns), now_ns);
    }
}

impl Cluster<'_> {
    /// A process is made, which comes up in a while.
    pub(super) fn spawn(&mut self, node: usize, soon_ns: u64) {
        let up_ns = soon_ns + std::mem::take(&mut self.nodes[node].up_ns);
        let spawned = &mut self.nodes[node];
        spawned.life += 1;
        spawned.process = Process::Starting;
        (spawned.heartbeat_ns, spawned.state_since_ns) = (None, self.now_ns);
        if spawned.doom.is_none() {
            spawned.doom = spawned.dooms_to_come.pop();
        }
        let life = spawned.life;
        self.after(up_ns, Happening::ComesUp { node, life });
    }

    /// Something goes wrong with a node, now or soon.
    pub(super) fn begin(&mut self, fault: usize) -> Result<(), Violation> {
        match self.plan.faults[fault].kind {
            FaultKind::Kill { node, after_actions, times, .. } => {
                self.nodes[node].doom = Some(Doom { after_actions, fault });
                self.nodes[node].dooms_to_come.extend((1..times).map(|_| Doom { after_actions, fault }));
            }
            FaultKind::Break { node, after_actions } | FaultKind::Stop { node, after_actions, .. } => {
                self.nodes[node].doom = Some(Doom { after_actions, fault });
            }
            FaultKind::StopLeader { after_actions, .. } => {
                let Some(node) = self.lead.holder else { return Ok(()) };
                self.nodes[node].doom = Some(Doom { after_actions, fault });
            }
            FaultKind::KillHeir { .. } => self.heirs_dooms.push(fault),
            FaultKind::RefuseStarts { times } => self.supervisor.refusals += times,
            FaultKind::StopSupervisor { for_ns } => {
                self.counts.faults += 1;
                self.stop_supervisor(for_ns);
            }
            FaultKind::StopAll { for_ns, with_supervisor } => {
                self.counts.faults += 1;
                if with_supervisor {
                    self.stop_supervisor(for_ns);
                }
                for node in 0..self.nodes.len() {
                    if !matches!(self.nodes[node].process, Process::None | Process::Starting) {
                        let later_ns = self.random.random_range(0..1_000_000);
                        self.stop(node, for_ns + later_ns);
                    }
                }
            }
            FaultKind::Partition { nodes, for_ns } => {
                self.counts.faults += 1;
                self.partitions.push((fault, nodes));
                self.tell(None, || format!("nodes {nodes:#b} are cut off"));
                self.after(for_ns, Happening::Heals(fault));
            }
        }
        Ok(())
    }

    /// A process has taken the lead: what was to become of the next one that does.
    pub(super) fn doom_heir(&mut self, node: usize) {
        if let Some(fault) = self.heirs_dooms.pop()
            && let FaultKind::KillHeir { after_actions } = self.plan.faults[fault].kind
        {
            self.nodes[node].doom = Some(Doom { after_actions, fault });
        }
    }

    /// Counts an action of a node, and says what becomes of it before that.
    pub(super) fn meet_doom(&mut self, node: usize) -> Result<Fate, Violation> {
        self.nodes[node].actions += 1;
        if self.nodes[node].actions > ACTIONS_MAX {
            return Err(self.violation(Some(node), "it acts and acts, and comes to no rest".to_owned()));
        }
        Ok(self.fate(node))
    }

    fn fate(&mut self, node: usize) -> Fate {
        let Some(doom) = &mut self.nodes[node].doom else { return Fate::Lives };
        if let Some(fewer) = doom.after_actions.checked_sub(1) {
            doom.after_actions = fewer;
            return Fate::Lives;
        }
        let fault = doom.fault;
        if self.plan.leaves_robots && !self.may_leave(node) {
            return Fate::Lives;
        }
        self.nodes[node].doom = None;
        self.counts.faults += 1;
        match self.plan.faults[fault].kind {
            FaultKind::Kill { written, is_own, up_ns, .. } => {
                self.nodes[node].up_ns = up_ns;
                self.die(node, if is_own { End::Failed } else { End::Killed });
                Fate::Dies { written }
            }
            FaultKind::KillHeir { .. } => {
                self.die(node, End::Killed);
                Fate::Dies { written: 0.0 }
            }
            FaultKind::Break { after_actions, .. } => {
                self.nodes[node].dooms_to_come.push(Doom { after_actions, fault });
                self.die(node, End::Failed);
                Fate::Dies { written: 0.0 }
            }
            FaultKind::Stop { for_ns, .. } | FaultKind::StopLeader { for_ns, .. } => {
                self.stop(node, for_ns);
                Fate::Stops
            }
            _ => Fate::Lives,
        }
    }

    /// Robots that are not started again may leave once the whole team has been there; one stays.
    fn may_leave(&self, node: usize) -> bool {
        let robots = self.plan.robot_nodes();
        !robots.contains(&node) || node != robots.start && self.witness.newest_world() > 0
    }

    fn stop(&mut self, node: usize, for_ns: u64) {
        self.tell(Some(node), || "is stopped".to_owned());
        let stopped = &mut self.nodes[node];
        if !std::mem::replace(&mut stopped.is_stopped, true) {
            stopped.state_since_ns = self.now_ns;
        }
        stopped.is_interrupted = true;
        let life = stopped.life;
        self.after(for_ns, Happening::Continues { node, life });
    }

    /// A stopped process goes on.
    pub(super) fn carry_on(&mut self, node: usize) -> Result<(), Violation> {
        let stopped = &mut self.nodes[node];
        if std::mem::take(&mut stopped.is_stopped) {
            let stopped_ns = self.now_ns - stopped.state_since_ns;
            stopped.stopped_ns += stopped_ns;
            stopped.suspended_ns += stopped_ns.saturating_sub(ROUND_MAX_NS);
            stopped.state_since_ns = self.now_ns;
            self.tell(Some(node), || "continues".to_owned());
            self.forget_first_range();
            self.run(node)?;
        }
        Ok(())
    }

    /// A process is gone.
    pub(super) fn die(&mut self, node: usize, end: End) {
        self.tell(Some(node), || if end == End::Killed { "is killed".to_owned() } else { "fails".to_owned() });
        let dead = &mut self.nodes[node];
        dead.life += 1;
        (dead.takes_part, dead.is_stopped, dead.is_interrupted) = (false, false, false);
        dead.doom = None;
        dead.inbox.clear();
        dead.wakes_at_ns = u64::MAX;
        let lock = match std::mem::replace(&mut dead.process, Process::None) {
            Process::Leader(leading) => Some(leading.lease.lock),
            Process::Heir(heir) => Some(heir.lease.lock),
            _ => None,
        };
        let lock = if self.lead.let_go(node, self.now_ns) { Some(self.lead.lock) } else { lock };
        if let Some(lock) = lock {
            self.free(lock);
        }
        self.supervisor.ends.push((node, end));
        self.after(WAKE_NS, Happening::Supervises);
    }

    /// A lock is free: those who wait for it wake up. If it is that of a deposed one, they wait for the one that counts.
    pub(super) fn free(&mut self, lock: u64) {
        for node in self.plan.fusion_nodes() {
            if let Process::Standby(standing_by) = &mut self.nodes[node].process
                && standing_by.waits_for == lock
            {
                standing_by.waits_for = self.lead.lock;
                self.after(WAKE_NS, Happening::Wakes { node, event: Some(Event::Range) });
            }
        }
    }

    /// Lets a process look at what has come, and do all that it has to do.
    pub(super) fn run(&mut self, node: usize) -> Result<(), Violation> {
        let running = &mut self.nodes[node];
        if running.is_stopped || matches!(running.process, Process::None | Process::Starting) {
            return Ok(());
        }
        let process = std::mem::replace(&mut running.process, Process::None);
        let life = running.life;
        running.actions = 0;
        // Who leads signs for the lead.
        if matches!(process, Process::Sim(_) | Process::Robot(_) | Process::Standby(_))
            && running.heartbeat_ns.is_none_or(|heartbeat_ns| self.now_ns >= heartbeat_ns + SIGN_NS)
        {
            running.heartbeat_ns = Some(self.now_ns);
        }
        let process = match process {
            Process::None | Process::Starting => process,
            Process::Sim(machine) => self.run_sim(machine)?,
            Process::Standby(standing_by) => self.run_standby(node, standing_by)?,
            Process::Heir(heir) => self.run_heir(node, heir)?,
            Process::Leader(leading) => self.run_leader(node, leading)?,
            Process::Robot(robot) => self.run_robot(node, robot)?,
        };
        // It has died meanwhile.
        if self.nodes[node].life == life {
            self.nodes[node].process = process;
        }
        Ok(())
    }

    /// Sleeps until a time by its own clock, or for a while.
    pub(super) fn sleep_until(&mut self, node: usize, local_ns: Option<u64>) -> Result<(), Violation> {
        let now_local_ns = self.local_ns(node);
        let left_ns = local_ns.map_or(IDLE_NS, |local_ns| local_ns.saturating_sub(now_local_ns));
        if left_ns == 0 {
            let what = "it is past the time at which it had something to do, and does nothing";
            return Err(self.violation(Some(node), what.to_owned()));
        }
        let left_ns = ((left_ns as f64 / self.nodes[node].clock_rate) as u64 + 1).min(IDLE_NS);
        self.sleep(node, left_ns);
        Ok(())
    }

    /// Sleeps for a time.
    pub(super) fn sleep(&mut self, node: usize, left_ns: u64) {
        let wakes_at_ns = self.now_ns + left_ns;
        // A sooner one, or one of a process before it, is looked at when it comes.
        if wakes_at_ns < self.nodes[node].wakes_at_ns || self.nodes[node].wakes_at_ns <= self.now_ns {
            self.nodes[node].wakes_at_ns = wakes_at_ns;
            self.after(left_ns, Happening::Wakes { node, event: None });
        }
    }

    /// The time by a node's own clock, ns.
    pub(super) fn local_ns(&self, node: usize) -> u64 {
        (self.now_ns as f64 * self.nodes[node].clock_rate) as u64
    }

    /// How far clocks may have gone apart, and how late a node that runs may see a deadline pass, ns.
    pub(super) fn late_ns(&self) -> u64 {
        let has_clocks_apart = self.plan.clock_rates.iter().any(|rate| *rate != 1.0);
        1_000_000 + if has_clocks_apart { self.now_ns / 80 } else { 0 }
    }
}
