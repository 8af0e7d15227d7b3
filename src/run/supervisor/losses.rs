//! Files that a run can no longer write. The user is warned at once, because nodes go on without them.
//!
//! Nodes report it in their logs, which may be on the same full disk. So the supervisor checks by itself: a file that
//! nodes write at every tick is lost if it does not change while ticks pass, whatever the reason.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

use rangehound_node::checkpoint;
use rangehound_node::logs;
use rangehound_node::rendezvous::{Role, RunDescription};
use rustix::fs::statvfs;

use crate::run::watch::Newest;

/// Interval between two checks of the files.
const EVERY: Duration = Duration::from_millis(500);

/// Ticks within which a file must have been written. A node writes before it publishes, so 2 would be enough.
const TICKS: u64 = 4;

/// The files of a run that are written at every tick.
pub(super) struct Losses {
    files: Vec<Watched>,
    looked: Instant,
}

struct Watched {
    path: PathBuf,
    role: Role,
    is_log: bool,
    /// Time of its last change, and the tick of its node at the check that noticed the change.
    seen: Option<(SystemTime, u64)>,
    is_lost: bool,
}

impl Losses {
    pub(super) fn new(description: &RunDescription) -> Self {
        let out_dir = &description.out_dir;
        let watched = |path, role, is_log| Watched { path, role, is_log, seen: None, is_lost: false };
        let checkpoint = |role| watched(out_dir.join(checkpoint::file_name(role)), role, false);
        let files = vec![
            watched(logs::worlds_path(out_dir), Role::Sim, true),
            watched(logs::estimates_path(out_dir), Role::Fusion, true),
            checkpoint(Role::Sim),
            checkpoint(Role::Fusion),
        ];
        Self { files, looked: Instant::now() }
    }

    /// Checks the files if the interval is over, and warns of each loss once.
    pub(super) fn look(&mut self, newest: Newest) {
        if self.looked.elapsed() < EVERY {
            return;
        }
        self.looked = Instant::now();
        for file in self.files.iter_mut().filter(|file| !file.is_lost) {
            let tick = if file.role == Role::Fusion { newest.fusion } else { newest.sim };
            if let Some(tick) = tick
                && let Some(reason) = file.loss(tick)
            {
                file.is_lost = true;
                let Watched { path, role, is_log, .. } = file;
                let but =
                    if *is_log { "its report ends here".to_owned() } else { format!("it would end if {role} died") };
                log::warn!("{}: {reason}; the run continues, but {but}: check the disk", path.display());
            }
        }
    }
}

impl Watched {
    /// Why the file is lost, if it is.
    fn loss(&mut self, tick: u64) -> Option<String> {
        let written = match std::fs::metadata(&self.path).and_then(|metadata| metadata.modified()) {
            Ok(written) => written,
            // Before the first ticks the file may be missing.
            Err(error) => return (tick >= TICKS).then(|| error.to_string()),
        };
        match self.seen {
            Some((before, at)) if before == written => {
                (tick >= at + TICKS).then(|| reason_of_loss(&self.path, self.role))
            }
            _ => {
                self.seen = Some((written, tick));
                None
            }
        }
    }
}

/// Why a file is no longer written, as far as the supervisor can know.
fn reason_of_loss(path: &Path, role: Role) -> String {
    match path.parent().map(statvfs) {
        Some(Ok(space)) if space.f_bavail == 0 => "the disk is full".to_owned(),
        _ => format!("no longer written, see logs/{role}.log"),
    }
}
