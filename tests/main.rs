//! The integration tests, one binary.
//!
//! | module | what it is for |
//! |---|---|
//! | `book` | README, ARCHITECTURE.md and `docs/`: every command works, every link and name leads somewhere |
//! | `command_line` | what a user types: exit codes and one-line complaints |
//! | `command_line::hostile` | damaged input of every kind: refused in one line, no panic, hang or endless memory |
//! | `command_line::kept` | nothing of the user's is replaced or removed; one writer of each result |
//! | `command_line::terminal` | what is printed: widths, colours, JSON; completions and manual pages |
//! | `estimation::comparison` | Monte Carlo of the planners: figures, pictures, threads |
//! | `estimation::distrust` | robots whose sensors fail, many seeds in one process: the right one is named |
//! | `estimation::golden` | the filter against numbers from independent implementations |
//! | `estimation::paper` | the paper's experiment, many seeds in one process: do the figures come out |
//! | `licences` | every dependency is free to use |
//! | `live` | the live page: who is let in, what its buttons do, and in a real browser |
//! | `plan` | one step per JSON line, against brute force and the matrices themselves |
//! | `processes` | runs with real processes: digests, kills, several at once, nothing left behind |
//! | `processes::chaos` | campaigns of faults: every promise kept, nothing left behind |
//! | `processes::drivers` | a robot whose sensor and drive are on a port: the example, fed through a FIFO |
//! | `processes::latency` | the system beside its references: who is counted, what is left |
//! | `processes::resources` | full disks, lost folders, no shared memory, few open files: a clear line, and on where it can |
//! | `processes::strangers` | other users and other versions: kept out, in a clear line |
//! | `recordings` | recorded ranges, ours and (where they lie beside the project) real ones |
//! | `recordings::believed` | what is believed of a recording: verdicts, and what `calibrate` finds |
//! | `recordings::intake` | how a recording gets into a run: pipes, its copy in the run folder, names, a known start |
//! | `results::page` | `report.html`: whole, small, offline, and the faults are in it |
//! | `results::run_mcap` | a run in one file: for other readers, replayed to the bit, cut, repaired, bounded |
//! | `support` | run names, watchdogs, temporary folders |

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot go on should panic")]

mod book;
mod command_line;
mod estimation;
mod licences;
mod live;
mod plan;
mod processes;
mod recordings;
mod results;
mod support;
