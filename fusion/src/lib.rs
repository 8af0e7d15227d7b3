//! The fusion centre.
//!
//! Its place in the loop is between the robots' ranges and their headings; observers hear what it knows:
//!
//! ```text
//! robot 0..M-1 --range--> FUSION --heading--> robot 0..M-1
//!                           `--estimate--> observers
//! ```
//!
//! Each tick it takes the ranges of all robots, updates the target's estimate with an extended
//! Kalman filter, predicts it one step ahead, and plans every robot's heading so that the next
//! ranges tell most. [`Centre`] is the pure step.
//!
//! | module | what |
//! |---|---|
//! | [`filter`] | prediction and joint update of one Gaussian estimate (Eqs. 1-13) |
//! | [`tracker`] | the estimate over time: gate, start from ranges alone, way out of lock-out |
//! | [`trust`] | whose ranges are fused: a robot that keeps failing the gate is distrusted until it mends |
//! | [`belief`] | what trackers tell planners of the target |
//! | [`vector`] | plane vectors, of which bearings are the unit ones |
//! | [`planner`] | the optimisation (Eqs. 14-29) and its solvers |
//! | [`centre`] | one tick: ranges in, estimate and headings out |
//! | [`intake`] | which messages count: checks, the tick that is being gathered, what comes late |
//! | [`leader`] | the protocol of the one that leads: what comes in, what to do out |
//! | [`standby`] | when another takes the lead |

pub mod belief;
pub mod centre;
pub mod filter;
pub mod intake;
pub mod leader;
mod past;
pub mod planner;
pub mod standby;
pub mod tracker;
mod tracking;
pub mod trust;
pub mod vector;

pub use centre::Centre;
pub use past::LATE_TICKS_MAX;
