//! The simulator.
//!
//! It keeps the team's clock: `world(k)` says where each robot is and what its sensor would measure,
//! and the next tick starts when the robots have said what they drive (lock step) or when it is time
//! (real time). What it shows of the target are ranges only; the true state goes to observers.
//!
//! | module | what |
//! |---|---|
//! | [`world`] | what a tick shows: the trait behind both kinds |
//! | [`simulation`] | a target that moves by its model, robots that move as they drive |
//! | [`playback`] | recorded ranges in place of a simulation |
//! | [`run`] | the process |

pub mod playback;
pub mod run;
pub mod simulation;
pub mod world;

pub use world::World;
