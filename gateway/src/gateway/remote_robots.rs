//! The robots that have joined through the gateway, with their roles and links.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;

use quinn::Connection;
use rangehound_node::bus::{Bus, BusError, Event, Events, Notifier, Publisher, Subscriber, WaitGroup};
use rangehound_node::gateway_note::{GatewayNote, RemoteRobotNote, RobotOrder};
use rangehound_node::rendezvous::{Rendezvous, RendezvousError, Role, RoleLease};
use rangehound_node::system::clock::monotonic_ns;
use rangehound_robot::remote::wire::Uplink;
use rangehound_robot::remote::{Claim, Publication, Relay, RoleHolder};
use rangehound_shared::message::{Command, Drive, Outgoing, Range, WorldEntry};
use rangehound_shared::protocol::wake::Notification;
use rangehound_shared::protocol::{PROGRAM, PROTOCOL};
use tokio::sync::mpsc::Sender;

use super::acceptor::Applicant;
use super::refusals::Refusals;
use super::{GatewayError, Input};
use crate::keys::RefusalCause;
use crate::link::{self, Answer, Notice, Request};

/// Interval of the note about the links.
const NOTE_NS: u64 = 500_000_000;

/// Interval of looks for orders to robots.
const ORDERS_NS: u64 = 100_000_000;

/// All robots that have joined through the gateway.
pub(super) struct RemoteRobots<'a> {
    rendezvous: &'a Rendezvous,
    sender: Sender<Input>,
    bus: Bus,
    worlds: Subscriber<WorldEntry>,
    headings: Subscriber<Command>,
    sim: Notifier,
    fusion: Notifier,
    all: BTreeMap<usize, RemoteRobot>,
    /// Robots whose roles are being taken.
    asked_for: BTreeSet<usize>,
    /// To be published after the ranges, for which the whole team waits.
    drives: Vec<(usize, Outgoing<Drive>, Option<Notification>)>,
    refusals: Rc<RefCell<Refusals>>,
    noted_ns: u64,
    ordered_ns: u64,
}

/// A robot on another host.
struct RemoteRobot {
    lease: RoleLease,
    /// Ports of its own: each has a queue at the receiver, and one for all would lose messages of a large team.
    ranges: Publisher<Range>,
    drives: Publisher<Drive>,
    relay: Relay,
    connection: Connection,
    holder: RoleHolder,
    host: String,
    allows_control: bool,
    notices: Sender<Notice>,
}

impl RemoteRobot {
    /// The round trip of its link, which is known before its first frame comes, ns.
    fn round_trip_ns(&self) -> u64 {
        link::round_trip_ns(&self.connection)
    }
}

/// Why a robot does not get its role.
type Refusal = (RefusalCause, String);

impl<'a> RemoteRobots<'a> {
    pub(super) fn new(
        rendezvous: &'a Rendezvous,
        sender: Sender<Input>,
        refusals: Rc<RefCell<Refusals>>,
    ) -> Result<Self, BusError> {
        let bus = Bus::connect(rendezvous, "gateway")?;
        Ok(Self {
            rendezvous,
            sender,
            worlds: bus.subscriber()?,
            headings: bus.subscriber()?,
            sim: bus.notifier_of(WaitGroup::Sim),
            fusion: bus.notifier_of(WaitGroup::Fusion),
            bus,
            all: BTreeMap::new(),
            asked_for: BTreeSet::new(),
            drives: Vec::new(),
            refusals,
            noted_ns: 0,
            ordered_ns: 0,
        })
    }

    pub(super) fn on_input(&mut self, input: Input) -> Result<(), GatewayError> {
        match input {
            Input::Bus(events) => self.read_bus(events)?,
            Input::Applicant(applicant) => self.on_applicant(applicant),
            Input::Lease(applicant, lease) => self.on_lease(applicant, lease),
            Input::Frame { robot, connection, bytes } => self.on_frame(robot, connection, &bytes)?,
            Input::Ordered { robot, has_arrived } => self.report_order(robot, has_arrived),
            // No robot is informed while the run goes on.
            Input::Informed { .. } => {}
            Input::Leaving { robot, connection } => {
                // With its role, what it has driven would be lost.
                self.publish_drives()?;
                if self.all.get(&robot).is_some_and(|remote| remote.connection.stable_id() == connection) {
                    self.release(robot, "has left");
                }
            }
        }
        Ok(())
    }

