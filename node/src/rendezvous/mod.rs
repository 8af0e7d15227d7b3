//! How the processes of a run find each other, detect who lives, and clean up.
//!
//! A run is a folder in `/dev/shm`, readable by its owner only:
//!
//! | file | what |
//! |---|---|
//! | `membership.lock` | the membership lock: held briefly to create, join or leave the run |
//! | `members` | locked (shared) by every live member: if an exclusive lock succeeds, the run is dead |
//! | `run` | the sealed [`RunDescription`]: exists once the creator lets nodes join |
//! | `iceoryx2.toml` | prefix and root of the run's shared memory |
//! | `<role>.role` | locked by the process that holds the role; see [`Roster`] |
//! | `ending` | exists once the supervisor ends the run |
//! | `live` | port and token of the run's live page |
//! | `finished` | exists once the simulator has ended the run |
//! | `estimated` | exists once fusion has estimated and recorded every tick |
//!
//! All locks are kernel locks: a process that dies, for whatever reason, releases them at once. The
//! last member to leave removes the folder and the shared memory. If the last member was killed, the
//! next creator of any run removes them.

mod description;
mod error;
mod holder;
mod place;
mod presence;
mod role;
mod roster;
pub mod tenure;

use std::fs::{File, TryLockError};
use std::path::PathBuf;
use std::time::{Duration, Instant, UNIX_EPOCH};

use rangehound_shared::record::Record;
use rangehound_shared::run_name::RunName;
use rangehound_shared::sealed::{self, SealError};
use rustix::process::Signal;

use crate::system::bounded;
use crate::system::resources;
use crate::system::signal::Termination;
use crate::tick_log::TickLogWriter;
use crate::wait_groups;
pub use description::RunDescription;
pub use error::RendezvousError;
pub use holder::{Holder, Process};
use place::{Place, run_names};
pub use presence::Inspection;
use presence::Presence;
pub use role::Role;
pub use roster::{RoleLease, Roster, Succession};

/// Poll interval of a joiner that waits for its run to be created.
const JOIN_POLL: Duration = Duration::from_millis(20);

/// How long a creator retries before it calls a name taken: a killed process keeps its locks until the kernel has
/// removed it.
const LOCK_RELEASE_MAX: Duration = Duration::from_millis(500);

/// Longest note, bytes: that of a gateway with the largest team.
const NOTE_LEN_MAX: usize = 1 << 17;

/// The note with port and token of the live page, so that a restarted page keeps its address.
pub const LIVE_NOTE: &str = "live";

/// The note of a supervisor that ends its run: nodes are not restarted any more, and the results are written.
pub const ENDING_NOTE: &str = "ending";

/// A run that this process has created and that no node can join yet: its folder is prepared meanwhile. On drop it is removed.
#[derive(Debug)]
pub struct Created(Rendezvous);

impl Created {
    /// Lets nodes join.
    ///
    /// # Errors
    /// If the system refuses, or the description is too large.
    pub fn open(self) -> Result<Rendezvous, RendezvousError> {
        let Self(mut run) = self;
        let place = &run.place;
        let sealed =
            run.description.seal().map_err(|reason| RendezvousError::Unusable { file: place.path("run"), reason })?;
        place.write("run", sealed.as_bytes())?;
        run.presence = Presence::of(place);
        Ok(run)
    }
}

/// Membership in a run: holds the shared lock while it lives, and leaves on drop.
#[derive(Debug)]
pub struct Rendezvous {
    place: Place,
    roster: Roster,
    description: RunDescription,
    presence: Presence,
    /// The path of [`ENDING_NOTE`], which nodes look for in each tick.
    ending: PathBuf,
    members: Option<File>,
}

impl Rendezvous {
    /// Creates a run under this name and becomes its first member. Leftovers of dead runs, of this
    /// name or another, are removed; a live run is never touched.
    ///
    /// # Errors
    /// [`RendezvousError::Taken`] if a run of this name lives; others if the system refuses.
    pub fn create(name: &RunName, description: RunDescription) -> Result<Self, RendezvousError> {
        Self::create_closed(name, description)?.open()
    }

    /// As [`Self::create`], but no node can join yet.
    ///
    /// # Errors
    /// As [`Self::create`].
    pub fn create_closed(name: &RunName, description: RunDescription) -> Result<Created, RendezvousError> {
        Self::create_within(LOCK_RELEASE_MAX, name, description)
    }

    /// As [`Self::create_closed`], but fails at once if the name is taken: for a caller that can use another name.
    ///
    /// # Errors
    /// As [`Self::create`].
    pub fn create_closed_if_free(name: &RunName, description: RunDescription) -> Result<Created, RendezvousError> {
        Self::create_within(Duration::ZERO, name, description)
    }

