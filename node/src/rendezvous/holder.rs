//! The process that holds a lock, according to the kernel.
//!
//! A PID in a file does not identify a process: it may be from another PID namespace (containers that share `/dev/shm`), or
//! have been reused. Here a PID is only a hint. The process is opened first (pidfd) and then checked to
//! hold the lock, so no unrelated process is ever signalled.

use std::fs::File;
use std::os::fd::{AsRawFd, OwnedFd};
use std::os::unix::fs::MetadataExt;

use rustix::process::{Pid, PidfdFlags, Signal, pidfd_open, pidfd_send_signal};

/// The holder of a role.
#[derive(Debug)]
pub enum Holder {
    /// No living process.
    Nobody,
    /// A process that this one can reach.
    Here(Process),
    /// A process that this one cannot reach: in another PID namespace, or hidden in `/proc`.
    Elsewhere,
}

/// A process, opened by pidfd so that a reused PID is never mistaken for it.
#[derive(Debug)]
pub struct Process {
    pid: Pid,
    /// Its PID in the namespace of `/proc`, which may differ from this process's namespace.
    proc_pid: i32,
    fd: OwnedFd,
}

impl Process {
    /// The live process that holds an exclusive lock on this file. `hint` may be its PID.
    pub(super) fn holding(file: &File, hint: Option<Pid>) -> Option<Self> {
        let metadata = file.metadata().ok()?;
        let lock = (metadata.dev(), metadata.ino());
        let hinted = hint.and_then(Self::open).filter(|process| process.holds(lock));
        let locking = || locked_by(metadata.ino()).into_iter().filter_map(|number| Self::open(number_here(number)?));
        hinted.or_else(|| locking().find(|process| process.holds(lock)))
    }

    fn open(pid: Pid) -> Option<Self> {
        let fd = pidfd_open(pid, PidfdFlags::empty()).ok()?;
        Some(Self { pid, proc_pid: number_in_proc(&fd)?, fd })
    }

    /// Its PID in this process's namespace.
    #[must_use]
    pub fn pid(&self) -> Pid {
        self.pid
    }

    /// Sends it a signal.
    ///
    /// # Errors
    /// If it has ended.
    pub fn signal(&self, signal: Signal) -> std::io::Result<()> {
        Ok(pidfd_send_signal(&self.fd, signal)?)
    }

    /// The text of its file in `/proc`; empty if it has ended.
    #[must_use]
    pub fn proc_text(&self, file: &str) -> String {
        let text = std::fs::read_to_string(format!("/proc/{}/{file}", self.proc_pid)).unwrap_or_default();
        // It is alive after the read, so the PID was its own.
        if number_in_proc(&self.fd) == Some(self.proc_pid) { text } else { String::new() }
    }

    fn holds(&self, (dev, ino): (u64, u64)) -> bool {
        let folder = format!("/proc/{}", self.proc_pid);
        let holds = std::fs::read_dir(format!("{folder}/fd")).into_iter().flatten().flatten().any(|fd| {
            std::fs::metadata(fd.path()).is_ok_and(|file| (file.dev(), file.ino()) == (dev, ino))
                && std::fs::read_to_string(format!("{folder}/fdinfo/{}", fd.file_name().display()))
                    .is_ok_and(|info| info.lines().any(is_exclusive_lock))
        });
        holds && number_in_proc(&self.fd) == Some(self.proc_pid)
    }
}

/// `lock: 1: FLOCK  ADVISORY  WRITE 417 00:19:1033 0 EOF`.
fn is_exclusive_lock(line: &str) -> bool {
    let mut words = line.split_whitespace();
    words.next() == Some("lock:") && words.any(|word| word == "FLOCK") && words.any(|word| word == "WRITE")
}

/// The PID that `/proc` gives a process; `None` if it has ended or is not in the namespace of `/proc`.
fn number_in_proc(process: &OwnedFd) -> Option<i32> {
    let info = std::fs::read_to_string(format!("/proc/self/fdinfo/{}", process.as_raw_fd())).ok()?;
    field(&info, "Pid:")?.parse().ok().filter(|number| *number > 0)
}

/// PIDs, in the namespace of `/proc`, of processes with an exclusive lock on a file of this inode number. Files on several
/// file systems may share the number.
fn locked_by(ino: u64) -> Vec<i32> {
    let locks = std::fs::read_to_string("/proc/locks").unwrap_or_default();
    let numbers = locks.lines().filter_map(|line| {
        let words: Vec<&str> = line.split_whitespace().collect();
        // Lines of processes that wait for a lock have an arrow and do not match.
        let [_, "FLOCK", _, "WRITE", pid, file, ..] = words[..] else { return None };
        let is_it = file.rsplit_once(':').is_some_and(|(_, inode)| inode.parse() == Ok(ino));
        pid.parse().ok().filter(|pid| is_it && *pid > 0)
    });
    numbers.collect()
}

/// Translates a PID of `/proc` into this process's namespace.
fn number_here(proc_pid: i32) -> Option<Pid> {
    let depth = |process: &str| -> Option<Vec<i32>> {
        let status = std::fs::read_to_string(format!("/proc/{process}/status")).ok()?;
        Some(field(&status, "NSpid:")?.split_whitespace().filter_map(|number| number.parse().ok()).collect())
    };
    let here = depth("self")?.len().checked_sub(1)?;
    Pid::from_raw(*depth(&proc_pid.to_string())?.get(here)?)
}

fn field<'a>(text: &'a str, name: &str) -> Option<&'a str> {
    text.lines().find_map(|line| line.strip_prefix(name)).map(str::trim)
}
