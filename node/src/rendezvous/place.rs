//! The files of a run in shared memory.

use std::fs::{File, OpenOptions, Permissions, TryLockError};
use std::io::Write;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use rangehound_shared::run_name::RunName;
use rustix::fs::OFlags;
use xxhash_rust::xxh3::xxh3_64;

use super::RendezvousError;
use crate::system::resources::SHARED_MEMORY;

/// File of the membership lock.
pub(super) const MEMBERSHIP_LOCK: &str = "membership.lock";

/// How long to wait for the membership lock, and how often to try.
const LOCK_WAIT: Duration = Duration::from_secs(10);
const LOCK_POLL: Duration = Duration::from_micros(200);
/// Retry interval for large teams: shorter retries by all members at once would keep the processors busy.
const LOCK_POLL_MAX: Duration = Duration::from_millis(10);

/// Permissions of a run's folder.
const MODE: u32 = 0o700;

/// The files of one run.
#[derive(Debug, Clone)]
pub(super) struct Place {
    pub(super) name: RunName,
    dir: PathBuf,
    /// Prefix of every file that iceoryx2 creates for this run.
    prefix: String,
}

impl Place {
    pub(super) fn of(name: &RunName) -> Self {
        let dir = Path::new(SHARED_MEMORY).join(format!("{}{name}", folder_prefix()));
        // A hash, not the name: socket names have little room.
        let prefix = format!("rh{:08x}_", xxh3_64(dir.as_os_str().as_encoded_bytes()) as u32);
        Self { name: name.clone(), dir, prefix }
    }

    /// Prefix of everything in shared memory that belongs to the run.
    pub(super) fn prefix(&self) -> &str {
        &self.prefix
    }

    /// The run's folder.
    pub(super) fn dir(&self) -> &Path {
        &self.dir
    }

    pub(super) fn path(&self, file: &str) -> PathBuf {
        self.dir.join(file)
    }

    pub(super) fn io_error(&self, file: &str, source: std::io::Error) -> RendezvousError {
        RendezvousError::Io { path: self.path(file), source }
    }

    /// Takes the membership lock if it is free.
    pub(super) fn try_lock(&self) -> Result<Option<File>, RendezvousError> {
        self.look_for_owner()?;
        let lock = self.open_existing(MEMBERSHIP_LOCK)?;
        match lock.try_lock() {
            Ok(()) => Ok(self.is_named(&lock).then_some(lock)),
            Err(TryLockError::WouldBlock) => Ok(None),
            Err(TryLockError::Error(source)) => Err(self.io_error(MEMBERSHIP_LOCK, source)),
        }
    }

    /// Takes the membership lock. Only a suspended process holds it for long.
    pub(super) fn lock(&self, create: bool) -> Result<File, RendezvousError> {
        let began = Instant::now();
        let mut poll = LOCK_POLL;
        loop {
            if create {
                let made = std::fs::DirBuilder::new().mode(MODE).create(&self.dir);
                if let Err(source) = made
                    && source.kind() != std::io::ErrorKind::AlreadyExists
                {
                    return Err(RendezvousError::Io { path: self.dir.clone(), source });
                }
            }
            self.look_for_owner()?;
            // Observers open it without creating it: a dead run's folder must not come back.
            let lock = match if create { self.open(MEMBERSHIP_LOCK) } else { self.open_existing(MEMBERSHIP_LOCK) } {
                Err(RendezvousError::Io { source, .. }) if create && source.kind() == std::io::ErrorKind::NotFound => {
                    continue;
                }
                other => other?,
            };
            match lock.try_lock() {
                Ok(()) if self.is_named(&lock) => return Ok(lock),
                Ok(()) => {}
                Err(TryLockError::WouldBlock) if began.elapsed() < LOCK_WAIT => {
                    std::thread::sleep(poll);
                    poll = (2 * poll).min(LOCK_POLL_MAX);
                }
                Err(TryLockError::WouldBlock) => {
                    let held =
                        "a process holds this lock for too long and may be suspended: continue or end that process";
                    return Err(self.io_error(MEMBERSHIP_LOCK, std::io::Error::new(std::io::ErrorKind::TimedOut, held)));
                }
                Err(TryLockError::Error(source)) => return Err(self.io_error(MEMBERSHIP_LOCK, source)),
            }
        }
    }

    fn look_for_owner(&self) -> Result<(), RendezvousError> {
        let dir_error = |source| RendezvousError::Io { path: self.dir.clone(), source };
        // Any user can create names there. Do not follow a link: the contents of the folder get removed.
        let found = std::fs::symlink_metadata(&self.dir).map_err(dir_error)?;
        if found.uid() != rustix::process::getuid().as_raw() {
            return Err(RendezvousError::NotOurs(self.dir.clone()));
        }
        if !found.is_dir() {
            return Err(RendezvousError::NoFolder(self.dir.clone()));
        }
        if found.permissions().mode() & 0o777 != MODE {
            std::fs::set_permissions(&self.dir, Permissions::from_mode(MODE)).map_err(dir_error)?;
        }
        Ok(())
    }

    /// The last member removes the folder, so a lock counts only if the path still names the locked file.
    fn is_named(&self, lock: &File) -> bool {
        let inode = |file: std::io::Result<std::fs::Metadata>| file.map(|file| file.ino()).ok();
        let locked = inode(lock.metadata());
        locked.is_some() && locked == inode(std::fs::metadata(self.path(MEMBERSHIP_LOCK)))
    }

