//! Cleaning up after killed nodes, where nobody waits for it.

use std::sync::mpsc::{self, Sender};
use std::thread::Scope;

use rangehound_node::bus::Bus;
use rangehound_node::rendezvous::Rendezvous;

use crate::failure::with_causes;

/// A thread that cleans up after killed nodes: it takes tens of milliseconds for each, which nobody
/// should wait for who watches the living. Ends when dropped.
pub(super) struct Cleaner {
    requests: Sender<()>,
}

impl Cleaner {
    pub(super) fn start<'scope>(rendezvous: &'scope Rendezvous, scope: &'scope Scope<'scope, '_>) -> Self {
        let (requests, received) = mpsc::channel();
        let clean = move || {
            // A node of its own: ports do not move between threads.
            let Ok(bus) = Bus::connect(rendezvous, "observer") else { return };
            let mut left = 0;
            while received.recv().is_ok() {
                // One round for all deaths so far.
                while received.try_recv().is_ok() {}
                left = bus.clean_up_after_the_dead();
            }
            if left > 0 {
                log::warn!("{left} dead nodes were left to be removed with the run");
            }
        };
        if let Err(error) = std::thread::Builder::new().name("cleaner".to_owned()).spawn_scoped(scope, clean) {
            let reason = with_causes(&error.into());
            log::warn!(
                "what killed nodes leave stays until the end of the run: no thread for it can be started: {reason}"
            );
        }
        Self { requests }
    }

    pub(super) fn request(&self) {
        // An error means that the bus refused the cleaner, as it will refuse the nodes.
        let _ = self.requests.send(());
    }
}
