//! Types and rules that all nodes of a rangehound run share.
//!
//! The complete loop; each arrow is one topic:
//!
//! ```text
//! sim --world--> robot 0..M-1 --range--> fusion --heading--> robot 0..M-1 --drive--> sim
//!                                           `--estimate--> observers        sim --truth--> observers
//! ```
//!
//! The crates `sim`, `robot` and `fusion` depend on this crate and never on each other. None of them does I/O.
//! Everything that two of them share is defined here once:
//!
//! | module | contents |
//! |---|---|
//! | [`scenario`] | the experiment: file format, defaults, validation |
//! | [`motion`] | linear target models, exactly discretised; matrices of run-time size |
//! | [`angle`] | angles within one turn |
//! | [`draws`] | random numbers as a function of (seed, stream, tick) |
//! | [`recording`] | recorded ranges: tables from loggers, and logs of radios |
//! | [`radio`] | output formats of ranging radios |
//! | [`measurement`] | a robot's measurement and its pose |
//! | [`message`] | the payload of each topic |
//! | [`robot_set`] | a set of robots' ids |
//! | [`record`] | the log record of each tick, and the rolling digest over all estimates |
//! | [`sealed`] | values that must be complete, such as the state of a killed node |
//! | [`protocol`] | compatibility of builds, wake-ups, deadlines of a real-time tick |
//! | [`run_name`] | names of runs |

pub mod angle;
pub mod draws;
pub mod measurement;
pub mod message;
pub mod motion;
pub mod protocol;
pub mod radio;
pub mod record;
pub mod recording;
pub mod robot_set;
pub mod run_name;
pub mod scenario;
pub mod sealed;

/// Most robots in one run: sizes every service and every per-robot bit set.
pub const ROBOTS_MAX: usize = 1024;

/// Largest dimension of a target state.
pub const STATE_DIM_MAX: usize = 8;

/// Runs `$body` with the constant `$N` bound to the run-time dimension `$dim` (2 to 8).
///
/// Filters and target models have their state dimension in their type, so that a step needs no
/// heap; this is where a scenario's number becomes that type. A dimension outside 2..=8 cannot
/// come from a validated scenario and is treated as the largest.
#[macro_export]
macro_rules! with_state_dim {
    ($dim:expr, $N:ident => $body:expr) => {
        $crate::with_state_dim!(@each $dim, $N => $body, 2 3 4 5 6 7)
    };
    (@each $dim:expr, $N:ident => $body:expr, $($n:literal)+) => {
        match $dim {
            $($n => {
                const $N: usize = $n;
                $body
            })+
            _ => {
                const $N: usize = $crate::STATE_DIM_MAX;
                $body
            }
        }
    };
}