    pub(super) fn open(&self, file: &str) -> Result<File, RendezvousError> {
        OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .mode(0o600)
            .open(self.path(file))
            .map_err(|source| self.io_error(file, source))
    }

    pub(super) fn open_existing(&self, file: &str) -> Result<File, RendezvousError> {
        OpenOptions::new().read(true).write(true).open(self.path(file)).map_err(|source| self.io_error(file, source))
    }

    /// Writes a file atomically.
    pub(super) fn write(&self, file: &str, bytes: &[u8]) -> Result<(), RendezvousError> {
        let partial = format!("{file}.partial");
        let write = || {
            let mut out =
                OpenOptions::new().write(true).create(true).truncate(true).mode(0o600).open(self.path(&partial))?;
            out.write_all(bytes)?;
            std::fs::rename(self.path(&partial), self.path(file))
        };
        write().map_err(|source| self.io_error(file, source))
    }

    pub(super) fn iceoryx2_config(&self) -> String {
        format!("[global]\nroot-path = {:?}\nprefix = {:?}\n", self.dir.display().to_string(), self.prefix)
    }

    /// Removes the files of a dead run of this name, except the locks, which the caller holds.
    pub(super) fn remove_leftovers(&self) {
        for entry in std::fs::read_dir(&self.dir).into_iter().flatten().flatten() {
            let name = entry.file_name();
            if name != MEMBERSHIP_LOCK && name != "members" {
                let path = entry.path();
                let _ = if path.is_dir() { std::fs::remove_dir_all(&path) } else { std::fs::remove_file(&path) };
            }
        }
        for entry in std::fs::read_dir(SHARED_MEMORY).into_iter().flatten().flatten() {
            if entry.file_name().as_encoded_bytes().starts_with(self.prefix.as_bytes()) {
                let _ = std::fs::remove_file(entry.path());
            }
        }
    }

    /// Removes shared memory that a killed process had not finished creating: files of this run with
    /// length zero that no process holds open. iceoryx2 would wait without end for such a file to be
    /// finished, if it may open it at all.
    pub(super) fn remove_incomplete(&self) {
        for entry in std::fs::read_dir(SHARED_MEMORY).into_iter().flatten().flatten() {
            let is_ours = entry.file_name().as_encoded_bytes().starts_with(self.prefix.as_bytes());
            if is_ours && entry.metadata().is_ok_and(|file| file.is_file() && file.len() == 0) {
                let path = entry.path();
                // Checked again after the search: its creator may have finished it meanwhile.
                if !is_open_elsewhere(&path) && std::fs::metadata(&path).is_ok_and(|file| file.len() == 0) {
                    let _ = std::fs::remove_file(&path);
                }
            }
        }
    }

    /// Removes the permissions of group and others from this run's files in shared memory. Any user can create names there, so
    /// links are not followed and files of other users are not touched.
    pub(super) fn close_to_others(&self) {
        let flags = (OFlags::NOFOLLOW | OFlags::NONBLOCK).bits().cast_signed();
        for path in self.files() {
            let Ok(file) = OpenOptions::new().read(true).custom_flags(flags).open(path) else { continue };
            let Ok(metadata) = file.metadata() else { continue };
            let mode = metadata.permissions().mode();
            if metadata.uid() == rustix::process::getuid().as_raw() && mode & 0o077 != 0 {
                // An error means that the file is gone.
                let _ = file.set_permissions(Permissions::from_mode(mode & 0o700));
            }
        }
    }

    /// The run's files in shared memory.
    pub(super) fn files(&self) -> Vec<PathBuf> {
        let entries = std::fs::read_dir(SHARED_MEMORY).into_iter().flatten().flatten().map(|entry| entry.path());
        let is_segment = |path: &Path| {
            path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(self.prefix.as_bytes()))
        };
        entries.filter(|path| *path == self.dir || is_segment(path)).collect()
    }

    /// Removes the run. The caller holds the membership lock and knows that no member lives.
    pub(super) fn remove(&self) {
        self.remove_leftovers();
        let _ = std::fs::remove_dir_all(&self.dir);
    }
}

/// True if another process that this user can see holds the file open. This process itself does not count.
fn is_open_elsewhere(path: &Path) -> bool {
    // `/proc` may belong to another PID namespace than this process.
    let me = std::fs::read_link("/proc/self").unwrap_or_default();
    let processes = std::fs::read_dir("/proc").into_iter().flatten().flatten();
    let processes = processes.filter(|process| process.file_name() != me.as_os_str());
    let files =
        processes.flat_map(|process| std::fs::read_dir(process.path().join("fd")).into_iter().flatten().flatten());
    files.into_iter().any(|file| std::fs::read_link(file.path()).is_ok_and(|target| target == path))
}

/// Prefix of this user's run folders.
fn folder_prefix() -> String {
    format!("rh-{}-", rustix::process::getuid().as_raw())
}

/// Names of this user's runs, dead or alive.
pub(super) fn run_names() -> impl Iterator<Item = RunName> {
    let prefix = folder_prefix();
    std::fs::read_dir(SHARED_MEMORY)
        .into_iter()
        .flatten()
        .flatten()
        .filter_map(move |entry| entry.file_name().to_str()?.strip_prefix(&prefix)?.parse().ok())
}
