//! The robot's part in the protocol as a state machine: no clock, no port, no sensor.
//!
//! A driver feeds it with messages ([`Machine::on_world`], [`Machine::on_heading`]), asks for the next [`Action`], carries
//! it out, and asks again until there is none. Two actions are answered: [`Action::Measure`] by [`Machine::measured`],
//! [`Action::CarryOut`] by [`Machine::carried_out`]. Time is an argument: monotonic, ns.

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
    /// Publish a range.
    SendRange(Outgoing<Range>),
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
    world: Option<(Header, WorldEntry)>,
    /// The newest heading received: its tick and this robot's command.
    heading: Option<(u64, Command)>,
    present: Option<Present>,
    /// The action that the driver has not answered yet.
    asked: Option<Asked>,
    /// Greatest known incarnation of fusion: headings of earlier ones are ignored.
    fusion_incarnation: u64,
    headings_refused: u64,
    actions: VecDeque<Action>,
}

/// The present tick of a robot.
#[derive(Debug, Clone, Copy)]
struct Present {
    sim_incarnation: u64,
    tick: u64,
    time_s: f64,
    range: Range,
    range_sent_ns: u64,
    /// True once the default command, for the case that no heading arrives, has been published.
    provided: bool,
    drive: Option<Drive>,
}

#[derive(Debug, Clone, Copy)]
enum Asked {
    Range {
        header: Header,
    },
    /// A command from a heading that was received at this time; 0 without a heading.
    Drive {
        heading_held_ns: u64,
        is_late: bool,
    },
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

    /// Takes a message of the topic `world`.
    pub fn on_world(&mut self, header: &Header, entries: &[WorldEntry]) {
        let is_of_run = header.tick <= self.last_tick && header.valid_at_s.is_finite();
        if let Some(entry) = entries.get(self.id).filter(|entry| is_of_run && entry.is_valid()) {
            self.world = Some((*header, *entry));
        }
    }

    /// Takes a message of the topic `heading`; those of a deposed fusion are ignored.
    pub fn on_heading(&mut self, header: &Header, commands: &[Command]) {
        if header.incarnation < self.fusion_incarnation {
            self.headings_refused += 1;
            return;
        }
        self.fusion_incarnation = header.incarnation;
        if let Some(command) = commands.get(self.id).filter(|_| commands.len() == self.robots) {
            self.heading = Some((header.tick, *command));
        }
    }

    /// Counts headings of processes that do not lead.
    pub fn refuse_headings(&mut self, count: u64) {
        self.headings_refused += count;
    }

    /// The next action; `None` until a message arrives or [`Self::wakes_at_ns`].
    pub fn next_action(&mut self, now_ns: u64) -> Option<Action> {
        if self.actions.is_empty() && self.asked.is_none() {
            self.decide(now_ns);
        }
        self.actions.pop_front()
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
        waits.then(|| heading_deadline_ns(present.range.tick_began_ns, self.dt_s))
    }

    /// True before its first tick.
    #[must_use]
    pub fn is_new(&self) -> bool {
        self.present.is_none()
    }

    /// Publishes the default command before the robot sleeps, without a notification: in real time a tick does not wait for
    /// a late robot, and the kernel's timer may expire after the end of the tick.
    pub fn before_sleep(&mut self) {
        let Some(present) = self.present.filter(|present| !present.provided) else { return };
        if self.heading_deadline_ns().is_some() {
            let held = self.controller.hold(present.tick);
            let drive = Drive { headings_refused: 0, ..self.drive(&present, held, 0, false) };
            self.present = Some(Present { provided: true, ..present });
            self.send_drive(&present, drive);
        }
    }

    /// Answers [`Action::Measure`]. The measurement is published next.
    pub fn measured(&mut self, measurement: Measurement, now_ns: u64) {
        let Some(Asked::Range { header }) = self.asked.take_if(|asked| matches!(asked, Asked::Range { .. })) else {
            return;
        };
        let range = Range { robot: self.id as u64, measurement, tick_began_ns: header.sent_ns };
        self.present = Some(Present {
            sim_incarnation: header.incarnation,
            tick: header.tick,
            time_s: header.valid_at_s,
            range,
            range_sent_ns: now_ns,
            provided: false,
            drive: None,
        });
        self.send_range(&header, range);
        // In real time the first range starts fusion's deadline.
        let or_first = self.clock == Clock::Realtime;
        self.notify(Notification::by_last_answer(WaitGroup::Fusion, Event::Range, header.tick, or_first));
    }

