//! The fusion centre.
//!
//! It receives the robots' measurements, sends their headings, and publishes estimates for observers:
//!
//! ```text
//! robot 0..M-1 --range--> FUSION --heading--> robot 0..M-1
//!                           `--estimate--> observers
//! ```
//!
//! Each tick it takes the measurements of all robots, updates the target's estimate with an extended Kalman filter, predicts
//! it one step ahead, and plans every robot's heading so that the next measurements are most informative. [`Centre`] is the
//! pure step.
//!
//! | module | what |
//! |---|---|
//! | [`filter`] | prediction and joint update of one Gaussian estimate (Eqs. 1-13) |
//! | [`nuisance`] | errors of the robots' poses and biases of their ranges, which the estimate depends on |
//! | [`tracker`] | the estimate over time: gating, start without a prior, recovery from lock-out |
//! | [`trust`] | whose measurements are fused: a sensor that keeps failing the gate is distrusted until it passes again |
//! | [`belief`] | the estimate that trackers give to planners |
//! | [`vector`] | plane vectors; bearings are unit vectors |
//! | [`planner`] | the optimisation (Eqs. 14-29) and its solvers |
//! | [`centre`] | one tick: ranges in, estimate and headings out |
//! | [`intake`] | which messages count: checks them, gathers the present tick, sorts out late reports |
//! | [`leader`] | the protocol of the leading fusion: messages in, actions out |
//! | [`standby`] | when a standby takes the lead |

pub mod belief;
pub mod centre;
pub mod filter;
pub mod intake;
pub mod leader;
pub mod nuisance;
mod past;
pub mod planner;
pub mod standby;
pub mod tracker;
mod tracking;
pub mod trust;
pub mod vector;

pub use centre::Centre;
pub use past::LATE_TICKS_MAX;
