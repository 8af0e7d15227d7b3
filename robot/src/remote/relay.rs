//! The gateway's end of the link to one robot.

use rangehound_shared::message::{Command, Drive, Header, Outgoing, Range, WorldEntry};
use rangehound_shared::protocol::wake::{Event, Notification, WaitGroup};
use rangehound_shared::scenario::{Clock, Scenario};

use super::RoundTrip;
use super::wire::{Downlink, Driven, FrameError, Heading, Measured, Ticks, Uplink, World};

/// Interval of frames that only show that the link works, ns: longer than a tick of a tenth of a second, which has its own frames.
const KEEP_ALIVE_NS: u64 = 120_000_000;

/// A message of the robot for the run's host, and the node that waits for it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Publication {
    /// On the topic `range`.
    Range(Outgoing<Range>, Notification),
    /// On the topic `drive`. In real time nobody waits for it.
    Drive(Outgoing<Drive>, Option<Notification>),
}

/// The newest messages to and from a robot. If it is lost, the next one learns them from the repeats of both sides.
#[derive(Debug)]
pub struct Relay {
    run_id: u64,
    robot: usize,
    clock: Clock,
    last_tick: u64,
    /// Greatest known incarnation of fusion: headings of earlier ones are not sent.
    fusion_incarnation: u64,
    world: Option<World>,
    heading: Option<Heading>,
    /// Its measurement of the present tick.
    measured: Option<Measured>,
    /// Its drive in the present tick.
    driven: Option<Outgoing<Drive>>,
    /// When measurement and heading of the present tick came, ns.
    measured_at_ns: Option<u64>,
    heading_at_ns: Option<u64>,
    /// When that heading was sent first, ns.
    heading_sent_ns: Option<u64>,
    heard: Ticks,
    round_trip: RoundTrip,
    /// It has news for the robot.
    has_news: bool,
    /// The simulator waits for an answer that this relay does not have.
    asks_again: bool,
    sent_at_ns: u64,
    repeats: u32,
    /// Frames sent since the robot joined, and how many of them were repeats.
    counts: [u64; 2],
}

impl Relay {
    /// The link to a robot that has just joined; `fusion_incarnation` is the newest of fusion.
    #[must_use]
    pub fn new(run_id: u64, robot: usize, scenario: &Scenario, fusion_incarnation: u64) -> Self {
        Self {
            run_id,
            robot,
            clock: scenario.clock,
            last_tick: scenario.ticks,
            fusion_incarnation,
            world: None,
            heading: None,
            measured: None,
            driven: None,
            measured_at_ns: None,
            heading_at_ns: None,
            heading_sent_ns: None,
            heard: Ticks::default(),
            round_trip: RoundTrip::default(),
            has_news: true,
            asks_again: false,
            sent_at_ns: 0,
            repeats: 0,
            counts: [0; 2],
        }
    }

    /// Takes a message of the topic `world` for this robot. If the simulator repeats one that the robot has answered, the
    /// answers are returned again.
    pub fn on_world(&mut self, header: &Header, entry: &WorldEntry) -> Vec<Publication> {
        // The robot would refuse it, and it would hide the right ones.
        if header.tick > self.last_tick || !header.valid_at_s.is_finite() || !entry.is_valid() {
            return Vec::new();
        }
        let news = (header.incarnation, header.tick);
        let known = self.world.map(|world| (world.incarnation, world.tick));
        if known.is_some_and(|known| news < known) {
            return Vec::new();
        }
        let is_same_tick = self.world.is_some_and(|world| world.tick == header.tick);
        let Header { incarnation, tick, valid_at_s, .. } = *header;
        self.world = Some(World { incarnation, tick, valid_at_s, entry: *entry });
        if !is_same_tick {
            // A robot that has joined a new gateway may have answered this tick before its world came here.
            self.measured = self.measured.filter(|measured| measured.tick == tick);
            self.measured_at_ns = self.measured_at_ns.filter(|_| self.measured.is_some());
            (self.driven, self.heading_at_ns, self.heading_sent_ns) = (None, None, None);
            self.heading = self.heading.filter(|heading| heading.tick == tick);
            (self.has_news, self.repeats) = (true, 0);
            return Vec::new();
        }
        // Fusion may wait for the measurement until the robot has its heading.
        let measured = self.measured.filter(|measured| measured.tick == tick && !self.is_obeyed());
        let range = measured.map(|range| self.range(&range, Notification::always(WaitGroup::Fusion, Event::Range)));
        let notification = Notification::always(WaitGroup::Sim, Event::Drive);
        let drive = self.driven.map(|driven| Publication::Drive(driven, Some(notification)));
        if range.is_none() && drive.is_none() {
            (self.has_news, self.asks_again) = (true, true);
        }
        range.into_iter().chain(drive).collect()
    }

