//! The roles' machines in simulated time.

mod fusion;
mod gateway;
mod leader;
pub(super) mod remote;
mod robot;
mod sim;
mod supervisor;
