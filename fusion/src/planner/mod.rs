//! Planners: each step they choose every robot's heading so that the trace of the target's
//! position covariance after the next ranges is small (Eqs. 14-29).
//!
//! [`Problem`] poses the step as the minimisation of `|S|`; a [`Planner`] solves it, one file each:
//!
//! | planner | method |
//! |---|---|
//! | [`certified`] | branch and bound: the global optimum, with a proof |
//! | [`relaxation`] | the paper's adaptive relaxation, and standard relaxation as its case `alpha = 0` |
//! | [`grid`] | exhaustive search, the paper's yardstick: exponential in the number of robots |
//! | [`greedy`] | each robot by itself, its teammates counted where they stand |
//! | [`pursue`] | straight to the predicted target |
//! | [`random`] | uniformly random headings, the paper's lower end |
//!
//! A planner is a pure function of (tick, problem): nothing is kept from one step to the next, so
//! a restarted fusion plans as the old one would have.

mod arm;
pub mod certified;
pub mod greedy;
pub mod grid;
pub mod pair;
mod problem;
pub mod pursue;
pub mod random;
mod reach;
pub mod relaxation;
mod vector;

use rangehound_shared::scenario::PlannerSpec;

pub use arm::{Arm, Extent};
use problem::trace_m2;
pub use problem::{Problem, TeamMember};
pub use vector::Vector;

/// The headings of one step and what they are worth.
#[derive(Debug, Clone, PartialEq)]
pub struct Plan {
    /// Doubled bearing of each robot to the predicted target after the step, `exp(2j theta_i)`.
    pub directions: Vec<Vector>,
    /// Heading of each robot, rad in (-pi, pi].
    pub headings_rad: Vec<f64>,
    /// Speed of each robot, m/s.
    pub speeds_mps: Vec<f64>,
    /// `|S|` that these directions reach, 1/m^2.
    pub objective: f64,
    /// No directions in the arcs reach less than this; minus infinity from planners that prove nothing.
    pub lower_bound: f64,
    /// Trace of the position covariance after the next ranges, m^2.
    pub position_trace_m2: f64,
    /// `T - |S|`, twice the least eigenvalue of the information, 1/m^2: the trace hangs on it, and the difference of
    /// the two may be nothing but rounding.
    pub least_information: f64,
    /// No directions in the arcs reach more than this; infinite from planners that prove nothing.
    pub least_information_bound: f64,
}

/// A way to choose headings.
pub trait Planner: std::fmt::Debug + Send {
    /// The name by which scenario and command line know it.
    fn name(&self) -> &'static str;

    /// Chooses a direction for each robot of the problem and completes the plan with
    /// [`Plan::complete`].
    fn plan(&mut self, tick: u64, problem: &Problem, plan: &mut Plan);
}

/// Why a planner cannot serve a team.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PlannerError {
    /// The search would not finish.
    #[error(
        "planner.step_rad: expected a grid of at most {limit:.0e} candidates, got {candidates:.3e} \
         ({points} bearings for each of {robots} robots): take a wider step, fewer robots or another planner"
    )]
    GridTooLarge {
        /// Candidates in the worst case, when every robot is within one step of the target.
        candidates: f64,
        /// Bearings a robot.
        points: usize,
        /// Robots.
        robots: usize,
        /// Most candidates that are searched.
        limit: f64,
    },
}

/// The planner that a scenario asks for, for a team of `robots`.
///
/// # Errors
/// [`PlannerError`] if it could not serve a team of this size.
pub fn for_team(spec: PlannerSpec, robots: usize, seed: u64) -> Result<Box<dyn Planner>, PlannerError> {
    Ok(match spec {
        PlannerSpec::Certified { nodes } => Box::new(certified::Certified::new(nodes)),
        PlannerSpec::Adaptive { iterations, alpha } => Box::new(relaxation::Relaxation::adaptive(iterations, alpha)),
        PlannerSpec::Standard { iterations } => Box::new(relaxation::Relaxation::standard(iterations)),
        PlannerSpec::Grid { step_rad } => Box::new(grid::Grid::for_team(step_rad, robots)?),
        PlannerSpec::Greedy => Box::new(greedy::Greedy),
        PlannerSpec::Pursue => Box::new(pursue::Pursue),
        PlannerSpec::Random => Box::new(random::Random::new(seed)),
    })
}

impl Default for Plan {
    /// Nothing chosen, nothing proven.
    fn default() -> Self {
        Self {
            directions: Vec::new(),
            headings_rad: Vec::new(),
            speeds_mps: Vec::new(),
            objective: 0.0,
            lower_bound: f64::NEG_INFINITY,
            position_trace_m2: 0.0,
            least_information: 0.0,
            least_information_bound: f64::INFINITY,
        }
    }
}

