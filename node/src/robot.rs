//! The robot's process: a [`Machine`] over shared memory, with a [`Sensor`], a [`PoseSource`] and an [`Actuator`].

use rangehound_robot::drive::{Actuator, SimulatedActuator};
use rangehound_robot::machine::{Action, Machine};
use rangehound_robot::pose::{self, PoseSource};
use rangehound_robot::sensor::{self, Sensor, measure};
use rangehound_shared::message::{Command, Drive, Range, WorldEntry};
use rangehound_shared::scenario::{Clock, Scenario};

use crate::bus::{Bus, BusError, Event, Events, IDLE, Notifier, Publisher, Subscriber, WaitGroup, Waiter};
use crate::rendezvous::{Rendezvous, RendezvousError, Role, RoleLease};
use crate::system::clock::{monotonic_ns, until};
use crate::system::signal::Termination;

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
    #[error("robot {id} (--id) is not in this run: expected 0 to {last}")]
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
    let mut sensor = sensor::of_scenario(scenario, id).ok_or_else(|| RobotError::no_such(scenario, id))?;
    let mut poses = pose::of_scenario(scenario, id).ok_or_else(|| RobotError::no_such(scenario, id))?;
    run_with(rendezvous, id, (sensor.as_mut(), poses.as_mut(), &mut SimulatedActuator), termination)
}

/// Runs one robot with the caller's sensor, localiser and actuator. The last command is always to stop, however the run ends.
///
/// # Errors
/// [`RobotError`].
pub fn run_with<S: Sensor + ?Sized, P: PoseSource + ?Sized, A: Actuator>(
    rendezvous: &Rendezvous,
    id: usize,
    (sensor, poses, actuator): (&mut S, &mut P, &mut A),
    termination: &Termination,
) -> Result<(), RobotError> {
    let scenario = &rendezvous.description().scenario;
    let lease = match scenario.robots.get(id) {
        Some(_) => rendezvous.roster().take(Role::Robot(id))?,
        None => return Err(RobotError::no_such(scenario, id)),
    };
    let fusion_incarnation = rendezvous.roster().starts(Role::Fusion);
    let machine = Machine::new(scenario, id, fusion_incarnation).ok_or_else(|| RobotError::no_such(scenario, id))?;
    let bus = Bus::of_role(rendezvous, Role::Robot(id), &lease)?;
    let mut robot = Driver {
        clock: scenario.clock,
        machine,
        sensor,
        poses,
        actuator,
        ranges: bus.publisher_of_robot(id)?,
        drives: bus.publisher_of_robot(id)?,
        worlds: bus.subscriber()?,
        headings: bus.subscriber()?,
        waiter: bus.waiter_of(WaitGroup::Robots),
        sim: bus.notifier_of(WaitGroup::Sim),
        fusion: bus.notifier_of(WaitGroup::Fusion),
    };
    let ended = robot.take_part(rendezvous, &lease, termination);
    robot.actuator.carry_out(Command::default());
    ended
}

struct Driver<'a, S: ?Sized, P: ?Sized, A> {
    clock: Clock,
    machine: Machine,
    sensor: &'a mut S,
    poses: &'a mut P,
    actuator: &'a mut A,
    ranges: Publisher<Range>,
    drives: Publisher<Drive>,
    worlds: Subscriber<WorldEntry>,
    headings: Subscriber<Command>,
    waiter: Waiter,
    sim: Notifier,
    fusion: Notifier,
}

impl<S: Sensor + ?Sized, P: PoseSource + ?Sized, A: Actuator> Driver<'_, S, P, A> {
    fn take_part(
        &mut self,
        rendezvous: &Rendezvous,
        lease: &RoleLease,
        termination: &Termination,
    ) -> Result<(), RobotError> {
        self.act()?;
        while !termination.requested() {
            let events = self.wait()?;
            let now_ns = monotonic_ns();
            lease.renew(now_ns);
            rendezvous.look_for_removal(now_ns)?;
            self.receive(events, now_ns)?;
            self.act()?;
            let may_have_ended = events.has(Event::Finished) || self.machine.is_new() || events.is_empty();
            if may_have_ended && (rendezvous.is_finished() || rendezvous.is_ending()) {
                break;
            }
        }
        Ok(())
    }

    /// Waits for an event, or until the machine has something to do.
    fn wait(&mut self) -> Result<Events, BusError> {
        // In real time the next tick is far away.
        if self.clock == Clock::Lockstep || self.machine.heading_deadline_ns().is_some() {
            let events = self.waiter.watch();
            if !events.is_empty() {
                return Ok(events);
            }
            self.machine.before_sleep();
            self.act()?;
        }
        Ok(self.waiter.sleep(self.machine.wakes_at_ns().map_or(IDLE, |at_ns| until(at_ns).min(IDLE))))
    }

    /// Drains the topics whose events came, or all topics after a time-out.
    fn receive(&mut self, events: Events, now_ns: u64) -> Result<(), BusError> {
        let Self { machine, worlds, headings, .. } = self;
        if events.has(Event::World) || events.is_empty() {
            worlds.drain(|header, entries| machine.on_world(header, entries, now_ns))?;
        }
        if events.has(Event::Heading) || events.is_empty() {
            headings.drain(|header, commands| machine.on_heading(header, commands))?;
            machine.refuse_headings(headings.take_impostors());
        }
        Ok(())
    }

    fn act(&mut self) -> Result<(), BusError> {
        let mut now_ns = monotonic_ns();
        while let Some(action) = self.machine.next_action(now_ns) {
            // Only sensor and actuator take their time: a turn that reads the clock less often is shorter.
            match action {
                Action::Measure { tick, time_s, entry } => {
                    let measurement = measure(self.sensor, self.poses, (tick, time_s), &entry);
                    now_ns = monotonic_ns();
                    self.machine.measured(measurement, now_ns);
                }
                Action::CarryOut(command) => {
                    let driven = self.actuator.carry_out(command);
                    now_ns = monotonic_ns();
                    self.machine.carried_out(driven);
                }
                Action::SendRange => self.machine.range().map_or(Ok(()), |message| self.ranges.send_one(&message))?,
                Action::SendDrive(message) => self.drives.send_one(&message)?,
                Action::Notify(notification) => match notification.to {
                    WaitGroup::Fusion => self.fusion.notify(&notification),
                    WaitGroup::Sim | WaitGroup::Robots => self.sim.notify(&notification),
                },
            }
        }
        Ok(())
    }
}
