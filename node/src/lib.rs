//! A role in a process: what its machine says, done over shared memory, files and the kernel.
//!
//! The members `sim`, `robot` and `fusion` are pure: their machines take messages and the time, and say what to do. Here is
//! the loop that carries it out, and all that a process needs for it:
//!
//! | module | what |
//! |---|---|
//! | [`sim`], [`robot`], [`fusion`] | the loop of each role |
//! | [`world`] | the world that the simulator shows, a recording's copy among it |
//! | [`serial`] | a robot's sensor and drive that speak lines of text over a port |
//! | [`bus`] | topics and their iceoryx2 services |
//! | [`wait_groups`] | wake-ups over shared memory |
//! | [`block`] | words of shared memory that all processes of a run see |
//! | [`rendezvous`] | how processes find a run, know who lives, and clean up after it |
//! | [`checkpoint`] | the state of a killed node |
//! | [`tick_log`], [`logs`] | files of fixed-size records, one for each tick |
//! | [`system`] | the operating system: its limits and resources, monotonic time, requests to end |

pub mod block;
pub mod bus;
pub mod checkpoint;
pub mod fusion;
pub mod logs;
pub mod rendezvous;
pub mod robot;
pub mod serial;
pub mod sim;
pub mod system;
pub mod tick_log;
pub mod wait_groups;
pub mod world;
