//! Exhaustive search on a grid of bearings: the paper's reference.

use std::f64::consts::PI;

use super::{Arm, Extent, PlannerError, Problem, Solution, Solver};
use crate::vector::Vector;

/// Most candidates of a step, at about a nanosecond each.
const CANDIDATES_MAX: f64 = 2e9;

/// Tries every combination of bearings `theta_min, theta_min + step, ..., theta_max`: exponential in
/// the number of robots. Optimal to within the grid's resolution.
#[derive(Debug, Clone)]
pub struct Grid {
    step_rad: f64,
    points: Vec<Vector>,
    ends: Vec<usize>,
    cursor: Vec<usize>,
}

impl Grid {
    /// A search with this step on the bearing, for a team of this size.
    ///
    /// # Errors
    /// [`PlannerError::GridTooLarge`], with the count, if it would not finish.
    pub fn for_team(step_rad: f64, robots: usize) -> Result<Self, PlannerError> {
        // Bearings matter modulo pi, as their doubles do modulo a turn.
        let points = (PI / step_rad).ceil() as usize;
        let candidates = (points as f64).powi(robots as i32);
        if candidates > CANDIDATES_MAX {
            return Err(PlannerError::GridTooLarge { candidates, points, robots, limit: CANDIDATES_MAX });
        }
        Ok(Self { step_rad, points: Vec::new(), ends: Vec::new(), cursor: Vec::new() })
    }

    /// Lays the grid over one arc: its ends included, spaced by at most the step.
    fn lay(&mut self, arm: &Arm) {
        let (start, width) = match arm.extent {
            Extent::Circle => (arm.centre, 2.0 * PI),
            Extent::Narrow | Extent::Wide => {
                (arm.low, 2.0 * arm.low.cross(arm.centre).atan2(arm.low.dot(arm.centre)).max(0.0))
            }
        };
        let step = 2.0 * self.step_rad;
        let full_steps = (width / step).floor() as usize;
        for index in 0..=full_steps {
            let angle = index as f64 * step;
            if arm.extent == Extent::Circle && angle >= width - 1e-9 {
                break;
            }
            self.points.push(start.rotated_by(Vector::from_angle(angle)));
        }
        if arm.extent != Extent::Circle {
            self.points.push(arm.high);
        }
        self.ends.push(self.points.len());
    }

    /// Goes through all combinations; the last robot's bearings are the innermost loop.
    fn search(&mut self, problem: &Problem, best: &mut [Vector]) {
        let Some((last, outer)) = problem.arms.split_last() else { return };
        let start = |robot: usize| robot.checked_sub(1).map_or(0, |before| self.ends[before]);
        self.cursor.clear();
        self.cursor.extend((0..problem.len()).map(start));
        let innermost = start(outer.len())..self.ends[outer.len()];
        let mut least = f64::INFINITY;
        loop {
            let partial = outer
                .iter()
                .zip(&self.cursor)
                .fold(problem.prior, |sum, (arm, point)| sum + self.points[*point] * arm.lambda);
            for point in innermost.clone() {
                let value = (partial + self.points[point] * last.lambda).norm_squared();
                if value < least {
                    least = value;
                    self.cursor[outer.len()] = point;
                    for (direction, point) in best.iter_mut().zip(&self.cursor) {
                        *direction = self.points[*point];
                    }
                }
            }
            // The next combination of the outer robots, as an odometer counts.
            let Some(turning) = (0..outer.len()).rev().find(|&robot| self.cursor[robot] + 1 < self.ends[robot]) else {
                return;
            };
            self.cursor[turning] += 1;
            for robot in turning + 1..outer.len() {
                self.cursor[robot] = start(robot);
            }
        }
    }
}

impl Solver for Grid {
    fn name(&self) -> &'static str {
        "grid"
    }

    fn solve(&mut self, _tick: u64, problem: &Problem, solution: &mut Solution) {
        self.points.clear();
        self.ends.clear();
        for arm in &problem.arms {
            self.lay(arm);
        }
        solution.directions.clear();
        solution.directions.extend(problem.arms.iter().map(|arm| arm.centre));
        self.search(problem, &mut solution.directions);
        solution.complete(problem);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_search_that_would_not_finish_is_refused_with_its_count() {
        assert!(Grid::for_team(PI / 200.0, 4).is_ok());
        let error = Grid::for_team(PI / 200.0, 5).unwrap_err();
        assert!(error.to_string().contains("3.200e11"), "{error}");
        assert!(error.to_string().contains("200 bearings for each of 5 robots"), "{error}");
    }

    #[test]
    fn an_arc_is_covered_from_end_to_end() {
        let mut grid = Grid::for_team(0.1, 1).unwrap();
        let half = 0.75_f64;
        grid.lay(&Arm::with_half_width(1.0, Vector::from_angle(3.0), Vector::from_angle(half)));
        let first = grid.points[0].angle_rad();
        let last = grid.points.last().unwrap().angle_rad();
        assert!((first - 2.25).abs() < 1e-12 && (last - (3.75 - 2.0 * PI)).abs() < 1e-12);
        for pair in grid.points.windows(2) {
            assert!(pair[0].dot(pair[1]) >= 0.2_f64.cos() - 1e-12);
        }
    }

    #[test]
    fn the_innermost_loop_sees_every_combination() {
        // Three free robots of equal weight and no prior: the optimum is a balanced triangle.
        let problem = Problem::of_arms(Vector::default(), vec![Arm::circle(1.0, Vector::new(1.0, 0.0)); 3]);
        let mut solution = Solution::default();
        Grid::for_team(PI / 30.0, 3).unwrap().solve(0, &problem, &mut solution);
        assert!(solution.objective < 1e-12, "{solution:?}");
    }
}
