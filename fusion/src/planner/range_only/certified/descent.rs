//! Local descent from given directions: by single robots, by pairs, and by Newton steps of all robots.

use crate::planner::range_only::Problem;
use crate::planner::range_only::pair::best_pair;
use crate::vector::Vector;

/// A sum that is zero up to rounding, relative to the sum of all lambda.
const CLOSED: f64 = 1e-15;

/// Largest number of cycles of a descent. It usually ends earlier, when nothing moves.
const CYCLES_MAX: usize = 20;

/// Newton converges in a few steps or not at all.
const NEWTON_STEPS_MAX: usize = 12;

/// From a sum this small, relative to the sum of all lambda, a sum of zero may be in reach.
const NEARLY_CLOSED: f64 = 0.05;

/// Teams up to this size try all pairs of robots, larger ones each robot with the next.
pub(super) const ALL_PAIRS_MAX: usize = 8;

/// Turns one robot after the other, and then pairs of them, to their closed-form optimum until
/// nothing moves; returns `|S|`, which never grows.
pub(super) fn descend(problem: &Problem, directions: &mut [Vector], trial: &mut Vec<Vector>) -> f64 {
    let mut value = problem.sum(directions).norm();
    for _ in 0..CYCLES_MAX {
        let before = value;
        let mut sum = problem.sum(directions);
        for (arm, direction) in problem.arms.iter().zip(directions.iter_mut()) {
            let rest = sum - *direction * arm.lambda;
            *direction = arm.nearest(-rest, *direction);
            sum = rest + *direction * arm.lambda;
        }
        value = problem.sum(directions).norm();
        if value >= before * (1.0 - 1e-3) {
            value = turn_pairs(problem, directions, None);
            if value >= before * (1.0 - 1e-9) {
                break;
            }
        }
    }
    let total = problem.lambda_sum();
    if value > CLOSED * total && value < NEARLY_CLOSED * total {
        return close(problem, directions, trial, value);
    }
    value
}

/// Turns one robot after the other as [`descend`] does, but adds up the others' vectors each time: in a difference from
/// the sum, robots with little information would be lost to rounding. Returns `|S| - T`.
pub(super) fn settle(problem: &Problem, directions: &mut [Vector]) -> f64 {
    let mut value = -problem.uncertainty(directions);
    for _ in 0..CYCLES_MAX {
        let before = value;
        for i in 0..directions.len() {
            let others = problem.arms.iter().zip(&*directions).enumerate().filter(|(other, _)| *other != i);
            let rest = others.fold(problem.prior, |sum, (_, (arm, u))| sum + *u * arm.lambda);
            directions[i] = problem.arms[i].nearest(-rest, directions[i]);
        }
        value = -problem.uncertainty(directions);
        if value >= before * (1.0 + 1e-12) {
            break;
        }
    }
    value
}

/// Tries to reach a sum of zero by Newton's method on all directions at once, with the shortest such step: turning one
/// or two robots at a time converges slowly if many are nearly aligned. Returns `|S|`; `directions` change only if it
/// becomes less.
fn close(problem: &Problem, directions: &mut [Vector], trial: &mut Vec<Vector>, value: f64) -> f64 {
    trial.clear();
    trial.extend_from_slice(directions);
    let mut best = value;
    for _ in 0..NEWTON_STEPS_MAX {
        let sum = problem.sum(trial);
        // The sum moves by `J delta`, whose columns are `lambda_i j u_i`; here J J^T, which is 2 x 2.
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for (arm, u) in problem.arms.iter().zip(trial.iter()) {
            let (x, y) = (-u.y * arm.lambda, u.x * arm.lambda);
            (xx, xy, yy) = (xx + x * x, xy + x * y, yy + y * y);
        }
        let determinant = xx * yy - xy * xy;
        if determinant <= 0.0 {
            break;
        }
        let w = Vector::new(xy * sum.y - yy * sum.x, xy * sum.x - xx * sum.y) * determinant.recip();
        for (arm, u) in problem.arms.iter().zip(trial.iter_mut()) {
            let turn = arm.lambda * u.cross(w);
            let turned = *u + Vector::new(-u.y, u.x) * turn.clamp(-1.0, 1.0);
            *u = arm.nearest(turned, *u);
        }
        let value = problem.sum(trial).norm();
        if value < best {
            best = value;
            directions.copy_from_slice(trial);
        }
        if best <= CLOSED * problem.lambda_sum() {
            break;
        }
    }
    best
}

/// Turns pairs of robots if that reduces `|S|`, but not the robot `held`; returns `|S|`.
pub(super) fn turn_pairs(problem: &Problem, directions: &mut [Vector], held: Option<usize>) -> f64 {
    let robots = problem.len();
    let mut sum = problem.sum(directions);
    for i in 0..robots {
        let last = if robots <= ALL_PAIRS_MAX { robots } else { (i + 2).min(robots) };
        for j in i + 1..last {
            if held == Some(i) || held == Some(j) {
                continue;
            }
            let (first, second) = (&problem.arms[i], &problem.arms[j]);
            let rest = sum - directions[i] * first.lambda - directions[j] * second.lambda;
            let [u1, u2] = best_pair(rest, first, second);
            let turned = rest + u1 * first.lambda + u2 * second.lambda;
            if turned.norm_squared() < sum.norm_squared() {
                sum = turned;
                [directions[i], directions[j]] = [u1, u2];
            }
        }
    }
    problem.sum(directions).norm()
}
