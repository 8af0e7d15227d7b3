//! A drive on a port.

use std::fs::File;
use std::io::{ErrorKind, Result, Write};
use std::path::Path;

use rangehound_robot::drive::Actuator;
use rangehound_shared::message::Command;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{OFlags, fcntl_getfl};

use super::writer;

/// Writes each command to a port as `heading_rad,speed_mps`.
///
/// If the port does not accept a command at once, the command is dropped and the drive keeps the previous one.
/// The first dropped command is logged.
#[derive(Debug)]
pub struct SerialActuator {
    port: File,
    never_blocks: bool,
    /// What the port has not accepted yet: the newest line, or the rest of one.
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
        Self::new(writer(port)?)
    }

    fn new(port: File) -> Result<Self> {
        let never_blocks = fcntl_getfl(&port)?.contains(OFlags::NONBLOCK);
        Ok(Self { port, never_blocks, line: Vec::new(), carried_out: Command::default(), has_warned: false })
    }

    fn send(&mut self, command: Command) -> Result<()> {
        // Never of a terminal, where it waits for a worker of the kernel: for a second, if the machine is busy.
        if !self.never_blocks {
            let mut ports = [PollFd::new(&self.port, PollFlags::OUT)];
            if poll(&mut ports, Some(&Timespec::default()))? == 0 {
                return Err(ErrorKind::WouldBlock.into());
            }
        }
        // A line that the port has accepted in part is completed first.
        self.write()?;
        writeln!(self.line, "{:.6},{:.6}", command.heading_rad, command.speed_mps)?;
        let len = self.line.len();
        let written = self.write();
        if written.is_err() && self.line.len() == len {
            self.line.clear();
            return written;
        }
        Ok(())
    }

    /// Writes what is left of the line, as far as the port accepts it.
    fn write(&mut self) -> Result<()> {
        while !self.line.is_empty() {
            match self.port.write(&self.line) {
                Ok(0) => return Err(ErrorKind::WriteZero.into()),
                Ok(count) => _ = self.line.drain(..count),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(())
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

    use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};

    #[test]
    fn a_command_is_a_line() {
        let (mut drive, port) = pipe().unwrap();
        let mut actuator = SerialActuator::new(OwnedFd::from(port).into()).unwrap();
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
        let mut actuator = SerialActuator::new(OwnedFd::from(port).into()).unwrap();
        let commands = (0..100_000).map(|speed| Command { heading_rad: 0.0, speed_mps: f64::from(speed) });
        let lost = commands.filter(|command| actuator.carry_out(*command) != *command).count();
        assert!(lost > 0 && actuator.has_warned);
        let last = actuator.carried_out;
        assert_eq!(actuator.carry_out(Command::default()), last, "the port is full");
        drop(drive);
        assert_eq!(actuator.carry_out(Command::default()), last, "nobody reads it");
    }

    /// What a full device has accepted of a line is completed before the next one.
    #[test]
    fn a_device_that_is_full_blocks_nobody_and_gets_whole_lines() {
        let drive = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
        grantpt(&drive).unwrap();
        unlockpt(&drive).unwrap();
        let port = ptsname(&drive, Vec::new()).unwrap().into_string().unwrap();
        let (mut drive, mut actuator) = (File::from(drive), SerialActuator::open(Path::new(&port)).unwrap());
        let (mut sent, mut heard) = (Vec::new(), Vec::new());
        for round in 0..3 {
            let mut has_dropped = false;
            for number in 0..20_000 {
                let command = Command { heading_rad: 0.0, speed_mps: f64::from(100_000 * round + number) };
                match actuator.carry_out(command) == command {
                    true => sent.push(command.speed_mps),
                    false => has_dropped = true,
                }
            }
            assert!(has_dropped);
            let mut bytes = [0; 4_096];
            let count = drive.read(&mut bytes).unwrap();
            heard.extend_from_slice(&bytes[..count]);
        }
        drop(actuator);
        // Its end is an error, because the other end is closed.
        let _ = drive.read_to_end(&mut heard);
        let heard = String::from_utf8(heard).unwrap();
        // The last line may be cut, as no further command has followed it.
        let (whole, _) = heard.rsplit_once("\r\n").unwrap();
        let speed_mps = |line: &str| line.strip_prefix("0.000000,").unwrap().parse().unwrap();
        let arrived: Vec<f64> = whole.split("\r\n").map(speed_mps).collect();
        assert!(sent.starts_with(&arrived) && sent.len() - arrived.len() <= 1, "{} of {}", arrived.len(), sent.len());
    }
}
