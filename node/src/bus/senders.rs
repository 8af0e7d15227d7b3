//! Checks whether a message comes from the process that holds its role.

use std::cell::RefCell;

use rustix::process::{Pid, test_kill_process};

use crate::rendezvous::{Role, Roster};

/// Impostors that are remembered; further ones are looked up again each time.
const STRANGERS_MAX: usize = 64;

/// A sender's standing towards the role of its message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Standing {
    /// Its process holds the role.
    Holder,
    /// Its process has ended, and its lease may have too; or its state is unknown.
    Gone,
    /// Its process lives and does not hold the role.
    Impostor,
}

/// The node that holds each role. Each node is looked up in the roster once, so that an impostor that floods a
/// topic costs one comparison per message.
#[derive(Debug)]
pub(super) struct Senders {
    roster: Roster,
    known: RefCell<Known>,
}

#[derive(Debug)]
struct Known {
    /// Node id by role; 0 if unknown.
    bound: Vec<u128>,
    /// Roles and the nodes that do not hold them. One node can hold several roles: a gateway's does.
    strangers: Vec<(usize, u128)>,
}

impl Senders {
    pub(super) fn new(roster: Roster, robots: usize) -> Self {
        let known = Known { bound: vec![0; 2 + robots], strangers: Vec::with_capacity(STRANGERS_MAX) };
        Self { roster, known: RefCell::new(known) }
    }

    /// The standing of a node towards a role. `pid` gives the node's process id in that process's own namespace.
    pub(super) fn standing(&self, role: Role, node: u128, pid: impl FnOnce() -> Option<Pid>) -> Standing {
        let slot = match role {
            Role::Sim => 0,
            Role::Fusion => 1,
            Role::Robot(id) => id.saturating_add(2),
            Role::Standby(_) | Role::Gateway | Role::Supervisor => return Standing::Impostor,
        };
        let Known { bound, strangers } = &mut *self.known.borrow_mut();
        let Some(bound) = bound.get_mut(slot) else { return Standing::Impostor };
        if *bound == node {
            return Standing::Holder;
        }
        if strangers.contains(&(slot, node)) {
            return Standing::Impostor;
        }
        match self.roster.speaks_through(role, node) {
            Ok(true) => {
                *bound = node;
                return Standing::Holder;
            }
            // A sender in another PID namespace has no more rights, but this process cannot tell whether it lives.
            Ok(false) if pid().is_some_and(|pid| test_kill_process(pid).is_ok()) => {}
            // A failed look-up is not remembered: the next message tries again.
            Ok(false) | Err(_) => return Standing::Gone,
        }
        if strangers.len() == STRANGERS_MAX {
            strangers.clear();
        }
        strangers.push((slot, node));
        Standing::Impostor
    }
}