    /// Tells the tool that gave an order what has become of it.
    fn report_order(&self, robot: usize, has_arrived: bool) {
        if let Err(error) = RobotOrder::report(self.rendezvous, robot, has_arrived) {
            log::debug!("{error}");
        }
    }

    /// Drains the topics whose events came, or all topics after a time-out.
    fn read_bus(&mut self, events: Events) -> Result<(), BusError> {
        let Self { worlds, headings, all, .. } = self;
        let now_ns = monotonic_ns();
        let mut again = Vec::new();
        if events.has(Event::World) || events.is_empty() {
            worlds.drain(|header, entries| {
                for (robot, remote) in all.iter_mut() {
                    let answers = entries.get(*robot).map(|entry| remote.relay.on_world(header, entry));
                    again.extend(answers.into_iter().flatten().map(|message| (*robot, message)));
                }
            })?;
        }
        if events.has(Event::Heading) || events.is_empty() {
            let robots = self.rendezvous.description().scenario.robots.len();
            headings.drain(|header, commands| {
                for (robot, remote) in all.iter_mut().filter(|_| commands.len() == robots) {
                    remote.relay.on_heading(header, commands[*robot], now_ns);
                }
            })?;
            headings.take_impostors();
        }
        again.into_iter().try_for_each(|(robot, message)| self.publish(robot, message))
    }

    fn on_frame(&mut self, robot: usize, connection: usize, bytes: &[u8]) -> Result<(), BusError> {
        let run_id = self.rendezvous.description().run_id;
        let is_it = |remote: &&mut RemoteRobot| remote.connection.stable_id() == connection;
        let Some(remote) = self.all.get_mut(&robot).filter(is_it) else { return Ok(()) };
        let now_ns = monotonic_ns();
        let news = Uplink::from_bytes(bytes, run_id).and_then(|frame| remote.relay.on_uplink(&frame, now_ns));
        let news = match news {
            Ok(news) => news,
            Err(error) => {
                let what = format_args!("sends an invalid frame for robot-{robot}: {error}");
                self.refusals.borrow_mut().add(remote.connection.remote_address().ip(), error.name(), what);
                return Ok(());
            }
        };
        remote.holder.hear(now_ns);
        news.into_iter().try_for_each(|message| self.publish(robot, message))
    }

    fn publish(&mut self, robot: usize, message: Publication) -> Result<(), BusError> {
        match message {
            Publication::Range(range, notification) => {
                let Some(remote) = self.all.get(&robot) else { return Ok(()) };
                self.bus.mark_messages(remote.lease.incarnation);
                remote.ranges.send_one(&range)?;
                self.fusion.notify(&notification);
            }
            Publication::Drive(drive, notification) => self.drives.push((robot, drive, notification)),
        }
        Ok(())
    }

    /// Publishes what the robots drive, after everything that has come is read.
    pub(super) fn publish_drives(&mut self) -> Result<(), BusError> {
        for (robot, drive, notification) in self.drives.drain(..) {
            let Some(remote) = self.all.get(&robot) else { continue };
            self.bus.mark_messages(remote.lease.incarnation);
            remote.drives.send_one(&drive)?;
            notification.iter().for_each(|notification| self.sim.notify(notification));
        }
        Ok(())
    }

    /// Welcomes a robot that connects again, asks for the role of another one, or says why it does not get it.
    fn on_applicant(&mut self, applicant: Box<Applicant>) {
        match self.check(&applicant).and_then(|()| self.reconnect(&applicant)) {
            Ok(true) => self.welcome(*applicant),
            Ok(false) => self.ask_for_role(applicant),
            Err(refusal) => self.refuse(*applicant, refusal),
        }
    }

    fn check(&self, applicant: &Applicant) -> Result<(), Refusal> {
        let Applicant { request: Request { protocol, program, robot, run, .. }, peer, .. } = applicant;
        let name = self.rendezvous.name().to_string();
        if *protocol != PROTOCOL {
            let program: String = program.chars().filter(char::is_ascii_graphic).take(16).collect();
            let text = format!(
                "the robot's host has rangehound {program} (protocol {protocol}), the run's host has {PROGRAM} (protocol {PROTOCOL}): use one version"
            );
            return Err((RefusalCause::Version, text));
        }
        if run.as_ref().is_some_and(|run| *run != name) {
            return Err((RefusalCause::Run, format!("this is the gateway of run {name} (--name)")));
        }
        let robots = self.rendezvous.description().scenario.robots.len();
        if *robot >= robots {
            let text = format!("robot {robot} (--id) is not in this run: expected 0 to {}", robots - 1);
            return Err((RefusalCause::NoSuchRobot, text));
        }
        match peer {
            Some(peer) if !peer.may_be(*robot) => Err((
                RefusalCause::WrongRobot,
                format!(
                    "the certificate of {} does not name robot-{robot}: use the keys of its host, or make new ones with \
                     rangehound keys --host",
                    peer.host
                ),
            )),
            _ => Ok(()),
        }
    }

