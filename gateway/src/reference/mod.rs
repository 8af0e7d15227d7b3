//! The exchange of a tick over the bare network: the time of the transport alone, for `rangehound latency --hosts`.
//!
//! Each robot sends a frame as long as that of a measurement; a centre waits for all of them, and answers each with a frame as
//! long as that of a heading. A robot without an answer sends its frame again.
//!
//! | file | transport |
//! |---|---|
//! | `udp` | UDP |
//! | `quic` | datagrams of QUIC, with the keys and settings of the links |
//! | `zenoh` | zenoh over datagrams of QUIC with the same keys; a feature of the same name, because it takes minutes to build |
//!
//! A node says on standard output that it is ready. A robot starts once its standard input has a word, and writes its stamps at
//! the end. All of these are words of 8 bytes, little-endian.

mod quic;
mod udp;
#[cfg(feature = "zenoh")]
mod zenoh;

use std::io::{Read, Write};
use std::net::SocketAddr;
use std::path::Path;
use std::time::Duration;

use rangehound_node::system::clock::monotonic_ns;

use crate::keys::KeysError;

/// Length of the frame with a measurement, bytes: `docs/machines.md`.
const UP_LEN: usize = 198;

/// Length of the frame with a heading, bytes.
const DOWN_LEN: usize = 75;

/// From a robot: its number and the tick.
type Up = [u8; UP_LEN];

/// From the centre: the tick, and the time until the next frame is due, ns.
type Down = [u8; DOWN_LEN];

/// The word with which a node says that it is ready.
const READY: u64 = u64::from_le_bytes(*b"rh-ready");

/// Silence after which a robot sends its frame again.
const REPEAT: Duration = Duration::from_millis(20);

/// Silence after which a robot gives up.
const SILENCE: Duration = Duration::from_secs(10);

/// The transport of the frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Transport {
    /// UDP.
    Udp,
    /// Datagrams of QUIC.
    Quic,
    /// Publishers and subscribers of zenoh.
    #[cfg(feature = "zenoh")]
    Zenoh,
}

/// A reference run.
#[derive(Debug, Clone, Copy)]
pub struct Exchange<'a> {
    /// The transport of the frames.
    pub transport: Transport,
    /// The centre's address.
    pub address: SocketAddr,
    /// Keys of this host; not for UDP.
    pub keys: &'a Path,
    /// Number of ticks.
    pub ticks: u64,
    /// Time between two ticks, ns; 0 if each follows the answer before.
    pub dt_ns: u64,
}

