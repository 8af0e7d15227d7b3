//! Whether a message comes from the process that holds the role it speaks for.

use std::cell::RefCell;

use rustix::process::{Pid, test_kill_process};

use crate::rendezvous::{Role, Roster};

/// Nodes that are known not to hold what they speak for; more are looked up again and again.
const STRANGERS_MAX: usize = 64;

/// What a sender is to the role that its message speaks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Standing {
    /// Its process holds the role.
    Holder,
    /// Its process is gone, and so may be its hold; or that cannot be told.
    Gone,
    /// Its process lives and does not hold the role.
    Impostor,
}

/// The node that speaks for each role. Looked up in the roster once a node, so that a stranger that floods a
/// topic costs a comparison a message.
#[derive(Debug)]
pub(super) struct Senders {
    roster: Roster,
    known: RefCell<Known>,
}

#[derive(Debug)]
struct Known {
    /// Node id by role; 0 for none.
    bound: Vec<u128>,
    strangers: Vec<u128>,
}

impl Senders {
    pub(super) fn new(roster: Roster, robots: usize) -> Self {
        let known = Known { bound: vec![0; 2 + robots], strangers: Vec::with_capacity(STRANGERS_MAX) };
        Self { roster, known: RefCell::new(known) }
    }

    /// What a node, of the process that has this number where it runs, is to a role.
    pub(super) fn standing(&self, role: Role, node: u128, pid: impl FnOnce() -> Option<Pid>) -> Standing {
        let slot = match role {
            Role::Sim => 0,
            Role::Fusion => 1,
            Role::Robot(id) => id.saturating_add(2),
            Role::Standby(_) | Role::Supervisor => return Standing::Impostor,
        };
        let Known { bound, strangers } = &mut *self.known.borrow_mut();
        let Some(bound) = bound.get_mut(slot) else { return Standing::Impostor };
        if *bound == node {
            return Standing::Holder;
        }
        if strangers.contains(&node) {
            return Standing::Impostor;
        }
        match self.roster.speaks_through(role, node) {
            Ok(true) => {
                *bound = node;
                return Standing::Holder;
            }
            // One in another PID namespace counts for as little, but nobody can tell whether it lives.
            Ok(false) if pid().is_some_and(|pid| test_kill_process(pid).is_ok()) => {}
            // What cannot be told now is not held against a sender for ever.
            Ok(false) | Err(_) => return Standing::Gone,
        }
        if strangers.len() == STRANGERS_MAX {
            strangers.clear();
        }
        strangers.push(node);
        Standing::Impostor
    }
}
