//! Studies: many runs, or one run analysed in another way.
//!
//! | module | what |
//! |---|---|
//! | [`calibrate`] | noise, bias and scale of sensors from a recording |
//! | [`compare`] | Monte Carlo of the planners on all cores |
//! | [`chaos`] | campaigns of faults on live runs |
//! | [`explore`] | campaigns of faults in simulated time |
//! | [`hosts`] | a team on several hosts, all of them on this machine, for `chaos` and `latency` |
//! | [`latency`] | the time from range to heading, compared with the transport |
//! | [`replay`] | a recording through a fresh fusion: bit-identical, or the differences |

pub mod calibrate;
pub mod chaos;
pub mod compare;
pub mod explore;
pub mod hosts;
pub mod latency;
pub mod replay;