    /// True if it is the process that has the role. Frees the role of one that is not heard any more.
    fn reconnect(&mut self, applicant: &Applicant) -> Result<bool, Refusal> {
        let Applicant { request: Request { robot, process, .. }, connection, notices, .. } = applicant;
        let Some(remote) = self.all.get_mut(robot) else { return Ok(false) };
        let now_ns = monotonic_ns();
        match remote.holder.claim(*process, remote.round_trip_ns(), now_ns) {
            Claim::ComesBack => {
                remote.connection.close(link::REPLACED, b"the robot has connected again");
                (remote.connection, remote.notices) = (connection.clone(), notices.clone());
                remote.relay.reconnect();
                Ok(true)
            }
            Claim::Refused => Err((
                RefusalCause::RoleTaken,
                format!("host {} already runs this robot: end it there, or choose another --id", remote.host),
            )),
            Claim::Succeeds => {
                self.release(*robot, "starts again");
                Ok(false)
            }
        }
    }

    /// Takes the role in a thread of its own: a lock that another process holds must not delay the ticks of the team.
    fn ask_for_role(&mut self, applicant: Box<Applicant>) {
        let robot = applicant.request.robot;
        if !self.asked_for.insert(robot) {
            return self.refuse(*applicant, (RefusalCause::RoleTaken, "this robot is already joining".to_owned()));
        }
        let (roster, sender) = (self.rendezvous.roster().clone(), self.sender.clone());
        tokio::task::spawn_blocking(move || {
            let lease = roster.take(Role::Robot(robot));
            // An error means that the gateway ends.
            let _ = sender.blocking_send(Input::Lease(applicant, lease));
        });
    }

    fn on_lease(&mut self, applicant: Box<Applicant>, lease: Result<RoleLease, RendezvousError>) {
        self.asked_for.remove(&applicant.request.robot);
        // It has given up: its role is free again.
        if applicant.answer.is_closed() || applicant.connection.close_reason().is_some() {
            return;
        }
        let lease = lease.map_err(|error| match error {
            RendezvousError::RoleTaken { .. } => (RefusalCause::RoleTaken, error.to_string()),
            error => (RefusalCause::Other, error.to_string()),
        });
        match lease.and_then(|lease| self.admit(&applicant, lease)) {
            Ok(()) => self.welcome(*applicant),
            Err(refusal) => self.refuse(*applicant, refusal),
        }
    }

    fn admit(&mut self, applicant: &Applicant, lease: RoleLease) -> Result<(), Refusal> {
        let Applicant { request: Request { robot, process, allows_control, .. }, peer, connection, notices, .. } =
            applicant;
        let (robot, process, allows_control) = (*robot, *process, *allows_control);
        let address = connection.remote_address();
        let host = peer.as_ref().map_or_else(|| address.ip().to_string(), |peer| peer.host.clone());
        let other = |error: BusError| (RefusalCause::Other, error.to_string());
        self.bus.take_role(self.rendezvous, Role::Robot(robot), &lease).map_err(other)?;
        let ranges = self.bus.publisher_of_robot(robot).map_err(other)?;
        let drives = self.bus.publisher_of_robot(robot).map_err(other)?;
        log::info!("robot-{robot} joins from {host} ({address})");
        let description = self.rendezvous.description();
        let fusion_incarnation = self.rendezvous.roster().starts(Role::Fusion);
        let relay = Relay::new(description.run_id, robot, &description.scenario, fusion_incarnation);
        // An order is for the process that had the role when it was given.
        if RobotOrder::take(self.rendezvous, robot).is_some() {
            self.report_order(robot, false);
        }
        let (connection, notices) = (connection.clone(), notices.clone());
        let holder = RoleHolder::new(process, monotonic_ns());
        let remote = RemoteRobot { lease, ranges, drives, relay, connection, holder, host, allows_control, notices };
        self.all.insert(robot, remote);
        self.sim.signal(Event::Hello);
        Ok(())
    }

