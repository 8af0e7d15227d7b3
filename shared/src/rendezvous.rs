//! How the processes of a run find each other, know who lives, and leave nothing behind.
//!
//! A run is a folder in `/dev/shm`, readable by its owner only:
//!
//! | file | what |
//! |---|---|
//! | `door` | locked for the moment in which somebody founds, joins or leaves |
//! | `members` | locked (shared) by every living member: exclusive success means nobody lives |
//! | `run` | the sealed [`RunDescription`] |
//! | `iceoryx2.toml` | prefix and root of the run's shared memory |
//! | `<role>.role` | locked by the one process in that role; holds its count of starts and its pid |
//! | `finished` | there once the simulator has ended the run |
//!
//! All locks are the kernel's: a process that dies, however it dies, lets go of them at once. The
//! last member to leave removes the folder and the shared memory; where the last one was killed, the
//! next founder of any run does.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read, Seek, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::xxh3_64;

use crate::scenario::Scenario;
use crate::sealed::{self, SealError};
use crate::signal::Termination;

/// Where shared memory lives.
const SHARED_MEMORY: &str = "/dev/shm";

/// Longest run name: the names of the sockets in the run's folder must stay under 108 bytes.
const NAME_LEN_MAX: usize = 24;

/// How often a joiner looks whether its run has been founded.
const JOIN_POLL: Duration = Duration::from_millis(20);

/// A run's name: 1 to 24 of `a-z`, `A-Z`, `0-9`, `-`, `_`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RunName(String);

/// A text that is no [`RunName`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("expected {}", self.expected())]
pub struct RunNameError;

impl RunNameError {
    /// What a name must be.
    #[must_use]
    pub fn expected(self) -> &'static str {
        "a name of 1 to 24 letters, digits, '-' or '_'"
    }
}

impl FromStr for RunName {
    type Err = RunNameError;

    fn from_str(text: &str) -> Result<Self, RunNameError> {
        let allowed = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        if (1..=NAME_LEN_MAX).contains(&text.len()) && text.chars().all(allowed) {
            Ok(Self(text.to_owned()))
        } else {
            Err(RunNameError)
        }
    }
}

impl std::fmt::Display for RunName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.fmt(f)
    }
}

/// A role in a run: one living process each.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Role {
    /// Advances the world and keeps the clock.
    Sim,
    /// Filters and plans.
    Fusion,
    /// One robot, by id.
    Robot(usize),
    /// Starts and ends the nodes.
    Supervisor,
}

impl std::fmt::Display for Role {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Sim => f.write_str("sim"),
            Self::Fusion => f.write_str("fusion"),
            Self::Robot(id) => write!(f, "robot-{id}"),
            Self::Supervisor => f.write_str("run"),
        }
    }
}

/// What every node of a run must know.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunDescription {
    /// Tells this run from every other, of the same name too.
    pub run_id: u64,
    /// The experiment.
    pub scenario: Scenario,
    /// The run folder, absolute: logs and report.
    pub out_dir: PathBuf,
}

impl RunDescription {
    /// A new run of this scenario.
    #[must_use]
    pub fn new(scenario: Scenario, out_dir: PathBuf) -> Self {
        let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
        let mut unique = [0; 20];
        unique[..16].copy_from_slice(&now.as_nanos().to_le_bytes());
        unique[16..].copy_from_slice(&std::process::id().to_le_bytes());
        Self { run_id: xxh3_64(&unique), scenario, out_dir }
    }
}

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
    #[error("{role} of run {name} is already there, as process {pid}")]
    RoleTaken {
        /// The role.
        role: Role,
        /// The run.
        name: RunName,
        /// Who holds it, as far as it could write its pid.
        pid: String,
    },
    /// The folder belongs to somebody else.
    #[error("{} belongs to another user: choose another --name", .0.display())]
    NotOurs(PathBuf),
    /// The description of the run cannot be used.
    #[error("{}: {reason}", .file.display())]
    Unusable {
        /// The file.
        file: PathBuf,
        /// Why.
        reason: SealError,
    },
    /// The system refuses a file operation.
    #[error("{}: {source}", .path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A request to end came while waiting for the run.
    #[error("ended while waiting for the run")]
    Terminated,
}

