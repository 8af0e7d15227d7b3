//! The holders of the roles: one locked file for each role.
//!
//! The lock shows that a role is held, and ends with the holder's process. The file's text has the number of times that the
//! role was taken and the holder's PID; its modification time is the holder's last heartbeat.
//!
//! A role is passed on in two ways. If the holder ends, it releases the lock and a waiting process gets it. If the
//! holder hangs, it keeps its lock and is deposed: a new file replaces the old one, whose lock
//! then has no effect. Each holder has a greater incarnation than all before it.

use std::cell::Cell;
use std::fs::{File, TryLockError};
use std::io::{Read, Seek, Write};
use std::os::unix::fs::MetadataExt;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::time::{Duration, Instant, SystemTime};

use rustix::process::Pid;

use super::holder::{Holder, Process};
use super::place::Place;
use super::tenure::Tenure;
use super::{RendezvousError, Role};
use crate::system::clock::monotonic_ns;

/// Heartbeat interval of a holder that wakes up often enough.
const HEARTBEAT: Duration = Duration::from_millis(50);

/// A process that checks whether a role is held locks its file briefly: retry for this long before reporting a holder.
const TRY_LOCK_TIME: Duration = Duration::from_millis(20);

/// The roles of one run.
#[derive(Debug, Clone)]
pub struct Roster {
    place: Place,
}

/// One process's lease on its role.
#[derive(Debug)]
pub struct RoleLease {
    file: File,
    /// Number of this holder among all of the role, from 1: its fencing token.
    pub incarnation: u64,
    renewed_ns: Cell<u64>,
}

/// A wait for a role to become free.
#[derive(Debug)]
pub struct Succession {
    freed: Receiver<File>,
}

impl Roster {
    pub(super) fn of(place: &Place) -> Self {
        Self { place: place.clone() }
    }

    /// Takes a role for this process, until it ends or is deposed.
    ///
    /// # Errors
    /// [`RendezvousError::RoleTaken`] if a live process holds it.
    pub fn take(&self, role: Role) -> Result<RoleLease, RendezvousError> {
        let began = Instant::now();
        loop {
            let file = self.place.open(&file_name(role))?;
            match file.try_lock() {
                Ok(()) => {
                    // Under the membership lock nobody can be deposed, so the result of this check stays true.
                    let _lock = self.place.lock(false)?;
                    if is_current(&file) {
                        return self.register(role, file);
                    }
                }
                Err(TryLockError::WouldBlock) if began.elapsed() < TRY_LOCK_TIME => {
                    std::thread::sleep(Duration::from_millis(1));
                }
                Err(TryLockError::WouldBlock) => {
                    let holder = match self.process(role) {
                        Holder::Here(process) => format!("as process {}", process.pid().as_raw_pid()),
                        Holder::Elsewhere => "in another PID namespace (container)".to_owned(),
                        // The holder has just released it.
                        Holder::Nobody => "about to end".to_owned(),
                    };
                    return Err(RendezvousError::RoleTaken { role, name: self.place.name.clone(), holder });
                }
                Err(TryLockError::Error(source)) => return Err(self.place.io_error(&file_name(role), source)),
            }
        }
    }

    /// Waits for a role in the background, and locks it as soon as its holder ends.
    #[must_use]
    pub fn succeed(&self, role: Role) -> Succession {
        let (send, freed) = mpsc::channel();
        let place = self.place.clone();
        // The thread ends with the process at the latest: a wait for a lock has no time-out.
        let waited = std::thread::Builder::new().spawn(move || {
            let mut next = place.open(&file_name(role));
            while let Ok(file) = next {
                if file.lock().is_ok() && is_current(&file) {
                    // If the receiver is gone, the file is closed and the lock is free again.
                    let _ = send.send(file);
                    return;
                }
                // Not created here: a deposed holder's file has been replaced; a missing file means that the run is being removed.
                next = place.open_existing(&file_name(role));
            }
        });
        if let Err(error) = waited {
            log::warn!("cannot wait for the holder of {role} to end, only for missing heartbeats: {error}");
        }
        Succession { freed }
    }

    /// Takes a role, within the time, from a holder that ends. `None` also if that holder was deposed meanwhile: the awaited
    /// lock then has no effect.
    ///
    /// # Errors
    /// If the role's file cannot be written.
    pub fn take_when_free(
        &self,
        role: Role,
        succession: &Succession,
        at_most: Duration,
    ) -> Result<Option<RoleLease>, RendezvousError> {
        match succession.freed.recv_timeout(at_most) {
            Ok(file) => {
                let _lock = self.place.lock(false)?;
                if is_current(&file) { self.register(role, file).map(Some) } else { Ok(None) }
            }
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(RecvTimeoutError::Disconnected) => {
                std::thread::sleep(at_most);
                Ok(None)
            }
        }
    }

