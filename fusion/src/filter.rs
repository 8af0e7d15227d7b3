//! The extended Kalman filter (Eqs. 1-13) for a linear target model and measurements of range and bearing.
//!
//! Both inform the position alone, so an update needs only 2 x 2 sums over the measurements
//! ([`Information`]) and a regression of the other states on the position. Its cost is O(M) for
//! M measurements; there is no M x M matrix and no heap allocation.

use std::f64::consts::PI;

use nalgebra::{Matrix2, SMatrix, SVector, Vector2};
use rangehound_shared::angle::wrapped_rad;
use rangehound_shared::motion::Transition;
use serde::{Deserialize, Serialize};

/// Below this distance from the estimate, m, a range has no line of sight and carries no information.
const LINE_OF_SIGHT_MIN_M: f64 = 1e-9;

/// Variance of a direction that is not known at all, rad^2.
const UNKNOWN_DIRECTION_RAD2: f64 = PI * PI / 3.0;

/// Largest second-order mean of a bearing, rad: beyond it the target is about on the robot, and the bearing tells nothing.
const MEAN_BEND_MAX_RAD: f64 = 0.5;

/// Relative inflation of the variances in each step. It exceeds the rounding that could make a covariance indefinite if
/// directions are known to very different degrees, and has no other effect.
const ROUNDING: f64 = 1e-12;

/// Rounding of a difference relative to its operands: about a hundred units in the last place.
const DIFFERENCE_ROUNDING: f64 = 3e-14;

/// Gaussian estimate of the target: `X` (position first) and its error covariance `P`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Gaussian<const N: usize> {
    /// State `X = [x y | vx vy | ...]`, m, m/s, ...
    pub x: SVector<f64, N>,
    /// Covariance of its error, symmetric to the bit.
    pub p: SMatrix<f64, N, N>,
}

/// Information of a set of measurements about the target's position, linearised about one estimate.
///
/// With `h_i` the gradient of measurement i and `nu_i` its innovation: `J = sum h_i h_i^T / sigma_i^2` (the sum of Eq. 13,
/// where `h_i` is the line of sight from robot i to the estimate), `y = sum h_i nu_i / sigma_i^2`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Information {
    /// `J`.
    pub matrix: Matrix2<f64>,
    /// `y`.
    pub vector: Vector2<f64>,
    /// Measurements in the sums.
    pub count: u32,
}

/// A range or a bearing compared with the estimate's prediction of it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Innovation {
    /// Gradient of the predicted value with the target's position, a row of `H`. For a range it is the unit vector from the
    /// robot to the estimated target; for a sensor at another height the horizontal part of that vector, which is zero
    /// straight above the target. For a bearing it is the normal of that unit vector over the distance, 1/m. Zero without a
    /// line of sight.
    pub gradient: Vector2<f64>,
    /// `nu = z - h(X)`, m or rad; that of a bearing is within `(-pi, pi]`.
    pub innovation: f64,
    /// Measurement variance `sigma^2`, m^2 or rad^2.
    pub noise_variance: f64,
}

impl<const N: usize> Gaussian<N> {
    /// Target position, m.
    #[must_use]
    pub fn position(&self) -> Vector2<f64> {
        Vector2::new(self.x[0], self.x[1])
    }

    /// Covariance of the position, `P_11`, m^2.
    #[must_use]
    pub fn position_covariance(&self) -> Matrix2<f64> {
        Matrix2::new(self.p[(0, 0)], self.p[(0, 1)], self.p[(1, 0)], self.p[(1, 1)])
    }

    /// `X' = Phi X`, `P' = Phi P Phi^T + G Qd G^T` (Eq. 2 and the one after it).
    #[must_use]
    pub fn predict(&self, transition: &Transition<N>) -> Self {
        let p = transition.phi * self.p * transition.phi.transpose() + transition.process_noise;
        Self { x: transition.phi * self.x, p: conditioned(&p) }
    }

