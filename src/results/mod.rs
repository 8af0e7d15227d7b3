//! The results of a run, made from its nodes' logs.
//!
//! | module | what |
//! |---|---|
//! | [`frame`] | a run tick by tick: the only reader of the logs |
//! | [`report`], [`hops`], [`percentiles`] | `report.json` and its figures |
//! | [`made`] | all output of a finished run |
//! | [`tables`] | CSV |
//! | [`curves`], [`page`], [`picture`] | drawings: `report.html`, a picture |
//! | [`run_mcap`] | the run in one file that viewers open |
//! | [`ros_bag`] | the run as a ROS 2 bag |

pub mod curves;
pub mod frame;
pub mod hops;
pub mod made;
pub mod page;
pub mod percentiles;
pub mod picture;
pub mod report;
pub mod ros_bag;
pub mod run_mcap;
pub mod tables;
