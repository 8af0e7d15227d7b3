//! Straight to the predicted target: a team that does not plan for information.

use super::{Problem, Solution, Solver};

/// Every robot heads for the predicted target, up to the stand-off.
#[derive(Debug, Clone, Copy, Default)]
pub struct Pursue;

impl Solver for Pursue {
    fn name(&self) -> &'static str {
        "pursue"
    }

    fn solve(&mut self, _tick: u64, problem: &Problem, solution: &mut Solution) {
        solution.directions.clear();
        solution
            .directions
            .extend(problem.arms.iter().zip(problem.standing()).map(|(arm, u)| arm.nearest(u, arm.centre)));
        solution.complete(problem);
    }
}