/// Membership in a run: holds the shared lock while it lives, and leaves on drop.
#[derive(Debug)]
pub struct Rendezvous {
    place: Place,
    description: RunDescription,
    members: Option<File>,
}

/// One process's hold on its role.
#[derive(Debug)]
pub struct RoleHold {
    _lock: File,
    /// Which start of the role this is, counted from 1.
    pub incarnation: u64,
}

impl Rendezvous {
    /// Founds a run under this name and becomes its first member. Leftovers of dead runs, of this
    /// name or another, are removed; a living run is never touched.
    ///
    /// # Errors
    /// [`RendezvousError::Taken`] if a run of this name lives; others if the system refuses.
    pub fn found(name: &RunName, description: RunDescription) -> Result<Self, RendezvousError> {
        remove_dead_runs(name);
        let place = Place::of(name);
        let _door = place.enter(true)?;
        let members = place.open("members")?;
        match members.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(RendezvousError::Taken { name: name.clone() }),
            Err(TryLockError::Error(source)) => return Err(place.io_error("members", source)),
        }
        place.remove_leftovers();
        place.write("iceoryx2.toml", place.iceoryx2_config().as_bytes())?;
        let sealed = sealed::seal(&description)
            .map_err(|reason| RendezvousError::Unusable { file: place.path("run"), reason })?;
        place.write("run", &sealed)?;
        members.lock_shared().map_err(|source| place.io_error("members", source))?;
        Ok(Self { place, description, members: Some(members) })
    }

    /// Joins the run of this name, waiting for it to be founded. `waiting` is called once if that is
    /// not at once.
    ///
    /// # Errors
    /// [`RendezvousError`], [`RendezvousError::Terminated`] among them.
    pub fn join(name: &RunName, termination: &Termination, waiting: impl FnOnce()) -> Result<Self, RendezvousError> {
        let mut waiting = Some(waiting);
        while !termination.requested() {
            if let Some(run) = Self::join_if_alive(name)? {
                return Ok(run);
            }
            if let Some(waiting) = waiting.take() {
                waiting();
            }
            std::thread::sleep(JOIN_POLL);
        }
        Err(RendezvousError::Terminated)
    }

    /// Joins the run of this name if it has been founded and a member of it lives.
    ///
    /// # Errors
    /// [`RendezvousError`].
    pub fn join_if_alive(name: &RunName) -> Result<Option<Self>, RendezvousError> {
        let place = Place::of(name);
        if !place.path("run").exists() {
            return Ok(None);
        }
        let _door = match place.enter(false) {
            Ok(door) => door,
            Err(RendezvousError::Io { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => {
                return Ok(None);
            }
            Err(error) => return Err(error),
        };
        let members = place.open_existing("members")?;
        match members.try_lock() {
            // Nobody lives: what lies here is a dead run's.
            Ok(()) => return Ok(None),
            Err(TryLockError::WouldBlock) => {}
            Err(TryLockError::Error(source)) => return Err(place.io_error("members", source)),
        }
        members.lock_shared().map_err(|source| place.io_error("members", source))?;
        let sealed = std::fs::read(place.path("run")).map_err(|source| place.io_error("run", source))?;
        let description =
            sealed::open(&sealed).map_err(|reason| RendezvousError::Unusable { file: place.path("run"), reason })?;
        Ok(Some(Self { place, description, members: Some(members) }))
    }

    /// The run.
    #[must_use]
    pub fn description(&self) -> &RunDescription {
        &self.description
    }

    /// The run's name.
    #[must_use]
    pub fn name(&self) -> &RunName {
        &self.place.name
    }

    /// The file that sets up iceoryx2 for this run.
    #[must_use]
    pub fn iceoryx2_config_path(&self) -> PathBuf {
        self.place.path("iceoryx2.toml")
    }

    /// Takes a role, which nobody else can until this process ends.
    ///
    /// # Errors
    /// [`RendezvousError::RoleTaken`] if a living process has it.
    pub fn take_role(&self, role: Role) -> Result<RoleHold, RendezvousError> {
        let file_name = format!("{role}.role");
        let mut file = self.place.open(&file_name)?;
        let io_error = |source| self.place.io_error(&file_name, source);
        let mut text = String::new();
        let taken = file.try_lock();
        file.read_to_string(&mut text).map_err(io_error)?;
        let (starts, pid) = text.trim().split_once(' ').unwrap_or(("0", "unknown"));
        match taken {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                return Err(RendezvousError::RoleTaken { role, name: self.name().clone(), pid: pid.to_owned() });
            }
            Err(TryLockError::Error(source)) => return Err(io_error(source)),
        }
        let incarnation = starts.parse::<u64>().unwrap_or(0) + 1;
        file.rewind().map_err(io_error)?;
        // Padded, so that an overwrite never leaves digits of a longer number behind; at once, so that
        // nobody reads half of it.
        let text = format!("{incarnation:010} {:010}\n", std::process::id());
        file.write_all(text.as_bytes()).map_err(io_error)?;
        Ok(RoleHold { _lock: file, incarnation })
    }

    /// How often a role has been started in this run.
    #[must_use]
    pub fn starts(&self, role: Role) -> u64 {
        let text = std::fs::read_to_string(self.place.path(&format!("{role}.role"))).unwrap_or_default();
        text.split(' ').next().and_then(|starts| starts.parse().ok()).unwrap_or(0)
    }

    /// True while a living process holds this role.
    #[must_use]
    pub fn is_held(&self, role: Role) -> bool {
        let file = File::open(self.place.path(&format!("{role}.role")));
        file.is_ok_and(|file| matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock)))
    }

    /// Marks the run as ended.
    ///
    /// # Errors
    /// If the mark cannot be written.
    pub fn finish(&self) -> Result<(), RendezvousError> {
        self.place.write("finished", b"")
    }

    /// True once the run has ended, or its folder is gone.
    #[must_use]
    pub fn is_finished(&self) -> bool {
        self.place.path("finished").exists() || !self.place.path("run").exists()
    }
}

