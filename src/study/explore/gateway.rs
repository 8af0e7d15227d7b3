//! The gateway of a team: its state.

use std::collections::BTreeMap;

use rangehound_robot::remote::{Claim, Publication, Relay, RoleHolder};
use rangehound_shared::scenario::Scenario;

use super::checker::link::LinkChecker;
use super::message::Message;
use super::node::{Node, Process};

/// There is only one run here.
pub(super) const RUN_ID: u64 = 1;

/// The gateway and what the run's roster has about its robots.
#[derive(Debug, Default)]
pub(super) struct Gateway {
    /// Messages and frames that have arrived.
    pub(super) inbox: Vec<Message>,
    pub(super) remote_robots: BTreeMap<usize, RemoteRobot>,
    /// The kill that is due, and the number of actions before it.
    pub(super) pending_kill: Option<(usize, u32)>,
    /// Links that robots have opened so far.
    connections: u64,
    /// How often each robot's role was taken: lives on in the roster.
    taken: BTreeMap<usize, u64>,
}

/// A robot that has joined.
#[derive(Debug)]
pub(super) struct RemoteRobot {
    pub(super) relay: Relay,
    /// How often its role had been taken.
    pub(super) incarnation: u64,
    pub(super) connection: u64,
    /// Its process, by the life of its node.
    holder: RoleHolder,
    joined_ns: u64,
    pub(super) checker: LinkChecker,
}

/// The process that asks for a robot's role.
#[derive(Debug, Clone, Copy)]
pub(super) struct Applicant {
    pub(super) robot: usize,
    /// The life of its node.
    pub(super) process: u32,
}

/// An open link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Joined {
    pub(super) connection: u64,
    /// The robot's role was taken; otherwise it had it.
    pub(super) is_new: bool,
}

impl Gateway {
    /// It is killed: all roles and links are lost.
    pub(super) fn die(&mut self) {
        self.pending_kill = None;
        self.inbox.clear();
        self.remote_robots.clear();
    }

    /// The roster of the run is lost.
    pub(super) fn forget_roles(&mut self) {
        self.taken.clear();
    }

    /// Gives a robot its role, unless another process has it and was heard lately.
    pub(super) fn welcome(
        &mut self,
        scenario: &Scenario,
        Applicant { robot, process }: Applicant,
        fusion_incarnation: u64,
        now_ns: u64,
    ) -> Option<Joined> {
        if let Some(remote) = self.remote_robots.get_mut(&robot) {
            match remote.holder.claim(process.into(), remote.relay.round_trip_ns().unwrap_or(0), now_ns) {
                Claim::ComesBack => {
                    self.connections += 1;
                    (remote.connection, remote.joined_ns) = (self.connections, now_ns);
                    remote.relay.reconnect();
                    return Some(Joined { connection: self.connections, is_new: false });
                }
                Claim::Refused => return None,
                Claim::Succeeds => {}
            }
        }
        self.connections += 1;
        let taken = self.taken.entry(robot).or_default();
        *taken += 1;
        let remote = RemoteRobot {
            relay: Relay::new(RUN_ID, robot, scenario, fusion_incarnation),
            incarnation: *taken,
            connection: self.connections,
            holder: RoleHolder::new(process.into(), now_ns),
            joined_ns: now_ns,
            checker: LinkChecker::new(scenario, fusion_incarnation, now_ns),
        };
        self.remote_robots.insert(robot, remote);
        Some(Joined { connection: self.connections, is_new: true })
    }

    /// Takes a message of the run or a frame of a robot. Returns what is to be published for which robots.
    pub(super) fn take(
        &mut self,
        message: &Message,
        robots: usize,
        now_ns: u64,
    ) -> Result<Vec<(usize, Publication)>, (usize, String)> {
        let mut publications = Vec::new();
        match message {
            Message::World(header, entries) => {
                for (robot, remote) in &mut self.remote_robots {
                    let Some(entry) = entries.get(*robot) else { continue };
                    remote.checker.world(header, entry);
                    let again = remote.relay.on_world(header, entry);
                    publications.extend(again.into_iter().map(|message| (*robot, message)));
                }
            }
            Message::Heading(header, commands) if commands.len() == robots => {
                for (robot, remote) in &mut self.remote_robots {
                    remote.checker.heading(header);
                    remote.relay.on_heading(header, commands[*robot], now_ns);
                }
            }
            Message::Uplink { robot, connection, frame } => {
                let remote = self.remote_robots.get_mut(robot).filter(|remote| remote.connection == *connection);
                if let Some(remote) = remote {
                    remote.holder.hear(now_ns);
                    let news = remote.relay.on_uplink(frame, now_ns).map_err(|error| (*robot, error.to_string()))?;
                    remote.checker.news(&news).map_err(|what| (*robot, what))?;
                    publications.extend(news.into_iter().map(|message| (*robot, message)));
                }
            }
            _ => {}
        }
        for (robot, publication) in &publications {
            if let Some(remote) = self.remote_robots.get(robot) {
                remote.checker.publishes(publication).map_err(|what| (*robot, what))?;
            }
        }
        Ok(publications)
    }

    /// Forgets the robots that have been silent for long, and returns them.
    pub(super) fn release_silent(&mut self, now_ns: u64) -> Vec<usize> {
        let is_gone = |remote: &RemoteRobot| remote.holder.is_gone(now_ns);
        let gone = self.remote_robots.iter().filter(|(_, remote)| is_gone(remote)).map(|(robot, _)| *robot).collect();
        self.remote_robots.retain(|_, remote| !is_gone(remote));
        gone
    }

    /// When a frame is due, ns.
    pub(super) fn frame_due_ns(&self) -> u64 {
        self.remote_robots.values().map(|remote| remote.relay.wakes_at_ns()).min().unwrap_or(u64::MAX)
    }

    /// Time for which the robot's process has had an open link, ns.
    pub(super) fn linked_for_ns(&self, robot: usize, node: &Node, now_ns: u64) -> u64 {
        let Process::Robot(process) = &node.process else { return 0 };
        let connection = process.remote.as_ref().and_then(|remote| remote.connection());
        let remote = self.remote_robots.get(&robot).filter(|remote| Some(remote.connection) == connection);
        remote.map_or(0, |remote| now_ns - remote.joined_ns)
    }
}
