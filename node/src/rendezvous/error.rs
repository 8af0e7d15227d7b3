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
    /// A live run has the name.
    #[error("run {name} is already running: choose another --name, or stop it first")]
    Taken {
        /// The name.
        name: RunName,
    },
    /// A live process has the role.
    #[error("{role} of run {name} is already running, {holder}: end it first, or choose another role")]
    RoleTaken {
        /// The role.
        role: Role,
        /// The run.
        name: RunName,
        /// The holder, as far as this process can see it.
        holder: String,
    },
    /// The system lacks a resource.
    #[error(transparent)]
    Short(#[from] Shortage),
    /// The folder belongs to another user.
    #[error("{} belongs to another user: choose another --name", .0.display())]
    NotOurs(PathBuf),
    /// The path of the folder is taken by something else.
    #[error("{} is not a folder: remove it, or choose another --name", .0.display())]
    NoFolder(PathBuf),
    /// The description of the run cannot be used.
    #[error("cannot use {}: {reason}: end the run and remove its folder, or choose another --name", .file.display())]
    Unusable {
        /// The file.
        file: PathBuf,
        /// Why.
        reason: SealError,
    },
    /// The run was created by a build with another protocol.
    #[error("run {name} was started by {build}: use one version for all its nodes")]
    OtherBuild {
        /// The run.
        name: RunName,
        /// The build that created it.
        build: OtherBuild,
    },
    /// The wait groups cannot be created.
    #[error("cannot use the wait groups of the run in /dev/shm: {0}: start the run again")]
    WaitGroups(#[from] BlockError),
    /// The system refuses a file operation.
    #[error("cannot use {}: {source}: check that this user may use it, and that its disk has room", .path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The role's process has ended, and the state that a successor needs is missing.
    #[error("{role} of run {name} ended and saved no state to resume from: start a new run")]
    StateLost {
        /// The role.
        role: Role,
        /// The run.
        name: RunName,
    },
    /// The run's shared memory was removed from outside.
    #[error(
        "run {name} has lost its shared memory: {} was removed during the run, as systemd does at a user's last logout with RemoveIPC=yes: `rangehound resume {}` continues from its checkpoints", .folder.display(), .out_dir.display()
    )]
    Removed {
        /// The run.
        name: RunName,
        /// The removed file or folder.
        folder: PathBuf,
        /// Its run folder.
        out_dir: PathBuf,
    },
    /// A request to end arrived while waiting for the run.
    #[error("the wait for the run was ended by a signal")]
    Terminated,
}
