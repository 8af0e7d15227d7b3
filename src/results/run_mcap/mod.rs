//! A run in one MCAP file, which Foxglove, Rerun and `rangehound replay` open; `docs/recording.md` lists its topics.
//!
//! | module | what |
//! |---|---|
//! | [`messages`] | the typed messages of the six topics |
//! | [`topics`] | conversion between messages and a [`Frame`](crate::results::frame::Frame) |
//! | [`scene`] | the same run drawn in the well-known messages of Foxglove |
//! | [`encode`] | frames into the encoded messages of all channels |
//! | [`write`](mod@write), [`file`](mod@file) | those into a file |
//! | [`count`] | the number of ticks in a file |
//! | [`read`] | frames out of a file, which may be damaged or foreign |

pub mod count;
pub mod encode;
pub mod file;
pub mod messages;
pub mod read;
pub mod scene;
pub mod topics;
pub mod write;

pub use crate::files::records::PROFILE;
