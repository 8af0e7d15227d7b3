//! Keys and certificates: which hosts may take part in a run, and for which robots each may speak.
//!
//! The command `keys` makes an authority, whose key stays where it was made, and a folder for each host with the host's
//! certificate and key. Both ends of a connection then accept only certificates of the same authority: a robot's host
//! one of a gateway, and a gateway one of a robot's host, for the robots that it names.

mod authority;
mod cause;
pub mod command;
mod credentials;
mod error;
mod files;
#[cfg(test)]
mod handshake_tests;
mod host;
mod peer;
mod renewal;
mod verifier;

pub use authority::{Authority, HostKeys, Validity, make};
pub use cause::RefusalCause;
pub use credentials::{ALPN, Credentials};
pub use error::KeysError;
#[cfg(feature = "zenoh")]
pub(crate) use files::{AUTHORITY_CERTIFICATE, HOST_CERTIFICATE, HOST_KEY};
pub use host::{Host, HostName, HostRole, RobotHost};
pub use peer::Peer;
pub(crate) use renewal::Reloaded;

/// The name in a gateway's certificate; a robot's host demands it of whatever answers.
pub const GATEWAY_NAME: &str = "gateway.rangehound";

/// The name in the certificate of each host that may speak for the robot.
fn robot_name(robot: usize) -> String {
    format!("robot-{robot}.rangehound")
}

/// The robot that [`robot_name`] gives this name.
fn robot_of_name(name: &str) -> Option<usize> {
    let robot = name.strip_prefix("robot-")?.strip_suffix(".rangehound")?.parse().ok()?;
    // One robot has one name: no sign, no leading zero.
    (robot_name(robot) == name).then_some(robot)
}
