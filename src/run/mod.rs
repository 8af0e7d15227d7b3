//! A run: what it is, who starts and watches its processes, and how others look at it and act on it.
//!
//! | module | what |
//! |---|---|
//! | [`experiment`] | from the command line to a validated scenario, a name and a folder |
//! | [`folder`] | the run folder, made ready or gone on with |
//! | [`supervisor`] | `run`, `resume`, `track`: starts the nodes, watches, starts them again, ends them |
//! | [`node`] | `sim`, `fusion`, `robot`: one node |
//! | [`in_process`] | all roles stepped in this process |
//! | [`watch`] | progress, as an observer sees it |
//! | [`recorder`] | who writes `run.mcap` while the run goes on |
//! | [`remote`], [`mod@status`] | `kill`, `restart`, `stop`, `status`: from another terminal |
//! | [`port`] | ports of this machine |
//! | [`pin`] | which processors a command runs on |

pub mod experiment;
pub mod folder;
pub mod in_process;
pub mod node;
pub mod pin;
pub mod port;
pub mod recorder;
pub mod remote;
pub mod status;
pub mod supervisor;
pub mod watch;
