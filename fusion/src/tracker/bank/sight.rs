//! One range compared with one hypothesis.

use std::f64::consts::TAU;

use super::super::Reading;
use crate::filter::{Gaussian, Innovation};

/// Share of the ranges taken to be outliers: that of radio ranges without a line of sight.
const OUTLIER_SHARE: f64 = 0.05;

/// Spread of an outlier beyond that of the hypothesis, in standard deviations of the range. One outlier then divides
/// the weight of the right hypothesis by 400, and does not remove it.
const OUTLIER_SPREAD: f64 = 50.0;

/// A range compared with a hypothesis, to second order.
pub(super) struct Sight {
    pub(super) innovation: Innovation,
    /// How far the circle bends within the hypothesis's standard deviation, `tr((I - e e^T) P_11) / (2 d)`, m.
    pub(super) bend_m: f64,
    /// `S`, m^2.
    pub(super) variance_m2: f64,
    /// `nu^2 / S`.
    pub(super) normalised_square: f64,
    /// `ln` of the probability density that the range is an outlier of this value, 1/m.
    pub(super) log_outlier: f64,
}

impl Sight {
    /// Compares with the second-order terms of `d(X)`. In the plane, where the distance is curved in one direction
    /// only, the mean is `d + bend` and the added variance `2 bend^2`. For a sensor at another height, where it is
    /// curved in all directions, they come from [`Gaussian::bend`].
    pub(super) fn of<const N: usize>(estimate: &Gaussian<N>, reading: &Reading) -> Self {
        let Reading { position_m, height_m, range_m, range_std_m, .. } = *reading;
        let mut innovation = estimate.slant_innovation(position_m, height_m, range_m, range_std_m);
        let covariance = estimate.position_covariance();
        let e = innovation.line_of_sight;
        let across_m2 = (covariance.trace() - e.dot(&(covariance * e))).max(0.0);
        let (bend_m, bend_variance_m2) = if height_m == 0.0 {
            let distance_m = (estimate.position() - position_m).norm().min(range_m);
            // A distance changes by no more than the position does.
            let bend_m = (across_m2 / (2.0 * distance_m)).min(across_m2.sqrt());
            (bend_m, 2.0 * bend_m * bend_m)
        } else {
            // No slant distance is less than the height.
            let bend = estimate.bend(&e, (range_m - innovation.innovation_m).min(range_m).max(height_m.abs()));
            (bend.mean_m, bend.variance_m2)
        };
        innovation.innovation_m -= bend_m;
        innovation.noise_variance_m2 += bend_variance_m2;
        let variance_m2 = innovation.variance_m2(&covariance);
        let normalised_square = innovation.normalised_square(&covariance);
        // A range that is short beside a wide estimate has the density `r / across_m2`, less than `1 / sqrt(S)`.
        let spread_m = OUTLIER_SPREAD * range_std_m + (TAU * variance_m2).sqrt() + across_m2 / range_m.max(range_std_m);
        let log_outlier = (OUTLIER_SHARE / spread_m).ln();
        Self { innovation, bend_m, variance_m2, normalised_square, log_outlier }
    }
}