impl Drop for Rendezvous {
    /// Leaves; the last one out removes the run. Errors are not told: there is nobody to act on them,
    /// and the next founder tries again.
    fn drop(&mut self) {
        let Ok(_door) = self.place.enter(false) else { return };
        self.members = None;
        let Ok(members) = self.place.open_existing("members") else { return };
        if members.try_lock().is_ok() {
            self.place.remove();
        }
    }
}

/// The files of one run.
#[derive(Debug)]
struct Place {
    name: RunName,
    dir: PathBuf,
    /// Starts the name of every file that iceoryx2 makes for this run.
    prefix: String,
}

impl Place {
    fn of(name: &RunName) -> Self {
        let dir = Path::new(SHARED_MEMORY).join(format!("{}{name}", folder_prefix()));
        // A hash, not the name: the names of sockets are short of room.
        let prefix = format!("rh{:08x}_", xxh3_64(dir.as_os_str().as_encoded_bytes()) as u32);
        Self { name: name.clone(), dir, prefix }
    }

    fn path(&self, file: &str) -> PathBuf {
        self.dir.join(file)
    }

    fn io_error(&self, file: &str, source: std::io::Error) -> RendezvousError {
        RendezvousError::Io { path: self.path(file), source }
    }

    /// Locks the door. The last one out removes the folder, so a lock counts only if the door is still
    /// the one that the path names.
    fn enter(&self, create: bool) -> Result<File, RendezvousError> {
        loop {
            if create {
                let made = std::fs::DirBuilder::new().mode(0o700).create(&self.dir);
                if let Err(source) = made
                    && source.kind() != std::io::ErrorKind::AlreadyExists
                {
                    return Err(RendezvousError::Io { path: self.dir.clone(), source });
                }
            }
            let dir_error = |source| RendezvousError::Io { path: self.dir.clone(), source };
            if std::fs::metadata(&self.dir).map_err(dir_error)?.uid() != rustix::process::getuid().as_raw() {
                return Err(RendezvousError::NotOurs(self.dir.clone()));
            }
            // Opened, not made, by those who only look: a dead run's folder must not come back.
            let door = match if create { self.open("door") } else { self.open_existing("door") } {
                Err(RendezvousError::Io { source, .. }) if create && source.kind() == std::io::ErrorKind::NotFound => {
                    continue;
                }
                other => other?,
            };
            door.lock().map_err(|source| self.io_error("door", source))?;
            let locked = door.metadata().map_err(|source| self.io_error("door", source))?;
            match std::fs::metadata(self.path("door")) {
                Ok(named) if named.ino() == locked.ino() => return Ok(door),
                _ => {}
            }
        }
    }

