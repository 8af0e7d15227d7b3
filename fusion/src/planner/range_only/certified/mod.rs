//! The global optimum of (25) under (26), with a certificate.
//!
//! The task is to find, in a Minkowski sum of arcs, the point nearest the origin. It is solved by
//! branch and bound: each node restricts some robots to parts of their arcs, [`hull_bound`] bounds `|S|`
//! from below over the convex hulls of what is left, and the hull's nearest point names the robot whose
//! arc to split next. `docs/certified.md` has the proofs.

mod answer;
mod bound;
mod descent;
mod parts;
mod search;

use super::pair::best_of_free;
use super::relaxation::Relaxation;
use super::{Problem, Solution, Solver};
use crate::vector::Vector;
pub use bound::hull_bound;
use search::Search;

/// Proven gap, relative to the sum of all lambda, below which an answer is called optimal.
pub const GAP_MAX: f64 = 1e-9;

/// Proven gap in the trace, relative to it, below which an answer is called optimal.
pub const TRACE_GAP_MAX: f64 = 1e-6;

/// Branch and bound over the arcs, started from adaptive relaxation.
///
/// One and two robots have closed forms ([`super::pair`]); more are searched until the proven gap is at most
/// [`GAP_MAX`] of the sum of all lambda and [`TRACE_GAP_MAX`] of the trace, or until `nodes` nodes have been examined.
/// Deterministic, and without allocation once its buffers have grown.
#[derive(Debug, Clone)]
pub struct Certified {
    start: Relaxation,
    search: Search,
    /// The answer of the search by `|S|`; reused memory.
    found: Vec<Vector>,
}

impl Certified {
    /// A search of at most this many nodes a step.
    #[must_use]
    pub fn new(nodes: u32) -> Self {
        use rangehound_shared::scenario::defaults;
        let start = Relaxation::adaptive(defaults::ITERATIONS as u32, defaults::ALPHA);
        Self { start, search: Search::new(nodes as usize), found: Vec::new() }
    }
}

impl Solver for Certified {
    fn name(&self) -> &'static str {
        "certified"
    }

    fn solve(&mut self, _tick: u64, problem: &Problem, solution: &mut Solution) {
        solution.directions.clear();
        solution.directions.extend(problem.arms.iter().map(|arm| arm.centre));
        if !best_of_free(problem.prior, &problem.arms, &mut solution.directions) {
            self.start.relax(problem, &mut solution.directions);
        }
        let lower_bound = self.search.improve(problem, &mut solution.directions);
        solution.complete(problem);
        solution.prove(lower_bound);
        if problem.len() > 1 && problem.is_lopsided_at(solution.position_trace_m2) {
            self.solve_lopsided(problem, solution);
        }
    }
}

impl Certified {
    /// Solves problems with nearly all information along one axis. There, rounding of `|S|` dominates `T - |S|` and
    /// with it the trace. So the search maximises `T - |S|` itself, from the better of relaxation's answer and the one
    /// found by `|S|`.
    #[cold]
    fn solve_lopsided(&mut self, problem: &Problem, solution: &mut Solution) {
        let found = solution.least_information;
        std::mem::swap(&mut solution.directions, &mut self.found);
        solution.directions.clear();
        solution.directions.extend(problem.arms.iter().map(|arm| arm.centre));
        self.start.relax(problem, &mut solution.directions);
        if problem.uncertainty(&solution.directions) <= found {
            std::mem::swap(&mut solution.directions, &mut self.found);
        }
        let bound = self.search.improve_information(problem, &mut solution.directions);
        solution.complete(problem);
        solution.least_information_bound = bound.max(solution.least_information);
        // The same bound on `|S|`, lowered by its rounding.
        let sum = solution.least_information + solution.objective;
        let rounding = 4.0 * f64::EPSILON * (problem.len() as f64 + 1.0) * sum;
        solution.lower_bound = (sum - solution.least_information_bound - rounding).clamp(0.0, solution.objective);
    }
}

#[cfg(test)]
mod tests;