    /// Answers [`Action::CarryOut`] with the driven command.
    pub fn carried_out(&mut self, driven: Command) {
        let Some(Asked::Drive { heading_held_ns, is_late }) = self.asked.take() else { return };
        let Some(present) = self.present else { return };
        let drive = self.drive(&present, driven, heading_held_ns, is_late);
        self.present = Some(Present { drive: Some(drive), ..present });
        self.send_drive(&present, drive);
        // In real time the simulator ends a tick by its clock, except the first tick.
        if self.clock == Clock::Lockstep || present.tick == 0 {
            self.notify(Notification::by_last_answer(WaitGroup::Sim, Event::Drive, present.tick, false));
        }
    }

    fn decide(&mut self, now_ns: u64) {
        if let Some((header, entry)) = self.world.take() {
            self.see_world(header, entry);
            if self.asked.is_some() || !self.actions.is_empty() {
                return;
            }
        }
        let Some(present) = self.present else { return };
        let is_fresh = |&(tick, _): &(u64, Command)| tick == present.tick;
        let obeyed = present.drive.is_some_and(|drive| drive.heading_held_ns != 0);
        if let Some((_, command)) = self.heading.take_if(|heading| is_fresh(heading)).filter(|_| !obeyed) {
            // After the deadline, but within the tick: a late heading is better than a held one.
            let is_late = present.drive.is_some();
            let command = self.controller.obey(present.tick, command);
            self.carry_out(command, Asked::Drive { heading_held_ns: now_ns, is_late });
        } else if self.heading_deadline_ns().is_some_and(|deadline_ns| deadline_ns <= now_ns) {
            let command = self.controller.hold(present.tick);
            self.carry_out(command, Asked::Drive { heading_held_ns: 0, is_late: false });
        } else if self.stop_deadline_ns().is_some_and(|deadline_ns| deadline_ns <= now_ns) {
            self.carry_out(Command::default(), Asked::Stop);
        }
    }

    /// Measures a new tick and publishes the range; answers a repeated tick with the same message.
    fn see_world(&mut self, header: Header, entry: WorldEntry) {
        let seen = self.present.map(|present| (present.sim_incarnation, present.tick));
        let news = (header.incarnation, header.tick);
        if seen == Some(news) {
            self.repeat();
        } else if seen.is_none_or(|seen| seen < news) {
            // The last drive message has already counted these refusals.
            if let Some(reported) = self.present.and_then(|present| present.drive) {
                self.headings_refused -= reported.headings_refused;
            }
            self.asked = Some(Asked::Range { header });
            self.actions.push_back(Action::Measure { tick: header.tick, time_s: header.valid_at_s, entry });
        }
        // A restarted simulator may go back in ticks; the same incarnation never does.
    }

    fn repeat(&mut self) {
        let Some(present) = self.present else { return };
        if let Some(drive) = present.drive {
            self.send_drive(&present, drive);
            self.notify(Notification::always(WaitGroup::Sim, Event::Drive));
        } else {
            self.actions.push_back(Action::SendRange(Outgoing {
                tick: present.tick,
                valid_at_s: present.time_s,
                entry: present.range,
            }));
            self.notify(Notification::always(WaitGroup::Fusion, Event::Range));
        }
    }

    /// In real time, when a robot must stop because the simulator has been silent for longer than a heading is held: the
    /// simulator's bodies stand still then, and so must a real one.
    fn stop_deadline_ns(&self) -> Option<u64> {
        let present = self.present.filter(|_| self.is_moving && self.clock == Clock::Realtime)?;
        let held_ns = ((HOLD_TICKS + 1) as f64 * self.dt_s * 1e9) as u64;
        Some(present.range.tick_began_ns.saturating_add(held_ns))
    }

    fn carry_out(&mut self, command: Command, asked: Asked) {
        self.is_moving = command != Command::default();
        self.asked = Some(asked);
        self.actions.push_back(Action::CarryOut(command));
    }

    fn send_range(&mut self, header: &Header, entry: Range) {
        let (tick, valid_at_s) = (header.tick, header.valid_at_s);
        self.actions.push_back(Action::SendRange(Outgoing { tick, valid_at_s, entry }));
    }

    fn send_drive(&mut self, present: &Present, entry: Drive) {
        let (tick, valid_at_s) = (present.tick, present.time_s);
        self.actions.push_back(Action::SendDrive(Outgoing { tick, valid_at_s, entry }));
    }

    fn notify(&mut self, notification: Notification) {
        self.actions.push_back(Action::Notify(notification));
    }

    fn drive(&self, present: &Present, driven: Command, heading_held_ns: u64, is_late: bool) -> Drive {
        Drive {
            robot: self.id as u64,
            heading_rad: driven.heading_rad,
            speed_mps: driven.speed_mps,
            range_sent_ns: if present.range.measurement.kinds != 0 { present.range_sent_ns } else { 0 },
            heading_held_ns,
            heading_late: u64::from(is_late),
            headings_refused: self.headings_refused,
        }
    }
}