    /// The innovation of a range `z` measured at `robot` with standard deviation `std_m` (Eqs. 3-8).
    #[must_use]
    pub fn innovation(&self, robot: Vector2<f64>, range_m: f64, std_m: f64) -> Innovation {
        self.slant_innovation(robot, 0.0, range_m, std_m)
    }

    /// The innovation of a range measured by a sensor `height_m` above (or below) the plane in which the target moves:
    /// the predicted distance is the slant one, `d = sqrt(dx^2 + dy^2 + h^2)`, and its gradient `(dx, dy) / d`.
    #[must_use]
    pub fn slant_innovation(&self, sensor: Vector2<f64>, height_m: f64, range_m: f64, std_m: f64) -> Innovation {
        let sight = self.position() - sensor;
        let distance_m = (sight.norm_squared() + height_m * height_m).sqrt();
        let gradient = if distance_m > LINE_OF_SIGHT_MIN_M { sight / distance_m } else { Vector2::zeros() };
        Innovation { gradient, innovation: range_m - distance_m, noise_variance: std_m * std_m }
    }

    /// The innovation of a bearing measured at `sensor`, counter-clockwise from the x axis, with standard deviation
    /// `std_rad`.
    ///
    /// The direction to a near target is far from linear in its position. With the covariance `P` of the sight, its
    /// components along (a) and across (c) the line of sight, and `d = |sight|`, the second-order terms are: mean
    /// `-P_ac / d^2` and variance `(P_aa P_cc + P_ac^2) / d^4`. They let a bearing of a target on the robot tell nothing.
    #[must_use]
    pub fn bearing_innovation(
        &self,
        sensor: Vector2<f64>,
        sight_covariance: &Matrix2<f64>,
        (bearing_rad, std_rad): (f64, f64),
    ) -> Innovation {
        let sight = self.position() - sensor;
        let square_m2 = sight.norm_squared();
        if square_m2 < LINE_OF_SIGHT_MIN_M * LINE_OF_SIGHT_MIN_M {
            let noise_variance = std_rad * std_rad + UNKNOWN_DIRECTION_RAD2;
            return Innovation { noise_variance, ..Innovation::default() };
        }
        let across = Vector2::new(-sight.y, sight.x);
        let (p_sight, p_across) = (sight_covariance * sight, sight_covariance * across);
        // Each of these is a component of P times d^2.
        let [along_along, across_across, along_across] =
            [sight.dot(&p_sight), across.dot(&p_across), sight.dot(&p_across)];
        let fourth = square_m2 * square_m2;
        let mean_rad = (along_across / fourth).clamp(-MEAN_BEND_MAX_RAD, MEAN_BEND_MAX_RAD);
        let bend_rad2 = (along_along * across_across + along_across * along_across) / (fourth * fourth);
        Innovation {
            gradient: across / square_m2,
            innovation: wrapped_rad(bearing_rad - sight.y.atan2(sight.x) + mean_rad),
            noise_variance: std_rad * std_rad + bend_rad2,
        }
    }

    /// The second-order terms of a distance of `distance_m` with this gradient. Its second derivative is
    /// `(I - e e^T) / d` at any height, so the terms are: mean `tr((I - e e^T) P) / 2 d` and variance
    /// `tr(((I - e e^T) P)^2) / 2 d^2`.
    ///
    /// `P` is the covariance of the sight: that of the estimate, and of the sensor's own position.
    #[must_use]
    pub fn second_order(sight_covariance: &Matrix2<f64>, gradient: &Vector2<f64>, distance_m: f64) -> SecondOrder {
        let (p, e) = (sight_covariance, gradient);
        let along_m2 = e.dot(&(p * e));
        let across_m2 = (p.trace() - along_m2).max(0.0);
        // A distance changes by no more than the position does.
        let mean_m = (across_m2 / (2.0 * distance_m)).min(across_m2.sqrt());
        let square = (p.norm_squared() - 2.0 * (p * e).norm_squared() + along_m2 * along_m2).max(0.0);
        let variance_m2 = (0.5 * square / (distance_m * distance_m)).min(2.0 * mean_m * mean_m);
        SecondOrder { mean_m, variance_m2 }
    }

