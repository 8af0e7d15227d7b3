//! Drawing for all pictures.
//!
//! | module | what |
//! |---|---|
//! | [`chart`] | a picture: its axes, colours and file |
//! | [`field`], [`ellipse`], [`belief`] | paths, covariances and the robots' own views in the plane |
//! | [`over_time`] | curves over time |

pub mod belief;
pub mod chart;
pub mod ellipse;
pub mod field;
pub mod over_time;
