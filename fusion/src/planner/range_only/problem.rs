//! One step's optimisation (Eqs. 14-26): from positions and covariance to a sum of plane vectors.

use nalgebra::Matrix2;
use rangehound_shared::message::Command;
use rangehound_shared::scenario::RangeNoise;

use super::arm::Arm;
use super::reach::{Limit, Reach, stand_off_m};
use crate::planner::{Situation, TeamMember};
use crate::vector::Vector;

/// Largest share of `T - |S|` that may be rounding of `|S|`. Above it, `T - |S|` itself is compared.
const ROUNDED_MAX: f64 = 1e-8;

/// Ratio of a covariance's determinant to the product of its variances below which the products cancel.
const FLAT: f64 = 1e-4;

/// Minimise `|S|`, `S = V_0 + sum_i lambda_i u_i`, each unit vector `u_i` within its arc (Eqs. 25, 26).
///
/// All vectors stand in the doubled-angle plane of the *global* frame: `u_i = exp(2j theta_i)`.
/// There `V_0 = (A_11 - A_22, 2 A_12)` for `A = P'_11^-1`, whose length is the paper's `lambda_0` and
/// whose angle is `2 theta_0`; the paper's frame differs by the rotation `-2 theta_0`, which leaves
/// `|S|` as it is. So neither an eigen-decomposition nor an angle is needed.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Problem {
    pub(super) prior: Vector,
    pub(super) information_trace: f64,
    covariance_m2: Matrix2<f64>,
    /// `1 / |P|`, and true if products of the covariance's entries cancel.
    inverse_determinant: f64,
    is_flat: bool,
    pub(super) arms: Vec<Arm>,
    pub(in crate::planner) reaches: Vec<Reach>,
    /// Corners of the cells that neighbours leave to robots, m.
    pub(in crate::planner) corners_m: Vec<Vector>,
    positions_m: Vec<Vector>,
    scratch_m: Vec<Vector>,
}

impl Problem {
    /// A problem without positions, to study the minimisation alone. Its plans have
    /// directions and no headings.
    #[must_use]
    pub fn of_arms(prior: Vector, arms: Vec<Arm>) -> Self {
        // Any information with this difference of its eigenvalues; here the lesser one is 1.
        let trace = prior.norm() + 2.0;
        let adjugate = Matrix2::new(trace - prior.x, -prior.y, -prior.y, trace + prior.x) * 0.5;
        let covariance_m2 = adjugate / (prior.norm() + 1.0);
        let information_trace = arms.iter().fold(trace, |sum, arm| sum + arm.lambda);
        let (inverse_determinant, is_flat) = (determinant(&covariance_m2).recip(), is_flat(&covariance_m2));
        Self { prior, information_trace, covariance_m2, inverse_determinant, is_flat, arms, ..Self::default() }
    }

    /// The problem of a situation.
    #[must_use]
    pub fn of(situation: &Situation) -> Self {
        let mut problem = Self::default();
        problem.pose(situation);
        problem
    }

    /// Poses the problem of a situation, reusing this value's memory.
    pub fn pose(&mut self, situation: &Situation) {
        let Situation { belief, team, clearance, step_s, .. } = situation;
        let (p, target_m) = (belief.position_covariance_m2(), belief.position_m());
        let scale = 1.0 / determinant(&p).max(f64::MIN_POSITIVE);
        // A = adj(P) / |P|.
        self.prior = Vector::new((p[(1, 1)] - p[(0, 0)]) * scale, -2.0 * p[(0, 1)] * scale);
        self.information_trace = (p[(0, 0)] + p[(1, 1)]) * scale;
        self.covariance_m2 = p;
        (self.inverse_determinant, self.is_flat) = (scale, is_flat(&p));
        self.arms.clear();
        self.reaches.clear();
        self.corners_m.clear();
        self.positions_m.clear();
        let stand_off_m = stand_off_m(clearance, p[(0, 0)] + p[(1, 1)]);
        for member in team {
            let reach = Reach::new(member, target_m, *step_s, stand_off_m);
            let arm = reach.arm(if reach.is_blind() { 0.0 } else { lambda(member) }, &[]);
            self.information_trace += arm.lambda;
            self.positions_m.push(member.position_m);
            self.reaches.push(reach);
            self.arms.push(arm);
        }
        if clearance.separation_m > 0.0 {
            self.separate(clearance.separation_m);
        }
    }

    /// Restricts each robot to its part of the space between it and its neighbours.
    fn separate(&mut self, separation_m: f64) {
        let Self { arms, reaches, corners_m, positions_m, scratch_m, .. } = self;
        let robots = positions_m.len();
        for (me, (reach, arm)) in reaches.iter_mut().zip(arms).enumerate() {
            let others = positions_m.iter().enumerate().filter(|(other, _)| *other != me);
            let limits =
                others.map(|(other, at)| Limit::between((me, positions_m[me]), (other, *at), separation_m, robots));
            reach.separate(limits, corners_m, scratch_m);
            *arm = reach.arm(arm.lambda, corners_m);
        }
    }

