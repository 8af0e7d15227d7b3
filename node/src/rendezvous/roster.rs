//! Who holds which role: a locked file each.
//!
//! The lock says who holds a role, and ends with its process. The file's text counts how often the role has
//! been taken and names the holder's process; its time of change is the holder's last heartbeat.
//!
//! A role is passed on in two ways. A holder that ends lets go of the lock, and whoever waits for it has it. A
//! holder that hangs keeps its lock and is deposed: a new file takes the name of the old one, whose lock
//! then counts for nothing. Each holder has a greater incarnation than all before it.

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

/// How often a holder gives a heartbeat, if it is called or wakes up often enough.
const SIGN: Duration = Duration::from_millis(50);

/// Whoever looks whether a role is held has its lock for a moment: not at once taken for a holder.
const GLANCE: Duration = Duration::from_millis(20);

/// The roles of one run.
#[derive(Debug, Clone)]
pub struct Roster {
    place: Place,
}

/// One process's hold on its role.
#[derive(Debug)]
pub struct RoleLease {
    file: File,
    /// Which holder of the role this is, counted from 1: its fencing token.
    pub incarnation: u64,
    signed: Cell<Instant>,
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

    /// Takes a role, which nobody else can until this process ends or is deposed.
    ///
    /// # Errors
    /// [`RendezvousError::RoleTaken`] if a living process has it.
    pub fn take(&self, role: Role) -> Result<RoleLease, RendezvousError> {
        let began = Instant::now();
        loop {
            let file = self.place.open(&file_name(role))?;
            match file.try_lock() {
                Ok(()) => {
                    // Behind the door nobody is deposed: what is seen of the file then stays so.
                    let _door = self.place.enter(false)?;
                    if is_current(&file) {
                        return self.register(role, file);
                    }
                }
                Err(TryLockError::WouldBlock) if began.elapsed() < GLANCE => {
                    std::thread::sleep(Duration::from_millis(1));
                }
                Err(TryLockError::WouldBlock) => {
                    let holder = match self.process(role) {
                        Holder::Here(process) => format!("as process {}", process.pid().as_raw_pid()),
                        Holder::Elsewhere => "in another PID namespace (container)".to_owned(),
                        // It has let go just now.
                        Holder::Nobody => "about to end".to_owned(),
                    };
                    return Err(RendezvousError::RoleTaken { role, name: self.place.name.clone(), holder });
                }
                Err(TryLockError::Error(source)) => return Err(self.place.io_error(&file_name(role), source)),
            }
        }
    }

    /// Waits for a role in the background, to have it as soon as the kernel says that its holder is gone.
    #[must_use]
    pub fn succeed(&self, role: Role) -> Succession {
        let (send, freed) = mpsc::channel();
        let place = self.place.clone();
        // Ends with the process if not before: a wait for a lock has no time limit.
        let waited = std::thread::Builder::new().spawn(move || {
            let mut next = place.open(&file_name(role));
            while let Ok(file) = next {
                if file.lock().is_ok() && is_current(&file) {
                    // If nobody waits for it any more, the file is closed and the lock is free again.
                    let _ = send.send(file);
                    return;
                }
                // Not made anew: who was deposed has left another; where there is none, somebody removes the run.
                next = place.open_existing(&file_name(role));
            }
        });
        if let Err(error) = waited {
            log::warn!("cannot wait for the end of who holds {role}, only for its silence: {error}");
        }
        Succession { freed }
    }

    /// Takes a role, within the time, from a holder that ends. `None` also if that holder was deposed meanwhile: the lock
    /// that was waited for then counts for nothing.
    ///
    /// # Errors
    /// If the role's file cannot be written.
    pub fn take_in_succession(
        &self,
        role: Role,
        succession: &Succession,
        at_most: Duration,
    ) -> Result<Option<RoleLease>, RendezvousError> {
        match succession.freed.recv_timeout(at_most) {
            Ok(file) => {
                let _door = self.place.enter(false)?;
                if is_current(&file) { self.register(role, file).map(Some) } else { Ok(None) }
            }
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(RecvTimeoutError::Disconnected) => {
                std::thread::sleep(at_most);
                Ok(None)
            }
        }
    }

