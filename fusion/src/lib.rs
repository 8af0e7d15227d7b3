//! The fusion centre.
//!
//! It receives the robots' ranges, sends their headings, and publishes estimates for observers:
//!
//! ```text
//! robot 0..M-1 --range--> FUSION --heading--> robot 0..M-1
//!                           `--estimate--> observers
//! ```
//!
//! Each tick it takes the ranges of all robots, updates the target's estimate with an extended Kalman filter, predicts
//! it one step ahead, and plans every robot's heading so that the next ranges are most informative. [`Centre`] is the
//! pure step.
//!
//! | module | what |
//! |---|---|
//! | [`filter`] | prediction and joint update of one Gaussian estimate (Eqs. 1-13) |
//! | [`tracker`] | the estimate over time: gating, start without a prior, recovery from lock-out |
//! | [`trust`] | whose ranges are fused: a robot that keeps failing the gate is distrusted until its ranges pass again |
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
mod past;
pub mod planner;
pub mod standby;
pub mod tracker;
mod tracking;
pub mod trust;
pub mod vector;

pub use centre::Centre;
pub use past::LATE_TICKS_MAX;
