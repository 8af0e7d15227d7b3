//! Each robot plans by itself, without coordination.

use super::{Problem, Solution, Solver};

/// Each robot minimises `|S|` as if its teammates stayed where they stand (after Stroupe and Balch):
/// the one-robot closed form, once, for all robots at the same time.
#[derive(Debug, Clone, Copy, Default)]
pub struct Greedy;

impl Solver for Greedy {
    fn name(&self) -> &'static str {
        "greedy"
    }

    fn solve(&mut self, _tick: u64, problem: &Problem, solution: &mut Solution) {
        solution.directions.clear();
        solution.directions.extend(problem.standing());
        let sum = problem.sum(&solution.directions);
        for (arm, direction) in problem.arms.iter().zip(&mut solution.directions) {
            *direction = arm.nearest(*direction * arm.lambda - sum, arm.centre);
        }
        solution.complete(problem);
    }
}
