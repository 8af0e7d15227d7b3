//! Files: the users' inputs and the results.
//!
//! | module | what |
//! |---|---|
//! | [`input`] | scenarios, recordings, anchors, true tracks |
//! | [`calibration`] | `calibration.toml` |
//! | [`layout`] | the files in result folders |
//! | [`out_folder`] | where results may go, and what may be replaced there |
//! | [`atomic_file`] | files that are complete or absent |

pub mod atomic_file;
pub mod calibration;
pub mod input;
pub mod layout;
pub mod out_folder;
