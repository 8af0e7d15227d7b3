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
        plan.directions.clear();
        plan.directions.extend(problem.standing());
        let sum = problem.sum(&plan.directions);
        for (arm, direction) in problem.arms.iter().zip(&mut plan.directions) {
            *direction = arm.nearest(*direction * arm.lambda - sum, arm.centre);
        }
        plan.complete(problem);
    }
}
