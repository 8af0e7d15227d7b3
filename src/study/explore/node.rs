//! A node of the team and its process: the state only.

use rangehound_fusion::leader::Leader;
use rangehound_fusion::standby::Standby;
use rangehound_robot::pose::PoseSource;
use rangehound_robot::sensor::Sensor;
use rangehound_shared::sealed::slots::SlotWriter;
use rangehound_sim::machine as sim;

use super::checker::robot::RobotChecker;
use super::lead::Lease;
use super::message::Message;
use super::plan::LocalClock;
use super::roles::remote::RemoteEnd;

/// A robot's machine, sensor, localiser and checks.
pub(super) struct Robot {
    pub(super) machine: rangehound_robot::machine::Machine,
    pub(super) sensor: Box<dyn Sensor>,
    pub(super) poses: Box<dyn PoseSource>,
    pub(super) checker: RobotChecker,
    /// Its end of the link to the gateway, if it is on another host.
    pub(super) remote: Option<RemoteEnd>,
}

/// The process of a node.
pub(super) enum Process {
    None,
    /// It has not taken its role yet.
    Starting,
    Sim(Box<sim::Machine>),
    Standby(Box<StandingBy>),
    Successor(Box<Successor>),
    Leader(Box<Leading>),
    Robot(Box<Robot>),
    Gateway,
}

impl Process {
    /// False for a process that does not read messages.
    pub(super) fn is_woken(&self) -> bool {
        matches!(self, Self::Sim(_) | Self::Leader(_) | Self::Robot(_))
    }
}

/// A node, and the history of its processes.
pub(super) struct Node {
    pub(super) clock: LocalClock,
    pub(super) process: Process,
    /// Counts the starts and ends of its processes.
    pub(super) life: u32,
    pub(super) is_stopped: bool,
    /// It was stopped between two actions: it finishes its actions before it reads messages, like a real process.
    pub(super) is_interrupted: bool,
    /// Its process has started, and has not ended.
    pub(super) takes_part: bool,
    /// The fault of its process after some more actions.
    pub(super) pending_fault: Option<PendingFault>,
    /// Faults of its later processes.
    pub(super) later_faults: Vec<PendingFault>,
    /// Messages that have arrived, and whether each is garbled.
    pub(super) inbox: Vec<(Message, bool)>,
    /// The newest tick of which a range has arrived, the time of the first such range, and the node that sent it.
    pub(super) first_arrival: Option<(u64, u64, usize)>,
    /// Actions since it last slept.
    pub(super) actions: u32,
    pub(super) wakes_at_ns: u64,
    pub(super) incarnation: u64,
    /// Its process's last heartbeat, in a role of its own.
    pub(super) heartbeat_ns: Option<u64>,
    /// Time since which its process has been in its state: taking part, stopped or starting.
    pub(super) state_since_ns: u64,
    /// Time for which its process was stopped.
    pub(super) stopped_ns: u64,
    /// The part of that time which it can notice: a running process may sleep for as long as the rest.
    pub(super) suspended_ns: u64,
    /// Time that its next process takes to start.
    pub(super) up_ns: u64,
}

#[derive(Debug, Clone, Copy)]
pub(super) struct PendingFault {
    pub(super) after_actions: u32,
    pub(super) fault: usize,
}

/// Effect of a fault on a node at an action.
pub(super) enum FaultEffect {
    Lives,
    /// It still does this action, and is then stopped.
    Stops,
    /// It does not do this action. If the action is to write a checkpoint, this share of it is written.
    Dies {
        written: f64,
    },
}

impl Node {
    pub(super) fn new(clock: LocalClock) -> Self {
        Self {
            clock,
            process: Process::None,
            life: 0,
            is_stopped: false,
            is_interrupted: false,
            takes_part: false,
            pending_fault: None,
            later_faults: Vec::new(),
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

    /// Time for which its process has taken part undisturbed, ns.
    pub(super) fn well_for_ns(&self, now_ns: u64) -> u64 {
        if self.takes_part && !self.is_stopped { now_ns - self.state_since_ns } else { 0 }
    }

    /// Time for which its process has been stopped, ns.
    pub(super) fn stopped_for_ns(&self, now_ns: u64) -> u64 {
        if self.is_stopped { now_ns - self.state_since_ns } else { 0 }
    }

    /// Its process has started.
    pub(super) fn start_process(&mut self, process: Process, now_ns: u64) {
        self.process = process;
        (self.takes_part, self.heartbeat_ns, self.state_since_ns) = (true, Some(now_ns), now_ns);
    }
}

/// A standby.
pub(super) struct StandingBy {
    pub(super) standby: Standby<u64, u64>,
    /// The lock that it waits for.
    pub(super) waits_for: u64,
    pub(super) since_ns: u64,
    pub(super) looks_at_ns: u64,
    /// The last heartbeat of a leader that it is about to depose.
    pub(super) deposes: Option<u64>,
}

/// A process that has taken the lead but does not lead yet.
pub(super) struct Successor {
    pub(super) lease: Lease,
    /// The state that it goes on from, once it has read it.
    pub(super) read: Option<(Leader, SlotWriter)>,
}

/// A process that leads.
pub(super) struct Leading {
    pub(super) machine: Leader,
    pub(super) lease: Lease,
    /// Its checkpoint file, if it has one.
    pub(super) disk: Option<usize>,
    pub(super) writer: SlotWriter,
    pub(super) since_ns: u64,
    /// A tick and when its first range arrived, by its own clock; `None` if a process was stopped since.
    pub(super) first_range: Option<(u64, u64)>,
    /// The same in time for which it ran, whichever process was stopped.
    pub(super) ran_at_first_ns: Option<(u64, u64)>,
    /// True if it has checked that it leads since it last sent headings.
    pub(super) has_looked: bool,
    /// The newest tick of which a range has arrived.
    pub(super) newest_heard: u64,
}
