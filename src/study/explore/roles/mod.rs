//! The roles' machines in simulated time.

pub(super) mod fusion;
mod leader;
mod robot;
pub(super) mod sim;
