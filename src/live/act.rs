//! The actions of the page's buttons on a process.

use rangehound_node::rendezvous::{Rendezvous, Role};
use rustix::process::Signal;

use crate::failure::Failure;
use crate::run::remote;

/// An action on a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Action {
    /// SIGKILL, like a crash.
    Kill,
    /// It is stopped, like a hung process, until it is continued.
    Stop,
    Continue,
    /// It is asked to end, and another is started.
    Restart,
}

/// Why an action failed.
#[derive(Debug)]
pub(super) enum Refused {
    /// The request is invalid.
    Nonsense(String),
    /// It cannot be done now.
    NotNow(String),
}

impl Action {
    pub(super) fn from_name(name: &str) -> Option<Self> {
        Some(match name {
            "kill" => Self::Kill,
            "stop" => Self::Stop,
            "continue" => Self::Continue,
            "restart" => Self::Restart,
            _ => return None,
        })
    }

    /// Acts on the process in a role; returns its id.
    pub(super) fn on(self, run: &Rendezvous, node: &str) -> Result<String, Refused> {
        let role: Role = node.parse().map_err(Refused::Nonsense)?;
        if run.is_finished() {
            return Err(Refused::NotNow(format!("run {} has ended", run.name())));
        }
        let hit = match self {
            Self::Kill => remote::signal(run, role, Signal::KILL),
            Self::Stop => remote::signal(run, role, Signal::STOP),
            Self::Continue => remote::signal(run, role, Signal::CONT),
            Self::Restart => remote::ask_for_successor(run, role),
        };
        let hit = hit.map_err(|failure| match failure {
            Failure::Input(problem) => Refused::Nonsense(problem),
            Failure::Running(error) => Refused::NotNow(error.to_string()),
            Failure::ReportedInput => Refused::NotNow(format!("{role} cannot be reached")),
        })?;
        let done = match self {
            Self::Kill => "killed",
            Self::Stop => "stopped",
            Self::Continue => "continued",
            Self::Restart => "asked to end",
        };
        Ok(format!("{role}, {hit}: {done}"))
    }
}
