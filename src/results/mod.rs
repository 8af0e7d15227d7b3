//! What a run leaves, made from its nodes' own logs.
//!
//! | module | what |
//! |---|---|
//! | [`frame`] | a run tick by tick: the one reader of the logs |
//! | [`report`], [`hops`], [`percentiles`] | `report.json` and what it is added up from |
//! | [`made`] | all that is made of the logs of a run that is over |
//! | [`tables`] | CSV |
//! | [`curves`], [`page`], [`picture`] | what is drawn: `report.html`, a picture |
//! | [`run_mcap`] | the run in one file that viewers open |

pub mod curves;
pub mod frame;
pub mod hops;
pub mod made;
pub mod page;
pub mod percentiles;
pub mod picture;
pub mod report;
pub mod run_mcap;
pub mod tables;
