//! The operator's tool: starts, watches and reports runs of rangehound.
//!
//! It is outside the nodes' loop: it starts and watches the nodes, and reads their records:
//!
//! ```text
//! sim --world--> robot 0..M-1 --range--> fusion --heading--> robot 0..M-1 --drive--> sim
//!                                           `--estimate--> observers        sim --truth--> observers
//! ```
//!
//! The binary `rangehound` is the tool and also each node: `rangehound sim`, `rangehound fusion`,
//! `rangehound robot --id 3`. This crate and `node`, which runs them, know all roles.
//!
//! | module | what |
//! |---|---|
//! | [`cli`] | the command line |
//! | [`run`] | a run: started, watched, acted on |
//! | [`live`] | a page that shows a living run |
//! | [`study`] | experiments over many runs, and analysis of one |
//! | [`plan`] | one step per JSON line, for programs of any language |
//! | [`results`] | the results of a run |
//! | [`draw`] | drawing for all pictures |
//! | [`files`] | the users' inputs and the results' folders |
//! | [`statistics`] | quantiles, means, intervals, fits |
//! | [`failure`] | exit codes |
//! | [`terminal`] | how output looks |

pub mod cli;
pub mod draw;
pub mod failure;
pub mod files;
pub mod live;
pub mod plan;
pub mod results;
pub mod run;
pub mod statistics;
pub mod study;
pub mod terminal;
