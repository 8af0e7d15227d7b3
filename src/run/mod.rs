//! A run: its definition, the supervision of its processes, and tools that observe and control it.
//!
//! | module | what |
//! |---|---|
//! | [`experiment`] | from the command line to a validated scenario, a name and a folder |
//! | [`external`] | which nodes others start |
//! | [`folder`] | the run folder, prepared or resumed |
//! | [`supervisor`] | `run`, `resume`, `track`: starts, watches, restarts and ends the nodes |
//! | [`node`] | `sim`, `fusion`, `robot`: one node |
//! | [`in_process`] | all roles stepped in this process |
//! | [`watch`] | progress, as an observer sees it |
//! | [`recorder`] | the sidecar that writes `run.mcap` during the run |
//! | [`remote`], [`mod@status`] | `kill`, `restart`, `stop`, `status`: from another terminal |
//! | [`port`] | ports of this machine |
//! | [`pin`] | which processors a command runs on |

pub mod experiment;
pub mod external;
pub mod folder;
pub mod gateway;
pub mod in_process;
pub mod node;
pub mod pin;
pub mod port;
pub mod recorder;
pub mod remote;
pub mod status;
pub mod supervisor;
pub mod watch;
