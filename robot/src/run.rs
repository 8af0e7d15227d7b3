//! The robot's process: ports and loop round a [`RangeSensor`], the [`Controller`] and an [`Actuator`].

use rangehound_shared::bus::{Bed, Bell, Bus, BusError, Call, Calls, IDLE, Publisher, Sleeper, Subscriber};
use rangehound_shared::clock::{heading_deadline_ns, monotonic_ns, until};
use rangehound_shared::footprint::give_back_code;
use rangehound_shared::message::{Command, Drive, Header, Range, WorldEntry};
use rangehound_shared::rendezvous::{Rendezvous, RendezvousError, Role, RoleHold};
use rangehound_shared::scenario::{Clock, Scenario};
use rangehound_shared::signal::Termination;

use crate::drive::{Actuator, Controller, HOLD_TICKS, SimulatedActuator};
use crate::sensor::{RangeSensor, Sensor};

/// Why a robot ended early.
#[derive(Debug, thiserror::Error)]
pub enum RobotError {
    /// It cannot take part in the run.
    #[error(transparent)]
    Rendezvous(#[from] RendezvousError),
    /// The bus failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The run has no robot with this id.
    #[error("--id: expected 0 to {last} for this run, got {id}")]
    NoSuchRobot {
        /// The id asked for.
        id: usize,
        /// The highest id of the run.
        last: usize,
    },
}

impl RobotError {
    fn no_such(scenario: &Scenario, id: usize) -> Self {
        Self::NoSuchRobot { id, last: scenario.robots.len() - 1 }
    }
}

/// Runs one robot, as the scenario has it, until the run ends or until asked to end.
///
/// # Errors
/// [`RobotError`].
pub fn run(rendezvous: &Rendezvous, id: usize, termination: &Termination) -> Result<(), RobotError> {
    let scenario = &rendezvous.description().scenario;
    let mut sensor = Sensor::new(scenario, id).ok_or_else(|| RobotError::no_such(scenario, id))?;
    run_with(rendezvous, id, &mut sensor, &mut SimulatedActuator, termination)
}

/// Runs one robot with a sensor and an actuator of one's own. Whatever ends it, the last command is to stop.
///
/// # Errors
/// [`RobotError`].
pub fn run_with<S: RangeSensor, A: Actuator>(
    rendezvous: &Rendezvous,
    id: usize,
    sensor: &mut S,
    actuator: &mut A,
    termination: &Termination,
) -> Result<(), RobotError> {
    let scenario = &rendezvous.description().scenario;
    let spec = scenario.robots.get(id).ok_or_else(|| RobotError::no_such(scenario, id))?;
    let hold = rendezvous.roster().take(Role::Robot(id))?;
    let bus = Bus::of_role(rendezvous, Role::Robot(id), &hold)?;
    let mut robot = Robot {
        scenario,
        id,
        sensor,
        controller: Controller::new(spec.speed_mps),
        actuator,
        is_moving: false,
        present: None,
        fusion_incarnation: rendezvous.roster().starts(Role::Fusion),
        headings_refused: 0,
        ranges: bus.publisher(1)?,
        drives: bus.publisher(1)?,
        worlds: bus.subscriber()?,
        headings: bus.subscriber()?,
        bed: bus.sleep_as(Sleeper::Robots),
        sim: bus.bell_of(Sleeper::Sim),
        fusion: bus.bell_of(Sleeper::Fusion),
    };
    give_back_code();
    robot.sim.ring(Call::Hello);
    let ended = robot.take_part(rendezvous, &hold, termination);
    robot.carry_out(Command::default());
    ended
}

struct Robot<'a, S, A> {
    scenario: &'a Scenario,
    id: usize,
    sensor: &'a mut S,
    controller: Controller,
    actuator: &'a mut A,
    is_moving: bool,
    present: Option<Present>,
    /// Greatest incarnation of fusion that has been heard or counted: none before it is obeyed.
    fusion_incarnation: u64,
    headings_refused: u64,
    ranges: Publisher<Range>,
    drives: Publisher<Drive>,
    worlds: Subscriber<WorldEntry>,
    headings: Subscriber<Command>,
    bed: Bed,
    sim: Bell,
    fusion: Bell,
}

/// The tick a robot is in.
#[derive(Debug, Clone, Copy)]
struct Present {
    incarnation: u64,
    tick: u64,
    time_s: f64,
    range: Range,
    range_sent_ns: u64,
    /// It has said what it drives if no heading comes.
    provided: bool,
    drive: Option<Drive>,
}

