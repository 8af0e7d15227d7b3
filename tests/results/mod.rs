//! The results of a run.

mod bearings;
mod page;
pub(crate) mod run_mcap;
