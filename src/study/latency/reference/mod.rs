//! The same exchange without filter, planner or checkpoints: the time of the transport only.
//!
//! Each robot publishes a range of 32 bytes; a centre waits for all of them and answers all with 272 bytes. Every
//! node is a process that sleeps in the kernel until it is woken. The references differ in the way of waking:
//!
//! | reference | a range wakes the centre | the command wakes the robots |
//! |---|---|---|
//! | `iceoryx2` | each by an event | an event to each |
//! | `futex` | the last one by a futex | one futex for all |
//!
//! A reference runs like the system: with a name, in its own folder, and with the same cleanup.
//!
//! Across hosts the exchange goes over UDP, over datagrams of QUIC with the keys of the hosts, and over zenoh. The program of the
//! gateway does it, because it has the libraries.

mod futex;
mod iceoryx2;
mod node;
mod processes;

use std::time::Duration;

pub use node::latency_node;
pub(super) use processes::measure;

/// The transport of a reference.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reference {
    /// Publish-subscribe and events of iceoryx2, as a program without other work would use them.
    Iceoryx2,
    /// Words of shared memory on which threads wait in the kernel: the least cost of a wake-up.
    Futex,
    /// UDP between hosts.
    Udp,
    /// Datagrams of QUIC between hosts: what the links to other hosts use.
    Quic,
    /// zenoh between hosts, over datagrams of QUIC; only if the gateway's program was built with it.
    Zenoh,
}

impl Reference {
    /// Its name on the command line and in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Iceoryx2 => "iceoryx2",
            Self::Futex => "futex",
            Self::Udp => "udp",
            Self::Quic => "quic",
            Self::Zenoh => "zenoh",
        }
    }
}

/// A range: 32 bytes.
type Range = [u64; 4];

/// The words of a [`Range`].
const ROBOT: usize = 0;
const RANGE_TICK: usize = 1;

/// A command: 272 bytes.
type Command = [u64; 34];

/// The words of a [`Command`]: its tick, and when the next range is due, monotonic ns.
const TICK: usize = 0;
const DUE: usize = 1;

/// The centre's end of a reference.
trait Centre {
    /// Waits until the range of every robot has come.
    fn collect(&mut self, tick: u64) -> anyhow::Result<()>;

    /// Sends the command and wakes all robots.
    fn answer(&mut self, command: &Command) -> anyhow::Result<()>;
}

/// A robot's end of a reference.
trait Robot {
    /// Sends a range, and wakes the centre if it is this robot's turn.
    fn publish(&mut self, range: &Range) -> anyhow::Result<()>;

    /// Waits for the command of a tick.
    fn command(&mut self, tick: u64) -> anyhow::Result<Command>;
}

/// How soon a node notices a request to end.
const WAIT: Duration = Duration::from_millis(100);

/// Nodes give up if no message comes for this time beyond the time of a tick.
const SILENCE: Duration = Duration::from_secs(5);
