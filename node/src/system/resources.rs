//! Checks the resources of a run before it starts, so that an error names the missing one.

use std::fs::File;
use std::path::Path;

use rustix::fs::{Access, access, statvfs};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// Where shared memory lives.
pub(crate) const SHARED_MEMORY: &str = "/dev/shm";

/// Open files of fusion and the simulator in a run without robots, and the increase per robot: measured, with a margin for
/// dead nodes that are not cleaned up yet.
const FILES: u64 = 48;
const FILES_PER_ROBOT: u64 = 6;

/// Shared memory of a run without robots, bytes and files, and the increase per robot, with the same margin.
const MEMORY: u64 = 512 << 10;
const MEMORY_PER_ROBOT: u64 = 64 << 10;
const MEMORY_FILES: u64 = 128;
const MEMORY_FILES_PER_ROBOT: u64 = 32;

/// A resource that is short.
#[derive(Debug, thiserror::Error)]
pub enum Shortage {
    /// Of open files.
    #[error("{robots} robots need {needed} open files, but the limit is {limit}: raise it, with ulimit -n {needed}")]
    Files {
        /// Robots of the run.
        robots: usize,
        /// How many they need.
        needed: u64,
        /// The most that the system allows.
        limit: u64,
    },
    /// Of shared memory.
    #[error(
        "{free} {what} free in {SHARED_MEMORY}, but {robots} robots need {needed}: make room there, or use fewer robots"
    )]
    Memory {
        /// Robots of the run.
        robots: usize,
        /// How much they need.
        needed: u64,
        /// The unit: kB or files.
        what: &'static str,
        /// How much is free.
        free: u64,
    },
    /// No usable folder for shared memory.
    #[error(
        "cannot write to {SHARED_MEMORY}, where processes share memory: {0}: expected a folder that can be written"
    )]
    NoSharedMemory(std::io::Error),
}

/// Raises this process's limit of open files as far as a run needs and the system allows.
///
/// # Errors
/// [`Shortage::Files`] if the limit stays too low.
pub fn provide_files(robots: usize) -> Result<(), Shortage> {
    let needed = FILES + FILES_PER_ROBOT * robots as u64;
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    if current.is_none_or(|current| current >= needed) {
        return Ok(());
    }
    // Twice the need: the supervisor's nodes inherit it, and dead nodes leave files open for a while.
    let wanted = maximum.map_or(2 * needed, |maximum| maximum.min(2 * needed));
    let limit = match setrlimit(Resource::Nofile, Rlimit { current: Some(wanted), maximum }) {
        Ok(()) => wanted,
        Err(_) => current.unwrap_or(0),
    };
    if limit < needed { Err(Shortage::Files { robots, needed, limit }) } else { Ok(()) }
}

/// Checks that shared memory is available.
///
/// # Errors
/// [`Shortage::NoSharedMemory`].
pub fn look_for_shared_memory() -> Result<(), Shortage> {
    let place = Path::new(SHARED_MEMORY);
    let usable = access(place, Access::READ_OK | Access::WRITE_OK | Access::EXEC_OK);
    usable.map_err(|error| Shortage::NoSharedMemory(error.into()))
}

/// Checks that there is enough shared memory for a run. A later lack of it kills the process that touches the missing page.
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
    // A file system that does not count files reports zero.
    if space.f_files > 0 && free < needed {
        return Err(Shortage::Memory { robots, needed, what: "files", free });
    }
    Ok(())
}

/// Names the resource that has run out, if any, after a failure that iceoryx2 does not explain.
#[must_use]
pub fn run_out_of() -> Option<&'static str> {
    let files: std::io::Result<Vec<File>> = (0..8).map(|_| File::open("/dev/null")).collect();
    if files.is_err_and(|error| [Some(23), Some(24)].contains(&error.raw_os_error())) {
        return Some("there is no room for more open files: raise the limit, with ulimit -n");
    }
    match statvfs(SHARED_MEMORY) {
        Err(_) => Some("/dev/shm, where processes share memory, is gone: mount it again"),
        Ok(space) if space.f_bavail.saturating_mul(space.f_frsize) < MEMORY_PER_ROBOT => {
            Some("/dev/shm is full: make room there, or use fewer robots")
        }
        Ok(space) if space.f_files > 0 && space.f_favail < 8 => {
            Some("/dev/shm has no room for more files: remove files there, or use fewer robots")
        }
        Ok(_) => None,
    }
}
