//! Cleans up after killed nodes, in a thread of its own.

use std::sync::mpsc::{self, Sender};
use std::thread::Scope;

use rangehound_node::bus::Bus;
use rangehound_node::rendezvous::Rendezvous;

use crate::failure::with_causes;

/// A thread that cleans up after killed nodes. It takes tens of milliseconds for each, and the supervision of the other
/// nodes must not wait for that. Ends when dropped.
pub(super) struct Cleaner {
    requests: Sender<()>,
}

impl Cleaner {
    pub(super) fn start<'scope>(rendezvous: &'scope Rendezvous, scope: &'scope Scope<'scope, '_>) -> Self {
        let (requests, received) = mpsc::channel();
        let clean = move || {
            // It has its own connection to the bus, because ports do not move between threads.
            let Ok(bus) = Bus::connect(rendezvous, "observer") else { return };
            let mut left = 0;
            while received.recv().is_ok() {
                // One round for all deaths so far.
                while received.try_recv().is_ok() {}
                left = bus.clean_up_dead_nodes();
            }
            if left > 0 {
                log::warn!("{left} dead nodes are not cleaned up yet; they are removed at the end of the run");
            }
        };
        if let Err(error) = std::thread::Builder::new().name("cleaner".to_owned()).spawn_scoped(scope, clean) {
            let reason = with_causes(&error.into());
            log::warn!(
                "cannot start the thread that cleans up after killed nodes: {reason}; what they leave is removed at the end of the run"
            );
        }
        Self { requests }
    }

    pub(super) fn request(&self) {
        // An error means that the bus refused the cleaner; it refuses the nodes too.
        let _ = self.requests.send(());
    }
}
