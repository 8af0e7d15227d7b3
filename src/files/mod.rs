//! Files: the users' inputs and the results.
//!
//! | module | what |
//! |---|---|
//! | [`input`] | scenarios, recordings, anchors, true tracks |
//! | [`bytes_read`] | how much of an input has been read |
//! | [`bag`] | ROS 2 bags as recordings and true tracks |
//! | [`calibration`] | `calibration.toml` |
//! | [`layout`] | the files in result folders |
//! | [`out_folder`] | where results may go, and what may be replaced there |
//! | [`atomic_file`] | files that are complete or absent |
//! | [`records`], `zstd` | records and chunks of MCAP files |

pub mod atomic_file;
pub mod bag;
pub mod bytes_read;
pub mod calibration;
pub mod input;
pub mod layout;
pub mod out_folder;
pub mod records;
pub(crate) mod zstd;
