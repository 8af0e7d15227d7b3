//! The operator's tool: starts, watches and reports runs of rangehound.
//!
//! The binary `rangehound` is the tool and also each node: `rangehound sim`, `rangehound fusion`,
//! `rangehound robot --id 3`. This crate alone knows all roles.
//!
//! | module | what |
//! |---|---|
//! | [`cli`] | the command line |
//! | [`experiment`] | from command line to a validated scenario |
//! | [`supervisor`] | `run`, `resume`, `track`: starts the nodes, watches, starts them again, ends them |
//! | [`remote`] | `status`, `kill`, `restart`, `stop`: acting on a run from another terminal |
//! | [`node`] | `sim`, `fusion`, `robot`: one node |
//! | [`watch`] | progress of a run, as an observer sees it |
//! | [`live`] | a page that shows a run while it goes on |
//! | [`plan`] | one step per JSON line, for programs of any language |
//! | [`chaos`] | campaigns of faults on a live run |
//! | [`latency`] | the time from range to heading, beside the bare transport |
//! | [`pin`] | which processors a command runs on |
//! | [`in_process`] | the same steps composed in one process |
//! | [`compare`] | Monte Carlo of the planners on all cores |
//! | [`report`], [`hops`], [`tables`], [`page`], [`picture`] | what a run leaves: `report.json`, CSV, `report.html`, a picture |
//! | [`frame`] | a run tick by tick, all that travelled on its topics |
//! | [`curves`] | what is drawn of a run: its logs, thinned |
//! | [`chart`], [`field`], [`over_time`], [`percentiles`] | what all pictures are drawn with |
//! | [`failure`] | exit codes |

pub mod chaos;
pub mod chart;
pub mod cli;
pub mod compare;
pub mod curves;
pub mod experiment;
pub mod failure;
pub mod field;
pub mod frame;
pub mod hops;
pub mod in_process;
pub mod latency;
pub mod live;
pub mod node;
pub mod over_time;
pub mod page;
pub mod percentiles;
pub mod picture;
pub mod pin;
pub mod plan;
pub mod remote;
pub mod report;
pub mod supervisor;
pub mod tables;
pub mod watch;
