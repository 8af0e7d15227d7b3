//! Straight to the predicted target: what a team does that does not plan for information.

use super::{Plan, Planner, Problem};

/// Every robot heads for the predicted target, up to the stand-off.
#[derive(Debug, Clone, Copy, Default)]
pub struct Pursue;

impl Planner for Pursue {
    fn name(&self) -> &'static str {
        "pursue"
    }

    fn plan(&mut self, _tick: u64, problem: &Problem, plan: &mut Plan) {
        plan.directions.clear();
        plan.directions.extend(problem.arms.iter().zip(problem.standing()).map(|(arm, u)| arm.nearest(u, arm.centre)));
        plan.complete(problem);
    }
}