    /// Joint update with all measurements of `information`, which must be linearised about this estimate (Eqs. 9-13).
    ///
    /// The position's posterior covariance is `(P_11^-1 + J)^-1`, written for 2 x 2 matrices without an
    /// inverse as `(P_11 + |P_11| adj J) / (1 + tr(P_11 J) + |P_11| |J|)`: a sum of positive terms, so
    /// it stays positive definite however precise the measurements are. The other states follow by their
    /// regression `B = P_21 P_11^-1` on the position; their conditional covariance does not change.
    #[must_use]
    pub fn update(&self, information: &Information) -> Self {
        let prior = self.position_covariance();
        let prior_det = determinant(&prior);
        let posterior = posterior_covariance(&prior, prior_det, &information.matrix);
        let shift = posterior * information.vector;

        // Columns of P belonging to the position, and the regression on it: B = A P_11^-1.
        let a = self.p.fixed_columns::<2>(0).into_owned();
        let prior_adjugate = Matrix2::new(prior[(1, 1)], -prior[(0, 1)], -prior[(1, 0)], prior[(0, 0)]);
        let b = a * prior_adjugate / prior_det;
        let mut p = self.p + b * (posterior - prior) * b.transpose();
        let cross = b * posterior;
        set_position(&mut p, &posterior, &cross, &self.p);
        let mut x = self.x + b * shift;
        x[0] = self.x[0] + shift[0];
        x[1] = self.x[1] + shift[1];
        Self { x, p: conditioned(&p) }
    }

    /// Joint normalised innovation squared of measurements linearised about this estimate: `nu^T S^-1 nu`, chi-square with
    /// one degree of freedom for each measurement.
    ///
    /// It is the residual of the least squares of prior and measurements:
    /// `min_s s^T P_11^-1 s + sum (nu_i - h_i . s)^2 / sigma_i^2`. Rotations add the measurements to the square root of the
    /// prior's information one by one, and the squares of the residuals are summed. All terms are positive, so nothing
    /// cancels, however vague the prior and however precise the measurements are.
    #[must_use]
    pub fn nis<'a>(&self, measured: impl Iterator<Item = &'a Innovation>) -> f64 {
        let prior = self.position_covariance();
        // P^-1 = R^T R, where the coordinate with the smaller variance comes first.
        let larger = usize::from(prior[(1, 1)] > prior[(0, 0)]);
        let lesser = 1 - larger;
        let rest_m2 = (determinant(&prior) / prior[(larger, larger)]).max(f64::EPSILON * prior[(lesser, lesser)]);
        let mut first = [rest_m2.sqrt().recip(), -prior[(0, 1)] / prior[(larger, larger)] / rest_m2.sqrt(), 0.0];
        let mut second = [prior[(larger, larger)].sqrt().recip(), 0.0];
        measured.fold(0.0, |nis, one| {
            let weight = one.noise_variance.sqrt().recip();
            let e = one.gradient;
            let row = [e[lesser], e[larger], one.innovation].map(|value| value * weight);
            let (cos, sin) = rotation(first[0], row[0]);
            let [across, value] = [1, 2].map(|i| cos * row[i] - sin * first[i]);
            first = std::array::from_fn(|i| cos * first[i] + sin * row[i]);
            let (cos, sin) = rotation(second[0], across);
            let left = cos * value - sin * second[1];
            second = [cos * second[0] + sin * across, cos * second[1] + sin * value];
            nis + left * left
        })
    }
}

