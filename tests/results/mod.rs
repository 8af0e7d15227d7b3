//! What a run leaves.

mod page;
pub(crate) mod run_mcap;
