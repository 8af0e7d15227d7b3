//! Drawing for all pictures.
//!
//! | module | what |
//! |---|---|
//! | [`chart`] | a picture: its axes, colours and file |
//! | [`field`], [`ellipse`] | paths and covariances in the plane |
//! | [`over_time`] | curves over time |

pub mod chart;
pub mod ellipse;
pub mod field;
pub mod over_time;
