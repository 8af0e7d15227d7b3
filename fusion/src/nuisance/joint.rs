//! Nuisances that are estimated with the target: the full covariance of target and nuisances, in O(M^2) a measurement.
//!
//! Those that are not estimated keep a gain of zero, as in the Schmidt filter.

use nalgebra::{Const, DMatrix, DVector, Dyn, Matrix2, OMatrix, SMatrix, SVector};
use serde::{Deserialize, Serialize};

use super::chain::{Chain, Change};
use super::{NUISANCES, Row, kept};
use crate::filter::{Gaussian, conditioned};

/// Estimates of nuisances and all covariances but the target's own.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Joint<const N: usize> {
    estimates_bias: bool,
    estimates_pose: bool,
    /// All robots' nuisances.
    mean: DVector<f64>,
    covariance: DMatrix<f64>,
    /// With the target's error.
    cross: OMatrix<f64, Const<N>, Dyn>,
}

impl<const N: usize> Joint<N> {
    pub(super) fn new(chain: &Chain, bias: bool, pose: bool) -> Self {
        let size = NUISANCES * chain.robots();
        let mut covariance = DMatrix::zeros(size, size);
        for robot in 0..chain.robots() {
            let block = chain.covariance(robot).matrix();
            covariance.fixed_view_mut::<NUISANCES, NUISANCES>(NUISANCES * robot, NUISANCES * robot).copy_from(&block);
        }
        Self {
            estimates_bias: bias,
            estimates_pose: pose,
            mean: DVector::zeros(size),
            covariance,
            cross: OMatrix::<f64, Const<N>, Dyn>::zeros(size),
        }
    }

    pub(super) fn is_of_team(&self, robots: usize) -> bool {
        let size = NUISANCES * robots;
        self.mean.len() == size && self.covariance.shape() == (size, size) && self.cross.shape() == (N, size)
    }

    pub(super) fn mean_of(&self, robot: usize) -> SVector<f64, NUISANCES> {
        self.mean.fixed_rows::<NUISANCES>(NUISANCES * robot).into_owned()
    }

    pub(super) fn position_covariance(&self, robot: usize) -> Matrix2<f64> {
        self.covariance.fixed_view::<2, 2>(NUISANCES * robot, NUISANCES * robot).into_owned()
    }

    pub(super) fn predict(&mut self, phi: &SMatrix<f64, N, N>) {
        self.cross = phi * &self.cross;
    }

    /// `n' = F n + w` for one robot.
    pub(super) fn change(&mut self, robot: usize, change: &Change) {
        let (at, f) = (NUISANCES * robot, change.matrix());
        let mean = f * self.mean.fixed_rows::<NUISANCES>(at);
        self.mean.fixed_rows_mut::<NUISANCES>(at).copy_from(&mean);
        let cross = self.cross.fixed_columns::<NUISANCES>(at) * f.transpose();
        self.cross.fixed_columns_mut::<NUISANCES>(at).copy_from(&cross);
        let columns = self.covariance.fixed_columns::<NUISANCES>(at) * f.transpose();
        self.covariance.fixed_columns_mut::<NUISANCES>(at).copy_from(&columns);
        let rows = f * self.covariance.fixed_rows::<NUISANCES>(at);
        self.covariance.fixed_rows_mut::<NUISANCES>(at).copy_from(&rows);
        let mut own = self.covariance.fixed_view_mut::<NUISANCES, NUISANCES>(at, at);
        own += change.noise.matrix();
    }

    /// Covariances of a measurement with the nuisances, less its noise: `(P n^T, C^T h)` added.
    fn with_nuisances(&self, row: &Row) -> DVector<f64> {
        let at = NUISANCES * row.robot;
        self.covariance.fixed_columns::<NUISANCES>(at) * row.nuisance
            + self.cross.rows(0, 2).transpose() * row.innovation.gradient
    }

    /// The same with the target's error, without the target's own part.
    fn with_target(&self, row: &Row) -> SVector<f64, N> {
        let part = self.cross.fixed_columns::<NUISANCES>(NUISANCES * row.robot) * row.nuisance;
        SVector::from_fn(|i, _| part[i])
    }

    /// Variance of a row on the nuisances alone.
    pub(super) fn own_variance(&self, row: &Row) -> f64 {
        let at = NUISANCES * row.robot;
        let block = self.covariance.fixed_view::<NUISANCES, NUISANCES>(at, at);
        (block * row.nuisance).dot(&row.nuisance).max(0.0)
    }