    fn welcome(&mut self, applicant: Applicant) {
        let welcome = match self.rendezvous.description().seal() {
            Ok(description) => {
                let fusion_incarnation = self.rendezvous.roster().starts(Role::Fusion);
                Answer::Welcome { description, life: self.rendezvous.life(), fusion_incarnation }
            }
            Err(error) => return self.refuse(applicant, (RefusalCause::Other, error.to_string())),
        };
        let _ = applicant.answer.send(welcome);
    }

    fn refuse(&mut self, applicant: Applicant, (cause, text): Refusal) {
        let (robot, address) = (applicant.request.robot, applicant.connection.remote_address().ip());
        self.refusals.borrow_mut().add(address, cause.name(), format_args!("is refused: robot-{robot}: {text}"));
        let may_change = matches!(cause, RefusalCause::RoleTaken | RefusalCause::Other);
        let _ = applicant.answer.send(Answer::Refused { text, may_change });
    }

    fn release(&mut self, robot: usize, why: &str) {
        if let Some(remote) = self.all.remove(&robot) {
            log::info!("robot-{robot} of {} {why}", remote.host);
            remote.connection.close(link::SILENT, why.as_bytes());
        }
    }

    /// Renews the roles of the robots that are heard, releases those of the others, and passes on orders of this host's tools.
    pub(super) fn look(&mut self, now_ns: u64) {
        let is_heard = |remote: &&RemoteRobot| remote.holder.is_heard(remote.round_trip_ns(), now_ns);
        self.all.values().filter(is_heard).for_each(|remote| remote.lease.renew(now_ns));
        let gone = self.all.iter().filter(|(_, remote)| remote.holder.is_gone(now_ns)).map(|(robot, _)| *robot);
        for robot in gone.collect::<Vec<_>>() {
            self.release(robot, "is silent: its role is free");
        }
        if now_ns >= self.ordered_ns.saturating_add(ORDERS_NS) {
            self.ordered_ns = now_ns;
            for (robot, remote) in self.all.iter().filter(|(_, remote)| remote.allows_control) {
                if let Some(order) = RobotOrder::take(self.rendezvous, *robot) {
                    let (notice, what) = match order {
                        RobotOrder::Kill => (Notice::Kill, "is killed from the run's host"),
                        RobotOrder::End => (Notice::End, "is asked to end from the run's host"),
                    };
                    log::info!("robot-{robot} of {} {what}", remote.host);
                    if remote.notices.try_send(notice).is_err() {
                        self.report_order(*robot, false);
                    }
                }
            }
        }
        if now_ns >= self.noted_ns.saturating_add(NOTE_NS) {
            self.noted_ns = now_ns;
            if let Err(error) = self.note(now_ns).write(self.rendezvous) {
                log::debug!("{error}");
            }
        }
    }

    fn note(&self, now_ns: u64) -> GatewayNote {
        let robots = self.all.iter().map(|(robot, remote)| {
            let path = remote.connection.stats().path;
            let [sent, repeated] = remote.relay.counts();
            RemoteRobotNote {
                robot: *robot,
                host: remote.host.clone(),
                address: remote.connection.remote_address().to_string(),
                round_trip_us: remote.relay.round_trip_ns().map(|ns| ns / 1_000),
                lost: path.lost_packets as f64 / path.sent_packets.max(1) as f64,
                repeated: repeated as f64 / sent.max(1) as f64,
                silent_ms: remote.holder.silence_ns(now_ns) / 1_000_000,
                allows_control: remote.allows_control,
            }
        });
        let refusals = self.refusals.borrow();
        let refusals = refusals.counts().iter().map(|(cause, count)| ((*cause).to_owned(), *count));
        GatewayNote { pid: std::process::id(), robots: robots.collect(), refusals: refusals.collect() }
    }

    /// The robots that have joined.
    pub(super) fn robots(&self) -> BTreeSet<usize> {
        self.all.keys().copied().collect()
    }

    /// When the next frame is due, ns.
    pub(super) fn wakes_at_ns(&self) -> u64 {
        self.all.values().map(|remote| remote.relay.wakes_at_ns()).min().unwrap_or(u64::MAX)
    }

    /// Sends every frame that is due.
    pub(super) fn send_frames(&mut self) {
        for remote in self.all.values_mut() {
            if let Some(frame) = remote.relay.next_frame(monotonic_ns()) {
                // A datagram that cannot be sent counts as lost.
                let _ = remote.connection.send_datagram(frame.to_bytes().into());
            }
        }
    }
}
