//! The extended Kalman filter (Eqs. 1-13) for a linear target model and range measurements.
//!
//! Ranges inform the position alone, so an update needs only 2 x 2 sums over the robots
//! ([`RangeInformation`]) and a regression of the other states on the position. Its cost is O(M) for
//! M ranges; there is no M x M matrix and no heap allocation.

use nalgebra::{Matrix2, SMatrix, SVector, Vector2};
use rangehound_shared::motion::Transition;
use serde::{Deserialize, Serialize};

/// Below this distance from the estimate, m, a range has no line of sight and informs of nothing.
const LINE_OF_SIGHT_MIN_M: f64 = 1e-9;

/// Relative inflation of the variances in each step: above the rounding that could make a covariance
/// indefinite where directions are known to very different degrees, and of no other effect.
const ROUNDING: f64 = 1e-12;

/// Rounding of a difference relative to what it was taken from: some hundred units in the last place.
const DIFFERENCE_ROUNDING: f64 = 3e-14;

/// Estimate of the target: `X` (position first) and its error covariance `P`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Estimate<const N: usize> {
    /// State `X = [x y | vx vy | ...]`, m, m/s, ...
    pub x: SVector<f64, N>,
    /// Covariance of its error, symmetric to the bit.
    pub p: SMatrix<f64, N, N>,
}

/// What a set of ranges says of the target's position, linearised about one estimate.
///
/// With `e_i` the unit vector from robot i to the estimate and `nu_i = z_i - d_i` the innovation:
/// `J = sum e_i e_i^T / sigma_i^2` (the sum of Eq. 13), `y = sum e_i nu_i / sigma_i^2`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RangeInformation {
    /// `J`.
    pub matrix: Matrix2<f64>,
    /// `y`.
    pub vector: Vector2<f64>,
    /// `sum nu_i^2 / sigma_i^2`.
    pub weighted_square: f64,
    /// Ranges in the sums.
    pub count: u32,
}

/// A range against what the estimate predicts of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Innovation {
    /// Unit vector from the robot to the estimated target, a row of `H`; zero without a line of sight.
    pub line_of_sight: Vector2<f64>,
    /// `nu = z - d`, m.
    pub innovation_m: f64,
    /// Measurement variance `sigma^2`, m^2.
    pub noise_variance_m2: f64,
}

impl<const N: usize> Estimate<N> {
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
        let sight = self.position() - robot;
        let distance_m = sight.norm();
        let line_of_sight = if distance_m > LINE_OF_SIGHT_MIN_M { sight / distance_m } else { Vector2::zeros() };
        Innovation { line_of_sight, innovation_m: range_m - distance_m, noise_variance_m2: std_m * std_m }
    }

    /// Joint update with all ranges of `information`, which must be linearised about this estimate
    /// (Eqs. 9-13). Returns the posterior and the normalised innovation squared (NIS).
    ///
    /// The position's posterior covariance is `(P_11^-1 + J)^-1`, written for 2 x 2 matrices without an
    /// inverse as `(P_11 + |P_11| adj J) / (1 + tr(P_11 J) + |P_11| |J|)`: a sum of positive terms, so
    /// it stays positive definite however much the ranges say. The other states follow by their
    /// regression `B = P_21 P_11^-1` on the position; their conditional covariance does not change.
    /// `NIS = nu^T S^-1 nu = sum nu_i^2 / sigma_i^2 - y^T P+_11 y`, chi-square with one degree of
    /// freedom for each range.
    #[must_use]
    pub fn update(&self, information: &RangeInformation) -> (Self, f64) {
        let RangeInformation { matrix: j, vector: y, weighted_square, .. } = information;
        let prior = self.position_covariance();
        let prior_det = determinant(&prior);
        let j_adjugate = Matrix2::new(j[(1, 1)], -j[(0, 1)], -j[(1, 0)], j[(0, 0)]);
        let trace_pj = prior[(0, 0)] * j[(0, 0)] + 2.0 * prior[(0, 1)] * j[(0, 1)] + prior[(1, 1)] * j[(1, 1)];
        let gain = 1.0 / (1.0 + trace_pj.max(0.0) + prior_det * determinant(j));
        let posterior = (prior + j_adjugate * prior_det) * gain;

        let shift = posterior * y;
        let nis = (weighted_square - y.dot(&shift)).max(0.0);

        // Columns of P belonging to the position, and the regression on it: B = A P_11^-1.
        let a = self.p.fixed_columns::<2>(0).into_owned();
        let prior_adjugate = Matrix2::new(prior[(1, 1)], -prior[(0, 1)], -prior[(1, 0)], prior[(0, 0)]);
        let b = a * prior_adjugate / prior_det;
        let mut p = self.p + b * (posterior - prior) * b.transpose();
        let cross = b * posterior;
        for i in 0..N {
            for k in 0..2 {
                let value = if i < 2 { posterior[(i, k)] } else { cross[(i, k)] };
                p[(i, k)] = value;
                p[(k, i)] = value;
            }
        }
        for i in 0..N {
            // What is left of a difference is uncertain by the rounding of what it was taken from.
            p[(i, i)] += DIFFERENCE_ROUNDING * self.p[(i, i)];
        }
        let mut x = self.x + b * shift;
        x[0] = self.x[0] + shift[0];
        x[1] = self.x[1] + shift[1];
        (Self { x, p: conditioned(&p) }, nis)
    }
}

