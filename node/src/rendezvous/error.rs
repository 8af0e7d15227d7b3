//! Why a process cannot take part in a run.

use std::path::PathBuf;

use rangehound_shared::protocol::OtherBuild;
use rangehound_shared::run_name::RunName;
use rangehound_shared::sealed::SealError;

use super::Role;
use crate::block::BlockError;
use crate::system::resources::Shortage;

/// Why a process cannot take part in a run.
#[derive(Debug, thiserror::Error)]
pub enum RendezvousError {
    /// The name is taken by a run that lives.
    #[error("run {name} is going on already: choose another --name, or stop it first")]
    Taken {
        /// The name.
        name: RunName,
    },
    /// The role is taken by a process that lives.
    #[error("{role} of run {name} is already there, {holder}")]
    RoleTaken {
        /// The role.
        role: Role,
        /// The run.
        name: RunName,
        /// Who holds it, as far as that can be told from here.
        holder: String,
    },
    /// The system has too little of something.
    #[error(transparent)]
    Short(#[from] Shortage),
    /// The folder belongs to somebody else.
    #[error("{} belongs to another user: choose another --name", .0.display())]
    NotOurs(PathBuf),
    /// Something else has the name of the folder.
    #[error("{}: expected a folder or nothing, got something else: remove it, or choose another --name", .0.display())]
    NoFolder(PathBuf),
    /// The description of the run cannot be used.
    #[error("{}: {reason}", .file.display())]
    Unusable {
        /// The file.
        file: PathBuf,
        /// Why.
        reason: SealError,
    },
    /// The run is of a build that this one does not understand.
    #[error("run {name} was founded by {build}: use one version for all its nodes")]
    OtherBuild {
        /// The run.
        name: RunName,
        /// What founded it.
        build: OtherBuild,
    },
    /// The wait groups cannot be made.
    #[error(transparent)]
    WaitGroups(#[from] BlockError),
    /// The system refuses a file operation.
    #[error("{}: {source}", .path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The role's process is gone, and with it what a new one would need.
    #[error("{role} of run {name} ended and has left no state to go on from: expected a new run")]
    StateLost {
        /// The role.
        role: Role,
        /// The run.
        name: RunName,
    },
    /// Somebody has removed the run's shared memory.
    #[error(
        "run {name} has lost its shared memory: {} was removed while it went on, as systemd does at a user's last logout with RemoveIPC=yes: `rangehound resume {}` goes on from its checkpoints", .folder.display(), .out_dir.display()
    )]
    Removed {
        /// The run.
        name: RunName,
        /// What has been removed.
        folder: PathBuf,
        /// Its run folder.
        out_dir: PathBuf,
    },
    /// A request to end came while waiting for the run.
    #[error("ended while waiting for the run")]
    Terminated,
}
