//! The estimate of the target that planners receive: one Gaussian of any supported dimension.

use nalgebra::{Matrix2, SMatrix, SVector};
use rangehound_shared::STATE_DIM_MAX;

use crate::filter::Gaussian;
use crate::vector::Vector;

/// A Gaussian of the target's state, position first. Entries beyond the dimension of the motion model are zero.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Belief {
    /// Mean: m, m/s and so on.
    pub mean: SVector<f64, STATE_DIM_MAX>,
    /// Covariance of the mean.
    pub covariance: SMatrix<f64, STATE_DIM_MAX, STATE_DIM_MAX>,
}

impl Belief {
    /// A belief about a position only.
    #[must_use]
    pub fn of_position(position_m: Vector, covariance_m2: &Matrix2<f64>) -> Self {
        let mut belief = Self::default();
        belief.set_position(position_m, covariance_m2);
        belief
    }

    /// Replaces the position and its covariance; all other entries stay.
    pub fn set_position(&mut self, position_m: Vector, covariance_m2: &Matrix2<f64>) {
        self.mean[0] = position_m.x;
        self.mean[1] = position_m.y;
        self.covariance.fixed_view_mut::<2, 2>(0, 0).copy_from(covariance_m2);
    }

    /// Copies a filter's estimate. All estimates must have the same dimension: entries beyond it are not cleared.
    pub fn assign<const N: usize>(&mut self, estimate: &Gaussian<N>) {
        self.mean.fixed_rows_mut::<N>(0).copy_from(&estimate.x);
        self.covariance.fixed_view_mut::<N, N>(0, 0).copy_from(&estimate.p);
    }

    /// Where the target is believed to be, m.
    #[must_use]
    pub fn position_m(&self) -> Vector {
        Vector::new(self.mean[0], self.mean[1])
    }

    /// Covariance of the position, m^2.
    #[must_use]
    pub fn position_covariance_m2(&self) -> Matrix2<f64> {
        self.covariance.fixed_view::<2, 2>(0, 0).into_owned()
    }
}
