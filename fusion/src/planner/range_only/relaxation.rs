//! Adaptive relaxation (Eqs. 28, 29) and standard relaxation, its case `alpha = 0`.

use super::{Problem, Solution, Solver};
use crate::vector::Vector;

/// The paper's solver. It turns one robot's vector after the other to where `|S + V|` is least, while the others stay.
/// The perturbation `V = -alpha S_old` of the cycle's start works against local minima.
///
/// The one-robot problem is closed form: the direction in the arc nearest to `-(rest)`. The cycle
/// runs from the last robot to the first and uses the newest directions at once, as the paper's
/// printed numbers do. O(M) a cycle; no trigonometric call.
#[derive(Debug, Clone)]
pub struct Relaxation {
    name: &'static str,
    iterations: u32,
    alpha: f64,
    /// `lambda_i u_i` of each robot: reused memory, without state between steps.
    vectors: Vec<Vector>,
}

impl Relaxation {
    /// Adaptive relaxation with factor `alpha` in [0, 1].
    #[must_use]
    pub fn adaptive(iterations: u32, alpha: f64) -> Self {
        Self { name: "adaptive", iterations, alpha, vectors: Vec::new() }
    }

    /// Standard relaxation.
    #[must_use]
    pub fn standard(iterations: u32) -> Self {
        Self { name: "standard", iterations, alpha: 0.0, vectors: Vec::new() }
    }

    /// Improves `directions` in place; they must lie in their arcs.
    pub fn relax(&mut self, problem: &Problem, directions: &mut [Vector]) {
        // A single robot has a closed form and no local minimum to escape from.
        let alpha = if problem.len() == 1 { 0.0 } else { self.alpha };
        let kept = 1.0 - alpha;
        self.vectors.clear();
        self.vectors.extend(problem.arms.iter().zip(&*directions).map(|(arm, u)| *u * arm.lambda));
        // S + V now, and as the next cycle starts with it: (1 - alpha) S.
        let mut pull = self.vectors.iter().fold(problem.prior, |sum, vector| sum + *vector) * kept;
        let mut next = pull;
        for _ in 0..self.iterations {
            let mut moved = false;
            let robots = problem.arms.iter().zip(&mut self.vectors).zip(&mut *directions);
            for ((arm, vector), direction) in robots.rev() {
                let goal = *vector - pull;
                // The new direction, and what it adds to `pull` and to `next`. The three products are independent,
                // because each robot depends on the one before.
                let lengths = [1.0, arm.lambda, arm.lambda * kept];
                let [turned, after, kept_after] = match arm.end_before(goal) {
                    Some(end) if end == *direction => continue,
                    Some(end) => lengths.map(|length| end * length),
                    None => match lengths.map(|length| goal.with_length(length)) {
                        [Some(turned), Some(after), Some(kept_after)] => [turned, after, kept_after],
                        _ => continue,
                    },
                };
                moved |= turned != *direction;
                pull = after - goal;
                next = kept_after - (*vector * kept - next);
                *direction = turned;
                *vector = after;
            }
            if !moved {
                // A fixed point to the bit: every further cycle would repeat this one.
                break;
            }
            pull = next;
        }
    }
}

impl Solver for Relaxation {
    fn name(&self) -> &'static str {
        self.name
    }

    fn solve(&mut self, _tick: u64, problem: &Problem, solution: &mut Solution) {
        solution.directions.clear();
        solution.directions.extend(problem.arms.iter().map(|arm| arm.centre));
        self.relax(problem, &mut solution.directions);
        solution.complete(problem);
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