    /// Takes a message of the topic `heading` for this robot, which came at `now_ns`.
    pub fn on_heading(&mut self, header: &Header, command: Command, now_ns: u64) {
        let Header { incarnation, tick, .. } = *header;
        if incarnation < self.fusion_incarnation || tick > self.last_tick {
            return;
        }
        self.fusion_incarnation = incarnation;
        self.heading = self.heading.filter(|known| known.incarnation == incarnation);
        let is_past = self.world.is_some_and(|world| tick < world.tick);
        let is_older = self.heading.is_some_and(|known| (incarnation, tick) <= (known.incarnation, known.tick));
        if is_past || is_older {
            return;
        }
        self.heading = Some(Heading { incarnation, tick, command });
        if !self.is_obeyed() {
            self.heading_at_ns.get_or_insert(now_ns);
            (self.has_news, self.repeats) = (true, 0);
        }
    }

    /// Takes a frame of the robot, which came at `now_ns`. Returns what is new in it.
    ///
    /// # Errors
    /// [`FrameError::AfterEnd`] if the run does not have a tick of the frame, of which nothing is then taken.
    pub fn on_uplink(&mut self, frame: &Uplink, now_ns: u64) -> Result<Vec<Publication>, FrameError> {
        let ticks = frame.measured.iter().map(|measured| measured.tick).chain(frame.driven.map(|driven| driven.tick));
        // Such a measurement would make all before it count as known.
        if let Some(tick) = ticks.max().filter(|tick| *tick > self.last_tick) {
            return Err(FrameError::AfterEnd(tick));
        }
        if let Some(echo) = frame.echo
            && let Some(elapsed_ns) = now_ns.checked_sub(echo.sent_ns)
        {
            self.round_trip.add(elapsed_ns.saturating_sub(echo.held_ns));
        }
        let mut news = Vec::new();
        for measured in &frame.measured {
            if !self.heard.has(measured.tick) {
                news.push(self.take_measured(measured, now_ns));
            }
        }
        news.extend(frame.driven.as_ref().and_then(|driven| self.take_driven(driven, now_ns)));
        Ok(news)
    }

    fn take_measured(&mut self, measured: &Measured, now_ns: u64) -> Publication {
        self.heard.add(measured.tick);
        let is_past = self.world.is_some_and(|world| measured.tick < world.tick);
        if !is_past && self.measured.is_none_or(|known| known.tick <= measured.tick) {
            (self.measured, self.measured_at_ns, self.repeats) = (Some(*measured), Some(now_ns), 0);
        }
        let or_first = self.clock == Clock::Realtime;
        self.range(measured, Notification::by_last_answer(WaitGroup::Fusion, Event::Range, measured.tick, or_first))
    }

    fn range(&self, measured: &Measured, notification: Notification) -> Publication {
        let Measured { tick, valid_at_s, measurement } = *measured;
        let entry = Range { robot: self.robot as u64, measurement };
        Publication::Range(Outgoing { tick, valid_at_s, entry }, notification)
    }

    /// Only the first report with a heading replaces one without: all others are repeats.
    fn take_driven(&mut self, driven: &Driven, now_ns: u64) -> Option<Publication> {
        let is_present = self.world.is_some_and(|world| world.tick == driven.tick);
        let is_known =
            self.driven.is_some_and(|known| known.entry.heading_held_ns != 0 || driven.heading_after_ns.is_none());
        if !is_present || is_known {
            return None;
        }
        let is_first = self.driven.is_none();
        let entry = self.drive_of(driven, now_ns);
        let message = Outgoing { tick: driven.tick, valid_at_s: driven.valid_at_s, entry };
        self.driven = Some(message);
        self.repeats = 0;
        let is_waited_for = self.clock == Clock::Lockstep || driven.tick == 0;
        let notification = is_waited_for.then(|| match is_first {
            true => Notification::by_last_answer(WaitGroup::Sim, Event::Drive, driven.tick, false),
            false => Notification::always(WaitGroup::Sim, Event::Drive),
        });
        Some(Publication::Drive(message, notification))
    }

