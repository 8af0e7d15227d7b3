//! The roles' machines in simulated time.

mod fusion;
mod leader;
mod robot;
mod sim;
mod supervisor;
