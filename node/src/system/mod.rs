//! The operating system, as nodes and tool need it.
//!
//! | module | what |
//! |---|---|
//! | [`bounded`] | reading no more of a file than it may have |
//! | [`limits`], [`resources`] | which limit of the system a refusal is about, and whether there is enough |
//! | [`clock`], [`signal`] | monotonic time, requests to end |

pub mod bounded;
pub mod clock;
pub mod limits;
pub mod resources;
pub mod signal;
