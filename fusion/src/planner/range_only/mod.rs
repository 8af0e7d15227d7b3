//! Planners of teams that measure ranges of constant noise.
//!
//! [`Problem`] reduces a situation to the minimisation of `|S|`, the length of a sum of vectors: each robot turns one
//! of them within an arc. There is a file for each [`Solver`]:
//!
//! | solver | method |
//! |---|---|
//! | [`certified`] | branch and bound: the global optimum, with a proof |
//! | [`relaxation`] | the paper's adaptive relaxation, and standard relaxation as its case `alpha = 0` |
//! | [`grid`] | exhaustive search, the paper's reference: exponential in the number of robots |
//! | [`greedy`] | each robot by itself, its teammates counted where they stand |
//! | [`pursue`] | straight to the predicted target |
//! | [`random`] | uniformly random headings, the paper's lower end |
//!
//! [`RangeOnly`] makes a [`Planner`] of any of them.

mod arm;
pub mod certified;
pub mod greedy;
pub mod grid;
pub mod pair;
mod problem;
pub mod pursue;
pub mod random;
pub(super) mod reach;
pub mod relaxation;
mod solution;

use rangehound_shared::message::Command;
use rangehound_shared::scenario::{PlannerSpec, defaults};

use super::{Plan, Planner, PlannerError, Predicted, Situation};
use crate::vector::Vector;
pub use arm::{Arm, Extent};
pub use problem::Problem;
pub use solution::{Solution, hull_certificate};

/// A way to choose directions within their arcs.
pub trait Solver: std::fmt::Debug + Send {
    /// Its name in scenarios and on the command line.
    fn name(&self) -> &'static str;

    /// Chooses a direction for each robot of the problem and completes the solution with
    /// [`Solution::complete`].
    fn solve(&mut self, tick: u64, problem: &Problem, solution: &mut Solution);
}

/// The solver that a scenario asks for, for a team of `robots`.
///
/// # Errors
/// [`PlannerError`] if it could not serve a team of this size.
pub fn solver(spec: PlannerSpec, robots: usize, seed: u64) -> Result<Box<dyn Solver>, PlannerError> {
    Ok(match spec {
        PlannerSpec::Certified { nodes } => Box::new(certified::Certified::new(nodes)),
        PlannerSpec::Adaptive { iterations, alpha } => Box::new(relaxation::Relaxation::adaptive(iterations, alpha)),
        PlannerSpec::Standard { iterations } => Box::new(relaxation::Relaxation::standard(iterations)),
        PlannerSpec::Grid { step_rad } => Box::new(grid::Grid::for_team(step_rad, robots)?),
        PlannerSpec::Greedy => Box::new(greedy::Greedy),
        PlannerSpec::Pursue => Box::new(pursue::Pursue),
        PlannerSpec::Random => Box::new(random::Random::new(seed)),
        // Of its single steps.
        PlannerSpec::Horizon { .. } => Box::new(certified::Certified::new(defaults::NODES as u32)),
    })
}

/// The planner that poses the problem of each situation to a solver.
#[derive(Debug)]
pub struct RangeOnly {
    solver: Box<dyn Solver>,
    /// Problem and solution of the present situation: reused memory.
    problem: Problem,
    solution: Solution,
}

impl RangeOnly {
    /// The planner round this solver.
    #[must_use]
    pub fn new(solver: Box<dyn Solver>) -> Self {
        Self { solver, problem: Problem::default(), solution: Solution::default() }
    }

    /// What these commands lead to.
    pub(super) fn predicted(&mut self, situation: &Situation, commands: &[Command]) -> Predicted {
        let Self { problem, solution, .. } = self;
        problem.pose(situation);
        solution.directions.clear();
        solution.directions.extend(problem.reaches.iter().zip(commands).map(|(reach, command)| {
            reach.direction_after(Vector::from_angle(command.heading_rad) * (command.speed_mps * situation.step_s))
        }));
        solution.value(problem);
        solution.predicted()
    }
}

