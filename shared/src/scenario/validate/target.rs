//! The target's motion, its start, and the knowledge of it before the first range.

use super::Checker;
use super::values::{list_of, quoted};
use crate::draws::{Draws, Stream};
use crate::motion::MotionModel;
use crate::motion::matrix::{Matrix, square_root};
use crate::scenario::bounds::{NOISE_PSD, RELATIVE_EIGENVALUE_MIN, VARIANCE};
use crate::scenario::{CovarianceKey, MeanKey, Prior, PriorTable, ScenarioError, TargetTable, defaults};
use crate::{STATE_DIM_MAX, with_state_dim};

impl Checker<'_> {
    pub(super) fn motion(&self, table: &TargetTable, recorded: bool) -> Result<MotionModel, ScenarioError> {
        let name = table.model.as_deref().unwrap_or(defaults::MODEL);
        let order = match name {
            "random_walk" => 1,
            "zero_acceleration" => 2,
            "constant_acceleration" => 3,
            "custom" if !recorded => return self.custom_motion(table),
            other => {
                let custom = if recorded { "" } else { ", \"custom\"" };
                let known = format!("\"random_walk\", \"zero_acceleration\", \"constant_acceleration\"{custom}");
                return Err(self.refuse("target.model", format!("one of {known}"), quoted(other)));
            }
        };
        for (key, given) in [("phi", table.phi.is_some()), ("g", table.g.is_some()), ("qd", table.qd.is_some())] {
            if given {
                return Err(self.refuse(
                    &format!("target.{key}"),
                    "both of them, or neither",
                    "given without target.model = \"custom\"",
                ));
            }
        }
        let default = if recorded { defaults::RECORDED_ACCEL_PSD } else { defaults::NOISE_PSD };
        let noise_psd = self.number("target.noise_psd", table.noise_psd, default, NOISE_PSD)?;
        Ok(MotionModel::IntegratorChain { order, noise_psd })
    }

    pub(super) fn custom_motion(&self, table: &TargetTable) -> Result<MotionModel, ScenarioError> {
        if table.noise_psd.is_some() {
            return Err(self.refuse(
                "target.noise_psd",
                "only target.qd",
                "given together with target.model = \"custom\"",
            ));
        }
        let phi = self.matrix("target.phi", table.phi.as_deref())?;
        let n = phi.shape().0;
        if phi.shape().1 != n || !(2..=STATE_DIM_MAX).contains(&n) {
            let (rows, columns) = phi.shape();
            let expected = format!("a square matrix of size 2 to {STATE_DIM_MAX}");
            return Err(self.refuse("target.phi", expected, format!("{rows} x {columns}")));
        }
        let qd = self.matrix("target.qd", table.qd.as_deref())?;
        if qd.relative_min_eigenvalue().is_none_or(|minimum| minimum < -1e-12) {
            return Err(self.refuse(
                "target.qd",
                "a symmetric positive semi-definite matrix",
                "asymmetric or indefinite",
            ));
        }
        let g = match table.g.as_deref() {
            None => Matrix::from_diagonal(&vec![1.0; n]),
            rows => self.matrix("target.g", rows)?,
        };
        if g.shape() != (n, qd.shape().0) {
            let expected = format!("{n} rows (as phi) of {} numbers (as qd)", qd.shape().0);
            return Err(self.refuse("target.g", expected, format!("{} x {}", g.shape().0, g.shape().1)));
        }
        Ok(MotionModel::Custom { phi, process_noise: qd.congruence(&g) })
    }

    pub(super) fn target_start(&self, start: Option<&Vec<f64>>, n: usize) -> Result<Vec<f64>, ScenarioError> {
        match start {
            Some(state) => self.state("target.start", state, n),
            None => Ok((0..n).map(|i| defaults::TARGET_START.get(i).copied().unwrap_or(0.0)).collect()),
        }
    }

    /// The prior's mean if nobody knows the truth from which it could be drawn.
    pub(super) fn mean_for_real_target(&self, given: Option<MeanKey>) -> Result<MeanKey, ScenarioError> {
        match given {
            Some(MeanKey::Word(word)) if word == "drawn" => Err(self.refuse(
                "prior.mean",
                "\"start\" or a state, because nobody knows the truth about a real target",
                quoted(&word),
            )),
            given => Ok(given.unwrap_or_else(|| MeanKey::Word("start".to_owned()))),
        }
    }

    pub(super) fn prior(&self, table: &PriorTable, target_start: &[f64], seed: u64) -> Result<Prior, ScenarioError> {
        let n = target_start.len();
        let key = "prior.covariance";
        let covariance = match table.covariance.as_ref().unwrap_or(&CovarianceKey::Scalar(defaults::PRIOR_VARIANCE)) {
            CovarianceKey::Scalar(variance) => {
                Matrix::from_diagonal(&vec![self.number(key, Some(*variance), *variance, VARIANCE)?; n])
            }
            CovarianceKey::Diagonal(variances) if variances.len() == n => {
                for variance in variances {
                    self.number(key, Some(*variance), *variance, VARIANCE)?;
                }
                Matrix::from_diagonal(variances)
            }
            CovarianceKey::Rows(rows) if rows.len() == n => self.matrix(key, Some(rows))?,
            CovarianceKey::Diagonal(list) => {
                return Err(self.refuse(key, list_of(n, "variance"), format!("a list of {}", list.len())));
            }
            CovarianceKey::Rows(rows) => {
                return Err(self.refuse(key, list_of(n, "row"), format!("a list of {}", rows.len())));
            }
        };
        match covariance.relative_min_eigenvalue() {
            Some(minimum) if minimum > RELATIVE_EIGENVALUE_MIN => {}
            Some(_) => return Err(self.refuse(key, "a positive definite matrix", "indefinite or singular")),
            None => return Err(self.refuse(key, "a symmetric matrix", "asymmetric")),
        }
        let mean = match table.mean.as_ref().unwrap_or(&MeanKey::Word(defaults::PRIOR_MEAN.to_owned())) {
            MeanKey::Word(word) if word == "start" => target_start.to_vec(),
            MeanKey::Word(word) if word == "drawn" => drawn_mean(target_start, &covariance, seed),
            MeanKey::Word(word) => {
                return Err(self.refuse("prior.mean", "\"drawn\", \"start\" or a list of numbers", quoted(word)));
            }
            MeanKey::State(state) => self.state("prior.mean", state, n)?,
        };
        Ok(Prior::Gaussian { mean, covariance })
    }
}

/// The prior mean drawn from N(start, covariance): a filter that is consistent from the first tick.
fn drawn_mean(start: &[f64], covariance: &Matrix, seed: u64) -> Vec<f64> {
    with_state_dim!(start.len(), N => {
        let root = square_root(&covariance.to_static::<N, N>());
        let mut normal = nalgebra::SVector::<f64, N>::zeros();
        Draws::new(seed, Stream::PriorMean).standard_normal(0, normal.as_mut_slice());
        let error = root * normal;
        start.iter().zip(error.iter()).map(|(start, error)| start + error).collect()
    })
}
