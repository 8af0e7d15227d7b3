//! What nodes agree on beside the messages: the one number that says whether two builds understand each other, who can be
//! woken ([`wake`]), and the deadlines of a real-time tick ([`timing`]).
//!
//! The number stands in every sealed file: a run's description, which all nodes open before they touch its shared
//! memory, and the checkpoints. It changes with whatever one process writes and another reads: the messages, the
//! run's description, and what the nodes save. For the messages and the description a test notices by itself: `node/tests/protocol.rs`.

pub mod timing;
pub mod wake;

/// Version of the messages, the run's description and the checkpoints.
pub const PROTOCOL: u32 = 5;

/// Version of this program, for people.
pub const PROGRAM: &str = env!("CARGO_PKG_VERSION");

/// A file of another build.
#[derive(Debug, Clone, PartialEq, Eq, serde::Deserialize, thiserror::Error)]
#[error("rangehound {program} (protocol {protocol}); this is {PROGRAM} (protocol {PROTOCOL})")]
pub struct OtherBuild {
    /// Its program's version.
    pub program: String,
    /// Its protocol.
    pub protocol: u32,
}
