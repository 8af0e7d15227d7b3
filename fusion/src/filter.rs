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
        Self { x: transition.phi * self.x, p: symmetric(&p) }
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
        let mut x = self.x + b * shift;
        x[0] = self.x[0] + shift[0];
        x[1] = self.x[1] + shift[1];
        (Self { x, p: symmetric(&p) }, nis)
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

fn symmetric<const N: usize>(m: &SMatrix<f64, N, N>) -> SMatrix<f64, N, N> {
    (m + m.transpose()) * 0.5
}