impl<S: RangeSensor, A: Actuator> Robot<'_, S, A> {
    fn take_part(
        &mut self,
        rendezvous: &Rendezvous,
        hold: &RoleHold,
        termination: &Termination,
    ) -> Result<(), RobotError> {
        while !termination.requested() {
            hold.sign();
            rendezvous.look_for_removal()?;
            let calls = self.wait()?;
            self.look(calls)?;
            self.stop_without_ticks();
            if (calls.has(Call::Finished) || self.present.is_none() || calls.is_empty()) && rendezvous.is_finished() {
                break;
            }
        }
        Ok(())
    }

    /// Until called, or until the heading is overdue.
    fn wait(&mut self) -> Result<Calls, BusError> {
        // In real time the next tick is far away.
        if self.scenario.clock == Clock::Lockstep || self.heading_deadline_ns().is_some() {
            let calls = self.bed.watch();
            if !calls.is_empty() {
                return Ok(calls);
            }
            self.provide_for_silence()?;
        }
        Ok(self.bed.sleep(self.time_to_wait()))
    }

    /// In real time, until the heading is overdue; else until called.
    fn time_to_wait(&self) -> std::time::Duration {
        match self.heading_deadline_ns() {
            Some(deadline_ns) => until(deadline_ns).min(IDLE),
            None => IDLE,
        }
    }

    /// When the heading that is waited for will be overdue; tick 0 waits for the whole team.
    fn heading_deadline_ns(&self) -> Option<u64> {
        let present = self.present.as_ref()?;
        let waits = self.scenario.clock == Clock::Realtime && present.tick > 0 && present.drive.is_none();
        waits.then(|| heading_deadline_ns(present.range.tick_began_ns, self.scenario.dt_s))
    }

    /// Acts on what it was called for; on whatever has come if nobody called.
    fn look(&mut self, calls: Calls) -> Result<(), BusError> {
        if calls.has(Call::World) || calls.is_empty() {
            self.look_at_world()?;
        }
        if calls.has(Call::Heading) || calls.is_empty() {
            self.take_heading()?;
        }
        if self.heading_deadline_ns().is_some_and(|deadline_ns| until(deadline_ns).is_zero()) {
            self.drive_without_heading()?;
        }
        Ok(())
    }

    fn look_at_world(&mut self) -> Result<(), BusError> {
        let mut newest: Option<(Header, WorldEntry)> = None;
        self.worlds.drain(|header, entries| {
            let is_of_run = header.tick <= self.scenario.ticks && header.valid_at_s.is_finite();
            if let Some(entry) = entries.get(self.id).filter(|entry| is_of_run && entry.is_sound()) {
                newest = Some((*header, *entry));
            }
        })?;
        match newest {
            Some((header, entry)) => self.see_world(&header, &entry),
            None => Ok(()),
        }
    }

    /// A new tick is measured and told to fusion; a repeated one is answered with what was said.
    fn see_world(&mut self, header: &Header, entry: &WorldEntry) -> Result<(), BusError> {
        let seen = self.present.as_ref().map(|present| (present.incarnation, present.tick));
        if seen == Some((header.incarnation, header.tick)) {
            return self.repeat();
        }
        // A simulator that was started again may go back; the same one never does.
        if seen > Some((header.incarnation, header.tick)) {
            return Ok(());
        }
        // What the last drive has told of is told.
        if let Some(told) = self.present.and_then(|present| present.drive) {
            self.headings_refused -= told.headings_refused;
        }
        // What is known at tick 0 is the prior.
        let range_m = if header.tick > 0 { self.sensor.measure(header.tick, entry) } else { None };
        let range = Range {
            robot: self.id as u64,
            present: u64::from(range_m.is_some()),
            x_m: entry.x_m,
            y_m: entry.y_m,
            range_m: range_m.unwrap_or(0.0),
            range_std_m: self.sensor.std_m(),
            tick_began_ns: header.sent_ns,
            height_m: entry.height_m,
        };
        let range_sent_ns = self.ranges.send(header.tick, header.valid_at_s, &[range])?;
        // In real time the first one starts fusion's deadline.
        self.fusion.ring_if_last(Call::Range, header.tick, self.scenario.clock == Clock::Realtime);
        self.present = Some(Present {
            incarnation: header.incarnation,
            tick: header.tick,
            time_s: header.valid_at_s,
            range,
            range_sent_ns,
            provided: false,
            drive: None,
        });
        Ok(())
    }

    /// In real time a tick does not wait for a robot that is late, and a kernel's timers may be later than the rest
    /// of the tick: so what it drives if nothing comes is said before it sleeps. Nobody is woken for it.
    fn provide_for_silence(&mut self) -> Result<(), BusError> {
        let Some(present) = self.present.filter(|present| !present.provided) else { return Ok(()) };
        if self.heading_deadline_ns().is_some() {
            let drive =
                Drive { headings_refused: 0, ..self.drive(&present, self.controller.hold(present.tick), 0, false) };
            self.drives.send(present.tick, present.time_s, &[drive])?;
            self.present = Some(Present { provided: true, ..present });
        }
        Ok(())
    }

    fn repeat(&self) -> Result<(), BusError> {
        let Some(present) = &self.present else { return Ok(()) };
        if let Some(drive) = present.drive {
            self.drives.send(present.tick, present.time_s, &[drive])?;
            self.sim.ring(Call::Drive);
        } else {
            self.ranges.send(present.tick, present.time_s, &[present.range])?;
            self.fusion.ring(Call::Range);
        }
        Ok(())
    }

    fn take_heading(&mut self) -> Result<(), BusError> {
        let Some(present) = &mut self.present else {
            return self.headings.drain(|_, _| {});
        };
        let (tick, id, robots) = (present.tick, self.id, self.scenario.robots.len());
        let (leader, mut refused) = (&mut self.fusion_incarnation, 0);
        let mut fresh = None;
        self.headings.drain(|header, commands| {
            if header.incarnation < *leader {
                refused += 1;
                return;
            }
            *leader = header.incarnation;
            if header.tick == tick && commands.len() == robots {
                fresh = Some(commands[id]);
            }
        })?;
        self.headings_refused += refused + self.headings.take_impostors();
        let held_ns = monotonic_ns();
        let obeyed = present.drive.is_some_and(|drive| drive.heading_held_ns != 0);
        let Some(command) = fresh.filter(|_| !obeyed) else { return Ok(()) };
        // Overdue, but the tick is not over: better late than held.
        let is_late = present.drive.is_some();
        let obeyed = self.controller.obey(tick, command);
        self.send_drive(obeyed, held_ns, is_late)
    }

    fn drive_without_heading(&mut self) -> Result<(), BusError> {
        let Some(present) = &self.present else { return Ok(()) };
        let held = self.controller.hold(present.tick);
        self.send_drive(held, 0, false)
    }

    /// In real time, when the simulator has been silent for longer than a heading is held: the simulator's bodies stand
    /// then, and so shall one that moves by itself.
    fn stop_without_ticks(&mut self) {
        let moves_by_the_clock = self.is_moving && self.scenario.clock == Clock::Realtime;
        let Some(present) = self.present.filter(|_| moves_by_the_clock) else { return };
        let held_ns = ((HOLD_TICKS + 1) as f64 * self.scenario.dt_s * 1e9) as u64;
        if until(present.range.tick_began_ns.saturating_add(held_ns)).is_zero() {
            self.carry_out(Command::default());
        }
    }

    fn carry_out(&mut self, command: Command) -> Command {
        self.is_moving = command != Command::default();
        self.actuator.carry_out(command)
    }

    fn send_drive(&mut self, command: Command, heading_held_ns: u64, is_late: bool) -> Result<(), BusError> {
        let Some(present) = self.present else { return Ok(()) };
        let driven = self.carry_out(command);
        let drive = self.drive(&present, driven, heading_held_ns, is_late);
        self.present = Some(Present { drive: Some(drive), ..present });
        self.drives.send(present.tick, present.time_s, &[drive])?;
        // In real time the simulator waits for its time, but for the first tick.
        if self.scenario.clock == Clock::Lockstep || present.tick == 0 {
            self.sim.ring_if_last(Call::Drive, present.tick, false);
        }
        Ok(())
    }

    fn drive(&self, present: &Present, driven: Command, heading_held_ns: u64, is_late: bool) -> Drive {
        Drive {
            robot: self.id as u64,
            heading_rad: driven.heading_rad,
            speed_mps: driven.speed_mps,
            range_sent_ns: if present.range.present == 1 { present.range_sent_ns } else { 0 },
            heading_held_ns,
            heading_late: u64::from(is_late),
            headings_refused: self.headings_refused,
        }
    }
}