    /// Takes a role from a holder that has sent no heartbeat since this one. `None` if it has, or if
    /// another process took the role first.
    ///
    /// # Errors
    /// If the role's file cannot be written.
    pub fn depose(&self, role: Role, last_heartbeat: SystemTime) -> Result<Option<RoleLease>, RendezvousError> {
        let _lock = self.place.lock(false)?;
        let tenure = Tenure { starts: self.starts(role), heartbeat: self.last_heartbeat(role) };
        if !tenure.is_silent_since(&last_heartbeat) {
            return Ok(None);
        }
        let (name, partial) = (file_name(role), format!("{}.partial", file_name(role)));
        let io_error = |source| self.place.io_error(&name, source);
        let mut file = self.place.open(&partial)?;
        file.lock().map_err(io_error)?;
        let incarnation = tenure.next_incarnation();
        // Registered before it gets the name: nobody sees a role without its count.
        write_entry(&mut file, incarnation).map_err(io_error)?;
        std::fs::rename(self.place.path(&partial), self.place.path(&name)).map_err(io_error)?;
        Ok(Some(RoleLease::new(role, file, incarnation)))
    }

    /// Counts a start of the role and writes this process to its locked file. The caller holds the membership lock.
    fn register(&self, role: Role, mut file: File) -> Result<RoleLease, RendezvousError> {
        let io_error = |source| self.place.io_error(&file_name(role), source);
        let mut text = String::new();
        file.read_to_string(&mut text).map_err(io_error)?;
        let starts = parse_entry(&text).map_or(0, |(starts, _)| starts);
        let incarnation = Tenure::<SystemTime> { starts, heartbeat: None }.next_incarnation();
        write_entry(&mut file, incarnation).map_err(io_error)?;
        Ok(RoleLease::new(role, file, incarnation))
    }

    /// Sets the incarnation count of a role in a run that was created again, so that each holder has a greater incarnation
    /// than all before it.
    pub(super) fn count_from(&self, role: Role, starts: u64) -> Result<(), RendezvousError> {
        if starts == 0 {
            return Ok(());
        }
        let mut file = self.place.open(&file_name(role))?;
        write_entry_of(&mut file, starts, 0).map_err(|source| self.place.io_error(&file_name(role), source))
    }

    fn entry(&self, role: Role) -> Option<(u64, i32)> {
        self.read_entry(role).ok()?
    }

    /// `None` if the role was never taken.
    fn read_entry(&self, role: Role) -> std::io::Result<Option<(u64, i32)>> {
        match std::fs::read_to_string(self.place.path(&file_name(role))) {
            Ok(text) => Ok(parse_entry(&text)),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// The live processes that hold any role and that this process can reach.
    pub(super) fn processes(&self) -> Vec<Process> {
        let files = std::fs::read_dir(self.place.path("")).into_iter().flatten().flatten().map(|file| file.path());
        let roles = files.filter(|path| path.extension().is_some_and(|extension| extension == "role"));
        roles
            .filter_map(|path| {
                let hint = std::fs::read_to_string(&path).ok().and_then(|text| Pid::from_raw(parse_entry(&text)?.1));
                Process::holding(&File::open(path).ok()?, hint)
            })
            .collect()
    }

    /// The identity of the role's file: it changes when a holder is deposed.
    #[must_use]
    pub fn file_of(&self, role: Role) -> Option<u64> {
        std::fs::metadata(self.place.path(&file_name(role))).map(|file| file.ino()).ok()
    }

    /// True if the last process that took the role uses this iceoryx2 node. The node's id is unique; a PID is not, across
    /// PID namespaces.
    ///
    /// # Errors
    /// If the file cannot be read now.
    pub fn speaks_through(&self, role: Role, node: u128) -> std::io::Result<bool> {
        let Some((starts, _)) = self.read_entry(role)? else { return Ok(false) };
        match std::fs::read_to_string(self.place.path(&node_file_name(role))) {
            Ok(text) => Ok(text == node_entry(starts, node)),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(false),
            Err(error) => Err(error),
        }
    }

    /// Registers the iceoryx2 node of a role's holder, before it sends anything.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn register_node(&self, role: Role, lease: &RoleLease, node: u128) -> Result<(), RendezvousError> {
        self.place.write(&node_file_name(role), node_entry(lease.incarnation, node).as_bytes())
    }

    /// The number of times that a role has been taken in this run.
    #[must_use]
    pub fn starts(&self, role: Role) -> u64 {
        self.entry(role).map_or(0, |(starts, _)| starts)
    }

    /// PID of the last process that took this role, alive or not.
    #[must_use]
    pub fn last_holder(&self, role: Role) -> Option<Pid> {
        Pid::from_raw(self.entry(role)?.1)
    }

    /// The live process that holds this role, if this process can reach it.
    #[must_use]
    pub fn holder(&self, role: Role) -> Option<Pid> {
        match self.process(role) {
            Holder::Here(process) => Some(process.pid()),
            Holder::Nobody | Holder::Elsewhere => None,
        }
    }

    /// The holder of this role according to the kernel, never by the PID in the file alone.
    #[must_use]
    pub fn process(&self, role: Role) -> Holder {
        // Twice: a new holder may have come between the two reads.
        for _ in 0..2 {
            let file = File::open(self.place.path(&file_name(role)));
            let process = file.ok().and_then(|file| Process::holding(&file, self.last_holder(role)));
            if let Some(process) = process {
                return Holder::Here(process);
            }
            if !self.is_held(role) {
                return Holder::Nobody;
            }
        }
        Holder::Elsewhere
    }

    /// True while a live process holds this role.
    #[must_use]
    pub fn is_held(&self, role: Role) -> bool {
        let file = File::open(self.place.path(&file_name(role)));
        file.is_ok_and(|file| matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock)))
    }

    /// Time of the last heartbeat of this role's holder. Only a change of it has a meaning, because
    /// the wall clock may jump.
    #[must_use]
    pub fn last_heartbeat(&self, role: Role) -> Option<SystemTime> {
        std::fs::metadata(self.place.path(&file_name(role))).ok()?.modified().ok()
    }

    /// The last process that took this role and its last heartbeat, read together.
    #[must_use]
    pub fn heartbeat_of(&self, role: Role) -> Option<(Pid, SystemTime)> {
        let mut file = File::open(self.place.path(&file_name(role))).ok()?;
        let mut text = String::new();
        file.read_to_string(&mut text).ok()?;
        Some((Pid::from_raw(parse_entry(&text)?.1)?, file.metadata().ok()?.modified().ok()?))
    }
}

