//! The global optimum of (25) under (26), with a certificate.
//!
//! The task is to find, in a Minkowski sum of arcs, the point nearest the origin. It is solved by
//! branch and bound: each node restricts some robots to parts of their arcs, [`hull_bound`] bounds `|S|`
//! from below over the convex hulls of what is left, and the hull's nearest point names the robot whose
//! arc to split next. `docs/certified.md` has the proofs.

mod bound;
mod search;

use super::pair::best_of_free;
use super::relaxation::Relaxation;
use super::{Plan, Planner, Problem};

pub use bound::hull_bound;
use search::Search;

/// Proven gap, relative to the sum of all lambda, below which an answer is called optimal.
pub const GAP_MAX: f64 = 1e-9;

/// Branch and bound over the arcs, started from adaptive relaxation.
///
/// One and two robots have closed forms ([`super::pair`]); more are searched until the proven gap is
/// at most [`GAP_MAX`] of the sum of all lambda, or until `nodes` nodes have been looked at. Deterministic,
/// and without allocation once its buffers have grown.
#[derive(Debug, Clone)]
pub struct Certified {
    start: Relaxation,
    search: Search,
}

impl Certified {
    /// A search of at most this many nodes a step.
    #[must_use]
    pub fn new(nodes: u32) -> Self {
        use rangehound_shared::scenario::defaults;
        let start = Relaxation::adaptive(defaults::ITERATIONS as u32, defaults::ALPHA);
        Self { start, search: Search::new(nodes as usize) }
    }
}

impl Planner for Certified {
    fn name(&self) -> &'static str {
        "certified"
    }

    fn plan(&mut self, _tick: u64, problem: &Problem, plan: &mut Plan) {
        plan.directions.clear();
        plan.directions.extend(problem.arms.iter().map(|arm| arm.centre));
        if !best_of_free(problem.prior, &problem.arms, &mut plan.directions) {
            self.start.relax(problem, &mut plan.directions);
        }
        let lower_bound = self.search.improve(problem, &mut plan.directions);
        plan.complete(problem);
        plan.lower_bound = lower_bound.min(plan.objective);
    }
}

#[cfg(test)]
mod tests;
