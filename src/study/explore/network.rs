//! The network between nodes: messages that are lost, doubled, slow, garbled or cut off; wake-ups.

use rand::RngExt as _;
use rangehound_shared::message::Header;
use rangehound_shared::protocol::wake::{Event, Notification, WaitGroup, When};
use rangehound_shared::scenario::Clock;

use super::cluster::{Cluster, SimEvent};
use super::message::Message;
use super::node::Process;

/// Least delay of a message, and the delay of a wake-up.
const MESSAGE_NS: u64 = 2_000;
pub(super) const WAKE_NS: u64 = 5_000;

/// Size of a process's inbox; new messages displace the oldest.
const INBOX: usize = 64;

fn message_of((message, _): (Message, bool)) -> Message {
    message
}

impl Cluster<'_> {
    /// Sends a message through the network with its faults.
    pub(super) fn send(&mut self, from: usize, to: usize, message: impl Fn() -> Message) {
        let cut = |(_, nodes): &(usize, u64)| (nodes >> from & 1) != (nodes >> to & 1);
        if self.partitions.iter().any(cut) {
            return;
        }
        let network = &self.plan.network;
        if self.now_ns >= self.calm_from_ns {
            self.after(MESSAGE_NS, SimEvent::Arrival { to, message: message(), is_garbled: false });
            return;
        }
        if self.random.random_bool(network.loss) {
            return;
        }
        let copies = if self.random.random_bool(network.duplicates) { 2 } else { 1 };
        for _ in 0..copies {
            let is_slow = self.random.random_bool(network.slow);
            let late_ns = if is_slow { self.random.random_range(0..network.slow_max_ns) } else { 0 };
            self.after(MESSAGE_NS + late_ns, SimEvent::Arrival { to, message: message(), is_garbled: false });
            if self.random.random_bool(network.garbled) {
                // In real time a tick may begin with the copy; then its content cannot be recognised as invalid.
                let kinds = if self.plan.clock == Clock::Realtime { 0..2 } else { 0..5 };
                let message = message().garbled(self.random.random_range(kinds));
                self.after(MESSAGE_NS + late_ns, SimEvent::Arrival { to, message, is_garbled: true });
            }
        }
    }

    /// A message reaches a node; true if that wakes its process.
    pub(super) fn arrive(&mut self, to: usize, message: Message, is_garbled: bool) -> bool {
        if to == self.plan.gateway() {
            let is_frame = message.is_frame();
            if matches!(self.nodes[to].process, Process::Gateway) {
                self.gateway.inbox.push(message);
            }
            return is_frame || self.plan.network.wakes_on_arrival;
        }
        let is_frame = message.is_frame();
        let node = &mut self.nodes[to];
        // A starting process may receive messages that were sent before it knew the leader.
        if matches!(node.process, Process::None) {
            return false;
        }
        if node.inbox.len() == INBOX {
            node.inbox.remove(0);
            // An invalid copy is dropped with its original: without it, the copy could not be recognised as invalid.
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
        (is_frame || self.plan.network.wakes_on_arrival) && node.process.is_woken()
    }

    /// The messages that have arrived. A process that was interrupted gets none yet, and reads them at once after its
    /// actions.
    pub(super) fn take_inbox(&mut self, node: usize) -> impl Iterator<Item = Message> + use<> {
        if std::mem::take(&mut self.nodes[node].is_interrupted) {
            self.after(0, SimEvent::Wakes { node, event: Some(Event::World) });
            return Vec::new().into_iter().map(message_of);
        }
        std::mem::take(&mut self.nodes[node].inbox).into_iter().map(message_of)
    }

    /// The first frame that has arrived, as [`Self::take_inbox`] has messages. The others wake the process at once.
    pub(super) fn take_frame(&mut self, node: usize) -> Option<Message> {
        let receiver = &mut self.nodes[node];
        let is_interrupted = std::mem::take(&mut receiver.is_interrupted);
        let frame = if is_interrupted || receiver.inbox.is_empty() { None } else { Some(receiver.inbox.remove(0)) };
        if is_interrupted || !receiver.inbox.is_empty() {
            self.after(0, SimEvent::Wakes { node, event: Some(Event::World) });
        }
        frame.map(message_of)
    }

    /// Wakes the nodes that a role notifies.
    pub(super) fn notify(&mut self, from: usize, Notification { to, event, when }: Notification) {
        if let When::LastAnswer { tick, or_first } = when {
            let group = &mut self.groups[to as usize];
            let answers = group.answers.with(tick);
            group.answers = answers.unwrap_or(group.answers);
            // For an answer of a past tick the group is always notified: the node that needs it waits for nothing else.
            if answers.is_some_and(|answers| !answers.wakes(group.expected as u64, or_first)) {
                return;
            }
        }
        let members = match to {
            WaitGroup::Sim => 0..1,
            WaitGroup::Fusion => self.plan.fusion_nodes(),
            WaitGroup::Robots => self.plan.robot_nodes().start..self.plan.all_nodes().end,
        };
        // A message that arrives wakes its receiver anyway.
        let is_needed = matches!(event, Event::Hello | Event::Finished) || !self.plan.network.wakes_on_arrival;
        for node in members.filter(|node| is_needed && *node != from && !self.plan.is_remote_node(*node)) {
            if !matches!(self.nodes[node].process, Process::Standby(_)) {
                self.after(WAKE_NS, SimEvent::Wakes { node, event: Some(event) });
            }
        }
    }

    /// The header of a node's message.
    pub(super) fn header(&self, node: usize, tick: u64, valid_at_s: f64) -> Header {
        let incarnation = self.nodes[node].incarnation;
        Header { run_id: 1, incarnation, tick, valid_at_s, sent_ns: self.local_ns(node) }
    }
}
