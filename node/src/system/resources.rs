//! What a run needs of the system, looked at before it starts, so that a lack is told by name.

use std::fs::File;
use std::path::Path;

use rustix::fs::{Access, access, statvfs};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// Where shared memory lives.
pub(crate) const SHARED_MEMORY: &str = "/dev/shm";

/// Open files that fusion and simulator take in a run of no robots, and more for each robot, measured, with room for
/// the dead until they are cleaned up after.
const FILES: u64 = 48;
const FILES_PER_ROBOT: u64 = 6;

/// Shared memory of a run of no robots, bytes and files, and more for each robot, with the same room.
const MEMORY: u64 = 512 << 10;
const MEMORY_PER_ROBOT: u64 = 64 << 10;
const MEMORY_FILES: u64 = 128;
const MEMORY_FILES_PER_ROBOT: u64 = 32;

/// What there is too little of.
#[derive(Debug, thiserror::Error)]
pub enum Shortage {
    /// Of open files.
    #[error(
        "expected room for {needed} open files for {robots} robots, got a limit of {limit}: raise it, with ulimit -n {needed}"
    )]
    Files {
        /// Robots of the run.
        robots: usize,
        /// What they need.
        needed: u64,
        /// What the system allows at most.
        limit: u64,
    },
    /// Of shared memory.
    #[error(
        "{SHARED_MEMORY}: expected {needed} {what} free for {robots} robots, got {free}: make room there, or take fewer robots"
    )]
    Memory {
        /// Robots of the run.
        robots: usize,
        /// What they need.
        needed: u64,
        /// Of what.
        what: &'static str,
        /// What there is.
        free: u64,
    },
    /// Of a place for shared memory.
    #[error("{SHARED_MEMORY}: expected a folder that can be written, where processes share memory: {0}")]
    NoSharedMemory(std::io::Error),
}

/// Provides for a process of a run: raises its limit of open files as far as it needs and may.
///
/// # Errors
/// [`Shortage::Files`] if that is not far enough.
pub fn provide_files(robots: usize) -> Result<(), Shortage> {
    let needed = FILES + FILES_PER_ROBOT * robots as u64;
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    if current.is_none_or(|current| current >= needed) {
        return Ok(());
    }
    // Twice the need: the supervisor's nodes inherit it, and dead ones leave files open for a while.
    let wanted = maximum.map_or(2 * needed, |maximum| maximum.min(2 * needed));
    let limit = match setrlimit(Resource::Nofile, Rlimit { current: Some(wanted), maximum }) {
        Ok(()) => wanted,
        Err(_) => current.unwrap_or(0),
    };
    if limit < needed { Err(Shortage::Files { robots, needed, limit }) } else { Ok(()) }
}

/// Looks whether processes can meet.
///
/// # Errors
/// [`Shortage::NoSharedMemory`].
pub fn look_for_shared_memory() -> Result<(), Shortage> {
    let place = Path::new(SHARED_MEMORY);
    let usable = access(place, Access::READ_OK | Access::WRITE_OK | Access::EXEC_OK);
    usable.map_err(|error| Shortage::NoSharedMemory(error.into()))
}

/// Looks whether there is shared memory for a run. A page that cannot be had later ends the process that touches it.
///
/// # Errors
/// [`Shortage`].
pub fn look_for_memory(robots: usize) -> Result<(), Shortage> {
    look_for_shared_memory()?;
    let space = statvfs(SHARED_MEMORY).map_err(|error| Shortage::NoSharedMemory(error.into()))?;
    let count = robots as u64;
    let (needed, free) = (MEMORY + MEMORY_PER_ROBOT * count, space.f_bavail.saturating_mul(space.f_frsize));
    if free < needed {
        return Err(Shortage::Memory { robots, needed: needed >> 10, what: "kB", free: free >> 10 });
    }
    let (needed, free) = (MEMORY_FILES + MEMORY_FILES_PER_ROBOT * count, space.f_favail);
    // No files in all: of a kind that does not count them.
    if space.f_files > 0 && free < needed {
        return Err(Shortage::Memory { robots, needed, what: "files", free });
    }
    Ok(())
}

/// After a failure whose reason iceoryx2 does not tell: what the system has run out of, if anything.
#[must_use]
pub fn run_out_of() -> Option<&'static str> {
    let files: std::io::Result<Vec<File>> = (0..8).map(|_| File::open("/dev/null")).collect();
    if files.is_err_and(|error| [Some(23), Some(24)].contains(&error.raw_os_error())) {
        return Some("there is no room for more open files: raise the limit, with ulimit -n");
    }
    match statvfs(SHARED_MEMORY) {
        Err(_) => Some("/dev/shm, where processes share memory, is gone"),
        Ok(space) if space.f_bavail.saturating_mul(space.f_frsize) < MEMORY_PER_ROBOT => Some("/dev/shm is full"),
        Ok(space) if space.f_files > 0 && space.f_favail < 8 => Some("/dev/shm has no room for more files"),
        Ok(_) => None,
    }
}
