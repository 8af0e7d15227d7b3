//! Access to the operating system, for nodes and the tool.
//!
//! | module | what |
//! |---|---|
//! | [`bounded`] | reading files within a memory limit |
//! | [`limits`], [`resources`] | the limit behind a refusal, and whether there are enough resources |
//! | [`clock`], [`signal`] | monotonic time, requests to end |

pub mod bounded;
pub mod clock;
pub mod limits;
pub mod resources;
pub mod signal;
