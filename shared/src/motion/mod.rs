//! Linear target models, `x(k+1) = Phi x(k) + G w_d(k)` (Eq. 1), position first.

pub mod matrix;

use nalgebra::SMatrix;
use serde::{Deserialize, Serialize};

use crate::STATE_DIM_MAX;
use crate::motion::matrix::Matrix;

/// The target's motion model: sets the dimension of its state, `Phi`, and the process noise.
///
/// The built-in models are chains of integrators driven by white noise of a continuous-time
/// spectral density, discretised exactly for any time step.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum MotionModel {
    /// `order` integrators an axis: 1 is a random walk (state `[x y]`), 2 zero acceleration (the
    /// paper's, `[x y vx vy]`), 3 constant acceleration (`[x y vx vy ax ay]`).
    IntegratorChain {
        /// Integrators between the white noise and the position, 1 to 3.
        order: usize,
        /// Spectral density of the noise on each axis, m^2/s^(2 order - 1).
        noise_psd: f64,
    },
    /// Fixed matrices, for one time step.
    Custom {
        /// State transition, n x n.
        phi: Matrix,
        /// Process noise of one step, `G Qd G^T`, n x n, positive semi-definite.
        process_noise: Matrix,
    },
}

/// `Phi` and `G Qd G^T` of one time step, for a state of dimension `N`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Transition<const N: usize> {
    /// State transition matrix.
    pub phi: SMatrix<f64, N, N>,
    /// Covariance of the process noise of the step.
    pub process_noise: SMatrix<f64, N, N>,
}

impl MotionModel {
    /// True if its dimensions are consistent and supported.
    pub(crate) fn is_complete(&self) -> bool {
        match self {
            Self::IntegratorChain { order, noise_psd } => (1..=3).contains(order) && noise_psd.is_finite(),
            Self::Custom { phi, process_noise } => {
                let n = phi.shape().0;
                (2..=STATE_DIM_MAX).contains(&n) && phi.is_complete(n) && process_noise.is_complete(n)
            }
        }
    }

    /// Dimension of the target's state.
    #[must_use]
    pub fn state_dim(&self) -> usize {
        match self {
            Self::IntegratorChain { order, .. } => order.saturating_mul(2),
            Self::Custom { phi, .. } => phi.shape().0,
        }
    }

    /// The transition over `dt_s` seconds, without heap allocation.
    ///
    /// For a chain of `p` integrators with spectral density `q`, with `i` and `j` counting
    /// derivatives of the position: `Phi_ij = dt^(j-i) / (j-i)!` and
    /// `Q_ij = q dt^(2p-1-i-j) / ((2p-1-i-j) (p-1-i)! (p-1-j)!)`: the exact integral, of which the
    /// paper's `q [[dt^3/3, dt^2/2], [dt^2/2, dt]]` is the case p = 2.
    /// Custom matrices hold for the scenario's own step and are returned as they are.
    #[must_use]
    pub fn transition<const N: usize>(&self, dt_s: f64) -> Transition<N> {
        match self {
            Self::Custom { phi, process_noise } => {
                Transition { phi: phi.to_static(), process_noise: process_noise.to_static() }
            }
            Self::IntegratorChain { order, noise_psd } => {
                let order = *order;
                let same_axis = |i: usize, j: usize| i % 2 == j % 2 && i < 2 * order && j < 2 * order;
                Transition {
                    phi: SMatrix::from_fn(|i, j| {
                        if !same_axis(i, j) || j < i {
                            return 0.0;
                        }
                        let power = (j - i) / 2;
                        dt_s.powi(power as i32) / factorial(power)
                    }),
                    process_noise: SMatrix::from_fn(|i, j| {
                        if !same_axis(i, j) {
                            return 0.0;
                        }
                        let (i, j) = (i / 2, j / 2);
                        let power = 2 * order - 1 - i - j;
                        let denominator = power as f64 * factorial(order - 1 - i) * factorial(order - 1 - j);
                        noise_psd * dt_s.powi(power as i32) / denominator
                    }),
                }
            }
        }
    }
}

fn factorial(n: usize) -> f64 {
    (1..=n).map(|k| k as f64).product()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zero_acceleration_is_the_papers_model() {
        let model = MotionModel::IntegratorChain { order: 2, noise_psd: 10.0 };
        let Transition { phi, process_noise } = model.transition::<4>(0.1);
        #[rustfmt::skip]
        let expected_phi = SMatrix::<f64, 4, 4>::new(
            1.0, 0.0, 0.1, 0.0,
            0.0, 1.0, 0.0, 0.1,
            0.0, 0.0, 1.0, 0.0,
            0.0, 0.0, 0.0, 1.0,
        );
        assert_eq!(phi, expected_phi);
        let (a, b, c) = (10.0 * 0.1_f64.powi(3) / 3.0, 10.0 * 0.1_f64.powi(2) / 2.0, 1.0);
        #[rustfmt::skip]
        let expected_noise = SMatrix::<f64, 4, 4>::new(
            a, 0.0, b, 0.0,
            0.0, a, 0.0, b,
            b, 0.0, c, 0.0,
            0.0, b, 0.0, c,
        );
        assert!((process_noise - expected_noise).amax() < 1e-15);
    }

    #[test]
    fn two_half_steps_make_one_whole_step() {
        for order in 1..=3 {
            let model = MotionModel::IntegratorChain { order, noise_psd: 3.0 };
            let half = model.transition::<6>(0.35);
            let whole = model.transition::<6>(0.7);
            let composed = half.phi * half.process_noise * half.phi.transpose() + half.process_noise;
            let used = 2 * order;
            let phi_error = (half.phi * half.phi - whole.phi).view((0, 0), (used, used)).amax();
            assert!(phi_error < 1e-14, "order {order}");
            assert!((composed - whole.process_noise).amax() < 1e-14, "order {order}");
        }
    }
}
