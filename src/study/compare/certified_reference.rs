//! The distance of any plan from the certified optimum of the same situation.

use rangehound_fusion::planner::range_only::Problem;
use rangehound_fusion::planner::{self, Plan, Planner, PlannerError, Situation, hull_certificate};
use rangehound_shared::scenario::{PlannerSpec, defaults};

/// The certified optimum of the same situations that other planners received.
#[derive(Debug)]
pub struct CertifiedReference {
    optimiser: Box<dyn Planner>,
    optimum: Plan,
    problem: Problem,
}

/// Distance of a plan from the optimum.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Distance {
    /// The plan's `|S|` above the certified lower bound, relative to the sum of all lambda; for teams with other sensors
    /// than ranges of constant noise the criterion above its bound, relative to the bound.
    pub gap: f64,
    /// The planned position trace above the least that the bound allows, relative to the latter.
    pub trace_excess: f64,
    /// False if the bound is not proven to be the optimum: to within a billionth of the sum of all lambda, or a millionth of
    /// the criterion.
    pub certified: bool,
}

impl CertifiedReference {
    /// The reference for a team of `robots`.
    ///
    /// # Errors
    /// [`PlannerError`] if no optimum can be computed for a team of this size.
    pub fn for_robots(robots: usize) -> Result<Self, PlannerError> {
        let certified = PlannerSpec::Certified { nodes: defaults::NODES as u32 };
        // The seed is that of the random planner alone.
        let optimiser = planner::for_team(certified, robots, defaults::SEED)?;
        Ok(Self { optimiser, optimum: Plan::default(), problem: Problem::default() })
    }

    /// Measures a plan for a situation.
    pub fn measure(&mut self, situation: &Situation, plan: &Plan) -> Distance {
        // A plan with its own certificate needs no second one.
        let own = plan.certificate.filter(|proven| proven.is_optimal);
        let best = own.or_else(|| {
            self.optimiser.plan(0, situation, &mut self.optimum);
            self.optimum.certificate
        });
        self.problem.pose(situation);
        let best = best.unwrap_or_else(|| hull_certificate(situation, plan));
        // The paper's |S| may be zero, a criterion of other teams is not.
        let scale = if situation.is_range_only() { self.problem.lambda_sum() } else { best.lower_bound };
        Distance {
            gap: ((plan.predicted.objective - best.lower_bound) / scale).max(0.0),
            trace_excess: (plan.predicted.position_trace_m2 / best.least_trace_m2 - 1.0).max(0.0),
            certified: best.is_optimal,
        }
    }
}
