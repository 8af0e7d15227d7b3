//! Checks that a run's files in shared memory still exist.
//!
//! Any process that may write to `/dev/shm` can remove them: systemd does at a user's last logout (`RemoveIPC=yes`).
//! Processes keep their open and mapped files, but no process can join, and no role can be passed on.

use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::{Duration, Instant};

use rustix::process::Pid;

use super::place::{MEMBERSHIP_LOCK, Place};
use crate::system::clock::monotonic_ns;
use crate::system::resources::SHARED_MEMORY;

/// Interval at which a member checks that the run exists.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// Nodes whose open files are examined per check: bounds its cost for any team size.
const NODES_PER_CHECK: usize = 4;

/// Longest time in which a node closes a removed file: a file that it holds open for longer is still needed.
const CLOSING_MAX: Duration = Duration::from_millis(250);

/// Files that every member needs until the run ends.
const COMMON_FILES: [&str; 4] = [MEMBERSHIP_LOCK, "members", "run", "iceoryx2.toml"];

/// Suffix that the kernel appends to the name of a removed file.
const REMOVED: &str = " (deleted)";

/// A file and its inode when first seen.
#[derive(Debug)]
struct Known {
    path: PathBuf,
    inode: Option<u64>,
}

impl Known {
    fn of(path: PathBuf) -> Self {
        Self { inode: inode(&path), path }
    }

    fn is_there(&self) -> bool {
        self.inode.is_some() && inode(&self.path) == self.inode
    }
}

fn inode(path: &Path) -> Option<u64> {
    std::fs::metadata(path).map(|file| file.ino()).ok()
}

/// A member's cheap check of one file, at intervals. Allocates no memory.
#[derive(Debug)]
pub(super) struct Presence {
    run: Known,
    looked_ns: AtomicU64,
}

impl Presence {
    pub(super) fn of(place: &Place) -> Self {
        Self { run: Known::of(place.path("run")), looked_ns: AtomicU64::new(monotonic_ns()) }
    }

    /// False once the run's folder has been removed or replaced, as of the last check.
    pub(super) fn holds(&self, now_ns: u64) -> bool {
        if now_ns.saturating_sub(self.looked_ns.load(Relaxed)) < POLL_INTERVAL.as_nanos() as u64 {
            return true;
        }
        self.looked_ns.store(now_ns, Relaxed);
        self.holds_now()
    }

    /// The same, checked now.
    pub(super) fn holds_now(&self) -> bool {
        self.run.is_there()
    }
}

/// A supervisor's thorough check: of the common files, and of the shared memory that each node holds open.
#[derive(Debug)]
pub struct Inspection {
    place: Place,
    common: Vec<Known>,
    /// Removed files that a node holds open, and since when: it may be about to close them.
    suspects: Vec<(Pid, PathBuf, Instant)>,
    next: usize,
}

impl Inspection {
    pub(super) fn of(place: &Place) -> Self {
        let wait_groups = place.files().into_iter().filter(|path| path.to_string_lossy().ends_with("_wait_groups.dyn"));
        let common = COMMON_FILES.map(|file| place.path(file)).into_iter().chain(wait_groups).map(Known::of).collect();
        Self { place: place.clone(), common, suspects: Vec::new(), next: 0 }
    }

    /// A required file that was removed from outside, if any. Each check examines some of the
    /// nodes. A node that cleans up after dead ones is not examined: it holds open files that are being removed.
    pub fn removed(&mut self, nodes: &[Pid]) -> Option<PathBuf> {
        if let Some(gone) = self.common.iter().find(|known| !known.is_there()) {
            return Some(gone.path.clone());
        }
        let suspected = self.suspects.first().and_then(|(pid, ..)| nodes.iter().position(|node| node == pid));
        // A suspected node is examined again at the next check.
        let first = suspected.unwrap_or(self.next);
        let examined: Vec<Pid> =
            nodes.iter().cycle().skip(first).take(nodes.len().min(NODES_PER_CHECK)).copied().collect();
        self.next = (first + examined.len()) % nodes.len().max(1);
        let now = Instant::now();
        let mut found = Vec::new();
        for pid in examined {
            for path in self.removed_under(pid) {
                let before = self.suspects.iter().find(|(of, what, _)| *of == pid && *what == path);
                found.push((pid, path.clone(), before.map_or(now, |(_, _, since)| *since)));
            }
        }
        self.suspects = found;
        let sure = self.suspects.iter().find(|(_, _, since)| since.elapsed() >= CLOSING_MAX);
        sure.map(|(_, path, _)| path.clone())
    }

    /// The same check of all nodes, repeated until the result is certain.
    pub fn removed_of_any(&mut self, nodes: &[Pid]) -> Option<PathBuf> {
        self.next = 0;
        for _ in 0..=nodes.len() / NODES_PER_CHECK {
            if let Some(removed) = self.removed(nodes) {
                return Some(removed);
            }
            if !self.suspects.is_empty() {
                std::thread::sleep(CLOSING_MAX);
                if let Some(removed) = self.removed(nodes) {
                    return Some(removed);
                }
            }
        }
        None
    }

    /// The run's files that a process holds open and needs, but that have been removed.
    fn removed_under(&self, pid: Pid) -> impl Iterator<Item = PathBuf> {
        let files = std::fs::read_dir(format!("/proc/{}/fd", pid.as_raw_pid())).into_iter().flatten().flatten();
        files.filter_map(|entry| {
            let target = std::fs::read_link(entry.path()).ok()?;
            let path = PathBuf::from(target.to_str()?.strip_suffix(REMOVED)?);
            let is_writable =
                || entry.path().symlink_metadata().is_ok_and(|link| link.permissions().mode() & 0o200 != 0);
            (self.is_ours(&path) && self.is_needed(&path, is_writable)).then_some(path)
        })
    }

    fn is_ours(&self, path: &Path) -> bool {
        let segments = Path::new(SHARED_MEMORY).join(self.place.prefix());
        path.as_os_str().as_encoded_bytes().starts_with(segments.as_os_str().as_encoded_bytes())
            || path.starts_with(self.place.dir())
    }

    /// False for files that may be removed while a process holds them open.
    fn is_needed(&self, path: &Path, is_writable: impl Fn() -> bool) -> bool {
        let nodes = self.place.path("nodes");
        if path.starts_with(&nodes) {
            // A starting node inspects the others, and may hold files of dead nodes open while those are cleaned up.
            return !nodes.exists();
        }
        match path.extension().and_then(|extension| extension.to_str()) {
            // A connection between two nodes is removed when either ends; a new node gets a new one.
            Some("connection" | "partial") => false,
            // A reader of a dead node's messages holds them open for a while: only the writer needs the name.
            Some("data") => is_writable(),
            // The file of a deposed holder: a new file has the name.
            Some("role") => !path.exists(),
            _ => true,
        }
    }
}
