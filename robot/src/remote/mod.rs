//! A robot on another host than the run: both ends of the link between them, pure.
//!
//! Either end sends the newest of what the other needs ([`wire`]). Frames may be lost, doubled, late or out of order, because
//! everything in them may be sent again: the gateway ([`Relay`]) repeats what a robot has not answered, after an interval
//! that follows the round trip, and the robot ([`RobotEnd`]) answers each frame. Neither end subtracts a time stamp of the
//! other: durations travel.

mod incarnation;
mod relay;
mod robot_end;
mod role_holder;
mod round_trip;
pub mod wire;

pub use incarnation::{Rejoin, RunIncarnation};
pub use relay::{Publication, Relay};
pub use robot_end::RobotEnd;
pub use role_holder::{Claim, RoleHolder, silence_max_ns};
pub use round_trip::RoundTrip;

#[cfg(test)]
mod tests;