impl Innovation {
    /// Variance of the innovation, `S = e^T P_11 e + sigma^2`, m^2.
    #[must_use]
    pub fn variance_m2(&self, position_covariance: &Matrix2<f64>) -> f64 {
        self.line_of_sight.dot(&(position_covariance * self.line_of_sight)) + self.noise_variance_m2
    }

    /// `nu^2 / S` for this range alone: chi-square with one degree of freedom.
    #[must_use]
    pub fn normalised_square(&self, position_covariance: &Matrix2<f64>) -> f64 {
        self.innovation_m * self.innovation_m / self.variance_m2(position_covariance)
    }
}

impl RangeInformation {
    /// Adds one range.
    pub fn add(&mut self, range: &Innovation) {
        let weight = 1.0 / range.noise_variance_m2;
        let weighted_sight = range.line_of_sight * weight;
        self.matrix += weighted_sight * range.line_of_sight.transpose();
        self.vector += weighted_sight * range.innovation_m;
        self.weighted_square += range.innovation_m * range.innovation_m * weight;
        self.count += 1;
    }
}

/// Determinant of a positive semi-definite matrix: never below zero, whatever the rounding.
fn determinant(m: &Matrix2<f64>) -> f64 {
    (m[(0, 0)] * m[(1, 1)] - m[(0, 1)] * m[(1, 0)]).max(0.0)
}

