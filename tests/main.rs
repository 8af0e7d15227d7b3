//! The integration tests, one binary.
//!
//! | module | what it is for |
//! |---|---|
//! | `believed` | what is believed of a recording: verdicts, and what `calibrate` finds |
//! | `paper` | the paper's experiment, many seeds in one process: do the figures come out |
//! | `distrust` | robots whose sensors fail, many seeds in one process: the right one is named |
//! | `drivers` | a robot whose sensor and drive are on a port: the example, fed through a FIFO |
//! | `golden` | the filter against numbers from independent implementations |
//! | `processes` | runs with real processes: digests, kills, several at once, nothing left behind |
//! | `book` | README, ARCHITECTURE.md and `docs/`: every command works, every link and name leads somewhere |
//! | `chaos` | campaigns of faults: every promise kept, nothing left behind |
//! | `comparison` | Monte Carlo of the planners: figures, pictures, threads |
//! | `command_line` | what a user types: exit codes and one-line complaints |
//! | `hostile` | damaged input of every kind: refused in one line, no panic, hang or endless memory |
//! | `kept` | nothing of the user's is replaced or removed; one writer of each result |
//! | `intake` | how a recording gets into a run: pipes, its copy in the run folder, names, a known start |
//! | `plan` | one step per JSON line, against brute force and the matrices themselves |
//! | `latency` | the system beside its references: who is counted, what is left |
//! | `live` | the live page: who is let in, what its buttons do, and in a real browser |
//! | `licences` | every dependency is free to use |
//! | `page` | `report.html`: whole, small, offline, and the faults are in it |
//! | `recordings` | recorded ranges, ours and (where they lie beside the project) real ones |
//! | `resources` | full disks, lost folders, no shared memory, few open files: a clear line, and on where it can |
//! | `run_mcap` | a run in one file: for other readers, replayed to the bit, cut, repaired, bounded |
//! | `strangers` | other users and other versions: kept out, in a clear line |
//! | `terminal` | what is printed: widths, colours, JSON; completions and manual pages |
//! | `support` | run names, watchdogs, temporary folders |

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot go on should panic")]

mod believed;
mod book;
mod chaos;
mod command_line;
mod comparison;
mod distrust;
mod drivers;
mod golden;
mod hostile;
mod intake;
mod kept;
mod latency;
mod licences;
mod live;
mod page;
mod paper;
mod plan;
mod processes;
mod recordings;
mod resources;
mod run_mcap;
mod strangers;
mod support;
mod terminal;