/// Cosine and sine of the rotation of `(kept, taken)` to `(length, 0)`.
fn rotation(kept: f64, taken: f64) -> (f64, f64) {
    let length = kept.hypot(taken);
    if length > 0.0 { (kept / length, taken / length) } else { (1.0, 0.0) }
}

/// `(P^-1 + J)^-1` without an inverse, as a sum of positive terms.
pub(crate) fn posterior_covariance(prior: &Matrix2<f64>, prior_det: f64, j: &Matrix2<f64>) -> Matrix2<f64> {
    let j_adjugate = Matrix2::new(j[(1, 1)], -j[(0, 1)], -j[(1, 0)], j[(0, 0)]);
    let trace_pj = prior[(0, 0)] * j[(0, 0)] + 2.0 * prior[(0, 1)] * j[(0, 1)] + prior[(1, 1)] * j[(1, 1)];
    let gain = 1.0 / (1.0 + trace_pj.max(0.0) + prior_det * determinant(j));
    (prior + j_adjugate * prior_det) * gain
}

/// Second-order terms of a distance, which is not linear in the position: bias and variance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SecondOrder {
    /// Mean distance less the distance at the estimate, m.
    pub mean_m: f64,
    /// Variance beyond the linear one, m^2.
    pub variance_m2: f64,
}

impl Innovation {
    /// Variance of the innovation, `S = h^T P_11 h + sigma^2`, m^2 or rad^2.
    #[must_use]
    pub fn variance(&self, position_covariance: &Matrix2<f64>) -> f64 {
        self.gradient.dot(&(position_covariance * self.gradient)) + self.noise_variance
    }

    /// `nu^2 / S` for this measurement alone: chi-square with one degree of freedom.
    #[must_use]
    pub fn normalised_square(&self, position_covariance: &Matrix2<f64>) -> f64 {
        self.innovation * self.innovation / self.variance(position_covariance)
    }
}

impl Information {
    /// Adds one measurement.
    pub fn add(&mut self, measured: &Innovation) {
        let weight = 1.0 / measured.noise_variance;
        let weighted = measured.gradient * weight;
        self.matrix += weighted * measured.gradient.transpose();
        self.vector += weighted * measured.innovation;
        self.count += 1;
    }
}

/// Determinant of a positive semi-definite matrix: never below zero, whatever the rounding.
pub(crate) fn determinant(m: &Matrix2<f64>) -> f64 {
    (m[(0, 0)] * m[(1, 1)] - m[(0, 1)] * m[(1, 0)]).max(0.0)
}

/// Completes a posterior covariance, of which only the part beyond the position is right: sets the position's own and its
/// covariance with the other states, and allows for the rounding of the difference from the prior.
pub(crate) fn set_position<const N: usize>(
    p: &mut SMatrix<f64, N, N>,
    position: &Matrix2<f64>,
    with_position: &SMatrix<f64, N, 2>,
    prior: &SMatrix<f64, N, N>,
) {
    for i in 0..N {
        for k in 0..2 {
            let value = if i < 2 { position[(i, k)] } else { with_position[(i, k)] };
            p[(i, k)] = value;
            p[(k, i)] = value;
        }
    }
    for i in 0..N {
        // A difference is uncertain by the rounding of its operands.
        p[(i, i)] += DIFFERENCE_ROUNDING * prior[(i, i)];
    }
}

