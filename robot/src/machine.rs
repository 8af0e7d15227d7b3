//! The robot's part in the protocol as a state machine: no clock, no port, no sensor.
//!
//! A driver feeds it with messages ([`Machine::on_world`], [`Machine::on_heading`]), asks for the next [`Action`], carries
//! it out, and asks again until there is none. Two actions are answered: [`Action::Measure`] by [`Machine::measured`],
//! [`Action::CarryOut`] by [`Machine::carried_out`]. Time is an argument: monotonic, ns, of the robot's own clock. All deadlines
//! count from when this robot received a message: the clocks of other hosts may show any time.

use std::collections::VecDeque;

use rangehound_shared::measurement::Measurement;
use rangehound_shared::message::{Command, Drive, Header, Outgoing, Range, WorldEntry};
use rangehound_shared::protocol::timing::heading_deadline_ns;
use rangehound_shared::protocol::wake::{Event, Notification, WaitGroup};
use rangehound_shared::scenario::{Clock, Scenario};

use crate::drive::{Controller, HOLD_TICKS};

/// The driver's next action.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Action {
    /// Ask localiser and sensor for the measurement of a tick, and answer with [`Machine::measured`].
    Measure {
        /// The tick.
        tick: u64,
        /// Its time, s.
        time_s: f64,
        /// This robot's entry of the world.
        entry: WorldEntry,
    },
    /// Have the actuator carry out a command, and answer with [`Machine::carried_out`].
    CarryOut(Command),
    /// Publish [`Machine::range`].
    SendRange,
    /// Publish a drive.
    SendDrive(Outgoing<Drive>),
    /// Notify another node.
    Notify(Notification),
}

/// One robot in one incarnation. It needs no checkpoint: after a restart it continues with the present tick.
#[derive(Debug)]
pub struct Machine {
    id: usize,
    robots: usize,
    last_tick: u64,
    clock: Clock,
    dt_s: f64,
    controller: Controller,
    is_moving: bool,
    /// The newest world message that has not been processed.
    world: Option<World>,
    /// The newest heading received: its tick and this robot's command.
    heading: Option<(u64, Command)>,
    present: Option<Present>,
    /// The action that the driver has not answered yet.
    asked: Option<Asked>,
    /// Greatest known incarnation of fusion: headings of earlier ones are ignored.
    fusion_incarnation: u64,
    headings_refused: u32,
    actions: VecDeque<Action>,
}

/// A world message, as far as it concerns this robot, and when it was received.
#[derive(Debug, Clone, Copy)]
struct World {
    sim_incarnation: u64,
    tick: u64,
    time_s: f64,
    entry: WorldEntry,
    at_ns: u64,
}

/// The present tick of a robot.
#[derive(Debug, Clone, Copy)]
struct Present {
    sim_incarnation: u64,
    tick: u64,
    time_s: f64,
    /// When its world was received first.
    began_ns: u64,
    range: Range,
    range_sent_ns: u64,
    /// True once the default command, for the case that no heading arrives, has been published.
    provided: bool,
    drive: Option<Drive>,
}

#[derive(Debug, Clone, Copy)]
enum Asked {
    /// The measurement at a tick, whose world was received at this time.
    Range { sim_incarnation: u64, tick: u64, time_s: f64, began_ns: u64 },
    /// A command from a heading that was received at this time; 0 without a heading.
    Drive { heading_held_ns: u64, is_late: bool },
    /// A stop, for which no message is published.
    Stop,
}

impl Machine {
    /// A robot that starts, by id; `fusion_incarnation` is the newest of fusion. `None` if the scenario has no such robot.
    #[must_use]
    pub fn new(scenario: &Scenario, id: usize, fusion_incarnation: u64) -> Option<Self> {
        let mut machine = Self {
            id,
            robots: scenario.robots.len(),
            last_tick: scenario.ticks,
            clock: scenario.clock,
            dt_s: scenario.dt_s,
            controller: Controller::new(scenario.robots.get(id)?.speed_mps),
            is_moving: false,
            world: None,
            heading: None,
            present: None,
            asked: None,
            fusion_incarnation,
            headings_refused: 0,
            actions: VecDeque::with_capacity(4),
        };
        machine.notify(Notification::always(WaitGroup::Sim, Event::Hello));
        Some(machine)
    }

    /// Takes a message of the topic `world`, received at `now_ns`.
    pub fn on_world(&mut self, header: &Header, entries: &[WorldEntry], now_ns: u64) {
        if let Some(entry) = entries.get(self.id) {
            self.on_own_world(header, entry, now_ns);
        }
    }

