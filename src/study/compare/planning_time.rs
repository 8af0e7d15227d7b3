//! Planning time over the size of the team.

use std::time::{Duration, Instant};

use nalgebra::Matrix2;
use rangehound_fusion::planner::{self, Plan, Situation, TeamMember};
use rangehound_fusion::vector::Vector;
use rangehound_shared::scenario::Scenario;
use serde::Serialize;

use crate::statistics::{Ascending, PowerLaw, fit_power_law};

/// Sizes of the team.
const SIZES: [usize; 7] = [1, 3, 10, 30, 100, 300, 1_000];

/// Time limit for one planner at one size; the step that exceeds it is the last, except below the least number of steps.
const BUDGET: Duration = Duration::from_millis(60);

/// Least number of measured steps, whatever their duration: a single delayed step must not decide the result.
const STEPS_MIN: usize = 3;

/// Most measured steps.
const STEPS_MAX: usize = 2_000;

/// Least and largest distance of robots to the target, m.
const DISTANCES_M: (f64, f64) = (3.0, 30.0);

/// The power law is fitted from this size on: in smaller teams the fixed cost of a step dominates.
const FITTED_FROM: usize = 10;

/// Planning time of one planner over the size of the team.
#[derive(Debug, Clone, Serialize)]
pub struct Scaling {
    /// The planner.
    pub name: String,
    /// Median time of a step by size.
    pub points: Vec<Point>,
    /// Power law through the points of teams that are not small, in us.
    pub law: Option<PowerLaw>,
}

/// Planning time at one size.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Point {
    /// Robots.
    pub robots: usize,
    /// Median time of a step, us.
    pub planning_us: f64,
}

/// Measures the planner of a scenario on teams of the scenario's robots round a target.
#[must_use]
pub fn measure(name: &str, scenario: &Scenario) -> Scaling {
    let mut points = Vec::new();
    for robots in SIZES {
        let began = Instant::now();
        let Some(planning_us) = measure_at(scenario, robots) else { break };
        points.push(Point { robots, planning_us });
        if began.elapsed() > 2 * BUDGET {
            break;
        }
    }
    let mut scaling = Scaling { name: name.to_owned(), points, law: None };
    let fitted = scaling.fitted().iter().map(|point| (point.robots as f64, point.planning_us));
    scaling.law = fit_power_law(&fitted.collect::<Vec<_>>());
    scaling
}

impl Scaling {
    /// The points of the power law's fit; all of them if the planner serves only small teams.
    #[must_use]
    pub fn fitted(&self) -> &[Point] {
        match self.points.iter().position(|point| point.robots >= FITTED_FROM) {
            Some(first) if first + 2 < self.points.len() => &self.points[first..],
            _ => &self.points,
        }
    }
}

/// Median time of a step, us: from a situation to commands, as at a tick of a run. `None` if the
/// planner refuses a team of this size.
fn measure_at(scenario: &Scenario, robots: usize) -> Option<f64> {
    let mut planner = planner::for_team(scenario.planner, robots, scenario.seed).ok()?;
    let mut situation = Situation { clearance: scenario.clearance, step_s: scenario.dt_s, ..Situation::default() };
    let mut plan = Plan::default();
    let mut times_us = Vec::with_capacity(STEPS_MAX);
    let began = Instant::now();
    while times_us.len() < STEPS_MAX && (times_us.len() < STEPS_MIN || began.elapsed() < BUDGET) {
        let step = times_us.len();
        let prior = prior_m2(step, robots);
        let step_began = Instant::now();
        situation.belief.set_position(Vector::default(), &prior);
        situation.team.clear();
        situation.team.extend(team(scenario, step, robots));
        planner.plan(step as u64, &situation, &mut plan);
        times_us.push(step_began.elapsed().as_secs_f64() * 1e6);
    }
    Some(times_us.into_iter().collect::<Ascending>().quantile(0.5))
}

/// Robots on a ring round the target, spread evenly in direction and distance by irrational steps; no
/// two steps have the same geometry.
fn team(scenario: &Scenario, step: usize, robots: usize) -> impl Iterator<Item = TeamMember> {
    let kinds = scenario.robots.iter().cycle();
    (0..robots).zip(kinds).map(move |(robot, kind)| {
        let i = (step * robots + robot) as f64;
        let (nearest_m, farthest_m) = DISTANCES_M;
        let distance_m = nearest_m + (farthest_m - nearest_m) * (i * 0.618_034).fract();
        let position_m = Vector::from_angle(i * 2.399_963) * distance_m;
        TeamMember { sensor: kind.reported, ..TeamMember::ranging(position_m, kind.speed_mps, 1.0) }
    })
}

/// Longer than wide, turned with each step, and more accurate the larger the team: in steady state
/// the prior has as much information as the ranges of a few ticks.
fn prior_m2(step: usize, robots: usize) -> Matrix2<f64> {
    let axis = Vector::from_angle(step as f64);
    let along = Matrix2::new(axis.x * axis.x, axis.x * axis.y, axis.x * axis.y, axis.y * axis.y);
    (Matrix2::identity() * 0.15 + along * 0.3) * (3.0 / robots as f64)
}
