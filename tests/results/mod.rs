//! The results of a run.

mod page;
pub(crate) mod run_mcap;
