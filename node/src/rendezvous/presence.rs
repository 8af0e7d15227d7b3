//! Whether a run's files in shared memory are still there.
//!
//! Whoever may write to `/dev/shm` can remove them under a run: systemd does at a user's last logout (`RemoveIPC=yes`).
//! Processes keep what they have open and mapped, but nobody new can join, and no role can be passed on.

use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::{Duration, Instant};

use rustix::process::Pid;

use super::place::Place;
use crate::system::clock::monotonic_ns;
use crate::system::resources::SHARED_MEMORY;

/// How often a member looks whether the run is still there.
const LOOK: Duration = Duration::from_millis(50);

/// Nodes whose open files are examined in one look: the cost of a look has a bound, whatever the team.
const NODES_PER_LOOK: usize = 4;

/// A node that still holds a removed file open after this long needs it: nobody takes so long to close one.
const SURE: Duration = Duration::from_millis(250);

/// Files that every member needs for as long as the run goes on.
const FOUNDATION: [&str; 4] = ["door", "members", "run", "iceoryx2.toml"];

/// What the kernel puts after the name of a file that has been removed.
const REMOVED: &str = " (deleted)";

/// A file, and the inode that it had.
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

/// One member's cheap look: at one file, now and then. No memory is allocated for it.
#[derive(Debug)]
pub(super) struct Presence {
    run: Known,
    looked_ns: AtomicU64,
}

impl Presence {
    pub(super) fn of(place: &Place) -> Self {
        Self { run: Known::of(place.path("run")), looked_ns: AtomicU64::new(monotonic_ns()) }
    }

    /// False once the run's folder has been removed or replaced, as of the newest look.
    pub(super) fn holds(&self) -> bool {
        let now_ns = monotonic_ns();
        if now_ns.saturating_sub(self.looked_ns.load(Relaxed)) < LOOK.as_nanos() as u64 {
            return true;
        }
        self.looked_ns.store(now_ns, Relaxed);
        self.holds_now()
    }

    /// The same, looked at now.
    pub(super) fn holds_now(&self) -> bool {
        self.run.is_there()
    }
}

/// A supervisor's thorough look: at what all have in common, and at what each node holds open in shared memory.
#[derive(Debug)]
pub struct Inspection {
    place: Place,
    common: Vec<Known>,
    /// Removed files that a node holds open, since when: it may be about to close them.
    suspects: Vec<(Pid, PathBuf, Instant)>,
    next: usize,
}

impl Inspection {
    pub(super) fn of(place: &Place) -> Self {
        let wait_groups = place.files().into_iter().filter(|path| path.to_string_lossy().ends_with("_wait_groups.dyn"));
        let common = FOUNDATION.map(|file| place.path(file)).into_iter().chain(wait_groups).map(Known::of).collect();
        Self { place: place.clone(), common, suspects: Vec::new(), next: 0 }
    }

    /// A file that somebody else has removed, if there is one that the run cannot do without. Some of the nodes are
    /// examined at each look; not who cleans up after the dead, and so holds open what is about to go.
    pub fn removed(&mut self, nodes: &[Pid]) -> Option<PathBuf> {
        if let Some(gone) = self.common.iter().find(|known| !known.is_there()) {
            return Some(gone.path.clone());
        }
        let suspected = self.suspects.first().and_then(|(pid, ..)| nodes.iter().position(|node| node == pid));
        // Who is suspected is examined again at the next look.
        let first = suspected.unwrap_or(self.next);
        let examined: Vec<Pid> =
            nodes.iter().cycle().skip(first).take(nodes.len().min(NODES_PER_LOOK)).copied().collect();
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
        let sure = self.suspects.iter().find(|(_, _, since)| since.elapsed() >= SURE);
        sure.map(|(_, path, _)| path.clone())
    }

    /// The same of all nodes, for as long as it takes to be sure.
    pub fn removed_of_any(&mut self, nodes: &[Pid]) -> Option<PathBuf> {
        self.next = 0;
        for _ in 0..=nodes.len() / NODES_PER_LOOK {
            if let Some(removed) = self.removed(nodes) {
                return Some(removed);
            }
            if !self.suspects.is_empty() {
                std::thread::sleep(SURE);
                if let Some(removed) = self.removed(nodes) {
                    return Some(removed);
                }
            }
        }
        None
    }

    /// The files of this run that a process holds open, that it needs, and that have lost their names.
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

    /// False for what legitimately loses its name while a process holds it open.
    fn is_needed(&self, path: &Path, is_writable: impl Fn() -> bool) -> bool {
        let nodes = self.place.path("nodes");
        if path.starts_with(&nodes) {
            // A node that starts looks at the others, and holds files of the dead open when those are cleaned up.
            return !nodes.exists();
        }
        match path.extension().and_then(|extension| extension.to_str()) {
            // A way from one node to another goes when either does, and a new one is made for whoever comes.
            Some("connection" | "partial") => false,
            // Whoever reads a dead node's messages holds them open for a while: only its writer needs the name.
            Some("data") => is_writable(),
            // Of one who has been deposed: another file has the name.
            Some("role") => !path.exists(),
            _ => true,
        }
    }
}