/// The matrix made symmetric to the bit, with variances inflated against rounding.
pub(crate) fn conditioned<const N: usize>(m: &SMatrix<f64, N, N>) -> SMatrix<f64, N, N> {
    let mut conditioned = (m + m.transpose()) * 0.5;
    for i in 0..N {
        conditioned[(i, i)] *= 1.0 + ROUNDING;
    }
    conditioned
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;
    use proptest::prelude::*;
    use rangehound_shared::motion::MotionModel;

    fn innovations<const N: usize>(at: &Gaussian<N>, ranges: &[(f64, f64, f64, f64)]) -> Vec<Innovation> {
        ranges.iter().map(|&(x, y, range_m, std_m)| at.innovation(Vector2::new(x, y), range_m, std_m)).collect()
    }

    fn information<const N: usize>(at: &Gaussian<N>, ranges: &[(f64, f64, f64, f64)]) -> Information {
        let mut information = Information::default();
        innovations(at, ranges).iter().for_each(|range| information.add(range));
        information
    }

    /// Positive definite: it has a Cholesky factor.
    fn is_spd<const N: usize>(p: &SMatrix<f64, N, N>) -> bool {
        *p == p.transpose() && DMatrix::from_fn(N, N, |i, j| p[(i, j)]).cholesky().is_some()
    }

    /// One prediction and joint update, against 50-digit arithmetic.
    #[test]
    fn a_step_matches_high_precision_arithmetic() {
        let start = Gaussian { x: SVector::from([0.5, -0.25, 8.0, -8.0]), p: SMatrix::<f64, 4, 4>::identity() * 10.0 };
        let model = MotionModel::IntegratorChain { order: 2, noise_psd: 10.0 };
        let predicted = start.predict(&model.transition(0.1));
        let ranges = [(-5.0, 0.0, 6.4, 1.0), (0.0, 4.0, 5.2, 1.0), (7.0, -3.0, 6.3, 1.0)];
        let updated = predicted.update(&information(&predicted, &ranges));
        let x = [1.1810777495805928, -1.0355879379168275, 7.987640874667729, -7.998502210638008];
        let p = [
            (0, 0, 0.625724634630599),
            (0, 1, 0.380078908058847),
            (1, 1, 1.086572229956757),
            (0, 2, 0.065029119072464),
        ];
        assert!((updated.x - SVector::from(x)).amax() < 1e-11);
        for (i, j, value) in p {
            assert!((updated.p[(i, j)] - value).abs() < 1e-11, "P[{i},{j}] = {}", updated.p[(i, j)]);
        }
    }

    /// A vague prior and precise ranges, against 80-digit arithmetic. The terms of `sum nu^2 / sigma^2 - y . shift` are
    /// 1e13 to 1e18 here, so none of its digits would be right.
    #[test]
    fn the_nis_of_a_vague_prior_matches_high_precision_arithmetic() {
        let far = [(-5.0, 0.0, 1_000_006.324, 1e-3), (0.0, 4.0, 500_002.0, 1e-3)];
        let near = [(-5.0, 0.0, 6.324, 1e-3), (0.0, 4.0, 2.237, 1e-3), (7.0, -3.0, 7.81, 1e-3)];
        let cases = [
            (0.0, &near[..], 0.055_884_205_656_080_34),
            (5e11, &far[..], 1.547_117_859_222_204),
            (5e11, &far[..1], 0.769_230_768_376_430_3),
        ];
        for (correlated, ranges, expected) in cases {
            let p = SMatrix::from([[1e12, correlated], [correlated, 1e12]]);
            let prior = Gaussian { x: SVector::from([1.0, 2.0]), p };
            let nis = prior.nis(innovations(&prior, ranges).iter());
            assert!((nis / expected - 1.0).abs() < 1e-6, "{nis} {expected}");
        }
    }

    proptest! {
        /// A slant range: gradient and second-order terms against differences of the distance.
        #[test]
        fn the_slant_range_and_its_terms_equal_finite_differences(
            at in (-20.0..20.0_f64, -20.0..20.0_f64), sensor in (-20.0..20.0_f64, -20.0..20.0_f64), height_m in -9.0..9.0_f64,
            seed in proptest::collection::vec(-1.0..1.0_f64, 4),
        ) {
            prop_assume!(height_m.abs() > 0.5);
            let sensor = Vector2::new(sensor.0, sensor.1);
            let slant = |x: f64, y: f64| Vector2::new(x, y).metric_distance(&sensor).hypot(height_m);
            let root = SMatrix::<f64, 2, 2>::from_iterator(seed);
            let estimate = Gaussian { x: SVector::from([at.0, at.1]), p: (root * root.transpose() + SMatrix::identity() * 0.1) * 0.1 };
            let range = estimate.slant_innovation(sensor, height_m, 1.0, 1.0);
            let d = slant(at.0, at.1);
            prop_assert!((range.innovation - (1.0 - d)).abs() < 1e-12);
            let step = 1e-4;
            let gradient = Vector2::new(
                slant(at.0 + step, at.1) - slant(at.0 - step, at.1), slant(at.0, at.1 + step) - slant(at.0, at.1 - step),
            ) / (2.0 * step);
            prop_assert!((range.gradient - gradient).norm() < 1e-7);
            let second = |i: usize, j: usize| {
                let [a, b] = [i, j].map(|axis| Vector2::ith(axis, step));
                let at = |v: Vector2<f64>| slant(at.0 + v.x, at.1 + v.y);
                (at(a + b) - at(a - b) - at(b - a) + at(-a - b)) / (4.0 * step * step)
            };
            let hp = Matrix2::new(second(0, 0), second(0, 1), second(1, 0), second(1, 1)) * estimate.p;
            let bend = Gaussian::<2>::second_order(&estimate.p, &range.gradient, d);
            let mean_m = (0.5 * hp.trace()).min(estimate.p.trace().sqrt());
            prop_assert!((bend.mean_m - mean_m).abs() < 1e-5 * (1.0 + mean_m), "{} {mean_m}", bend.mean_m);
            let variance_m2 = 0.5 * (hp * hp).trace();
            prop_assert!((bend.variance_m2 - variance_m2).abs() < 1e-5 * (1.0 + variance_m2), "{} {variance_m2}", bend.variance_m2);
        }

        /// The O(M) forms against the textbook's M x M ones.
        #[test]
        fn update_and_nis_equal_the_textbook_kalman_gain(
            seed in proptest::collection::vec(-1.0..1.0_f64, 16),
            ranges in proptest::collection::vec((-20.0..20.0_f64, -20.0..20.0_f64, 0.0..30.0_f64, 0.2..3.0_f64), 1..9),
        ) {
            let root = SMatrix::<f64, 4, 4>::from_iterator(seed);
            let prior = Gaussian { x: SVector::from([1.0, 2.0, 3.0, 4.0]), p: root * root.transpose() + SMatrix::identity() * 0.1 };
            let posterior = prior.update(&information(&prior, &ranges));
            let nis = prior.nis(innovations(&prior, &ranges).iter());
            let m = ranges.len();
            let mut h = DMatrix::zeros(m, 4);
            let mut nu = DMatrix::zeros(m, 1);
            let mut r = DMatrix::zeros(m, m);
            for (i, &(x, y, range_m, std_m)) in ranges.iter().enumerate() {
                let sight = prior.position() - Vector2::new(x, y);
                h[(i, 0)] = sight.x / sight.norm();
                h[(i, 1)] = sight.y / sight.norm();
                nu[(i, 0)] = range_m - sight.norm();
                r[(i, i)] = std_m * std_m;
            }
            let p = DMatrix::from_fn(4, 4, |i, j| prior.p[(i, j)]);
            let s_inverse = (&h * &p * h.transpose() + r).try_inverse().unwrap();
            let gain = &p * h.transpose() * &s_inverse;
            let x = DMatrix::from_fn(4, 1, |i, _| prior.x[i]) + &gain * &nu;
            let p_after = (DMatrix::identity(4, 4) - &gain * h) * &p;
            let textbook_nis = (nu.transpose() * s_inverse * nu)[(0, 0)];
            for i in 0..4 {
                prop_assert!((posterior.x[i] - x[(i, 0)]).abs() < 1e-9);
                for j in 0..4 {
                    prop_assert!((posterior.p[(i, j)] - p_after[(i, j)]).abs() < 1e-9);
                }
            }
            prop_assert!((nis - textbook_nis).abs() < 1e-8 * (1.0 + textbook_nis), "{nis} {textbook_nis}");
        }

        /// Precise and useless sensors, near and far. The information of a range is at most eleven digits greater than
        /// that of the prior; floating point has sixteen.
        #[test]
        fn the_covariance_stays_positive_definite_in_extremes(
            log_variance in -6.0..10.0_f64, log_std in -4.0..4.0_f64, robots in 1..200_usize, spread in -9.0..3.0_f64,
        ) {
            let log_std = log_std.max(0.5 * (log_variance - 11.0));
            let p = SMatrix::<f64, 6, 6>::identity() * 10.0_f64.powf(log_variance);
            let mut estimate = Gaussian { x: SVector::zeros(), p };
            let model = MotionModel::IntegratorChain { order: 3, noise_psd: 0.1 };
            for step in 0..20 {
                estimate = estimate.predict(&model.transition(0.1));
                let ranges: Vec<_> = (0..robots)
                    .map(|i| {
                        let (sin, cos) = (i as f64 * 0.7 + f64::from(step)).sin_cos();
                        let distance_m = 10.0_f64.powf(spread);
                        (estimate.x[0] + cos * distance_m, estimate.x[1] + sin * distance_m, distance_m, 10.0_f64.powf(log_std))
                    })
                    .collect();
                estimate = estimate.update(&information(&estimate, &ranges));
                prop_assert!(is_spd(&estimate.p), "step {step}: {}", estimate.p);
            }
        }
    }

    #[test]
    fn a_million_steps_keep_it_symmetric_and_positive_definite() {
        let transition = MotionModel::IntegratorChain { order: 2, noise_psd: 10.0 }.transition::<4>(0.1);
        let mut estimate = Gaussian { x: SVector::zeros(), p: SMatrix::<f64, 4, 4>::identity() * 10.0 };
        for step in 0..1_000_000_u32 {
            estimate = estimate.predict(&transition);
            let (sin, cos) = (f64::from(step) * 0.01).sin_cos();
            let on_top = (estimate.x[0], estimate.x[1], 0.3, 1.0);
            let ranges = [(10.0 * cos, 10.0 * sin, 10.0, 1.0), on_top, (5.0, 0.0, 6.0, 0.5)];
            estimate = estimate.update(&information(&estimate, &ranges));
            if step % 1_000 == 0 {
                assert!(is_spd(&estimate.p), "step {step}");
            }
        }
        assert!(is_spd(&estimate.p) && estimate.x.iter().all(|value| value.is_finite()));
    }

    /// Robots at one position measure one direction very precisely and the other not at all.
    #[test]
    fn the_covariance_stays_positive_definite_if_one_direction_is_known_far_better() {
        let transition = MotionModel::IntegratorChain { order: 2, noise_psd: 0.0 }.transition::<4>(0.1);
        let mut estimate =
            Gaussian { x: SVector::from([0.0, 3.0, -8.0, 4.0]), p: SMatrix::<f64, 4, 4>::identity() * 1e12 };
        for step in 0..500 {
            estimate = estimate.predict(&transition);
            let range_m = estimate.position().norm() + 1e-5;
            estimate = estimate.update(&information(&estimate, &[(0.0, 0.0, range_m, 1e-4); 10]));
            assert!(is_spd(&estimate.p), "step {step}: {}", estimate.p);
        }
    }

    #[test]
    fn a_robot_at_the_estimated_position_adds_no_information() {
        let prior = Gaussian { x: SVector::from([3.0, 4.0]), p: SMatrix::<f64, 2, 2>::identity() };
        let posterior = prior.update(&information(&prior, &[(3.0, 4.0, 2.0, 1.0)]));
        assert_eq!(posterior.x, prior.x);
        assert!((posterior.p - prior.p).amax() < 1e-11);
    }
}