/// Why a reference run ended.
#[derive(Debug, thiserror::Error)]
pub enum ReferenceError {
    /// The system.
    #[error("{0}")]
    System(#[from] std::io::Error),
    /// The keys cannot be used.
    #[error(transparent)]
    Keys(#[from] KeysError),
    /// The cryptography or the connection.
    #[error("{0}")]
    Connection(String),
    /// The other end is silent.
    #[error("no answer from {0}")]
    Silent(SocketAddr),
}

/// The centre's end of a transport.
trait Centre {
    /// The next frame of any robot that has this many robots beside it.
    fn receive(&mut self) -> Result<Up, ReferenceError>;

    /// Answers a robot that has sent a frame.
    fn answer(&mut self, robot: usize, frame: &Down) -> Result<(), ReferenceError>;
}

/// A robot's end of a transport.
trait Robot {
    fn send(&mut self, frame: &Up) -> Result<(), ReferenceError>;

    /// The next frame, or none within this time.
    fn receive(&mut self, wait: Duration) -> Result<Option<Down>, ReferenceError>;
}

fn failed(error: impl std::fmt::Display) -> ReferenceError {
    ReferenceError::Connection(error.to_string())
}

impl Exchange<'_> {
    /// Is the centre of this many robots, until the process is ended.
    ///
    /// # Errors
    /// [`ReferenceError`].
    pub fn run_centre(&self, robots: usize) -> Result<(), ReferenceError> {
        match self.transport {
            Transport::Udp => self.collect_and_answer(&mut udp::Centre::open(self, robots)?, robots),
            Transport::Quic => self.collect_and_answer(&mut quic::Centre::open(self)?, robots),
            #[cfg(feature = "zenoh")]
            Transport::Zenoh => self.collect_and_answer(&mut zenoh::Centre::open(self, robots)?, robots),
        }
    }

    /// Is a robot, to the last tick.
    ///
    /// # Errors
    /// [`ReferenceError`].
    pub fn be_robot(&self, robot: usize) -> Result<(), ReferenceError> {
        match self.transport {
            Transport::Udp => self.send_and_wait(&mut udp::Robot::open(self)?, robot),
            Transport::Quic => self.send_and_wait(&mut quic::Robot::open(self)?, robot),
            #[cfg(feature = "zenoh")]
            Transport::Zenoh => self.send_and_wait(&mut zenoh::Robot::open(self, robot)?, robot),
        }
    }

    fn collect_and_answer(&self, link: &mut impl Centre, robots: usize) -> Result<(), ReferenceError> {
        say_ready()?;
        let mut due_ns = 0;
        let frame = |tick: u64, due_ns: u64| {
            let mut frame = [0; DOWN_LEN];
            frame[..8].copy_from_slice(&tick.to_le_bytes());
            frame[8..16].copy_from_slice(&due_ns.saturating_sub(monotonic_ns()).to_le_bytes());
            frame
        };
        let mut tick = 1;
        loop {
            let mut has_sent = vec![false; robots];
            // After the last tick, frames that are repeated are still answered.
            while tick > self.ticks || has_sent.contains(&false) {
                let up = link.receive()?;
                let (robot, of) = (word(&up, 0) as usize, word(&up, 8));
                match has_sent.get_mut(robot) {
                    Some(has_sent) if of == tick => *has_sent = true,
                    Some(_) if of < tick => link.answer(robot, &frame(of, due_ns))?,
                    _ => {}
                }
            }
            if self.dt_ns > 0 {
                due_ns += self.dt_ns;
                let now_ns = monotonic_ns();
                // As in the simulator: lost time is not made up by a burst of ticks. The first frames start the ticks.
                if due_ns <= now_ns {
                    due_ns = now_ns + self.dt_ns;
                }
            }
            for robot in 0..robots {
                link.answer(robot, &frame(tick, due_ns))?;
            }
            tick += 1;
        }
    }

    fn send_and_wait(&self, link: &mut impl Robot, robot: usize) -> Result<(), ReferenceError> {
        let mut stamps = Vec::new();
        say_ready()?;
        // The word with which all robots start.
        std::io::stdin().read_exact(&mut [0; 8])?;
        let mut until_due = Duration::ZERO;
        for tick in 1..=self.ticks {
            std::thread::sleep(until_due);
            let mut frame = [0; UP_LEN];
            frame[..8].copy_from_slice(&(robot as u64).to_le_bytes());
            frame[8..16].copy_from_slice(&tick.to_le_bytes());
            let sent_ns = monotonic_ns();
            link.send(&frame)?;
            let answer = loop {
                match link.receive(REPEAT)? {
                    Some(answer) if word(&answer, 0) == tick => break answer,
                    Some(_) => {}
                    None if monotonic_ns() - sent_ns > SILENCE.as_nanos() as u64 + self.dt_ns => {
                        return Err(ReferenceError::Silent(self.address));
                    }
                    None => link.send(&frame)?,
                }
            };
            stamps.push([sent_ns, monotonic_ns()]);
            until_due = Duration::from_nanos(word(&answer, 8));
        }
        let bytes: Vec<u8> = stamps.iter().flatten().flat_map(|stamp| stamp.to_le_bytes()).collect();
        Ok(std::io::stdout().write_all(&bytes)?)
    }
}

/// A word of a frame.
fn word(frame: &[u8], at: usize) -> u64 {
    frame.get(at..at + 8).and_then(|bytes| bytes.try_into().ok()).map_or(0, u64::from_le_bytes)
}

fn say_ready() -> std::io::Result<()> {
    let mut out = std::io::stdout();
    out.write_all(&READY.to_le_bytes())?;
    out.flush()
}
