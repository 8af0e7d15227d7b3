//! One robot.
//!
//! Its place in the loop is everywhere that one part of the team acts by itself:
//!
//! ```text
//! sim --world--> ROBOT --range--> fusion --heading--> ROBOT --drive--> sim
//! ```
//!
//! At each tick it measures its range, publishes it, and drives as the heading that comes back says.
//! It has no state worth keeping: killed and started again, it goes on with the present tick.
//!
//! A robot of one's own is a [`sensor::RangeSensor`] and a [`drive::Actuator`], given to `rangehound_node::robot::run_with`
//! in place of the simulated ones; `node/examples/serial_range.rs` is such a program.
//!
//! | module | what |
//! |---|---|
//! | [`sensor`] | the range sensor: simulated (noise), recorded (calibration), or one's own |
//! | [`drive`] | from headings, or their absence, to commands; what carries them out |
//! | [`machine`] | the protocol: what comes in, what to do out |

pub mod drive;
pub mod machine;
pub mod sensor;