/// Symmetric to the bit and clear of rounding.
fn conditioned<const N: usize>(m: &SMatrix<f64, N, N>) -> SMatrix<f64, N, N> {
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

    fn information<const N: usize>(at: &Estimate<N>, ranges: &[(f64, f64, f64, f64)]) -> RangeInformation {
        let mut information = RangeInformation::default();
        for &(x, y, range_m, std_m) in ranges {
            information.add(&at.innovation(Vector2::new(x, y), range_m, std_m));
        }
        information
    }

    /// Positive definite in the sense that counts: it has a Cholesky factor.
    fn is_spd<const N: usize>(p: &SMatrix<f64, N, N>) -> bool {
        *p == p.transpose() && DMatrix::from_fn(N, N, |i, j| p[(i, j)]).cholesky().is_some()
    }

    /// One prediction and joint update, worked out in 50-digit arithmetic.
    #[test]
    fn a_step_matches_high_precision_arithmetic() {
        let start = Estimate { x: SVector::from([0.5, -0.25, 8.0, -8.0]), p: SMatrix::<f64, 4, 4>::identity() * 10.0 };
        let model = MotionModel::IntegratorChain { order: 2, noise_psd: 10.0 };
        let predicted = start.predict(&model.transition(0.1));
        let ranges = [(-5.0, 0.0, 6.4, 1.0), (0.0, 4.0, 5.2, 1.0), (7.0, -3.0, 6.3, 1.0)];
        let (updated, _) = predicted.update(&information(&predicted, &ranges));
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

    proptest! {
        /// The O(M) forms against the textbook's M x M ones.
        #[test]
        fn update_and_nis_equal_the_textbook_kalman_gain(
            seed in proptest::collection::vec(-1.0..1.0_f64, 16),
            ranges in proptest::collection::vec((-20.0..20.0_f64, -20.0..20.0_f64, 0.0..30.0_f64, 0.2..3.0_f64), 1..9),
        ) {
            let root = SMatrix::<f64, 4, 4>::from_iterator(seed);
            let prior = Estimate { x: SVector::from([1.0, 2.0, 3.0, 4.0]), p: root * root.transpose() + SMatrix::identity() * 0.1 };
            let (posterior, nis) = prior.update(&information(&prior, &ranges));
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

        /// From precise to useless sensors, from near to on top of the target: as long as what a range knows and
        /// what the prior knew are no more than eleven digits apart, of the sixteen that there are.
        #[test]
        fn the_covariance_stays_positive_definite_in_extremes(
            log_variance in -6.0..10.0_f64, log_std in -4.0..4.0_f64, robots in 1..200_usize, spread in -9.0..3.0_f64,
        ) {
            let log_std = log_std.max(0.5 * (log_variance - 11.0));
            let p = SMatrix::<f64, 6, 6>::identity() * 10.0_f64.powf(log_variance);
            let mut estimate = Estimate { x: SVector::zeros(), p };
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
                estimate = estimate.update(&information(&estimate, &ranges)).0;
                prop_assert!(is_spd(&estimate.p), "step {step}: {}", estimate.p);
            }
        }
    }

    #[test]
    fn a_million_steps_keep_it_symmetric_and_positive_definite() {
        let transition = MotionModel::IntegratorChain { order: 2, noise_psd: 10.0 }.transition::<4>(0.1);
        let mut estimate = Estimate { x: SVector::zeros(), p: SMatrix::<f64, 4, 4>::identity() * 10.0 };
        for step in 0..1_000_000_u32 {
            estimate = estimate.predict(&transition);
            let (sin, cos) = (f64::from(step) * 0.01).sin_cos();
            let on_top = (estimate.x[0], estimate.x[1], 0.3, 1.0);
            let ranges = [(10.0 * cos, 10.0 * sin, 10.0, 1.0), on_top, (5.0, 0.0, 6.0, 0.5)];
            estimate = estimate.update(&information(&estimate, &ranges)).0;
            if step % 1_000 == 0 {
                assert!(is_spd(&estimate.p), "step {step}");
            }
        }
        assert!(is_spd(&estimate.p) && estimate.x.iter().all(|value| value.is_finite()));
    }

    /// Robots on one spot tell one direction very well and the other not at all.
    #[test]
    fn one_direction_known_far_better_than_the_other_is_survived() {
        let transition = MotionModel::IntegratorChain { order: 2, noise_psd: 0.0 }.transition::<4>(0.1);
        let mut estimate =
            Estimate { x: SVector::from([0.0, 3.0, -8.0, 4.0]), p: SMatrix::<f64, 4, 4>::identity() * 1e12 };
        for step in 0..500 {
            estimate = estimate.predict(&transition);
            let range_m = estimate.position().norm() + 1e-5;
            estimate = estimate.update(&information(&estimate, &[(0.0, 0.0, range_m, 1e-4); 10])).0;
            assert!(is_spd(&estimate.p), "step {step}: {}", estimate.p);
        }
    }

    #[test]
    fn a_robot_on_the_estimate_informs_of_nothing() {
        let prior = Estimate { x: SVector::from([3.0, 4.0]), p: SMatrix::<f64, 2, 2>::identity() };
        let (posterior, _) = prior.update(&information(&prior, &[(3.0, 4.0, 2.0, 1.0)]));
        assert_eq!(posterior.x, prior.x);
        assert!((posterior.p - prior.p).amax() < 1e-11);
    }
}
