//! Requests to end: SIGINT, SIGTERM and SIGHUP set a flag that loops check.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM, SIGXFSZ};

/// Set once SIGINT, SIGTERM or SIGHUP has arrived, or the end was requested; cheap to copy and to check.
#[derive(Debug, Clone)]
pub struct Termination(Arc<AtomicBool>);

impl Termination {
    /// Handles SIGINT and SIGTERM instead of their default action. Handles SIGHUP, sent when the
    /// terminal closes, unless it is ignored, as under `nohup`.
    ///
    /// # Errors
    /// The system's, if it refuses to register a handler.
    pub fn listen() -> std::io::Result<Self> {
        let flag = Arc::new(AtomicBool::new(false));
        for signal in [SIGINT, SIGTERM] {
            signal_hook::flag::register(signal, Arc::clone(&flag))?;
        }
        if !is_ignored(SIGHUP) {
            signal_hook::flag::register(SIGHUP, Arc::clone(&flag))?;
        }
        // A write beyond the user's file size limit must fail, as on a full disk, and not kill the process.
        signal_hook::flag::register(SIGXFSZ, Arc::default())?;
        Ok(Self(flag))
    }

    /// One that no signal sets: for a node in a process with handlers of its own, which calls [`Self::request`].
    #[must_use]
    pub fn by_request() -> Self {
        Self(Arc::default())
    }

    /// Asks for the end.
    pub fn request(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// True once this process has been asked to end.
    #[must_use]
    pub fn requested(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// True if this process ignores a signal; it may have inherited that.
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    ignores(&status, signal)
}

/// The same, from the text of `/proc/PID/status`.
fn ignores(status: &str, signal: i32) -> bool {
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
    mask >> (signal - 1) & 1 == 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mask_shows_ignored_signals() {
        let status = "Name:\ta\nSigIgn:\t0000000000000001\nSigCgt:\t0000000000004002\n";
        assert!(ignores(status, SIGHUP) && !ignores(status, SIGINT) && !ignores("", SIGHUP));
    }
}
