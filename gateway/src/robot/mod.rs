//! A robot on a host without the run's shared memory: the role's machine over a link to the gateway.

mod session;

use std::path::PathBuf;
use std::time::Duration;

use rangehound_node::rendezvous::RunDescription;
use rangehound_node::system::clock::{monotonic_ns, until};
use rangehound_node::system::signal::Termination;
use rangehound_robot::drive::{Actuator, SimulatedActuator};
use rangehound_robot::machine::{Action, Machine};
use rangehound_robot::pose::{self, PoseSource};
use rangehound_robot::remote::wire::Downlink;
use rangehound_robot::remote::{Rejoin, RobotEnd, RunIncarnation, silence_max_ns};
use rangehound_robot::sensor::{self, Sensor, measure};
use rangehound_shared::message::Command;
use rangehound_shared::scenario::Scenario;
use rustix::process::{Signal, getpid, kill_process};

use crate::keys::KeysError;
use crate::link::{self, Notice};
pub use session::Refusal;
use session::{Connector, LinkEvent, Session};

/// Longest sleep: bounds how late the process sees that it is asked to end.
const LONGEST_SLEEP: Duration = Duration::from_millis(50);

/// Where a robot connects, and as whom.
#[derive(Debug, Clone)]
pub struct Target {
    /// `HOST:PORT` of the gateway.
    pub gateway: String,
    /// Folder of this host's keys. Without, only a gateway of this machine is asked.
    pub keys: Option<PathBuf>,
    /// The run; any if none is named.
    pub run: Option<String>,
    /// True if tools of the run's host may end this process.
    pub allows_control: bool,
}

/// The sensor, the localiser and the actuator of a robot.
pub type Equipment = (Box<dyn Sensor>, Box<dyn PoseSource>, Box<dyn Actuator>);