    /// Takes a role from a holder that has given no heartbeat since this one. `None` if it has, or if
    /// another was faster.
    ///
    /// # Errors
    /// If the role's file cannot be written.
    pub fn depose(&self, role: Role, last_heartbeat: SystemTime) -> Result<Option<RoleLease>, RendezvousError> {
        let _door = self.place.enter(false)?;
        let tenure = Tenure { starts: self.starts(role), heartbeat: self.last_heartbeat(role) };
        if !tenure.is_silent_since(&last_heartbeat) {
            return Ok(None);
        }
        let (name, partial) = (file_name(role), format!("{}.partial", file_name(role)));
        let io_error = |source| self.place.io_error(&name, source);
        let mut file = self.place.open(&partial)?;
        file.lock().map_err(io_error)?;
        let incarnation = tenure.next_incarnation();
        // Signed before it has the name: nobody sees a role that is not counted.
        write_entry(&mut file, incarnation).map_err(io_error)?;
        std::fs::rename(self.place.path(&partial), self.place.path(&name)).map_err(io_error)?;
        Ok(Some(RoleLease::new(role, file, incarnation)))
    }

    /// Counts a start of the role and puts this process down in its file, whose lock it has. The caller holds the door.
    fn register(&self, role: Role, mut file: File) -> Result<RoleLease, RendezvousError> {
        let io_error = |source| self.place.io_error(&file_name(role), source);
        let mut text = String::new();
        file.read_to_string(&mut text).map_err(io_error)?;
        let starts = parse_entry(&text).map_or(0, |(starts, _)| starts);
        let incarnation = Tenure::<SystemTime> { starts, heartbeat: None }.next_incarnation();
        write_entry(&mut file, incarnation).map_err(io_error)?;
        Ok(RoleLease::new(role, file, incarnation))
    }

    /// Sets how often a role has been taken, in a run that was founded again: each holder has a greater incarnation
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

    /// `None` for a role that nobody has ever taken.
    fn read_entry(&self, role: Role) -> std::io::Result<Option<(u64, i32)>> {
        match std::fs::read_to_string(self.place.path(&file_name(role))) {
            Ok(text) => Ok(parse_entry(&text)),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// The living processes that hold any role and can be reached from here.
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

    /// Which file has the role's name: another one after somebody was deposed.
    #[must_use]
    pub fn file_of(&self, role: Role) -> Option<u64> {
        std::fs::metadata(self.place.path(&file_name(role))).map(|file| file.ino()).ok()
    }

    /// True if the process that took the role last speaks through this iceoryx2 node: its id is unique, where a process's number
    /// is another's in another PID namespace.
    ///
    /// # Errors
    /// If that cannot be told now.
    pub fn speaks_through(&self, role: Role, node: u128) -> std::io::Result<bool> {
        let Some((starts, _)) = self.read_entry(role)? else { return Ok(false) };
        match std::fs::read_to_string(self.place.path(&node_file_name(role))) {
            Ok(text) => Ok(text == node_entry(starts, node)),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(false),
            Err(error) => Err(error),
        }
    }

    /// Tells which node the holder of a role speaks through, before it says anything.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn speak_through(&self, role: Role, lease: &RoleLease, node: u128) -> Result<(), RendezvousError> {
        self.place.write(&node_file_name(role), node_entry(lease.incarnation, node).as_bytes())
    }

    /// How often a role has been taken in this run.
    #[must_use]
    pub fn starts(&self, role: Role) -> u64 {
        self.entry(role).map_or(0, |(starts, _)| starts)
    }

    /// The process that took this role last, alive or not.
    #[must_use]
    pub fn last_holder(&self, role: Role) -> Option<Pid> {
        Pid::from_raw(self.entry(role)?.1)
    }

    /// The living process that holds this role, if it can be reached from here.
    #[must_use]
    pub fn holder(&self, role: Role) -> Option<Pid> {
        match self.process(role) {
            Holder::Here(process) => Some(process.pid()),
            Holder::Nobody | Holder::Elsewhere => None,
        }
    }

    /// Who holds this role, as the kernel tells it: never who has the number that stands in the file.
    #[must_use]
    pub fn process(&self, role: Role) -> Holder {
        // Twice: one may have come between two looks.
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

    /// True while a living process holds this role.
    #[must_use]
    pub fn is_held(&self, role: Role) -> bool {
        let file = File::open(self.place.path(&file_name(role)));
        file.is_ok_and(|file| matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock)))
    }

