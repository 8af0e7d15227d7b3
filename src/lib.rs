//! The operator's tool: starts, watches and reports runs of rangehound.
//!
//! It stands outside the loop that the nodes are in, starts and watches them, and reads what they put down:
//!
//! ```text
//! sim --world--> robot 0..M-1 --range--> fusion --heading--> robot 0..M-1 --drive--> sim
//!                                           `--estimate--> observers        sim --truth--> observers
//! ```
//!
//! The binary `rangehound` is the tool and also each node: `rangehound sim`, `rangehound fusion`,
//! `rangehound robot --id 3`. This crate alone knows all roles.
//!
//! | module | what |
//! |---|---|
//! | [`cli`] | the command line |
//! | [`experiment`] | from command line to a validated scenario |
//! | [`supervisor`] | `run`, `resume`, `track`: starts the nodes, watches, starts them again, ends them |
//! | [`remote`] | `kill`, `restart`, `stop`: acting on a run from another terminal |
//! | [`mod@status`] | `status`: a run at the moment |
//! | [`node`] | `sim`, `fusion`, `robot`: one node |
//! | [`watch`] | progress of a run, as an observer sees it |
//! | [`live`] | a page that shows a run while it goes on |
//! | [`plan`] | one step per JSON line, for programs of any language |
//! | [`chaos`] | campaigns of faults on a live run |
//! | [`explore`] | campaigns of faults in simulated time |
//! | [`latency`] | the time from range to heading, beside the bare transport |
//! | [`calibrate`] | noise, bias and scale of sensors from a recording |
//! | [`pin`] | which processors a command runs on |
//! | [`in_process`] | the same steps composed in one process |
//! | [`compare`] | Monte Carlo of the planners on all cores |
//! | [`report`], [`hops`], [`tables`], [`page`], [`picture`] | what a run leaves: `report.json`, CSV, `report.html`, a picture |
//! | [`frame`] | a run tick by tick, all that travelled on its topics |
//! | [`run_mcap`], [`recorder`] | a run in one file that viewers open, and who writes it while the run goes on |
//! | [`replay`] | a recording through a fresh fusion: the same to the bit, or what would be different |
//! | [`curves`] | what is drawn of a run: its logs, thinned |
//! | [`chart`], [`field`], [`ellipse`], [`over_time`], [`percentiles`] | what all pictures are drawn with |
//! | [`statistics`] | quantiles, means, intervals, fits |
//! | [`shell`] | completions and manual pages |
//! | [`out_folder`] | where results may go, and what may be replaced there |
//! | [`whole_file`] | files that are there as a whole or not at all |
//! | [`failure`] | exit codes |
//! | [`terminal`] | how output looks |

pub mod calibrate;
pub mod chaos;
pub mod chart;
pub mod cli;
pub mod compare;
pub mod curves;
pub mod ellipse;
pub mod experiment;
pub mod explore;
pub mod failure;
pub mod field;
pub mod frame;
pub mod hops;
pub mod in_process;
pub mod input;
pub mod latency;
pub mod live;
pub mod node;
pub mod out_folder;
pub mod over_time;
pub mod page;
pub mod percentiles;
pub mod picture;
pub mod pin;
pub mod plan;
pub mod recorder;
pub mod remote;
pub mod replay;
pub mod report;
pub mod run_mcap;
pub mod shell;
pub mod statistics;
pub mod status;
pub mod supervisor;
pub mod tables;
pub mod terminal;
pub mod watch;
pub mod whole_file;