impl Plan {
    /// Derives headings, speeds and worth from [`Self::directions`] (Eq. 16).
    pub fn complete(&mut self, problem: &Problem) {
        self.headings_rad.clear();
        self.speeds_mps.clear();
        for (reach, direction) in problem.reaches.iter().zip(&self.directions) {
            let (heading, speed_mps) = reach.motion(*direction, &problem.corners_m);
            self.headings_rad.push(heading.angle_rad());
            self.speeds_mps.push(speed_mps);
        }
        self.value(problem);
    }

    /// Derives what [`Self::directions`] are worth; proves nothing.
    fn value(&mut self, problem: &Problem) {
        let sum = problem.sum(&self.directions);
        self.objective = sum.norm();
        self.least_information = problem.least_information(&self.directions, sum);
        self.position_trace_m2 = trace_m2(self.least_information, self.objective);
        (self.lower_bound, self.least_information_bound) = (f64::NEG_INFINITY, f64::INFINITY);
    }

    /// Takes note that no directions reach less than `lower_bound`.
    pub fn prove(&mut self, lower_bound: f64) {
        self.lower_bound = lower_bound.min(self.objective);
        self.least_information_bound = self.least_information + (self.objective - self.lower_bound);
    }

    /// No directions have a lesser position trace than this, m^2; 0 if nothing is proven.
    #[must_use]
    pub fn least_trace_m2(&self) -> f64 {
        let gap = self.least_information_bound - self.least_information;
        if gap.is_finite() { trace_m2(self.least_information_bound, (self.objective - gap).max(0.0)) } else { 0.0 }
    }

    /// True if it is proven that no other headings are better by more than a billionth of the sum of all lambda in
    /// `|S|`, nor by more than a millionth in the trace.
    #[must_use]
    pub fn is_certified(&self, problem: &Problem) -> bool {
        self.objective - self.lower_bound <= certified::GAP_MAX * problem.lambda_sum()
            && self.least_information_bound <= self.least_information * (1.0 + certified::TRACE_GAP_MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix2;
    use proptest::prelude::*;
    use rangehound_shared::scenario::Clearance;

    fn random_problem(prior: (f64, f64, f64), robots: &[(f64, f64, f64, f64)]) -> Problem {
        let (a, c, correlation) = prior;
        let b = correlation * (a * c).sqrt();
        let mut problem = Problem::default();
        problem.pose(
            &Matrix2::new(a, b, b, c),
            Vector::default(),
            0.1,
            &Clearance::default(),
            robots.iter().map(|&(x, y, max_speed_mps, range_std_m)| TeamMember {
                position_m: Vector::new(x, y),
                max_speed_mps,
                range_std_m,
            }),
        );
        problem
    }

    fn solve(spec: PlannerSpec, problem: &Problem) -> Plan {
        let mut plan = Plan::default();
        for_team(spec, problem.len(), 1).unwrap().plan(0, problem, &mut plan);
        plan
    }

    const ALL: [PlannerSpec; 7] = [
        PlannerSpec::Certified { nodes: 2_000 },
        PlannerSpec::Greedy,
        PlannerSpec::Pursue,
        PlannerSpec::Adaptive { iterations: 20, alpha: 0.5 },
        PlannerSpec::Standard { iterations: 20 },
        PlannerSpec::Grid { step_rad: 0.05 },
        PlannerSpec::Random,
    ];

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]

        /// Whatever the geometry (on the target, at rest, within a step): the headings are finite,
        /// keep the arcs, and the claimed objective is the one that the motion leads to.
        #[test]
        fn every_plan_is_what_its_motion_leads_to(
            prior in (0.1..20.0_f64, 0.1..20.0_f64, -0.95..0.95_f64),
            robots in proptest::collection::vec(
                (prop_oneof![Just(0.0), -9.0..9.0_f64], prop_oneof![Just(0.0), -9.0..9.0_f64],
                 prop_oneof![Just(0.0), 0.1..60.0_f64], 0.1..3.0_f64), 1..4),
        ) {
            let problem = random_problem(prior, &robots);
            for spec in ALL {
                let plan = solve(spec, &problem);
                prop_assert_eq!(plan.headings_rad.len(), robots.len());
                prop_assert!(plan.objective.is_finite() && plan.position_trace_m2 > 0.0);
                prop_assert_eq!(plan.lower_bound.is_finite(), spec.name() == "certified");
                for (i, heading) in plan.headings_rad.iter().enumerate() {
                    prop_assert!(heading.is_finite());
                    let sight_m = problem.reaches[i].to_target_m
                        - Vector::from_angle(*heading) * (plan.speeds_mps[i] * 0.1);
                    let end_m = sight_m.norm();
                    let after = sight_m.normalised().unwrap_or(Vector::new(1.0, 0.0)).doubled();
                    let error = (after - plan.directions[i]).norm();
                    prop_assert!(error * end_m.min(1.0) < 1e-6, "{} robot {i}: {error}", spec.name());
                }
            }
        }

        /// With one robot every planner but the random finds the same optimum: the Rayleigh quotient.
        #[test]
        fn one_robot_goes_as_near_the_opposite_direction_as_it_may(
            prior in (0.1..20.0_f64, 0.1..20.0_f64, -0.95..0.95_f64), x in 1.0..30.0_f64, speed in 0.0..100.0_f64,
        ) {
            let problem = random_problem(prior, &[(x, 0.5, speed, 1.0)]);
            let adaptive = solve(PlannerSpec::Adaptive { iterations: 60, alpha: 0.5 }, &problem);
            let standard = solve(PlannerSpec::Standard { iterations: 1 }, &problem);
            let grid = solve(PlannerSpec::Grid { step_rad: 1e-4 }, &problem);
            prop_assert!((adaptive.objective - standard.objective).abs() < 1e-6, "{adaptive:?} {standard:?}");
            prop_assert!(standard.objective <= grid.objective + 1e-12);
            prop_assert!(grid.objective <= standard.objective + 2e-4);
        }

        /// No point of an arc is further than one grid step from a grid point, so the grid's best is
        /// within `2 step sum(lambda)` of any other solution.
        #[test]
        fn adaptive_beats_the_grid_by_no_more_than_its_resolution(
            prior in (0.1..20.0_f64, 0.1..20.0_f64, -0.95..0.95_f64),
            robots in proptest::collection::vec((-20.0..20.0_f64, -20.0..20.0_f64, 0.0..60.0_f64, 0.3..3.0_f64), 1..4),
        ) {
            let problem = random_problem(prior, &robots);
            let step_rad = 0.05;
            let adaptive = solve(PlannerSpec::Adaptive { iterations: 100, alpha: 0.5 }, &problem);
            let grid = solve(PlannerSpec::Grid { step_rad }, &problem);
            let resolution = problem.arms().iter().map(|arm| arm.lambda * step_rad).sum::<f64>();
            prop_assert!(grid.objective <= adaptive.objective + resolution);
        }
    }

