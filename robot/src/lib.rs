//! One robot.
//!
//! At each tick it measures its range, publishes it, and drives as the heading that comes back says.
//! It has no state worth keeping: killed and started again, it goes on with the present tick.
//!
//! | module | what |
//! |---|---|
//! | [`sensor`] | from what the world shows to a range: noise, or calibration of a recorded one |
//! | [`drive`] | from headings, or their absence, to motion |
//! | [`run`] | the process |

pub mod drive;
pub mod run;
pub mod sensor;
