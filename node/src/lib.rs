//! Runs a role in a process: connects its pure machine to shared memory, files and the kernel.
//!
//! The crates `sim`, `robot` and `fusion` are pure: their machines take messages and the time, and return actions. This
//! crate has the loops that carry these actions out, and all that a process needs for them:
//!
//! | module | what |
//! |---|---|
//! | [`sim`], [`robot`], [`fusion`] | the loop of each role |
//! | [`world`] | the simulator's world: simulated or played back from a recording |
//! | [`serial`] | a robot's sensor and drive on a serial port, as lines of text |
//! | [`bus`] | topics and their iceoryx2 services |
//! | [`wait_groups`] | wake-ups over shared memory |
//! | [`block`] | atomic words in shared memory, for all processes of a run |
//! | [`rendezvous`] | how processes find a run, detect who lives, and clean up |
//! | [`checkpoint`] | the state from which a killed node's successor resumes |
//! | [`tick_log`], [`logs`] | files of fixed-size records, one for each tick |
//! | [`system`] | the operating system: its limits and resources, monotonic time, requests to end |

pub mod block;
pub mod bus;
pub mod checkpoint;
pub mod fusion;
pub mod gateway_note;
pub mod logs;
pub mod rendezvous;
pub mod robot;
pub mod serial;
pub mod sim;
pub mod system;
pub mod tick_log;
pub mod wait_groups;
pub mod world;
