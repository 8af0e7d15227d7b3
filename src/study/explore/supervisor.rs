//! The supervisor of a team: its state.

use super::checker::supervision::Supervision;
use super::plan::Plan;
use crate::run::supervisor::deaths::End;
use crate::run::supervisor::machine::Machine;
use crate::run::supervisor::restart::{Policies, Rule};

/// The supervisor of a team.
pub(super) struct Supervisor {
    pub(super) machine: Machine<u64>,
    pub(super) is_stopped: bool,
    /// When it last checked the heartbeats.
    pub(super) looked_ns: u64,
    /// Number of starts that the system will refuse.
    pub(super) refusals: u32,
    /// Ends of processes that it has not noticed yet.
    pub(super) ends: Vec<(usize, End)>,
    pub(super) checker: Supervision,
    /// True if it has ended the run.
    pub(super) has_given_up: bool,
}

impl Supervisor {
    pub(super) fn new(plan: &Plan) -> Self {
        let rules: Vec<Rule> = plan.leaves_robots.then(|| "robot=never".parse()).into_iter().flatten().collect();
        let roles = plan.all_nodes().map(|node| plan.role_of(node));
        Self {
            machine: Machine::new(roles, &Policies::new(&rules)),
            is_stopped: false,
            looked_ns: 0,
            refusals: 0,
            ends: Vec::new(),
            checker: Supervision::new(plan),
            has_given_up: false,
        }
    }
}
