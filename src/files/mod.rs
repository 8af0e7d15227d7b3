//! Files: those that users give, and where results go.
//!
//! | module | what |
//! |---|---|
//! | [`input`] | scenarios, recordings, anchors, true tracks |
//! | [`calibration`] | `calibration.toml` |
//! | [`layout`] | what lies where in the folders of results |
//! | [`out_folder`] | where results may go, and what may be replaced there |
//! | [`atomic_file`] | files that are there as a whole or not at all |

pub mod atomic_file;
pub mod calibration;
pub mod input;
pub mod layout;
pub mod out_folder;