    fn create_within(
        timeout: Duration,
        name: &RunName,
        description: RunDescription,
    ) -> Result<Created, RendezvousError> {
        let robots = description.scenario.robots.len();
        resources::provide_files(robots)?;
        resources::look_for_shared_memory()?;
        remove_dead_runs(name);
        resources::look_for_memory(robots)?;
        let place = Place::of(name);
        let began = Instant::now();
        let (_lock, members) = loop {
            let lock = place.lock(true)?;
            let members = place.open("members")?;
            match members.try_lock() {
                Ok(()) => break (lock, members),
                Err(TryLockError::WouldBlock) if began.elapsed() < timeout => continue_orphans(&place),
                Err(TryLockError::WouldBlock) => return Err(RendezvousError::Taken { name: name.clone() }),
                Err(TryLockError::Error(source)) => return Err(place.io_error("members", source)),
            }
            drop(lock);
            std::thread::sleep(JOIN_POLL);
        };
        place.remove_leftovers();
        place.write("iceoryx2.toml", place.iceoryx2_config().as_bytes())?;
        wait_groups::create(place.prefix())?;
        members.lock_shared().map_err(|source| place.io_error("members", source))?;
        Ok(Created(Self::member(place, description, members)))
    }

    /// Joins the run of this name, waiting until it exists. `waiting` is called once if the run does not exist yet.
    ///
    /// # Errors
    /// [`RendezvousError`], [`RendezvousError::Terminated`] among them.
    pub fn join(name: &RunName, termination: &Termination, waiting: impl FnOnce()) -> Result<Self, RendezvousError> {
        resources::look_for_shared_memory()?;
        let mut waiting = Some(waiting);
        while !termination.requested() {
            if let Some(run) = Self::join_if_alive(name)? {
                resources::provide_files(run.description.scenario.robots.len())?;
                return Ok(run);
            }
            if let Some(waiting) = waiting.take() {
                waiting();
            }
            std::thread::sleep(JOIN_POLL);
        }
        Err(RendezvousError::Terminated)
    }

    /// Joins the run of this name if it has been created and a member of it lives.
    ///
    /// # Errors
    /// [`RendezvousError`].
    pub fn join_if_alive(name: &RunName) -> Result<Option<Self>, RendezvousError> {
        let place = Place::of(name);
        if !place.path("run").exists() {
            return Ok(None);
        }
        let lock = match place.lock(false) {
            Ok(lock) => lock,
            Err(RendezvousError::Io { source, .. }) if source.kind() == std::io::ErrorKind::NotFound => {
                return Ok(None);
            }
            Err(error) => return Err(error),
        };
        let members = place.open_existing("members")?;
        match members.try_lock() {
            // No live member: the files are a dead run's.
            Ok(()) => return Ok(None),
            Err(TryLockError::WouldBlock) => {}
            Err(TryLockError::Error(source)) => return Err(place.io_error("members", source)),
        }
        // Its creator has not opened it yet.
        if !place.path("run").exists() {
            return Ok(None);
        }
        members.lock_shared().map_err(|source| place.io_error("members", source))?;
        // A run with a member is neither removed nor created anew, so others may join while this process reads.
        drop(lock);
        let sealed =
            bounded::read(&place.path("run"), sealed::FILE_LEN_MAX).map_err(|source| place.io_error("run", source))?;
        let description = RunDescription::open(&sealed).map_err(|reason| match reason {
            SealError::OtherBuild(build) => RendezvousError::OtherBuild { name: name.clone(), build },
            reason => RendezvousError::Unusable { file: place.path("run"), reason },
        })?;
        Ok(Some(Self::member(place, description, members)))
    }

    fn member(place: Place, description: RunDescription, members: File) -> Self {
        let (roster, presence) = (Roster::of(&place), Presence::of(&place));
        let ending = place.path(ENDING_NOTE);
        Self { place, roster, description, presence, ending, members: Some(members) }
    }

    /// Creates the run again after its shared memory was removed from outside. Remains of it are removed too, so that
    /// processes that still use them see that the run is over. Incarnations continue from the old roles. All
    /// nodes must have ended.
    ///
    /// # Errors
    /// As [`Self::create`].
    pub fn recreate(self, starts: &[(Role, u64)]) -> Result<Self, RendezvousError> {
        let (name, description) = (self.name().clone(), self.description.clone());
        {
            // A failed lock means that it was removed.
            let _lock = self.place.lock(false);
            self.place.remove();
        }
        drop(self);
        let again = Self::create_closed(&name, description)?;
        for (role, starts) in starts {
            again.0.roster.count_from(*role, *starts)?;
        }
        again.open()
    }

    /// Checks at intervals that the run's shared memory still exists; call it in each round of a node's loop, with
    /// the time, monotonic ns.
    ///
    /// # Errors
    /// [`RendezvousError::Removed`].
    pub fn look_for_removal(&self, now_ns: u64) -> Result<(), RendezvousError> {
        if self.presence.holds(now_ns) { Ok(()) } else { Err(self.removed()) }
    }

