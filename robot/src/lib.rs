//! One robot.
//!
//! Its place in the loop:
//!
//! ```text
//! sim --world--> ROBOT --range--> fusion --heading--> ROBOT --drive--> sim
//! ```
//!
//! At each tick it measures, publishes the measurement, and drives the heading that fusion returns.
//! It needs no checkpoint: after a restart it continues with the present tick.
//!
//! Your own robot is a [`sensor::Sensor`], a [`pose::PoseSource`] and a [`drive::Actuator`], passed to
//! `rangehound_node::robot::run_with` in place of the simulated ones; `node/examples/serial_range.rs` is such a program.
//!
//! | module | what |
//! |---|---|
//! | [`sensor`] | the sensor of ranges and bearings: simulated (noise), recorded (calibration), or your own |
//! | [`pose`] | the localiser: simulated, recorded, or your own |
//! | [`drive`] | the motion controller, from headings or their absence to commands, and the actuator |
//! | [`machine`] | the protocol: messages in, actions out |
//! | [`remote`] | both ends of the link to a robot on another host |

pub mod drive;
pub mod machine;
pub mod pose;
pub mod remote;
pub mod sensor;
