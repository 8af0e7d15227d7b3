//! Requests to end: SIGINT, SIGTERM and SIGHUP as a flag that loops look at.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM, SIGXFSZ};

/// Set once SIGINT, SIGTERM or SIGHUP has arrived; cheap to copy and to ask.
#[derive(Debug, Clone)]
pub struct Termination(Arc<AtomicBool>);

impl Termination {
    /// Starts to listen for SIGINT and SIGTERM in place of their default action, and for SIGHUP, which comes when the
    /// terminal is closed, unless it is ignored, as `nohup` has it.
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
        // Beyond the user's limit on the size of files a write shall fail, as on a full disk, and not kill.
        signal_hook::flag::register(SIGXFSZ, Arc::default())?;
        Ok(Self(flag))
    }

    /// True once somebody has asked this process to end.
    #[must_use]
    pub fn requested(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// True if this process ignores a signal, which it may have inherited.
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    ignores(&status, signal)
}

/// The same, told by the text of `/proc/PID/status`.
fn ignores(status: &str, signal: i32) -> bool {
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
    mask >> (signal - 1) & 1 == 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_ignored_signal_is_told_by_its_bit() {
        let status = "Name:\ta\nSigIgn:\t0000000000000001\nSigCgt:\t0000000000004002\n";
        assert!(ignores(status, SIGHUP) && !ignores(status, SIGINT) && !ignores("", SIGHUP));
    }
}