    /// True if the run's shared memory was removed from outside.
    #[must_use]
    pub fn is_removed(&self) -> bool {
        !self.presence.holds_now()
    }

    /// The error for a member whose run was removed.
    #[must_use]
    pub fn removed(&self) -> RendezvousError {
        let out_dir = self.description.out_dir.clone();
        RendezvousError::Removed { name: self.name().clone(), folder: self.place.dir().to_owned(), out_dir }
    }

    /// A thorough check of the run's shared memory, for a supervisor.
    #[must_use]
    pub fn inspection(&self) -> Inspection {
        Inspection::of(&self.place)
    }

    /// Leaves the run but keeps observing it: creating or resuming the run does not wait for this process.
    #[must_use]
    pub fn observe(self) -> Self {
        let mut observer = self;
        observer.members = None;
        observer
    }

    /// A number of this life of the run: a run that is resumed has another one, and counts incarnations from the start again.
    #[must_use]
    pub fn life(&self) -> u64 {
        let created = std::fs::metadata(self.place.path("run")).and_then(|run| run.modified());
        let since = created.ok().and_then(|created| created.duration_since(UNIX_EPOCH).ok());
        since.map_or(0, |since| since.as_nanos() as u64)
    }

    /// Leaves the run while a thread of this process, which holds a role, still hangs: frees the role for a successor, and does
    /// not keep the run alive. Later actions of that thread have no effect.
    pub fn abandon(&self, role: Role) {
        let is_held_here = self.roster.holder(role) == Some(rustix::process::getpid());
        if let Some(silent_since) = self.roster.last_heartbeat(role).filter(|_| is_held_here) {
            // A failure leaves the role to a standby, which deposes a silent holder too.
            let _ = self.roster.depose(role, silent_since);
        }
        self.leave();
    }

    /// Leaves the run; the last member removes it. Errors are not reported: no caller could act on them,
    /// and the next creator tries again.
    fn leave(&self) {
        // If the folder was removed from outside, some of the run's shared memory may remain. The membership lock ensures that
        // it does not belong to a new creator of this name.
        let is_folder_gone = self.members.is_some() && !self.place.dir().exists();
        let Ok(_lock) = self.place.lock(is_folder_gone) else { return };
        if let Some(members) = &self.members {
            let _ = members.unlock();
        }
        let members = self.place.open_existing("members");
        let is_last = members.map_or(is_folder_gone, |members| members.try_lock().is_ok());
        if is_last {
            self.place.remove();
        }
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

    /// Prefix of the names of the run's shared memory.
    #[must_use]
    pub fn shared_memory_prefix(&self) -> &str {
        self.place.prefix()
    }

    /// Removes files that a killed process had not finished creating, so that no process waits for them. For
    /// a supervisor, after each death.
    pub fn remove_incomplete(&self) {
        self.place.remove_incomplete();
    }

    /// Removes the permissions of other users from all shared memory of this run.
    pub fn close_to_others(&self) {
        self.place.close_to_others();
    }

    /// The holders of the roles.
    #[must_use]
    pub fn roster(&self) -> &Roster {
        &self.roster
    }

    /// Refuses to replace a process that ended after it had logged ticks, or whose log is missing: a replacement
    /// would start from tick 0.
    ///
    /// # Errors
    /// [`RendezvousError::StateLost`].
    pub fn refuse_lost_state<R: Record>(
        &self,
        role: Role,
        log: Option<&TickLogWriter<R>>,
    ) -> Result<(), RendezvousError> {
        match log.map(TickLogWriter::is_empty) {
            Some(Ok(true)) => Ok(()),
            None if self.roster.starts(role) <= 1 => Ok(()),
            _ => Err(RendezvousError::StateLost { role, name: self.name().clone() }),
        }
    }

    /// Runs an action while nobody can be deposed. Returns `None` without running it if this holder was deposed before.
    ///
    /// # Errors
    /// If the membership lock cannot be taken: the action was not run.
    pub fn while_current<T>(
        &self,
        lease: &RoleLease,
        action: impl FnOnce() -> T,
    ) -> Result<Option<T>, RendezvousError> {
        let _lock = self.place.lock(false)?;
        Ok(lease.is_current().then(action))
    }

    /// Writes a note for other processes of this user to the run's folder. It is removed with the run.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write_note(&self, name: &str, text: &str) -> Result<(), RendezvousError> {
        self.place.write(name, text.as_bytes())
    }

    /// The text of a note, if it exists.
    #[must_use]
    pub fn note(&self, name: &str) -> Option<String> {
        String::from_utf8(bounded::read(&self.place.path(name), NOTE_LEN_MAX).ok()?).ok()
    }

