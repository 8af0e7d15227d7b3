//! The motion controller: a robot drives the given heading, then the last one for a while, then stops; and the actuator trait.

use rangehound_shared::message::Command;

/// Ticks for which a robot without a fresh heading holds its last one before it stops.
pub const HOLD_TICKS: u64 = 3;

/// The motion controller of one robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Controller {
    speed_limit_mps: f64,
    last: Option<(u64, Command)>,
}

impl Controller {
    /// A controller that stands still until it gets a heading.
    #[must_use]
    pub fn new(speed_limit_mps: f64) -> Self {
        Self { speed_limit_mps, last: None }
    }

    /// Takes the command for a tick and returns the driven one: its speed is within the robot's limit.
    /// A command with NaN or infinite values stops the robot.
    pub fn obey(&mut self, tick: u64, command: Command) -> Command {
        let is_valid = command.heading_rad.is_finite() && command.speed_mps.is_finite();
        let driven = if is_valid {
            Command { heading_rad: command.heading_rad, speed_mps: command.speed_mps.clamp(0.0, self.speed_limit_mps) }
        } else {
            Command::default()
        };
        self.last = Some((tick, driven));
        driven
    }

    /// Forgets the last heading: the robot stands still until it gets a new one.
    pub fn forget(&mut self) {
        self.last = None;
    }

    /// The command for a tick whose heading did not arrive in time: the last heading for
    /// [`HOLD_TICKS`], then a stop.
    #[must_use]
    pub fn hold(&self, tick: u64) -> Command {
        match self.last {
            Some((given, command)) if tick.saturating_sub(given) <= HOLD_TICKS => command,
            _ => Command::default(),
        }
    }
}

/// Carries out a robot's commands.
///
/// It receives the commands of a [`Controller`]: speeds are within the robot's limit. In real time a robot without ticks
/// or headings is commanded to stop after [`HOLD_TICKS`], and also when its process ends in order. A killed process sends
/// no command: a vehicle must stop by itself when no command arrives for longer.
pub trait Actuator {
    /// Carries out a command until the next one. Returns the motion that the robot drives, by which the simulator moves its
    /// body: the command, or the actual motion if it is known to differ.
    ///
    /// This is on the control path: it must not wait for the motion.
    fn carry_out(&mut self, command: Command) -> Command;
}

/// The actuator of a body that the simulator or a recording moves.
#[derive(Debug, Clone, Copy, Default)]
pub struct SimulatedActuator;

impl Actuator for SimulatedActuator {
    fn carry_out(&mut self, command: Command) -> Command {
        command
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_heading_is_held_for_a_few_ticks_and_then_dropped() {
        let mut controller = Controller::new(10.0);
        assert_eq!(controller.hold(1), Command::default());
        let command = controller.obey(4, Command { heading_rad: 1.0, speed_mps: 8.0 });
        assert_eq!(controller.hold(4 + HOLD_TICKS), command);
        assert_eq!(controller.hold(5 + HOLD_TICKS), Command::default());
    }

    #[test]
    fn no_command_makes_it_faster_than_it_is_or_drive_blindly() {
        let mut controller = Controller::new(10.0);
        assert_eq!(controller.obey(1, Command { heading_rad: 0.0, speed_mps: 99.0 }).speed_mps, 10.0);
        assert_eq!(controller.obey(2, Command { heading_rad: 0.0, speed_mps: -1.0 }).speed_mps, 0.0);
        assert_eq!(controller.obey(3, Command { heading_rad: f64::NAN, speed_mps: 1.0 }), Command::default());
    }
}