    /// Where one robot knows nearly all, the trace hangs on the last digits of `|S|`.
    #[test]
    fn a_robot_far_better_than_the_others_costs_no_digits_of_the_trace() {
        let mut problem = Problem::default();
        let team = [
            (-0.482_433_146_599_289_2, 0.131_370_693_315_932_26, 5.595_414_034_410_357),
            (-0.299_080_932_670_315_77, -0.400_687_653_557_049_44, 0.004_804_632_835_105_804),
            (-0.559_669_938_380_347_1, 1.050_553_144_249_981_7, 6.914_948_079_180_636),
        ];
        let prior = Matrix2::new(
            170.404_441_755_723_18,
            35.931_023_846_944_925,
            35.931_023_846_944_925,
            202.318_016_559_546_24,
        );
        let team = team.map(|(x, y, range_std_m)| TeamMember {
            position_m: Vector::new(x, y),
            max_speed_mps: 10.0,
            range_std_m,
        });
        problem.pose(&prior, Vector::default(), 0.1, &Clearance::default(), team);
        let plan = solve(PlannerSpec::Certified { nodes: 2_000 }, &problem);
        // Found by many restarts of a general optimiser.
        assert!(plan.position_trace_m2 < 16.763_387 && plan.is_certified(&problem), "{plan:?}");
    }

    #[test]
    fn no_robots_make_an_empty_plan() {
        let problem = random_problem((1.0, 2.0, 0.0), &[]);
        for spec in ALL {
            assert!(solve(spec, &problem).headings_rad.is_empty());
        }
    }

    #[test]
    fn a_round_prior_has_no_direction_of_its_own() {
        // lambda_0 = 0: two equal robots cancel each other exactly.
        let problem = random_problem((2.0, 2.0, 0.0), &[(0.5, 0.0, 10.0, 1.0), (0.0, 0.5, 10.0, 1.0)]);
        assert!(solve(PlannerSpec::Adaptive { iterations: 20, alpha: 0.5 }, &problem).objective < 1e-9);
    }
}