    /// The text of a note, which is removed.
    #[must_use]
    pub fn take_note(&self, name: &str) -> Option<String> {
        let text = self.note(name)?;
        std::fs::remove_file(self.place.path(name)).ok().map(|()| text)
    }

    /// True if its supervisor ends the run. It sends a signal to the nodes that it has started; the others look for this.
    #[must_use]
    pub fn is_ending(&self) -> bool {
        self.ending.exists()
    }

    /// Marks the run as ended.
    ///
    /// # Errors
    /// If the mark cannot be written.
    pub fn finish(&self) -> Result<(), RendezvousError> {
        self.place.write("finished", b"")
    }

    /// Marks the run as estimated: fusion has estimated and recorded every tick.
    ///
    /// # Errors
    /// If the mark cannot be written.
    pub fn mark_estimated(&self) -> Result<(), RendezvousError> {
        self.place.write("estimated", b"")
    }

    /// True once the run has ended and fusion has nothing left to do.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.is_finished() && (self.place.path("estimated").exists() || !self.place.path("run").exists())
    }

    /// True once the run has ended. The last member removes the folder, so for an observer a missing folder also means that the
    /// run has ended; for a member it means that the run was lost.
    #[must_use]
    pub fn is_finished(&self) -> bool {
        self.place.path("finished").exists() || self.members.is_none() && !self.place.path("run").exists()
    }
}

impl Drop for Rendezvous {
    fn drop(&mut self) {
        self.leave();
    }
}

/// Names of this user's runs with a live member.
#[must_use]
pub fn living_runs() -> Vec<RunName> {
    run_names()
        .filter(|name| {
            let place = Place::of(name);
            // Holds the membership lock, so that nobody mistakes this check for a member.
            // A process that holds the membership lock is alive.
            let Ok(lock) = place.try_lock() else { return false };
            lock.is_none()
                || place
                    .open_existing("members")
                    .is_ok_and(|file| matches!(file.try_lock(), Err(TryLockError::WouldBlock)))
        })
        .collect()
}

/// The shared-memory files of the run of this name: none once its last member has left.
#[must_use]
pub fn files_of(name: &RunName) -> Vec<PathBuf> {
    Place::of(name).files()
}

/// Continues the nodes that were suspended when their supervisor was killed: the kernel's request to end
/// stays pending until they run.
fn continue_orphans(place: &Place) {
    for process in Roster::of(place).processes() {
        let (status, command) = (process.proc_text("status"), process.proc_text("cmdline"));
        let field = |name: &str| status.lines().find_map(|line| line.strip_prefix(name)).map(str::trim);
        let mut words = command.split('\0').skip_while(|word| *word != "--end-with").skip(1);
        let is_orphan = words.next().is_some_and(|parent| field("PPid:") != Some(parent));
        if is_orphan && field("State:").is_some_and(|state| state.starts_with('T')) {
            let _ = process.signal(Signal::CONT);
        }
    }
}

/// Removes this user's dead runs, except the one that is about to be created.
fn remove_dead_runs(but: &RunName) {
    for name in run_names().filter(|name| name != but) {
        let place = Place::of(&name);
        // The process that holds the membership lock will clean up; no other run waits for that.
        let Ok(Some(_lock)) = place.try_lock() else { continue };
        let Ok(members) = place.open_existing("members") else { continue };
        if members.try_lock().is_ok() {
            place.remove();
        }
    }
}

/// A run of the default scenario under a name that no other process has.
#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test that cannot go on should panic")]
pub(crate) fn create_for_test(name: &str) -> Rendezvous {
    use rangehound_shared::scenario::{Scenario, ScenarioFile};
    let name = format!("{name}-{}", std::process::id()).parse().unwrap();
    let scenario = Scenario::from_file(&ScenarioFile::default(), "test").unwrap();
    Rendezvous::create(&name, RunDescription::new(scenario, PathBuf::new())).unwrap()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_abandoned_role_is_free_and_its_holder_keeps_no_run_alive() {
        let hung = create_for_test("rendezvous-abandon");
        let name = hung.name().clone();
        let lease = hung.roster().take(Role::Fusion).unwrap();
        let other = Rendezvous::join_if_alive(&name).unwrap().unwrap();
        hung.abandon(Role::Fusion);
        assert!(!lease.is_current());
        assert_eq!(other.roster().take(Role::Fusion).unwrap().incarnation, 3, "one for the change of hands");
        drop(other);
        assert!(!living_runs().contains(&name) && files_of(&name).is_empty());
        // The thread ends at last, when another run has the name.
        let next = create_for_test("rendezvous-abandon");
        drop((lease, hung));
        assert!(living_runs().contains(&name) && next.roster().take(Role::Fusion).is_ok());
    }
}
