//! What all nodes of a rangehound run agree on.
//!
//! The whole loop, each arrow a topic of its own:
//!
//! ```text
//! sim --world--> robot 0..M-1 --range--> fusion --heading--> robot 0..M-1 --drive--> sim
//!                                           `--estimate--> observers        sim --truth--> observers
//! ```
//!
//! The members `sim`, `robot` and `fusion` depend on this crate and never on each other. None of them does I/O;
//! whatever two of them must share stands here once:
//!
//! | module | the one place for |
//! |---|---|
//! | [`scenario`] | the experiment: file format, defaults, validation |
//! | [`motion`] | linear target models, exactly discretised; matrices of run-time size |
//! | [`draws`] | random numbers as a function of (seed, stream, tick) |
//! | [`recording`] | recorded ranges: tables as loggers write them, and logs of radios |
//! | [`radio`] | what ranging radios print |
//! | [`measurement`] | what a robot measures, and where |
//! | [`message`] | what travels on each topic |
//! | [`robot_set`] | a set of robots' ids |
//! | [`record`] | what is recorded of each tick, and the rolling digest over all estimates |
//! | [`sealed`] | values that must be complete, the state of a killed node among them |
//! | [`protocol`] | which builds understand each other, who wakes whom, deadlines of a real-time tick |
//! | [`run_name`] | names of runs |

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