/// Why a robot ended early.
#[derive(Debug, thiserror::Error)]
pub enum RobotError {
    /// The gateway does not take it, and will not.
    #[error("the gateway refused this robot: {0}")]
    Refused(String),
    /// Its keys cannot be used.
    #[error(transparent)]
    Keys(#[from] KeysError),
    /// The cryptography does not fit.
    #[error("{0}")]
    Cryptography(String),
    /// The system.
    #[error("{0}")]
    System(#[from] std::io::Error),
}

/// Runs one robot, as the scenario of the run has it, until the run ends or until asked to end.
///
/// # Errors
/// [`RobotError`].
pub fn run(target: &Target, id: usize, termination: &Termination) -> Result<(), RobotError> {
    let equipment = |scenario: &Scenario| -> Option<Equipment> {
        let actuator = Box::new(SimulatedActuator);
        Some((sensor::of_scenario(scenario, id)?, pose::of_scenario(scenario, id)?, actuator))
    };
    run_with(target, id, equipment, termination)
}

/// Runs one robot with the caller's sensor, localiser and actuator. `equipment` makes them once the scenario is known, and for
/// each further run that the robot joins; without them it does not take part. The last command is always to stop, however the run
/// ends. A lost gateway never ends it: the robot stops by itself, and connects again.
///
/// A robot with a radio and a drive of its own, on a vehicle whose position the simulator computes:
///
/// ```no_run
/// use rangehound_gateway::robot::{Equipment, Target, run_with};
/// use rangehound_node::system::signal::Termination;
/// use rangehound_robot::drive::Actuator;
/// use rangehound_robot::pose;
/// use rangehound_robot::sensor::{Sensed, Sensor};
/// use rangehound_shared::message::{Command, WorldEntry};
/// use rangehound_shared::scenario::Scenario;
///
/// #[derive(Debug)]
/// struct Radio;
///
/// impl Sensor for Radio {
///     fn sense(&mut self, _tick: u64, _entry: &WorldEntry) -> Sensed {
///         let newest_m = 12.34; // from the radio, without waiting
///         Sensed::range(newest_m, 0.1)
///     }
/// }
///
/// struct Wheels;
///
/// impl Actuator for Wheels {
///     fn carry_out(&mut self, command: Command) -> Command {
///         println!("{:.3} rad, {:.2} m/s", command.heading_rad, command.speed_mps);
///         command
///     }
/// }
///
/// let target = Target {
///     gateway: "station:7400".to_owned(),
///     keys: Some("keys/alice".into()),
///     run: None,
///     allows_control: false,
/// };
/// let equipment = |scenario: &Scenario| -> Option<Equipment> {
///     Some((Box::new(Radio), pose::of_scenario(scenario, 1)?, Box::new(Wheels)))
/// };
/// run_with(&target, 1, equipment, &Termination::listen()?)?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`RobotError`].
pub fn run_with(
    target: &Target,
    id: usize,
    equipment: impl FnMut(&Scenario) -> Option<Equipment>,
    termination: &Termination,
) -> Result<(), RobotError> {
    let connector = Connector::new(target.clone(), id)?;
    link::runtime()?.block_on(async {
        let allows_control = target.allows_control;
        let mut driver = Driver { id, equipment, part: None, has_joined: false, allows_control };
        let ended = driver.take_part(connector, termination).await;
        if let Some(part) = &mut driver.part {
            part.equipment.2.carry_out(Command::default());
        }
        ended
    })
}

struct Driver<E> {
    id: usize,
    equipment: E,
    part: Option<Part>,
    has_joined: bool,
    allows_control: bool,
}

/// A robot's part in one run.
struct Part {
    of: RunIncarnation,
    machine: Machine,
    robot_end: RobotEnd,
    equipment: Equipment,
    is_moving: bool,
    /// A frame that is invalid was reported.
    has_reported_frame: bool,
}

impl<E: FnMut(&Scenario) -> Option<Equipment>> Driver<E> {
    async fn take_part(&mut self, mut connector: Connector, termination: &Termination) -> Result<(), RobotError> {
        let mut session: Option<Session> = None;
        while !termination.requested() {
            let wait = self.part.as_ref().map_or(LONGEST_SLEEP, |part| part.wait(session.is_some()));
            let happened = match &mut session {
                Some(session) => session.next(wait).await,
                None => connector.next(wait).await,
            };
            match happened {
                LinkEvent::Joined(joined) => match self.join(&joined) {
                    Ok(()) => {
                        connector.report_joined(joined.description.run_id);
                        session = Some(*joined);
                    }
                    Err(text) => {
                        joined.leave().await;
                        connector.refuse(Refusal { text, may_change: false });
                    }
                },
                LinkEvent::Refused(refusal) if refusal.may_change || self.has_joined => connector.report(&refusal.text),
                LinkEvent::Refused(refusal) => return Err(RobotError::Refused(refusal.text)),
                LinkEvent::Unreachable(reason) => connector.report(&reason),
                LinkEvent::Frame(bytes) => {
                    if let Some(part) = &mut self.part {
                        part.on_frame(&bytes);
                    }
                }
                LinkEvent::Noticed(Notice::Finished) => break,
                LinkEvent::Finished(endpoint) => {
                    session::flush(&endpoint).await;
                    break;
                }
                LinkEvent::Noticed(Notice::Kill) if self.allows_control => {
                    log::warn!("killed from the run's host");
                    if let Some(session) = &mut session {
                        session.send_last(Notice::Kill).await;
                    }
                    kill_process(getpid(), Signal::KILL).map_err(std::io::Error::from)?;
                }
                LinkEvent::Noticed(Notice::End) if self.allows_control => {
                    log::warn!("asked to end from the run's host");
                    break;
                }
                LinkEvent::Noticed(_) => log::warn!(
                    "ignored an order of the run's host to end this robot: start it with --allow-remote-control to obey such orders"
                ),
                LinkEvent::Ended => session = None,
                LinkEvent::Nothing => {}
            }
            let Some(part) = &mut self.part else { continue };
            part.act();
            if let Some(open) = &mut session {
                part.send(open);
                let silent_ns = monotonic_ns().saturating_sub(open.joined_ns);
                if part.robot_end.silence_ns(monotonic_ns()).unwrap_or(u64::MAX).min(silent_ns)
                    > silence_max_ns(open.round_trip_ns())
                {
                    open.close(link::SILENT, "the gateway is silent");
                    session = None;
                }
            }
            if session.is_none() && connector.is_idle() {
                connector.open();
            }
        }
        if let Some(session) = session {
            session.leave().await;
        }
        Ok(())
    }

    /// Takes part in the run that the gateway describes, or returns why it cannot.
    fn join(&mut self, session: &Session) -> Result<(), String> {
        let Session { description: RunDescription { run_id, scenario, .. }, life, .. } = session;
        let of = RunIncarnation { run_id: *run_id, life: *life };
        let rejoin = of.after(self.part.as_ref().map(|part| part.of));
        if rejoin == Rejoin::Continue {
            return Ok(());
        }
        let equipment = self.part.take().and_then(|mut part| {
            part.equipment.2.carry_out(Command::default());
            (rejoin == Rejoin::Restart).then_some(part.equipment)
        });
        let machine = Machine::new(scenario, self.id, session.fusion_incarnation);
        let machine = machine.ok_or_else(|| {
            format!("robot {} is not in this run: expected 0 to {}", self.id, scenario.robots.len() - 1)
        })?;
        let equipment = equipment.or_else(|| (self.equipment)(scenario));
        let equipment = equipment.ok_or_else(|| {
            format!("its driver has no equipment for robot {}: expected the id of a robot that it has", self.id)
        })?;
        let robot_end = RobotEnd::new(*run_id, scenario.clock);
        self.part = Some(Part { of, machine, robot_end, equipment, is_moving: false, has_reported_frame: false });
        self.has_joined = true;
        Ok(())
    }
}

impl Part {
    /// How long it may sleep. Without a link no frame is due.
    fn wait(&self, is_linked: bool) -> Duration {
        let due = [self.machine.wakes_at_ns(), self.robot_end.wakes_at_ns().filter(|_| is_linked)];
        due.into_iter().flatten().map(until).min().unwrap_or(LONGEST_SLEEP).min(LONGEST_SLEEP)
    }

    fn on_frame(&mut self, bytes: &[u8]) {
        let now_ns = monotonic_ns();
        let frame = match Downlink::from_bytes(bytes, self.of.run_id) {
            Ok(frame) => frame,
            Err(error) => {
                if !std::mem::replace(&mut self.has_reported_frame, true) {
                    log::warn!(
                        "the gateway sends an invalid frame: {error}; further ones are dropped without a message"
                    );
                }
                return;
            }
        };
        self.robot_end.on_downlink(&frame, now_ns);
        if let Some(world) = &frame.world {
            let (header, entry) = world.message(self.of.run_id);
            self.machine.on_own_world(&header, &entry, now_ns);
        }
        if let Some(heading) = &frame.heading {
            let (header, command) = heading.message(self.of.run_id);
            self.machine.on_own_heading(&header, Some(&command));
        }
    }

    fn act(&mut self) {
        let mut provides = true;
        loop {
            let Some(action) = self.machine.next_action(monotonic_ns()) else {
                if !std::mem::take(&mut provides) {
                    return;
                }
                self.machine.before_sleep();
                continue;
            };
            let (sensor, poses, actuator) = &mut self.equipment;
            match action {
                Action::Measure { tick, time_s, entry } => {
                    let measurement = measure(sensor.as_mut(), poses.as_mut(), (tick, time_s), &entry);
                    self.machine.measured(measurement, monotonic_ns());
                }
                Action::CarryOut(command) => {
                    let is_moving = command != Command::default();
                    if std::mem::replace(&mut self.is_moving, is_moving) && !is_moving {
                        log::debug!("stands still");
                    }
                    let driven = actuator.carry_out(command);
                    self.machine.carried_out(driven);
                }
                Action::SendRange => self.machine.range().iter().for_each(|message| self.robot_end.on_range(message)),
                Action::SendDrive(message) => self.robot_end.on_drive(&message),
                // The gateway notifies the nodes on its host.
                Action::Notify(_) => {}
            }
        }
    }

    fn send(&mut self, session: &Session) {
        while let Some(frame) = self.robot_end.next_frame(monotonic_ns()) {
            session.send(frame.to_bytes());
        }
    }
}
