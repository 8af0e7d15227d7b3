//! The same exchange without filter, planner or checkpoints: what the transport alone takes.
//!
//! Each robot publishes a range of 32 bytes; a centre waits for all of them and answers all with 272 bytes. Every
//! node is a process that sleeps in the kernel until it is woken; what differs is how:
//!
//! | reference | a range wakes the centre | the command wakes the robots |
//! |---|---|---|
//! | `iceoryx2` | each by an event | an event to each |
//! | `futex` | the last one by a futex | one futex for all |
//!
//! They are runs as the system's are: named, in folders of their own, cleaned up after by the same rules.

mod futex;
mod iceoryx2;
mod node;
mod processes;

use std::time::Duration;

pub use node::latency_node;
pub(super) use processes::measure;

/// How nodes of a reference talk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reference {
    /// Publish-subscribe and events of iceoryx2, as a program would use it that has nothing else to do.
    Iceoryx2,
    /// Words of shared memory on which the kernel lets sleepers wait: the least that a wake-up takes.
    Futex,
}

impl Reference {
    /// Its name on the command line and in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Iceoryx2 => "iceoryx2",
            Self::Futex => "futex",
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
    /// Sends a range, and wakes the centre if that is this robot's to do.
    fn publish(&mut self, range: &Range) -> anyhow::Result<()>;

    /// Waits for the command of a tick.
    fn command(&mut self, tick: u64) -> anyhow::Result<Command>;
}

/// How soon a node sees that it is asked to end.
const WAIT: Duration = Duration::from_millis(100);

/// Where nobody is heard for so long, beyond the time of a tick, nodes give up.
const SILENCE: Duration = Duration::from_secs(5);