    /// Variance of an innovation beyond the target's and the noise.
    pub(super) fn variance(&self, row: &Row) -> f64 {
        let mixed = self.with_target(row);
        self.own_variance(row) + 2.0 * (mixed[0] * row.innovation.gradient.x + mixed[1] * row.innovation.gradient.y)
    }

    fn is_estimated(&self, index: usize) -> bool {
        if index % NUISANCES == NUISANCES - 1 { self.estimates_bias } else { self.estimates_pose }
    }

    /// Updates with measurements that are linearised about this estimate. Returns their normalised innovation squared.
    pub(super) fn update<'a>(&mut self, target: &mut Gaussian<N>, rows: impl Iterator<Item = &'a Row>) -> f64 {
        let rows: Vec<&Row> = rows.collect();
        let (m, size) = (rows.len(), self.mean.len());
        // Covariances of the measurements with target and nuisances: H P.
        let mut with_target = OMatrix::<f64, Const<N>, Dyn>::zeros(m);
        let mut with_nuisances = DMatrix::zeros(size, m);
        for (j, row) in rows.iter().enumerate() {
            let of_target = target.p.fixed_columns::<2>(0) * row.innovation.gradient + self.with_target(row);
            with_target.set_column(j, &of_target);
            with_nuisances.set_column(j, &self.with_nuisances(row));
        }
        let mut s = DMatrix::zeros(m, m);
        for (i, row) in rows.iter().enumerate() {
            let (h, at) = (row.innovation.gradient, NUISANCES * row.robot);
            for j in 0..m {
                s[(i, j)] = h.x * with_target[(0, j)]
                    + h.y * with_target[(1, j)]
                    + with_nuisances.view((at, j), (NUISANCES, 1)).column(0).dot(&row.nuisance);
            }
            s[(i, i)] += row.innovation.noise_variance;
        }
        s = (&s + s.transpose()) * 0.5;
        let innovation = DVector::from_fn(m, |i, _| rows[i].innovation.innovation);
        let Some(root) = s.clone().cholesky() else { return 0.0 };
        let inverse = root.inverse();
        let gain = &with_target * &inverse;
        let mut nuisance_gain = &with_nuisances * &inverse;
        for index in (0..size).filter(|index| !self.is_estimated(*index)) {
            nuisance_gain.row_mut(index).fill(0.0);
        }
        target.x += &gain * &innovation;
        self.mean += &nuisance_gain * &innovation;
        target.p = conditioned(&(target.p - &gain * with_target.transpose()));
        self.cross -= &gain * with_nuisances.transpose();
        let product = &nuisance_gain * with_nuisances.transpose();
        self.covariance -= &product + product.transpose();
        self.covariance += &nuisance_gain * s * nuisance_gain.transpose();
        innovation.dot(&(inverse * &innovation))
    }

    /// The target has been updated with information that does not depend on nuisances.
    pub(super) fn condition(&mut self, prior: &Gaussian<N>, posterior: &Gaussian<N>) {
        let moved = posterior.x - prior.x;
        let before = prior.position_covariance();
        let keep = kept(prior, posterior);
        let cross = self.cross.clone();
        self.cross = keep * &self.cross;
        let Some(inverse) = before.try_inverse() else { return };
        // Regression of the nuisances on the position.
        let regression = cross.rows(0, 2).transpose() * inverse;
        let mut estimated = regression.clone();
        for index in 0..estimated.nrows() {
            if !self.is_estimated(index) {
                estimated.row_mut(index).fill(0.0);
            }
        }
        self.mean += &estimated * moved.fixed_rows::<2>(0);
        let change = posterior.position_covariance() - before;
        let product = &estimated * change * regression.transpose();
        self.covariance += &product + product.transpose() - &estimated * change * estimated.transpose();
    }

    /// Mean and covariance of a sum of estimates with these weights; `None` without any.
    pub(super) fn mixture<'a>(
        target: &Gaussian<N>,
        parts: impl Iterator<Item = (f64, &'a Gaussian<N>, &'a Self)> + Clone,
    ) -> Option<Self> {
        let mut mixture = parts.clone().next()?.2.clone();
        mixture.mean.fill(0.0);
        mixture.covariance.fill(0.0);
        mixture.cross.fill(0.0);
        for (weight, _, part) in parts.clone() {
            mixture.mean += &part.mean * weight;
        }
        for (weight, part_target, part) in parts {
            let (apart, target_apart) = (&part.mean - &mixture.mean, part_target.x - target.x);
            mixture.covariance += (&part.covariance + &apart * apart.transpose()) * weight;
            mixture.cross += (&part.cross + target_apart * apart.transpose()) * weight;
        }
        Some(mixture)
    }
}