    fn open(&self, file: &str) -> Result<File, RendezvousError> {
        OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .mode(0o600)
            .open(self.path(file))
            .map_err(|source| self.io_error(file, source))
    }

    fn open_existing(&self, file: &str) -> Result<File, RendezvousError> {
        OpenOptions::new().read(true).write(true).open(self.path(file)).map_err(|source| self.io_error(file, source))
    }

    /// Writes a file whole or not at all.
    fn write(&self, file: &str, bytes: &[u8]) -> Result<(), RendezvousError> {
        let partial = format!("{file}.partial");
        let write = || {
            let mut out =
                OpenOptions::new().write(true).create(true).truncate(true).mode(0o600).open(self.path(&partial))?;
            out.write_all(bytes)?;
            std::fs::rename(self.path(&partial), self.path(file))
        };
        write().map_err(|source| self.io_error(file, source))
    }

    fn iceoryx2_config(&self) -> String {
        format!("[global]\nroot-path = {:?}\nprefix = {:?}\n", self.dir.display().to_string(), self.prefix)
    }

    /// Removes what a dead run of this name left, but for the locks, which the caller holds.
    fn remove_leftovers(&self) {
        for entry in std::fs::read_dir(&self.dir).into_iter().flatten().flatten() {
            let name = entry.file_name();
            if name != "door" && name != "members" {
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

    /// Removes the run. The caller holds the door and knows that nobody lives.
    fn remove(&self) {
        self.remove_leftovers();
        let _ = std::fs::remove_dir_all(&self.dir);
    }
}

/// Starts the names of this user's run folders.
fn folder_prefix() -> String {
    format!("rh-{}-", rustix::process::getuid().as_raw())
}

/// Names of this user's runs that have a living member.
#[must_use]
pub fn living_runs() -> Vec<RunName> {
    run_names()
        .filter(|name| {
            let place = Place::of(name);
            // Behind the door, so that nobody mistakes this look for a member.
            let Ok(_door) = place.enter(false) else { return false };
            place.open_existing("members").is_ok_and(|file| matches!(file.try_lock(), Err(TryLockError::WouldBlock)))
        })
        .collect()
}

fn run_names() -> impl Iterator<Item = RunName> {
    let prefix = folder_prefix();
    std::fs::read_dir(SHARED_MEMORY)
        .into_iter()
        .flatten()
        .flatten()
        .filter_map(move |entry| entry.file_name().to_str()?.strip_prefix(&prefix)?.parse().ok())
}

/// Removes this user's runs of which nobody lives, but for the one that is about to be founded.
fn remove_dead_runs(but: &RunName) {
    for name in run_names().filter(|name| name != but) {
        let place = Place::of(&name);
        let Ok(_door) = place.enter(false) else { continue };
        let Ok(members) = place.open_existing("members") else { continue };
        if members.try_lock().is_ok() {
            place.remove();
        }
    }
}
