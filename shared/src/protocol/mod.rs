//! The agreements of nodes besides the messages: the protocol number of compatible builds, the wait groups
//! ([`wake`]), and the deadlines of a real-time tick ([`timing`]).
//!
//! Every sealed file has the number: a run's description, which all nodes open before they touch its shared
//! memory, and the checkpoints. Raise the number when data changes that one process writes and another reads: messages, frames
//! between hosts, the run's description, or checkpoints. A test detects changes of all but checkpoints: `node/tests/protocol.rs`.

pub mod timing;
pub mod wake;

/// Version of the messages, the frames between hosts, the run's description and the checkpoints.
pub const PROTOCOL: u32 = 9;

/// Version of this program, for display.
pub const PROGRAM: &str = env!("CARGO_PKG_VERSION");

/// The build that wrote a file.
#[derive(Debug, Clone, PartialEq, Eq, serde::Deserialize, thiserror::Error)]
#[error("rangehound {program} (protocol {protocol}); this is {PROGRAM} (protocol {PROTOCOL})")]
pub struct OtherBuild {
    /// The program's version.
    pub program: String,
    /// The program's protocol.
    pub protocol: u32,
}
