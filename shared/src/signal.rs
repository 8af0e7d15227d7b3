//! Requests to end: SIGINT and SIGTERM as a flag that loops look at.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use signal_hook::consts::{SIGINT, SIGTERM, SIGXFSZ};

/// Set once SIGINT or SIGTERM has arrived; cheap to copy and to ask.
#[derive(Debug, Clone)]
pub struct Termination(Arc<AtomicBool>);

impl Termination {
    /// Starts to listen for SIGINT and SIGTERM in place of their default action.
    ///
    /// # Errors
    /// The system's, if it refuses to register a handler.
    pub fn listen() -> std::io::Result<Self> {
        let flag = Arc::new(AtomicBool::new(false));
        for signal in [SIGINT, SIGTERM] {
            signal_hook::flag::register(signal, Arc::clone(&flag))?;
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