impl RoleLease {
    fn new(role: Role, file: File, incarnation: u64) -> Self {
        role.name_process();
        Self { file, incarnation, renewed_ns: Cell::new(monotonic_ns()) }
    }

    /// False once another process has taken the role from this one, whose actions then have no effect.
    #[must_use]
    pub fn is_current(&self) -> bool {
        is_current(&self.file)
    }

    /// Sends a heartbeat at intervals; call it in each round of a node's loop, with the time, monotonic ns.
    pub fn renew(&self, now_ns: u64) {
        if now_ns.saturating_sub(self.renewed_ns.get()) >= HEARTBEAT.as_nanos() as u64 {
            self.renewed_ns.set(now_ns);
            // Observers see a failure as a missing heartbeat.
            let _ = self.file.set_modified(SystemTime::now());
        }
    }
}

fn file_name(role: Role) -> String {
    format!("{role}.role")
}

/// File with the iceoryx2 node of the holder.
fn node_file_name(role: Role) -> String {
    format!("{role}.node")
}

fn node_entry(incarnation: u64, node: u128) -> String {
    format!("{incarnation} {node:032x}\n")
}

/// True while the locked file still has a name.
fn is_current(file: &File) -> bool {
    file.metadata().is_ok_and(|file| file.nlink() > 0)
}

/// The role's incarnation count and the PID of its last holder.
fn parse_entry(text: &str) -> Option<(u64, i32)> {
    let (starts, pid) = text.trim().split_once(' ')?;
    Some((starts.parse().ok()?, pid.parse().ok()?))
}

fn write_entry(file: &mut File, incarnation: u64) -> std::io::Result<()> {
    write_entry_of(file, incarnation, std::process::id())
}

fn write_entry_of(file: &mut File, incarnation: u64, pid: u32) -> std::io::Result<()> {
    file.rewind()?;
    // Padded, so that an overwrite leaves no digits of a longer number; in one write, so that
    // nobody reads half of it.
    file.write_all(format!("{incarnation:010} {pid:010}\n").as_bytes())
}

#[cfg(test)]
mod tests {
    use super::super::create_for_test as run;
    use super::*;

    #[test]
    fn one_process_holds_a_role_and_every_lease_is_counted() {
        let run = run("roster-take");
        let roster = run.roster();
        let first = roster.take(Role::Sim).unwrap();
        assert!(matches!(roster.take(Role::Sim), Err(RendezvousError::RoleTaken { .. })));
        assert_eq!(roster.holder(Role::Sim), Some(rustix::process::getpid()));
        drop(first);
        assert_eq!((roster.holder(Role::Sim), roster.starts(Role::Sim)), (None, 1));
        assert_eq!(roster.take(Role::Sim).unwrap().incarnation, 2);
    }