    /// Robots in the team.
    #[must_use]
    pub fn len(&self) -> usize {
        self.arms.len()
    }

    /// True if no robot takes part.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.arms.is_empty()
    }

    /// Doubled bearing of robot `i` after a step along this heading, and the command for it. If it would violate a
    /// clearance, the nearest bearing in the arc is taken instead.
    pub(super) fn after_heading(&self, i: usize, heading_rad: f64) -> (Vector, Command) {
        let reach = &self.reaches[i];
        let heading = Vector::from_angle(heading_rad);
        let direction = reach.direction_after(heading * reach.step_m);
        if reach.is_clear_after(heading, &self.corners_m) {
            return (direction, Command { heading_rad, speed_mps: reach.speed_mps });
        }
        let direction = self.arms[i].nearest(direction, self.arms[i].centre);
        (direction, reach.command(direction, &self.corners_m))
    }

    /// The robots' vectors.
    #[must_use]
    pub fn arms(&self) -> &[Arm] {
        &self.arms
    }

    /// `S` for these directions.
    #[must_use]
    pub fn sum(&self, directions: &[Vector]) -> Vector {
        self.arms.iter().zip(directions).fold(self.prior, |sum, (arm, u)| sum + *u * arm.lambda)
    }

    /// Sum of all lambda, the prior's `lambda_0` among them: what gaps are relative to.
    #[must_use]
    pub fn lambda_sum(&self) -> f64 {
        self.arms.iter().fold(self.prior.norm(), |sum, arm| sum + arm.lambda)
    }

    /// Each robot's direction if it stays where it is, in its arc or not.
    pub(super) fn standing(&self) -> impl Iterator<Item = Vector> {
        self.reaches.iter().map(|reach| reach.sight.doubled())
    }

    /// `tr(P+_11) = 4 T / (T^2 - |S|^2)`, `T = tr(P'_11^-1) + sum lambda_i`, m^2.
    #[must_use]
    pub fn position_trace_m2(&self, objective: f64) -> f64 {
        let t = self.information_trace;
        4.0 * t / ((t - objective) * (t + objective))
    }

    /// `T - |S|` of these directions, twice the least eigenvalue of the information.
    #[inline(never)]
    pub(super) fn uncertainty(&self, directions: &[Vector]) -> f64 {
        self.least_information(directions, self.sum(directions))
    }

    /// True if `T - |S|` of a plan with this trace (m^2) is so small that rounding of `|S|` would show in the trace.
    pub(super) fn is_lopsided_at(&self, position_trace_m2: f64) -> bool {
        // T - |S| is at least twice the inverse of the trace.
        let rounding = 4.0 * f64::EPSILON * self.len() as f64 * self.information_trace;
        rounding * position_trace_m2 > ROUNDED_MAX
    }

    /// [`Self::uncertainty`] of directions with a known sum, as a sum of positive terms: if one direction is known far
    /// better than the other, the difference itself would be nothing but rounding.
    // Inlined because every plan ends with it: it then shares the root of the sum's square with its caller.
    #[inline(always)]
    pub(super) fn least_information(&self, directions: &[Vector], sum: Vector) -> f64 {
        let along = sum.normalised().unwrap_or(Vector::new(1.0, 0.0));
        // 1 - u . s = |u - s|^2 / 2.
        let arms = self.arms.iter().zip(directions);
        arms.fold(self.prior_across(along), |least, (arm, u)| least + 0.5 * arm.lambda * (*u - along).norm_squared())
    }

    /// `tr A - V_0 . n` for a unit vector `n`: twice the prior's information across the axis of which `n` is the double.
    #[inline]
    pub(super) fn prior_across(&self, n: Vector) -> f64 {
        let p = &self.covariance_m2;
        // Across the axis e, A = adj(P) / |P| has e^T P e / |P|.
        let e = n.halved();
        if self.is_flat {
            return flat_prior_across(p, e);
        }
        let variance_m2 = e.x * e.x * p[(0, 0)] + 2.0 * e.x * e.y * p[(0, 1)] + e.y * e.y * p[(1, 1)];
        2.0 * variance_m2 * self.inverse_determinant
    }

    /// Largest eigenvalue of `P+_11`, `2 / (T - |S|)`, m^2: grows with `|S|` as the trace does, so
    /// both criteria have the same solution.
    #[must_use]
    pub fn max_eigenvalue_m2(&self, objective: f64) -> f64 {
        2.0 / (self.information_trace - objective)
    }
}

/// Information of a robot's measurement, `sigma^-2`, 1/m^2.
fn lambda(member: &TeamMember) -> f64 {
    match member.sensor.range {
        Some(RangeNoise { std_m, .. }) if member.is_fused => 1.0 / (std_m * std_m),
        _ => 0.0,
    }
}

/// `tr(P+_11) = 4 T / (T^2 - |S|^2)` from `T - |S|` and `|S|`, m^2.
#[inline]
pub(super) fn trace_m2(least: f64, length: f64) -> f64 {
    4.0 * (least + length) / (least * (least + 2.0 * length))
}

