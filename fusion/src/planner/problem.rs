//! One step's optimisation (Eqs. 14-26): from positions and covariance to a sum of plane vectors.

use nalgebra::Matrix2;

use super::vector::Vector;

/// A robot as the planner sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TeamMember {
    /// Where it is, m.
    pub position_m: Vector,
    /// Its speed limit, m/s.
    pub max_speed_mps: f64,
    /// Standard deviation of its range, m.
    pub range_std_m: f64,
}

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
    pub(super) arms: Vec<Arm>,
    pub(super) steps: Vec<Step>,
}

/// One robot's vector: its length `lambda = sigma^-2` and the arc that its direction may take.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arm {
    /// Length, 1/m^2.
    pub lambda: f64,
    /// Middle of the arc: the doubled bearing to the predicted target from where the robot is now.
    pub centre: Vector,
    /// Clockwise end of the arc.
    pub low: Vector,
    /// Counter-clockwise end of the arc.
    pub high: Vector,
    /// How wide the arc is.
    pub extent: Extent,
}

/// How wide an arc is: decides which test tells that a direction is inside.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Extent {
    /// At most half a turn.
    Narrow,
    /// More than half a turn.
    Wide,
    /// All directions.
    Circle,
}

/// One robot's next step in the plane: what turns a bearing into a heading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Step {
    /// From the robot to the predicted target, m.
    pub to_target_m: Vector,
    /// The same with length one; (1, 0) if the robot is on the target.
    pub sight: Vector,
    /// How far it moves, `r = v dt`, m.
    pub reach_m: f64,
    /// Its speed, m/s.
    pub speed_mps: f64,
}