    /// When the holder of this role last gave a heartbeat: only whether it changes means anything, for
    /// the wall clock may jump.
    #[must_use]
    pub fn last_heartbeat(&self, role: Role) -> Option<SystemTime> {
        std::fs::metadata(self.place.path(&file_name(role))).ok()?.modified().ok()
    }

    /// The process that took this role last, and its last heartbeat, of one moment.
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
        Self { file, incarnation, signed: Cell::new(Instant::now()) }
    }

    /// False once another process has taken the role from this one: whatever it does then counts for nothing.
    #[must_use]
    pub fn is_current(&self) -> bool {
        is_current(&self.file)
    }

    /// Gives a heartbeat now and then; to be called in each round of a node's loop.
    pub fn renew(&self) {
        if self.signed.get().elapsed() >= SIGN {
            self.signed.set(Instant::now());
            // A failure shows as silence.
            let _ = self.file.set_modified(SystemTime::now());
        }
    }
}

fn file_name(role: Role) -> String {
    format!("{role}.role")
}

/// The iceoryx2 node that the holder speaks through.
fn node_file_name(role: Role) -> String {
    format!("{role}.node")
}

fn node_entry(incarnation: u64, node: u128) -> String {
    format!("{incarnation} {node:032x}\n")
}

/// True while the locked file has a name.
fn is_current(file: &File) -> bool {
    file.metadata().is_ok_and(|file| file.nlink() > 0)
}

/// Starts of the role and pid of its last holder.
fn parse_entry(text: &str) -> Option<(u64, i32)> {
    let (starts, pid) = text.trim().split_once(' ')?;
    Some((starts.parse().ok()?, pid.parse().ok()?))
}

fn write_entry(file: &mut File, incarnation: u64) -> std::io::Result<()> {
    write_entry_of(file, incarnation, std::process::id())
}

fn write_entry_of(file: &mut File, incarnation: u64, pid: u32) -> std::io::Result<()> {
    file.rewind()?;
    // Padded, so that an overwrite never leaves digits of a longer number behind; at once, so that
    // nobody reads half of it.
    file.write_all(format!("{incarnation:010} {pid:010}\n").as_bytes())
}

#[cfg(test)]
mod tests {
    use super::super::found_for_test as run;
    use super::*;

    #[test]
    fn a_role_is_held_once_and_every_hold_is_counted() {
        let run = run("roster-take");
        let roster = run.roster();
        let first = roster.take(Role::Sim).unwrap();
        assert!(matches!(roster.take(Role::Sim), Err(RendezvousError::RoleTaken { .. })));
        assert_eq!(roster.holder(Role::Sim), Some(rustix::process::getpid()));
        drop(first);
        assert_eq!((roster.holder(Role::Sim), roster.starts(Role::Sim)), (None, 1));
        assert_eq!(roster.take(Role::Sim).unwrap().incarnation, 2);
    }

    /// A process's number may be another's in another PID namespace: only the node that the holder told of speaks for it.
    #[test]
    fn a_role_is_spoken_for_through_its_last_holders_node_alone() {
        let run = run("roster-node");
        let roster = run.roster();
        let speaks = |node| roster.speaks_through(Role::Sim, node).unwrap();
        assert!(!speaks(7), "nobody has had the role");
        let first = roster.take(Role::Sim).unwrap();
        assert!(!speaks(7), "of this process, which has told of none");
        roster.speak_through(Role::Sim, &first, 7).unwrap();
        assert!(speaks(7) && !speaks(8));
        drop(first);
        let second = roster.take(Role::Sim).unwrap();
        assert!(!speaks(7), "of a holder before");
        roster.speak_through(Role::Sim, &second, 8).unwrap();
        assert!(speaks(8) && !speaks(7));
    }

