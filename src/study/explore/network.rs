//! What travels between nodes: messages that are lost, doubled, late, garbled or cut off; wake-ups.

use std::rc::Rc;

use rand::RngExt as _;
use rangehound_shared::message::{Command, Drive, Header, Range, WorldEntry};
use rangehound_shared::protocol::wake::{Answers, Event, Notification, WaitGroup, When};
use rangehound_shared::scenario::Clock;

use super::cluster::{Cluster, Happening};
use super::process::Process;

/// What a message takes at least, and what a wake-up takes.
const MESSAGE_NS: u64 = 2_000;
pub(super) const WAKE_NS: u64 = 5_000;

/// Messages that wait for a process; the newest displace the oldest.
const INBOX: usize = 64;

/// A tick that no run comes to.
const NO_TICK: u64 = 1_000;

/// A robot that no team has here.
const NO_ROBOT: u64 = 200;

/// What one node tells another.
#[derive(Debug, Clone)]
pub(super) enum Message {
    World(Header, Rc<[WorldEntry]>),
    Range(Header, Range),
    Heading(Header, Rc<[Command]>),
    Drive(u64, Drive),
}

/// One wait group: how many answers it waits for, and which came.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct GroupState {
    pub(super) expected: usize,
    answers: Answers,
}

impl Message {
    /// With nonsense in it, of one kind or another: whoever it reaches must act as if it had not come.
    fn garbled(self, kind: u32) -> Self {
        match self {
            Self::World(header, entries) => {
                let mut entries = entries.to_vec();
                match kind {
                    0 => return Self::World(Header { tick: header.tick + NO_TICK, ..header }, entries.into()),
                    1 => entries.iter_mut().for_each(|entry| entry.pose.x_m = f64::NAN),
                    2 => entries.iter_mut().for_each(|entry| entry.range_kind = u64::MAX),
                    _ => entries.clear(),
                }
                Self::World(header, entries.into())
            }
            Self::Range(header, mut range) => {
                match kind {
                    0 => return Self::Range(Header { tick: header.tick + NO_TICK, ..header }, range),
                    1 => range.robot = NO_ROBOT,
                    2 => range.measurement.range_m = f64::NAN,
                    3 => range.measurement.pose.x_m += 1e6,
                    _ => range.measurement.range_m += 5.0,
                }
                Self::Range(header, range)
            }
            Self::Heading(header, commands) => {
                let one = Command { heading_rad: 1.0, speed_mps: 1.0 };
                Self::Heading(header, commands.iter().map(|_| one).chain([one]).collect())
            }
            Self::Drive(tick, drive) => Self::Drive(tick, Drive { robot: NO_ROBOT, ..drive }),
        }
    }
}

fn message_of((message, _): (Message, bool)) -> Message {
    message
}

impl Cluster<'_> {
    /// Sends a message, which may get lost.
    pub(super) fn send(&mut self, from: usize, to: usize, message: impl Fn() -> Message) {
        let cut = |(_, nodes): &(usize, u64)| (nodes >> from & 1) != (nodes >> to & 1);
        if self.partitions.iter().any(cut) {
            return;
        }
        let network = &self.plan.network;
        if self.now_ns >= self.calm_from_ns {
            self.after(MESSAGE_NS, Happening::Arrives { to, message: message(), is_garbled: false });
            return;
        }
        if self.random.random_bool(network.loss) {
            return;
        }
        let copies = if self.random.random_bool(network.duplicates) { 2 } else { 1 };
        for _ in 0..copies {
            let is_slow = self.random.random_bool(network.slow);
            let late_ns = if is_slow { self.random.random_range(0..network.slow_max_ns) } else { 0 };
            self.after(MESSAGE_NS + late_ns, Happening::Arrives { to, message: message(), is_garbled: false });
            if self.random.random_bool(network.garbled) {
                // In real time a tick may begin with the copy: what it says is not known to be nonsense then.
                let kinds = if self.plan.clock == Clock::Realtime { 0..2 } else { 0..5 };
                let message = message().garbled(self.random.random_range(kinds));
                self.after(MESSAGE_NS + late_ns, Happening::Arrives { to, message, is_garbled: true });
            }
        }
    }

    /// A message reaches a node, whose process looks at it if that wakes it.
    pub(super) fn arrive(&mut self, to: usize, message: Message, is_garbled: bool) -> bool {
        let node = &mut self.nodes[to];
        // One that starts may hear what was said before it knew who leads.
        if matches!(node.process, Process::None) {
            return false;
        }
        if node.inbox.len() == INBOX {
            node.inbox.remove(0);
            // Nonsense goes with what it is a copy of: alone it could not be told.
            while node.inbox.first().is_some_and(|(_, is_garbled)| *is_garbled) {
                node.inbox.remove(0);
            }
        }
        if let Message::Range(header, range) = &message
            && !is_garbled
            && node.first_arrival.is_none_or(|(newest, ..)| newest < header.tick)
        {
            node.first_arrival = Some((header.tick, self.now_ns, self.plan.robot_nodes().start + range.robot as usize));
        }
        node.inbox.push((message, is_garbled));
        self.plan.network.wakes_on_arrival && node.process.is_woken()
    }

    /// What has come; nothing yet for a process that was interrupted, which looks again at once.
    pub(super) fn take_inbox(&mut self, node: usize) -> impl Iterator<Item = Message> + use<> {
        if std::mem::take(&mut self.nodes[node].is_interrupted) {
            self.after(0, Happening::Wakes { node, event: Some(Event::World) });
            return Vec::new().into_iter().map(message_of);
        }
        std::mem::take(&mut self.nodes[node].inbox).into_iter().map(message_of)
    }

    /// Wakes whom a role asks for.
    pub(super) fn notify(&mut self, from: usize, Notification { to, event, when }: Notification) {
        if let When::LastAnswer { tick, or_first } = when {
            let group = &mut self.groups[to as usize];
            let answers = group.answers.with(tick);
            group.answers = answers.unwrap_or(group.answers);
            // Of a tick that is over: whoever needs it waits for nothing else.
            if answers.is_some_and(|answers| !answers.wakes(group.expected as u64, or_first)) {
                return;
            }
        }
        let members = match to {
            WaitGroup::Sim => 0..1,
            WaitGroup::Fusion => self.plan.fusion_nodes(),
            WaitGroup::Robots => self.plan.robot_nodes(),
        };
        // What arrives wakes its receiver anyway.
        let is_needed = matches!(event, Event::Hello | Event::Finished) || !self.plan.network.wakes_on_arrival;
        for node in members.filter(|node| is_needed && *node != from) {
            if !matches!(self.nodes[node].process, Process::Standby(_)) {
                self.after(WAKE_NS, Happening::Wakes { node, event: Some(event) });
            }
        }
    }

    /// The header of what a node sends.
    pub(super) fn header(&self, node: usize, tick: u64, valid_at_s: f64) -> Header {
        let incarnation = self.nodes[node].incarnation;
        Header { run_id: 1, incarnation, tick, valid_at_s, sent_ns: self.local_ns(node) }
    }
}