    /// Takes this robot's part of a message of the topic `world`, received at `now_ns`.
    pub fn on_own_world(&mut self, header: &Header, entry: &WorldEntry, now_ns: u64) {
        if header.tick <= self.last_tick && header.valid_at_s.is_finite() && entry.is_valid() {
            let Header { incarnation: sim_incarnation, tick, valid_at_s: time_s, .. } = *header;
            self.world = Some(World { sim_incarnation, tick, time_s, entry: *entry, at_ns: now_ns });
        }
    }

    /// Takes a message of the topic `heading`; those of a deposed fusion are ignored.
    pub fn on_heading(&mut self, header: &Header, commands: &[Command]) {
        self.on_own_heading(header, commands.get(self.id).filter(|_| commands.len() == self.robots));
    }

    /// Takes this robot's part of a message of the topic `heading`, if the message has one.
    pub fn on_own_heading(&mut self, header: &Header, command: Option<&Command>) {
        if header.incarnation < self.fusion_incarnation {
            self.refuse_headings(1);
            return;
        }
        self.fusion_incarnation = header.incarnation;
        if let Some(command) = command {
            self.heading = Some((header.tick, *command));
        }
    }

    /// Counts headings of processes that do not lead.
    pub fn refuse_headings(&mut self, count: u64) {
        let count = u32::try_from(count).unwrap_or(u32::MAX);
        self.headings_refused = self.headings_refused.saturating_add(count);
    }

    /// The next action; `None` until a message arrives or [`Self::wakes_at_ns`].
    pub fn next_action(&mut self, now_ns: u64) -> Option<Action> {
        match self.actions.pop_front() {
            None if self.asked.is_none() => self.decide(now_ns),
            action => action,
        }
    }

    /// The message of its last measurement; `None` before the first.
    #[must_use]
    pub fn range(&self) -> Option<Outgoing<Range>> {
        self.present.as_ref().map(|present| present.message(present.range))
    }

    /// When it must act even if no message arrives, monotonic ns.
    #[must_use]
    pub fn wakes_at_ns(&self) -> Option<u64> {
        self.heading_deadline_ns().or_else(|| self.stop_deadline_ns())
    }

    /// When the expected heading is overdue; tick 0 waits for the complete team.
    #[must_use]
    pub fn heading_deadline_ns(&self) -> Option<u64> {
        let present = self.present.as_ref()?;
        let waits = self.clock == Clock::Realtime && present.tick > 0 && present.drive.is_none();
        waits.then(|| heading_deadline_ns(present.began_ns, self.dt_s))
    }

    /// True before its first tick.
    #[must_use]
    pub fn is_new(&self) -> bool {
        self.present.is_none()
    }

    /// Publishes the default command before the robot sleeps, without a notification: in real time a tick does not wait for
    /// a late robot, and the kernel's timer may expire after the end of the tick.
    pub fn before_sleep(&mut self) {
        if self.heading_deadline_ns().is_none() {
            return;
        }
        let Some(present) = self.present.as_mut().filter(|present| !present.provided) else { return };
        present.provided = true;
        let held = self.controller.hold(present.tick);
        let drive = present.drive_of(held, (0, false), 0);
        self.actions.push_back(Action::SendDrive(present.message(drive)));
    }

    /// Answers [`Action::Measure`]. The measurement is published next.
    pub fn measured(&mut self, measurement: Measurement, now_ns: u64) {
        let is_range = |asked: &mut Asked| matches!(asked, Asked::Range { .. });
        let Some(Asked::Range { sim_incarnation, tick, time_s, began_ns }) = self.asked.take_if(is_range) else {
            return;
        };
        self.present = Some(Present {
            sim_incarnation,
            tick,
            time_s,
            began_ns,
            range: Range { robot: self.id as u64, measurement },
            range_sent_ns: now_ns,
            provided: false,
            drive: None,
        });
        self.actions.push_back(Action::SendRange);
        // In real time the first range starts fusion's deadline.
        let or_first = self.clock == Clock::Realtime;
        self.notify(Notification::by_last_answer(WaitGroup::Fusion, Event::Range, tick, or_first));
    }

    /// Answers [`Action::CarryOut`] with the driven command.
    pub fn carried_out(&mut self, driven: Command) {
        let Some(Asked::Drive { heading_held_ns, is_late }) = self.asked.take() else { return };
        let Some(present) = &mut self.present else { return };
        let drive = *present.drive.insert(present.drive_of(driven, (heading_held_ns, is_late), self.headings_refused));
        self.actions.push_back(Action::SendDrive(present.message(drive)));
        // In real time the simulator ends a tick by its clock, except the first tick.
        let tick = present.tick;
        if self.clock == Clock::Lockstep || tick == 0 {
            self.notify(Notification::by_last_answer(WaitGroup::Sim, Event::Drive, tick, false));
        }
    }