/// `|P|` of a symmetric matrix; if the products cancel, their rounding is compensated (Kahan).
fn determinant(p: &Matrix2<f64>) -> f64 {
    let square = p[(0, 1)] * p[(0, 1)];
    if is_flat(p) {
        return p[(0, 0)].mul_add(p[(1, 1)], -square) - p[(0, 1)].mul_add(p[(0, 1)], -square);
    }
    p[(0, 0)] * p[(1, 1)] - square
}

/// [`Problem::prior_across`] the axis `e` as a sum of squares: near a singular direction the products cancel.
#[cold]
fn flat_prior_across(p: &Matrix2<f64>, e: Vector) -> f64 {
    let (x, y) = if p[(0, 0)] >= p[(1, 1)] { (e.x, e.y) } else { (e.y, e.x) };
    let (larger, determinant) = (p[(0, 0)].max(p[(1, 1)]), determinant(p));
    let along = x + y * (p[(0, 1)] / larger);
    2.0 * (larger * along * along + y * y * (determinant / larger)) / determinant
}

/// True if the eigenvalues of a symmetric matrix are so unequal that products of its entries cancel.
fn is_flat(p: &Matrix2<f64>) -> bool {
    let product = p[(0, 0)] * p[(1, 1)];
    product - p[(0, 1)] * p[(0, 1)] < FLAT * product
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::belief::Belief;
    use proptest::prelude::*;

    fn inverse(m: Matrix2<f64>) -> Matrix2<f64> {
        m.try_inverse().unwrap()
    }

    proptest! {
        /// Eqs. 19-25 and both closed forms against direct inversion of Eq. 13.
        #[test]
        fn objective_gives_the_trace_and_the_largest_eigenvalue(
            a in 0.1..20.0_f64, c in 0.1..20.0_f64, correlation in -0.95..0.95_f64,
            robots in proptest::collection::vec((-30.0..30.0_f64, -30.0..30.0_f64, 0.1..3.0_f64, 0.0..6.3_f64), 1..12),
        ) {
            let b = correlation * (a * c).sqrt();
            let prior = Matrix2::new(a, b, b, c);
            let problem = Problem::of(&Situation {
                belief: Belief::of_position(Vector::new(1.0, 2.0), &prior),
                team: robots.iter().map(|&(x, y, std_m, _)| TeamMember::ranging(Vector::new(x, y), 10.0, std_m)).collect(),
                step_s: 0.1,
                ..Situation::default()
            });
            let bearings: Vec<Vector> = robots.iter().map(|&(.., theta)| Vector::from_angle(theta)).collect();
            let directions: Vec<Vector> = bearings.iter().map(|e| e.doubled()).collect();
            let mut information = inverse(prior);
            for (e, &(_, _, std, _)) in bearings.iter().zip(&robots) {
                information += Matrix2::new(e.x * e.x, e.x * e.y, e.x * e.y, e.y * e.y) / (std * std);
            }
            let posterior = inverse(information);
            let objective = problem.sum(&directions).norm();
            let trace = problem.position_trace_m2(objective);
            prop_assert!((trace_m2(problem.uncertainty(&directions), objective) / trace - 1.0).abs() < 1e-9);
            prop_assert!((trace / posterior.trace() - 1.0).abs() < 1e-8, "{trace} {}", posterior.trace());
            let largest = posterior.symmetric_eigenvalues().max();
            prop_assert!((problem.max_eigenvalue_m2(objective) / largest - 1.0).abs() < 1e-8);
        }

        /// Trace and largest eigenvalue put any two plans into the same order, so they have the same solution.
        #[test]
        fn a_plan_better_in_trace_is_better_in_the_largest_eigenvalue(
            a in 0.1..20.0_f64, c in 0.1..20.0_f64, correlation in -0.95..0.95_f64,
            plans in proptest::collection::vec((0.0..6.3_f64, 0.0..6.3_f64, 0.0..6.3_f64), 2..9),
        ) {
            let b = correlation * (a * c).sqrt();
            let prior_information = inverse(Matrix2::new(a, b, b, c));
            // Straight from Eq. 13, without the closed forms.
            let mut reached: Vec<(f64, f64)> = plans.iter().map(|&(t1, t2, t3)| {
                let information = [t1, t2, t3].iter().fold(prior_information, |sum, theta| {
                    let e = Vector::from_angle(*theta);
                    sum + Matrix2::new(e.x * e.x, e.x * e.y, e.x * e.y, e.y * e.y)
                });
                let posterior = inverse(information);
                (posterior.trace(), posterior.symmetric_eigenvalues().max())
            }).collect();
            reached.sort_by(|x, y| x.0.total_cmp(&y.0));
            for pair in reached.windows(2) {
                prop_assert!(pair[0].1 <= pair[1].1 * (1.0 + 1e-9), "{reached:?}");
            }
        }
    }
}