impl Problem {
    /// Poses the problem for one step, reusing this value's memory.
    ///
    /// `prior_position_covariance_m2` is `P'_11` (after prediction), `target_m` the predicted target,
    /// `time_step_s` the time that robots move before they measure.
    pub fn pose(
        &mut self,
        prior_position_covariance_m2: &Matrix2<f64>,
        target_m: Vector,
        time_step_s: f64,
        team: impl IntoIterator<Item = TeamMember>,
    ) {
        let p = prior_position_covariance_m2;
        let scale = 1.0 / (p[(0, 0)] * p[(1, 1)] - p[(0, 1)] * p[(0, 1)]).max(f64::MIN_POSITIVE);
        // A = adj(P) / |P|.
        self.prior = Vector::new((p[(1, 1)] - p[(0, 0)]) * scale, -2.0 * p[(0, 1)] * scale);
        self.information_trace = (p[(0, 0)] + p[(1, 1)]) * scale;
        self.arms.clear();
        self.steps.clear();
        for member in team {
            let step = Step::new(&member, target_m, time_step_s);
            let arm = Arm::new(&member, &step);
            self.information_trace += arm.lambda;
            self.steps.push(step);
            self.arms.push(arm);
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

    /// `tr(P+_11) = 4 T / (T^2 - |S|^2)`, `T = tr(P'_11^-1) + sum lambda_i`, m^2.
    #[must_use]
    pub fn position_trace_m2(&self, objective: f64) -> f64 {
        let t = self.information_trace;
        4.0 * t / ((t - objective) * (t + objective))
    }

    /// Largest eigenvalue of `P+_11`, `2 / (T - |S|)`, m^2: grows with `|S|` as the trace does, so
    /// both criteria have the same solution.
    #[must_use]
    pub fn max_eigenvalue_m2(&self, objective: f64) -> f64 {
        2.0 / (self.information_trace - objective)
    }
}

impl Step {
    fn new(member: &TeamMember, target_m: Vector, time_step_s: f64) -> Self {
        let to_target_m = target_m - member.position_m;
        Self {
            to_target_m,
            sight: to_target_m.normalised().unwrap_or(Vector::new(1.0, 0.0)),
            reach_m: member.max_speed_mps * time_step_s,
            speed_mps: member.max_speed_mps,
        }
    }

    /// Heading (Eq. 16), as a unit vector, after which the target's predicted position bears along
    /// `direction` (a doubled bearing): of the two solutions the one that ends nearer the target.
    pub(super) fn heading(&self, direction: Vector, centre: Vector) -> Vector {
        if self.reach_m == 0.0 {
            return self.sight;
        }
        // The bearing within a quarter turn of the present one, from the doubled difference.
        let bearing = self.sight.rotated_by(direction.rotated_by(centre.conjugate()).halved());
        // To end on the line through the target, the move's part across the bearing is given: xi.
        let xi = (bearing.cross(self.to_target_m) / self.reach_m).clamp(-1.0, 1.0);
        let along = ((1.0 - xi) * (1.0 + xi)).sqrt();
        Vector::new(along, xi).rotated_by(bearing)
    }

    /// Doubled bearing to the predicted target after a move along this heading (Eqs. 7, 8).
    pub(super) fn direction_after(&self, heading: Vector) -> Vector {
        let sight_m = self.to_target_m - heading * self.reach_m;
        sight_m.normalised().unwrap_or(Vector::new(1.0, 0.0)).doubled()
    }
}

impl Arm {
    /// Constraint (18): `theta` within `asin(r / d)` of the present bearing, or free if the target is
    /// within one step.
    fn new(member: &TeamMember, step: &Step) -> Self {
        let distance_m = step.to_target_m.norm();
        // Without a line of sight now and after the step (robot at rest on the target): no range.
        let blind = distance_m == 0.0 && step.reach_m == 0.0;
        let lambda = if blind { 0.0 } else { 1.0 / (member.range_std_m * member.range_std_m) };
        let centre = step.sight.doubled();
        if distance_m > step.reach_m {
            let sin = step.reach_m / distance_m;
            let cos = ((1.0 - sin) * (1.0 + sin)).sqrt();
            Self::with_half_width(lambda, centre, Vector::new(cos, sin).doubled())
        } else {
            Self::circle(lambda, centre)
        }
    }

    /// The arc round `centre` whose half-width is the angle of the unit vector `half_width`.
    #[must_use]
    pub fn with_half_width(lambda: f64, centre: Vector, half_width: Vector) -> Self {
        let extent = if half_width.x >= 0.0 { Extent::Narrow } else { Extent::Wide };
        let low = centre.rotated_by(half_width.conjugate());
        Self { lambda, centre, low, high: centre.rotated_by(half_width), extent }
    }

    /// An arm that may point anywhere.
    #[must_use]
    pub fn circle(lambda: f64, centre: Vector) -> Self {
        Self { lambda, centre, low: -centre, high: -centre, extent: Extent::Circle }
    }

    /// True if the direction of `v` (of any length) lies in the arc.
    #[must_use]
    pub fn contains(&self, v: Vector) -> bool {
        match self.extent {
            // The scalar product tells the arc from its opposite, which an arc of no width would pass.
            Extent::Narrow => self.low.cross(v) >= 0.0 && v.cross(self.high) >= 0.0 && v.dot(self.centre) >= 0.0,
            Extent::Wide => !(self.high.cross(v) > 0.0 && v.cross(self.low) > 0.0),
            Extent::Circle => true,
        }
    }

    /// The direction in the arc nearest to that of `goal` (of any length); `held` if `goal` is zero.
    #[must_use]
    pub fn nearest(&self, goal: Vector, held: Vector) -> Vector {
        if self.contains(goal) {
            goal.normalised().unwrap_or(held)
        } else if self.centre.cross(goal) >= 0.0 {
            self.high
        } else {
            self.low
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f64::consts::PI;

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
            let mut problem = Problem::default();
            problem.pose(&prior, Vector::new(1.0, 2.0), 0.1, robots.iter().map(|&(x, y, range_std_m, _)| TeamMember {
                position_m: Vector::new(x, y), max_speed_mps: 10.0, range_std_m,
            }));
            let bearings: Vec<Vector> = robots.iter().map(|&(.., theta)| Vector::from_angle(theta)).collect();
            let directions: Vec<Vector> = bearings.iter().map(|e| e.doubled()).collect();
            let mut information = inverse(prior);
            for (e, &(_, _, std, _)) in bearings.iter().zip(&robots) {
                information += Matrix2::new(e.x * e.x, e.x * e.y, e.x * e.y, e.y * e.y) / (std * std);
            }
            let posterior = inverse(information);
            let objective = problem.sum(&directions).norm();
            let trace = problem.position_trace_m2(objective);
            prop_assert!((trace / posterior.trace() - 1.0).abs() < 1e-8, "{trace} {}", posterior.trace());
            let largest = posterior.symmetric_eigenvalues().max();
            prop_assert!((problem.max_eigenvalue_m2(objective) / largest - 1.0).abs() < 1e-8);
        }

        /// Trace and largest eigenvalue put any two plans into the same order: same solution.
        #[test]
        fn what_is_better_in_trace_is_better_in_the_largest_eigenvalue(
            a in 0.1..20.0_f64, c in 0.1..20.0_f64, correlation in -0.95..0.95_f64,
            plans in proptest::collection::vec((0.0..6.3_f64, 0.0..6.3_f64, 0.0..6.3_f64), 2..9),
        ) {
            let b = correlation * (a * c).sqrt();
            let prior_information = inverse(Matrix2::new(a, b, b, c));
            // Straight from Eq. 13, without the closed forms.
            let mut worths: Vec<(f64, f64)> = plans.iter().map(|&(t1, t2, t3)| {
                let information = [t1, t2, t3].iter().fold(prior_information, |sum, theta| {
                    let e = Vector::from_angle(*theta);
                    sum + Matrix2::new(e.x * e.x, e.x * e.y, e.x * e.y, e.y * e.y)
                });
                let posterior = inverse(information);
                (posterior.trace(), posterior.symmetric_eigenvalues().max())
            }).collect();
            worths.sort_by(|x, y| x.0.total_cmp(&y.0));
            for pair in worths.windows(2) {
                prop_assert!(pair[0].1 <= pair[1].1 * (1.0 + 1e-9), "{worths:?}");
            }
        }

        /// Eq. 16: the move ends on the line through the target along the bearing, at full speed.
        #[test]
        fn a_heading_realises_its_bearing(
            x in -30.0..30.0_f64, y in -30.0..30.0_f64, speed in 0.0..200.0_f64, fraction in -1.0..1.0_f64,
        ) {
            let member = TeamMember { position_m: Vector::new(x, y), max_speed_mps: speed, range_std_m: 1.0 };
            let step = Step::new(&member, Vector::default(), 0.1);
            let arm = Arm::new(&member, &step);
            let eta = (step.reach_m / step.to_target_m.norm()).min(1.0).asin();
            let half = if arm.extent == Extent::Circle { PI } else { 2.0 * eta };
            let direction = arm.centre.rotated_by(Vector::from_angle(fraction * half));
            let heading = step.heading(direction, arm.centre);
            prop_assert!((heading.norm() - 1.0).abs() < 1e-9);
            let after = step.direction_after(heading);
            // The bearing is ill-defined where the step ends on the target itself.
            let end_m = (step.to_target_m - heading * step.reach_m).norm();
            prop_assert!((after - direction).norm() * end_m < 1e-6, "{after:?} {direction:?}");
        }

        #[test]
        fn the_nearest_direction_is_in_the_arc_and_nearest(
            centre in -PI..PI, half in 0.0..PI, goal in -PI..PI, probe in -1.0..1.0_f64,
        ) {
            let arm = Arm::with_half_width(1.0, Vector::from_angle(centre), Vector::from_angle(half));
            let goal = Vector::from_angle(goal) * 2.5;
            let nearest = arm.nearest(goal, arm.centre);
            prop_assert!(nearest.dot(arm.centre) >= half.cos() - 1e-12);
            let other = Vector::from_angle(centre + probe * half);
            prop_assert!(nearest.dot(goal) >= other.dot(goal) - 1e-12);
        }
    }

    #[test]
    fn of_the_two_headings_the_nearer_end_is_taken() {
        let member = TeamMember { position_m: Vector::new(-3.0, 0.0), max_speed_mps: 10.0, range_std_m: 1.0 };
        let step = Step::new(&member, Vector::default(), 0.1);
        let bearing = Vector::from_angle(0.2);
        let heading = step.heading(bearing.doubled(), step.sight.doubled());
        let end_m = (step.to_target_m - heading * step.reach_m).norm();
        let xi = bearing.cross(step.to_target_m) / step.reach_m;
        let other = Vector::from_angle(0.2 + PI - xi.asin());
        let other_end = step.to_target_m - other * step.reach_m;
        assert!(bearing.cross(other_end).abs() < 1e-12, "the other solution is a solution");
        assert!(end_m < other_end.norm());
    }
}
