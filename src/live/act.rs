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
    /// It is asked to end, and the supervisor starts another.
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
        let signal = match self {
            Self::Kill => Signal::KILL,
            Self::Stop => Signal::STOP,
            Self::Continue => Signal::CONT,
            Self::Restart if !run.roster().is_held(Role::Supervisor) => {
                return Err(Refused::NotNow(format!(
                    "{role} was started by hand: nothing would start it again, so it is not ended"
                )));
            }
            Self::Restart => Signal::TERM,
        };
        let hit = remote::signal(run, role, signal).map_err(|failure| match failure {
            Failure::Input(problem) => Refused::Nonsense(problem),
            Failure::Running(error) => Refused::NotNow(error.to_string()),
            Failure::ReportedInput => Refused::NotNow(format!("{role} cannot be reached")),
        })?;
        if self == Self::Restart {
            // A stopped process receives the signal only after it is continued. An error means that the process has ended already.
            let _ = remote::signal(run, role, Signal::CONT);
        }
        let done = match self {
            Self::Kill => "killed",
            Self::Stop => "stopped",
            Self::Continue => "continued",
            Self::Restart => "asked to end",
        };
        Ok(format!("{role}, {hit}: {done}"))
    }
}
