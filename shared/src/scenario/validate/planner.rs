//! Planner and clearances.

use super::Checker;
use super::values::quoted;
use crate::scenario::bounds::CLEARANCE;
use crate::scenario::{Clearance, Criterion, PLANNERS, PlannerSpec, PlannerTable, ScenarioError, defaults};

impl Checker<'_> {
    pub(super) fn planner(&self, table: &PlannerTable) -> Result<PlannerSpec, ScenarioError> {
        let iterations =
            self.whole("planner.iterations", table.iterations, defaults::ITERATIONS, 1..=1_000_000)? as u32;
        let alpha = self.number("planner.alpha", table.alpha, defaults::ALPHA, 0.0..=1.0)?;
        let step_rad =
            self.number("planner.step_rad", table.step_rad, defaults::GRID_STEP_RAD, 1e-6..=std::f64::consts::PI)?;
        let nodes = self.whole("planner.nodes", table.nodes, defaults::NODES, 1..=1_000_000)? as u32;
        let steps = self.whole("planner.steps", table.steps, defaults::STEPS, 1..=100)?;
        let blocks = self.whole("planner.blocks", table.blocks, defaults::BLOCKS.min(steps), 1..=steps)? as u32;
        match table.name.as_deref().unwrap_or(defaults::PLANNER) {
            "certified" => Ok(PlannerSpec::Certified { nodes }),
            "adaptive" => Ok(PlannerSpec::Adaptive { iterations, alpha }),
            "standard" => Ok(PlannerSpec::Standard { iterations }),
            "grid" => Ok(PlannerSpec::Grid { step_rad }),
            "greedy" => Ok(PlannerSpec::Greedy),
            "pursue" => Ok(PlannerSpec::Pursue),
            "random" => Ok(PlannerSpec::Random),
            "horizon" => Ok(PlannerSpec::Horizon { steps: steps as u32, blocks }),
            other => {
                let known = PLANNERS.map(quoted).join(", ");
                Err(self.refuse("planner.name", format!("one of {known}"), quoted(other)))
            }
        }
    }

    pub(super) fn criterion(&self, name: Option<&str>) -> Result<Criterion, ScenarioError> {
        let Some(name) = name else { return Ok(Criterion::default()) };
        Criterion::ALL.into_iter().find(|criterion| criterion.name() == name).ok_or_else(|| {
            let known = Criterion::ALL.map(|criterion| quoted(criterion.name())).join(", ");
            self.refuse("planner.criterion", format!("one of {known}"), quoted(name))
        })
    }

    pub(super) fn clearance(&self, table: &PlannerTable) -> Result<Clearance, ScenarioError> {
        let least = |key: &str, value, default| self.number(key, value, default, CLEARANCE);
        // A user who sets one measure does not get the default of the other as well.
        let stand_off_sigma = if table.stand_off_m.is_some() { 0.0 } else { defaults::STAND_OFF_SIGMA };
        Ok(Clearance {
            stand_off_m: least("planner.stand_off_m", table.stand_off_m, 0.0)?,
            stand_off_sigma: least("planner.stand_off_sigma", table.stand_off_sigma, stand_off_sigma)?,
            separation_m: least("planner.separation_m", table.separation_m, 0.0)?,
        })
    }
}