    /// The message with the robot's durations as stamps of the gateway's clock. The time beyond this host's run is what the robot
    /// waited longer than the gateway; half of it is put on each way. Each end tells its own part of it.
    fn drive_of(&self, driven: &Driven, now_ns: u64) -> Drive {
        let Driven { command, has_measured, heading_after_ns, host_ns, heading_late, headings_refused, .. } = *driven;
        let whole_ns = heading_after_ns.unwrap_or(0);
        let (network_ns, sent_ns) = match (self.measured_at_ns, self.heading_at_ns, heading_after_ns) {
            (Some(measured_ns), Some(heading_ns), Some(_)) => {
                let network_ns = whole_ns.saturating_sub(heading_ns.saturating_sub(measured_ns));
                (network_ns, measured_ns.saturating_sub(network_ns / 2))
            }
            (Some(measured_ns), _, None) => (0, measured_ns),
            _ => (0, now_ns.saturating_sub(whole_ns)),
        };
        let sent_ns = sent_ns.max(1);
        let network_ns = if has_measured { network_ns } else { 0 };
        let gateway_ns =
            self.heading_sent_ns.zip(self.heading_at_ns).map_or(0, |(sent_ns, at_ns)| sent_ns.saturating_sub(at_ns));
        let part = |ns: u64| u32::try_from(ns).unwrap_or(u32::MAX);
        let robot_host_ns = part(network_ns.min(host_ns.into()));
        Drive {
            robot: self.robot as u64,
            heading_rad: command.heading_rad,
            speed_mps: command.speed_mps,
            range_sent_ns: if has_measured { sent_ns } else { 0 },
            heading_held_ns: heading_after_ns.map_or(0, |after_ns| sent_ns.saturating_add(after_ns)),
            heading_late: u32::from(heading_late),
            headings_refused,
            network_ns,
            robot_host_ns,
            gateway_ns: part(gateway_ns.min(network_ns - u64::from(robot_host_ns))),
        }
    }

    /// The next frame for the robot, if one is due.
    pub fn next_frame(&mut self, now_ns: u64) -> Option<Downlink> {
        if now_ns < self.wakes_at_ns() {
            return None;
        }
        let is_repeat = !self.has_news && self.awaits_answer();
        // A repeated world makes the robot repeat its answer.
        let awaits_measurement = self.awaits_measurement();
        let world = self.world.filter(|_| awaits_measurement || is_repeat || self.asks_again);
        let heading = self.heading.filter(|_| self.awaits_drive());
        if heading.is_some() {
            self.heading_sent_ns.get_or_insert(now_ns);
        }
        (self.has_news, self.asks_again) = (false, false);
        self.repeats = self.repeats.saturating_add(u32::from(is_repeat));
        self.sent_at_ns = now_ns;
        self.counts = [self.counts[0] + 1, self.counts[1] + u64::from(is_repeat)];
        let repeat_after_ns = self.round_trip.interval_ns(0);
        Some(Downlink { run_id: self.run_id, sent_ns: now_ns, world, heading, heard: self.heard, repeat_after_ns })
    }

    /// When the next frame is due if nothing comes, ns.
    #[must_use]
    pub fn wakes_at_ns(&self) -> u64 {
        if self.has_news {
            return 0;
        }
        let repeat_after_ns = if self.awaits_answer() { self.round_trip.interval_ns(self.repeats) } else { u64::MAX };
        self.sent_at_ns.saturating_add(repeat_after_ns.min(KEEP_ALIVE_NS))
    }

    /// The robot is there again, after its link was cut: it gets a frame at once.
    pub fn reconnect(&mut self) {
        (self.has_news, self.repeats) = (true, 0);
    }

    /// The smoothed round trip to the robot, ns, if it has answered.
    #[must_use]
    pub fn round_trip_ns(&self) -> Option<u64> {
        self.round_trip.mean_ns()
    }

    /// Frames sent, and how many of them were repeats.
    #[must_use]
    pub fn counts(&self) -> [u64; 2] {
        self.counts
    }

    fn awaits_answer(&self) -> bool {
        self.awaits_measurement() || self.awaits_drive()
    }

    fn awaits_measurement(&self) -> bool {
        self.world.is_some_and(|world| !self.heard.has(world.tick))
    }

    fn awaits_drive(&self) -> bool {
        let is_present = |heading: Heading| self.world.is_none_or(|world| world.tick == heading.tick);
        self.heading.is_some_and(is_present) && !self.is_obeyed()
    }

    fn is_obeyed(&self) -> bool {
        self.driven.is_some_and(|driven| driven.entry.heading_held_ns != 0)
    }
}
