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
//! `rangehound robot --id 3`. This crate and `node`, which runs them, know all roles.
//!
//! | module | what |
//! |---|---|
//! | [`cli`] | the command line |
//! | [`run`] | a run: started, watched, acted on |
//! | [`live`] | a page that shows a run while it goes on |
//! | [`study`] | many runs, or one looked at in another way |
//! | [`plan`] | one step per JSON line, for programs of any language |
//! | [`results`] | what a run leaves |
//! | [`draw`] | what all pictures are drawn with |
//! | [`files`] | what users give, and where results go |
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
