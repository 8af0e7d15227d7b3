//! State that all requests for a page share.

use std::sync::atomic::AtomicUsize;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use rangehound_node::rendezvous::Rendezvous;
use tokio::sync::watch;

use super::token::Token;
use crate::live::scene::Scene;

/// The data for answers.
pub(super) struct Shared {
    pub(super) scene: Mutex<Scene>,
    /// Counts the scene's changes.
    pub(super) changes: watch::Receiver<u64>,
    pub(super) token: Token,
    pub(super) port: u16,
    /// Shortest time between two pictures.
    pub(super) pace: Duration,
    /// The run to act on, if it is one.
    pub(super) run: Option<Arc<Rendezvous>>,
    /// Viewers that have a stream.
    pub(super) streams: AtomicUsize,
}

impl Shared {
    pub(super) fn scene(&self) -> MutexGuard<'_, Scene> {
        // A panic cannot leave a scene in an inconsistent state.
        self.scene.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
