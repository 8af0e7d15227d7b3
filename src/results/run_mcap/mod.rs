//! A run in one MCAP file, which Foxglove, Rerun and `rangehound replay` open; `docs/recording.md` lists its topics.
//!
//! | module | what |
//! |---|---|
//! | [`messages`] | the typed messages of the six topics |
//! | [`topics`] | what travelled, message by message, from and to a [`Frame`](crate::results::frame::Frame) |
//! | [`scene`] | the same as people see it, in the well-known messages of Foxglove |
//! | [`write`](mod@write), [`file`](mod@file) | frames into a file |
//! | [`count`] | how many ticks a file holds |
//! | [`read`] | frames out of a file, which may be damaged or somebody else's |

pub mod count;
pub mod file;
pub mod messages;
pub mod read;
pub mod scene;
pub mod topics;
pub mod write;
mod zstd;

/// Marks files as ours: the MCAP profile, and the name of the metadata record.
pub const PROFILE: &str = "rangehound";