    /// A PID may mean another process in another PID namespace: only the registered node speaks for the role.
    #[test]
    fn only_the_last_holders_node_speaks_for_a_role() {
        let run = run("roster-node");
        let roster = run.roster();
        let speaks = |node| roster.speaks_through(Role::Sim, node).unwrap();
        assert!(!speaks(7), "nobody has had the role");
        let first = roster.take(Role::Sim).unwrap();
        assert!(!speaks(7), "of this process, which has registered none");
        roster.register_node(Role::Sim, &first, 7).unwrap();
        assert!(speaks(7) && !speaks(8));
        drop(first);
        let second = roster.take(Role::Sim).unwrap();
        assert!(!speaks(7), "of an earlier holder");
        roster.register_node(Role::Sim, &second, 8).unwrap();
        assert!(speaks(8) && !speaks(7));
    }

    #[test]
    fn a_waiting_process_gets_a_role_once_it_is_free() {
        let run = run("roster-succeed");
        let roster = run.roster();
        let first = roster.take(Role::Fusion).unwrap();
        let succession = roster.succeed(Role::Fusion);
        let short = Duration::from_millis(20);
        assert!(roster.take_when_free(Role::Fusion, &succession, short).unwrap().is_none());
        drop(first);
        let second = roster.take_when_free(Role::Fusion, &succession, Duration::from_secs(60)).unwrap().unwrap();
        assert_eq!(second.incarnation, 2);
        assert!(roster.is_held(Role::Fusion));
    }

    #[test]
    fn only_a_holder_without_heartbeat_is_deposed() {
        let run = run("roster-depose");
        let roster = run.roster();
        let old = roster.take(Role::Fusion).unwrap();
        let silence = roster.last_heartbeat(Role::Fusion).unwrap();
        std::thread::sleep(2 * HEARTBEAT);
        old.renew(monotonic_ns());
        assert!(roster.depose(Role::Fusion, silence).unwrap().is_none() && old.is_current());

        let silence = roster.last_heartbeat(Role::Fusion).unwrap();
        let new = roster.depose(Role::Fusion, silence).unwrap().unwrap();
        assert!(new.is_current() && !old.is_current());
        assert_eq!((new.incarnation, roster.starts(Role::Fusion)), (2, 2));
        assert_eq!(run.while_current(&new, || 7).unwrap(), Some(7));
        assert_eq!(run.while_current(&old, || 7).unwrap(), None);
        // Its heartbeats and its end no longer affect the role.
        let silence = roster.last_heartbeat(Role::Fusion);
        std::thread::sleep(2 * HEARTBEAT);
        old.renew(monotonic_ns());
        assert_eq!(roster.last_heartbeat(Role::Fusion), silence);
        drop(old);
        assert!(roster.is_held(Role::Fusion));
        assert!(matches!(roster.take(Role::Fusion), Err(RendezvousError::RoleTaken { .. })));
    }

    /// One process waits for a lock while another deposes its holder: only one of the two leads.
    #[test]
    fn a_holder_that_ends_while_it_is_deposed_has_one_successor() {
        let run = run("roster-race");
        let roster = run.roster();
        let first = roster.take(Role::Fusion).unwrap();
        let silence = roster.last_heartbeat(Role::Fusion).unwrap();
        let succession = roster.succeed(Role::Fusion);
        drop(first);
        // The waiting process has the lock, but has not registered.
        while !roster.is_held(Role::Fusion) {
            std::thread::yield_now();
        }
        let deposer = roster.depose(Role::Fusion, silence).unwrap().unwrap();
        let late = roster.take_when_free(Role::Fusion, &succession, Duration::from_secs(1)).unwrap();
        assert!(late.is_none(), "{late:?}");
        assert!(deposer.is_current() && deposer.incarnation == 2 && roster.starts(Role::Fusion) == 2);
    }

    #[test]
    fn a_foreign_pid_is_never_taken_for_the_holder() {
        let run = run("roster-stranger");
        let roster = run.roster();
        let lease = roster.take(Role::Robot(0)).unwrap();
        let mut stranger = std::process::Command::new("sleep").arg("60").spawn().unwrap();
        // As a process of another namespace would have written its PID, which means another process here.
        let path = run.place.path(&file_name(Role::Robot(0)));
        std::fs::write(path, format!("{:010} {:010}\n", 1, stranger.id())).unwrap();
        assert_eq!(roster.holder(Role::Robot(0)), Some(rustix::process::getpid()), "the process with the lock");
        drop(lease);
        assert!(matches!(roster.process(Role::Robot(0)), Holder::Nobody));
        stranger.kill().unwrap();
        stranger.wait().unwrap();
    }
}
