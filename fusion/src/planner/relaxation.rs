//! Adaptive relaxation (Eqs. 28, 29) and standard relaxation, its case `alpha = 0`.

use super::vector::Vector;
use super::{Plan, Planner, Problem};

/// The paper's solver: turns one robot's vector after the other to where `|S + V|` is least, the
/// others held, with the perturbation `V = -alpha S_old` of the cycle's start against local minima.
///
/// The one-robot problem is closed form: the direction in the arc nearest to `-(rest)`. The cycle
/// runs from the last robot to the first and uses the newest directions at once, as the paper's
/// printed numbers do. O(M) a cycle; no trigonometric call.
#[derive(Debug, Clone)]
pub struct Relaxation {
    name: &'static str,
    iterations: u32,
    alpha: f64,
}

impl Relaxation {
    /// Adaptive relaxation with factor `alpha` in [0, 1].
    #[must_use]
    pub fn adaptive(iterations: u32, alpha: f64) -> Self {
        Self { name: "adaptive", iterations, alpha }
    }

    /// Standard relaxation.
    #[must_use]
    pub fn standard(iterations: u32) -> Self {
        Self { name: "standard", iterations, alpha: 0.0 }
    }

    /// Improves `directions` in place; they must lie in their arcs.
    pub fn relax(&self, problem: &Problem, directions: &mut [Vector]) {
        // One robot alone has a closed form and no local minimum to be shaken out of.
        let alpha = if problem.len() == 1 { 0.0 } else { self.alpha };
        let mut sum = problem.sum(directions);
        for _ in 0..self.iterations {
            // S + V, kept current: the one chain of additions that every robot waits for.
            let perturbation = sum * -alpha;
            let mut pull = sum + perturbation;
            let mut moved = false;
            for (arm, direction) in problem.arms.iter().zip(directions.iter_mut()).rev() {
                let goal = *direction * arm.lambda - pull;
                let turned = arm.nearest(goal, *direction);
                pull = turned * arm.lambda - goal;
                moved |= turned != *direction;
                *direction = turned;
            }
            if !moved {
                // A fixed point to the bit: every further cycle would repeat this one.
                break;
            }
            sum = pull - perturbation;
        }
    }
}

impl Planner for Relaxation {
    fn name(&self) -> &'static str {
        self.name
    }

    fn plan(&mut self, _tick: u64, problem: &Problem, plan: &mut Plan) {
        plan.directions.clear();
        plan.directions.extend(problem.arms.iter().map(|arm| arm.centre));
        self.relax(problem, &mut plan.directions);
        plan.complete(problem);
    }
}

#[cfg(test)]
mod tests {
    use super::super::Arm;
    use super::*;
    use std::f64::consts::{FRAC_PI_4, PI, SQRT_2};

    /// The paper's worked example: `lambda = (sqrt 2; 1, 1)`, no constraints.
    fn worked_example() -> (Problem, Vec<Vector>) {
        let problem = Problem::of_arms(Vector::new(SQRT_2, 0.0), vec![Arm::circle(1.0, Vector::new(1.0, 0.0)); 2]);
        // The first start is pi exactly, which no floating-point angle is.
        (problem, vec![Vector::new(-1.0, 0.0), Vector::from_angle(-5.0 * PI / 6.0)])
    }

    fn angles_after(iterations: u32, alpha: f64) -> [f64; 2] {
        let (problem, mut directions) = worked_example();
        Relaxation::adaptive(iterations, alpha).relax(&problem, &mut directions);
        [directions[0].angle_rad(), directions[1].angle_rad()]
    }

    #[test]
    fn the_papers_printed_angles_come_out() {
        for (iterations, phi_1, phi_2) in [(1, 2.9824, -2.7693), (2, 2.8053, -2.7745), (17, 2.3562, -2.3562)] {
            let angles = angles_after(iterations, 0.5);
            assert!((angles[0] - phi_1).abs() < 5e-5, "iteration {iterations}: phi_1 {}", angles[0]);
            assert!((angles[1] - phi_2).abs() < 5e-5, "iteration {iterations}: phi_2 {}", angles[1]);
        }
        assert!((angles_after(200, 0.5)[0] - 3.0 * FRAC_PI_4).abs() < 1e-12);
    }

    #[test]
    fn standard_relaxation_is_stuck_where_the_paper_says() {
        for iterations in [1, 2, 3, 1000] {
            let (problem, mut directions) = worked_example();
            Relaxation::standard(iterations).relax(&problem, &mut directions);
            assert!(directions.iter().all(|u| (u.angle_rad().abs() - PI).abs() < 1e-12), "{directions:?}");
            assert!((problem.sum(&directions).norm() - (2.0 - SQRT_2)).abs() < 1e-12);
        }
    }

    #[test]
    fn alpha_one_does_not_move() {
        let (problem, start) = worked_example();
        let mut directions = start.clone();
        Relaxation::adaptive(50, 1.0).relax(&problem, &mut directions);
        for (a, b) in directions.iter().zip(&start) {
            assert!((*a - *b).norm() < 1e-9);
        }
    }
}