    fn decide(&mut self, now_ns: u64) -> Option<Action> {
        // Before it looks at a world: after a suspension the newest one that it received may be as old as the others.
        if self.stop_deadline_ns().is_some_and(|deadline_ns| deadline_ns <= now_ns) {
            self.controller.forget();
            return Some(self.carry_out(Command::default(), Asked::Stop));
        }
        if let Some(world) = self.world.take()
            && let Some(action) = self.see_world(&world)
        {
            return Some(action);
        }
        let present = self.present.as_ref()?;
        let tick = present.tick;
        let obeyed = present.drive.is_some_and(|drive| drive.heading_held_ns != 0);
        // After the deadline, but within the tick: a late heading is better than a held one.
        let is_late = present.drive.is_some();
        if let Some((_, command)) = self.heading.take_if(|heading| heading.0 == tick).filter(|_| !obeyed) {
            let command = self.controller.obey(tick, command);
            return Some(self.carry_out(command, Asked::Drive { heading_held_ns: now_ns, is_late }));
        }
        let is_overdue = self.heading_deadline_ns().is_some_and(|deadline_ns| deadline_ns <= now_ns);
        is_overdue.then(|| {
            let command = self.controller.hold(tick);
            self.carry_out(command, Asked::Drive { heading_held_ns: 0, is_late: false })
        })
    }

    /// Measures a new tick and publishes the range; answers a repeated tick with the same message.
    fn see_world(&mut self, world: &World) -> Option<Action> {
        let World { sim_incarnation, tick, time_s, entry, at_ns: began_ns } = *world;
        let seen = self.present.as_ref().map(|present| (present.sim_incarnation, present.tick));
        let news = (sim_incarnation, tick);
        if seen == Some(news) {
            return self.repeat();
        }
        // A restarted simulator may go back in ticks; the same incarnation never does.
        seen.is_none_or(|seen| seen < news).then(|| {
            // The last drive message has already counted these refusals.
            if let Some(reported) = self.present.as_ref().and_then(|present| present.drive.as_ref()) {
                self.headings_refused -= reported.headings_refused;
            }
            self.asked = Some(Asked::Range { sim_incarnation, tick, time_s, began_ns });
            Action::Measure { tick, time_s, entry }
        })
    }

    fn repeat(&mut self) -> Option<Action> {
        let present = self.present.as_ref()?;
        let (action, to, event) = match present.drive {
            Some(drive) => (Action::SendDrive(present.message(drive)), WaitGroup::Sim, Event::Drive),
            None => (Action::SendRange, WaitGroup::Fusion, Event::Range),
        };
        self.notify(Notification::always(to, event));
        Some(action)
    }

    /// In real time, when a robot must stop because the simulator has been silent for longer than a heading is held: the
    /// simulator's bodies stand still then, and so must a real one.
    fn stop_deadline_ns(&self) -> Option<u64> {
        let present = self.present.as_ref().filter(|_| self.is_moving && self.clock == Clock::Realtime)?;
        let held_ns = ((HOLD_TICKS + 1) as f64 * self.dt_s * 1e9) as u64;
        Some(present.began_ns.saturating_add(held_ns))
    }

    fn carry_out(&mut self, command: Command, asked: Asked) -> Action {
        self.is_moving = command != Command::default();
        self.asked = Some(asked);
        Action::CarryOut(command)
    }

    fn notify(&mut self, notification: Notification) {
        self.actions.push_back(Action::Notify(notification));
    }
}

impl Present {
    fn message<T>(&self, entry: T) -> Outgoing<T> {
        Outgoing { tick: self.tick, valid_at_s: self.time_s, entry }
    }

    fn drive_of(&self, driven: Command, (heading_held_ns, is_late): (u64, bool), headings_refused: u32) -> Drive {
        Drive {
            robot: self.range.robot,
            heading_rad: driven.heading_rad,
            speed_mps: driven.speed_mps,
            range_sent_ns: if self.range.measurement.kinds != 0 { self.range_sent_ns } else { 0 },
            heading_held_ns,
            heading_late: u32::from(is_late),
            headings_refused,
            network_ns: 0,
            robot_host_ns: 0,
            gateway_ns: 0,
        }
    }
}
