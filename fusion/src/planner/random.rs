//! Uniformly random headings: what planning is measured against.

use std::f64::consts::{PI, TAU};

use rangehound_shared::draws::{Draws, Stream};

use super::{Plan, Planner, Problem};

/// Each heading uniform on the circle, a function of (seed, tick, place in the team).
#[derive(Debug, Clone)]
pub struct Random {
    draws: Draws,
}

impl Random {
    /// Random headings under this seed.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self { draws: Draws::new(seed, Stream::RandomPlanner) }
    }
}

impl Planner for Random {
    fn name(&self) -> &'static str {
        "random"
    }

    fn plan(&mut self, tick: u64, problem: &Problem, plan: &mut Plan) {
        plan.headings_rad.resize(problem.len(), 0.0);
        self.draws.uniform(tick, &mut plan.headings_rad);
        plan.directions.clear();
        plan.speeds_mps.clear();
        for (i, heading_rad) in plan.headings_rad.iter_mut().enumerate() {
            *heading_rad = *heading_rad * TAU - PI;
            let (direction, speed_mps) = problem.after_heading(i, heading_rad);
            plan.directions.push(direction);
            plan.speeds_mps.push(speed_mps);
        }
        plan.value(problem);
    }
}