    #[test]
    fn who_waits_for_a_role_has_it_once_it_is_free() {
        let run = run("roster-succeed");
        let roster = run.roster();
        let first = roster.take(Role::Fusion).unwrap();
        let succession = roster.succeed(Role::Fusion);
        let short = Duration::from_millis(20);
        assert!(roster.take_in_succession(Role::Fusion, &succession, short).unwrap().is_none());
        drop(first);
        let second = roster.take_in_succession(Role::Fusion, &succession, Duration::from_secs(60)).unwrap().unwrap();
        assert_eq!(second.incarnation, 2);
        assert!(roster.is_held(Role::Fusion));
    }

    #[test]
    fn who_gives_no_sign_is_deposed_and_who_does_is_not() {
        let run = run("roster-depose");
        let roster = run.roster();
        let old = roster.take(Role::Fusion).unwrap();
        let silence = roster.last_heartbeat(Role::Fusion).unwrap();
        std::thread::sleep(2 * SIGN);
        old.renew();
        assert!(roster.depose(Role::Fusion, silence).unwrap().is_none() && old.is_current());

        let silence = roster.last_heartbeat(Role::Fusion).unwrap();
        let new = roster.depose(Role::Fusion, silence).unwrap().unwrap();
        assert!(new.is_current() && !old.is_current());
        assert_eq!((new.incarnation, roster.starts(Role::Fusion)), (2, 2));
        assert_eq!(run.while_current(&new, || 7).unwrap(), Some(7));
        assert_eq!(run.while_current(&old, || 7).unwrap(), None);
        // Neither its signs nor its end are the role's any more.
        let silence = roster.last_heartbeat(Role::Fusion);
        std::thread::sleep(2 * SIGN);
        old.renew();
        assert_eq!(roster.last_heartbeat(Role::Fusion), silence);
        drop(old);
        assert!(roster.is_held(Role::Fusion));
        assert!(matches!(roster.take(Role::Fusion), Err(RendezvousError::RoleTaken { .. })));
    }

    /// Its lock is had by one that waited while another deposes it: one of the two leads, not both.
    #[test]
    fn a_holder_that_ends_while_it_is_deposed_has_one_successor() {
        let run = run("roster-race");
        let roster = run.roster();
        let first = roster.take(Role::Fusion).unwrap();
        let silence = roster.last_heartbeat(Role::Fusion).unwrap();
        let succession = roster.succeed(Role::Fusion);
        drop(first);
        // The one that waits has the lock, and has not signed.
        while !roster.is_held(Role::Fusion) {
            std::thread::yield_now();
        }
        let deposer = roster.depose(Role::Fusion, silence).unwrap().unwrap();
        let late = roster.take_in_succession(Role::Fusion, &succession, Duration::from_secs(1)).unwrap();
        assert!(late.is_none(), "{late:?}");
        assert!(deposer.is_current() && deposer.incarnation == 2 && roster.starts(Role::Fusion) == 2);
    }

    #[test]
    fn a_number_that_is_a_strangers_leads_to_nobody() {
        let run = run("roster-stranger");
        let roster = run.roster();
        let lease = roster.take(Role::Robot(0)).unwrap();
        let mut stranger = std::process::Command::new("sleep").arg("60").spawn().unwrap();
        // As a process of another namespace would have put down its number, which is another's here.
        let path = run.place.path(&file_name(Role::Robot(0)));
        std::fs::write(path, format!("{:010} {:010}\n", 1, stranger.id())).unwrap();
        assert_eq!(roster.holder(Role::Robot(0)), Some(rustix::process::getpid()), "who has the lock");
        drop(lease);
        assert!(matches!(roster.process(Role::Robot(0)), Holder::Nobody));
        stranger.kill().unwrap();
        stranger.wait().unwrap();
    }
}
