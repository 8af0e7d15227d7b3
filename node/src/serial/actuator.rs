//! A drive on a port.

use std::fs::File;
use std::io::{ErrorKind, Result, Write};
use std::path::Path;

use rangehound_robot::drive::Actuator;
use rangehound_shared::message::Command;
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use super::writer;

/// Writes each command to a port as `heading_rad,speed_mps`.
///
/// If the port does not accept a command at once, the command is dropped and the drive keeps the previous one.
/// The first dropped command is logged.
#[derive(Debug)]
pub struct SerialActuator {
    port: File,
    line: Vec<u8>,
    carried_out: Command,
    has_warned: bool,
}

impl SerialActuator {
    /// Opens the drive on a port; [`crate::serial`] says where commands go.
    ///
    /// # Errors
    /// The system's, if there is no such port or it cannot be written to.
    pub fn open(port: &Path) -> Result<Self> {
        Ok(Self::new(writer(port)?))
    }

    fn new(port: File) -> Self {
        Self { port, line: Vec::new(), carried_out: Command::default(), has_warned: false }
    }

    fn send(&mut self, command: Command) -> Result<()> {
        // A ready port has room for more than one line, so the loop never waits for it.
        let mut ports = [PollFd::new(&self.port, PollFlags::OUT)];
        if poll(&mut ports, Some(&Timespec::default()))? == 0 {
            return Err(ErrorKind::WouldBlock.into());
        }
        self.line.clear();
        writeln!(self.line, "{:.6},{:.6}", command.heading_rad, command.speed_mps)?;
        self.port.write_all(&self.line)
    }
}

impl Actuator for SerialActuator {
    fn carry_out(&mut self, command: Command) -> Command {
        match self.send(command) {
            Ok(()) => self.carried_out = command,
            Err(error) if !self.has_warned => {
                log::warn!("port: command dropped ({error}); the drive keeps the previous command");
                self.has_warned = true;
            }
            Err(_) => {}
        }
        self.carried_out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{Read, pipe};
    use std::os::fd::OwnedFd;

    #[test]
    fn a_command_is_a_line() {
        let (mut drive, port) = pipe().unwrap();
        let mut actuator = SerialActuator::new(OwnedFd::from(port).into());
        let command = Command { heading_rad: -1.25, speed_mps: 8.0 };
        assert_eq!(actuator.carry_out(command), command);
        assert_eq!(actuator.carry_out(Command::default()), Command::default());
        drop(actuator);
        let mut lines = String::new();
        drive.read_to_string(&mut lines).unwrap();
        assert_eq!(lines, "-1.250000,8.000000\n0.000000,0.000000\n");
    }

    #[test]
    fn a_blocked_port_does_not_block_the_robot() {
        let (drive, port) = pipe().unwrap();
        let mut actuator = SerialActuator::new(OwnedFd::from(port).into());
        let commands = (0..100_000).map(|speed| Command { heading_rad: 0.0, speed_mps: f64::from(speed) });
        let lost = commands.filter(|command| actuator.carry_out(*command) != *command).count();
        assert!(lost > 0 && actuator.has_warned);
        let last = actuator.carried_out;
        assert_eq!(actuator.carry_out(Command::default()), last, "the port is full");
        drop(drive);
        assert_eq!(actuator.carry_out(Command::default()), last, "nobody reads it");
    }
}