impl Planner for RangeOnly {
    fn name(&self) -> &'static str {
        self.solver.name()
    }

    fn plan(&mut self, tick: u64, situation: &Situation, plan: &mut Plan) {
        self.problem.pose(situation);
        self.solver.solve(tick, &self.problem, &mut self.solution);
        std::mem::swap(&mut plan.commands, &mut self.solution.commands);
        plan.predicted = self.solution.predicted();
        plan.certificate = self.solution.certificate(&self.problem);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::belief::Belief;
    use crate::planner::TeamMember;
    use crate::vector::Vector;
    use nalgebra::Matrix2;
    use proptest::prelude::*;

    fn random_situation(prior: (f64, f64, f64), robots: &[(f64, f64, f64, f64)]) -> Situation {
        let (a, c, correlation) = prior;
        let b = correlation * (a * c).sqrt();
        let member = |&(x, y, speed_mps, range_std_m)| TeamMember::ranging(Vector::new(x, y), speed_mps, range_std_m);
        Situation {
            belief: Belief::of_position(Vector::default(), &Matrix2::new(a, b, b, c)),
            team: robots.iter().map(member).collect(),
            step_s: 0.1,
            ..Situation::default()
        }
    }

    fn random_problem(prior: (f64, f64, f64), robots: &[(f64, f64, f64, f64)]) -> Problem {
        Problem::of(&random_situation(prior, robots))
    }

    fn solve(spec: PlannerSpec, problem: &Problem) -> Solution {
        let mut solution = Solution::default();
        solver(spec, problem.len(), 1).unwrap().solve(0, problem, &mut solution);
        solution
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
                let solution = solve(spec, &problem);
                prop_assert_eq!(solution.commands.len(), robots.len());
                prop_assert!(solution.objective.is_finite() && solution.position_trace_m2 > 0.0);
                prop_assert_eq!(solution.lower_bound.is_finite(), spec.name() == "certified");
                for (i, command) in solution.commands.iter().enumerate() {
                    prop_assert!(command.heading_rad.is_finite());
                    let sight_m = problem.reaches[i].to_target_m
                        - Vector::from_angle(command.heading_rad) * (command.speed_mps * 0.1);
                    let end_m = sight_m.norm();
                    let after = sight_m.normalised().unwrap_or(Vector::new(1.0, 0.0)).doubled();
                    let error = (after - solution.directions[i]).norm();
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

    /// If one robot has nearly all information, the trace depends on the last digits of `|S|`.
    #[test]
    fn a_robot_far_better_than_the_others_costs_no_digits_of_the_trace() {
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
        let team = team.map(|(x, y, range_std_m)| TeamMember::ranging(Vector::new(x, y), 10.0, range_std_m)).into();
        let belief = Belief::of_position(Vector::default(), &prior);
        let problem = Problem::of(&Situation { belief, team, step_s: 0.1, ..Situation::default() });
        let solution = solve(PlannerSpec::Certified { nodes: 2_000 }, &problem);
        // Found by many restarts of a general optimiser.
        assert!(solution.position_trace_m2 < 16.763_387 && solution.is_certified(&problem), "{solution:?}");
    }

    #[test]
    fn no_robots_make_an_empty_plan() {
        let problem = random_problem((1.0, 2.0, 0.0), &[]);
        for spec in ALL {
            assert!(solve(spec, &problem).commands.is_empty());
        }
    }

    #[test]
    fn a_round_prior_has_no_direction_of_its_own() {
        // lambda_0 = 0: two equal robots cancel each other exactly.
        let problem = random_problem((2.0, 2.0, 0.0), &[(0.5, 0.0, 10.0, 1.0), (0.0, 0.5, 10.0, 1.0)]);
        assert!(solve(PlannerSpec::Adaptive { iterations: 20, alpha: 0.5 }, &problem).objective < 1e-9);
    }

    /// A plan is the solution of its situation's problem, whatever was planned before. Robots that are not fused are sent
    /// to their best places and are not counted.
    #[test]
    fn a_plan_is_the_solution_of_the_situations_problem() {
        let mut situation = random_situation((3.0, 1.0, 0.4), &[(8.0, 1.0, 9.0, 0.5), (-4.0, 6.0, 9.0, 1.0)]);
        for spec in ALL {
            let (mut planner, mut plan) = (crate::planner::for_team(spec, 2, 1).unwrap(), Plan::default());
            for is_fused in [true, false, true] {
                situation.team[1].is_fused = is_fused;
                planner.plan(0, &situation, &mut plan);
                let problem = Problem::of(&situation);
                let solution = solve(spec, &problem);
                assert_eq!((&plan.commands, plan.predicted), (&solution.commands, solution.predicted()));
                assert_eq!(plan.certificate, solution.certificate(&problem));
                assert_eq!(plan.certificate.is_some(), spec.name() == "certified");
                assert_eq!(problem.arms()[1].lambda, if is_fused { 1.0 } else { 0.0 });
                assert!(plan.commands[1].speed_mps > 0.0);
                // The bound of the hulls holds too, and is no better than the search's.
                let hull = hull_certificate(&problem, &plan.predicted);
                let best = plan.certificate.unwrap_or(hull);
                assert!(hull.lower_bound <= best.lower_bound);
                assert!(best.least_trace_m2 > 0.0 && best.least_trace_m2 <= plan.predicted.position_trace_m2);
            }
        }
    }
}
