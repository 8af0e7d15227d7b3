//! Each robot by itself: what a team reaches without planning as one.

use super::{Plan, Planner, Problem};

/// Each robot minimises `|S|` as if its teammates stayed where they stand (after Stroupe and Balch):
/// the one-robot closed form, once, for everybody at the same time.
#[derive(Debug, Clone, Copy, Default)]
pub struct Greedy;

impl Planner for Greedy {
    fn name(&self) -> &'static str {
        "greedy"
    }

    fn plan(&mut self, _tick: u64, problem: &Problem, plan: &mut Plan) {
        let standing = problem.standing();
        let sum = problem.arms.iter().zip(standing).fold(problem.prior, |sum, (arm, u)| sum + u * arm.lambda);
        plan.directions.clear();
        let standing = problem.standing();
        plan.directions
            .extend(problem.arms.iter().zip(standing).map(|(arm, u)| arm.nearest(u * arm.lambda - sum, arm.centre)));
        plan.complete(problem);
    }
}
