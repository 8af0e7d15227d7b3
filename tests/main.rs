//! The integration tests, one binary.
//!
//! | module | purpose |
//! |---|---|
//! | `book` | README, ARCHITECTURE.md and `docs/`: every command works, every link and name exists |
//! | `command_line` | the command line: exit codes and one-line error messages |
//! | `command_line::hostile` | damaged input of every kind: refused in one line, no panic, hang or unbounded memory |
//! | `command_line::file_safety` | no file of the user is replaced or removed; one writer of each result |
//! | `command_line::terminal` | printed output: widths, colours, JSON; completions and manual pages |
//! | `estimation::comparison` | Monte Carlo of the planners: figures, pictures, threads |
//! | `estimation::distrust` | robots with sensor faults, many seeds in one process: the right robot is named |
//! | `estimation::golden` | the filter against numbers from independent implementations |
//! | `estimation::paper` | the paper's experiment, many seeds in one process: its figures are reproduced |
//! | `licences` | every dependency is free to use |
//! | `live` | the live page: access, buttons, and in a real browser |
//! | `mutations` | the faults that `explore` is tested with still fit the sources |
//! | `plan` | one step per JSON line, against brute force and the matrices themselves |
//! | `processes` | runs with real processes: digests, kills, several at once, no file left behind |
//! | `processes::chaos` | campaigns of faults: every promise kept, no file left behind |
//! | `processes::drivers` | a robot with sensor and drive on a port: the example, fed through a FIFO |
//! | `processes::latency` | the system beside its references: counted samples, and cleanup |
//! | `processes::resources` | full disks, lost folders, no shared memory, few open files: a clear line, and the run continues if possible |
//! | `processes::strangers` | other users and other versions: refused in a clear line |
//! | `recordings` | recorded ranges, ours and (where they lie beside the project) real ones |
//! | `recordings::bags` | ROS 2 bags: of our runs and of others, each flag, damaged ones |
//! | `recordings::verdicts` | the credibility of a recording: verdicts, and the findings of `calibrate` |
//! | `recordings::intake` | input of a recording into a run: pipes, the copy in the run folder, names, a known start |
//! | `results::bearings` | runs with bearings and uncertain robots: their report, and the run as a recording |
//! | `results::page` | `report.html`: complete, small, offline, and it shows the faults |
//! | `results::run_mcap` | a run in one file: for other readers, replayed bit-identically, cut, repaired, bounded |
//! | `support` | run names, watchdogs, temporary folders |

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot go on should panic")]

mod book;
mod command_line;
mod estimation;
mod licences;
mod live;
mod mutations;
mod plan;
mod processes;
mod recordings;
mod results;
mod support;
