//! One measurement compared with one hypothesis.

use std::f64::consts::{PI, TAU};

use nalgebra::Matrix2;
use rangehound_shared::measurement::Kind;

use super::super::Reading;
use crate::filter::Gaussian;
use crate::nuisance::{Chain, Estimate, Row};

/// Spread of an outlier beyond that of the hypothesis, in standard deviations of the measurement. One outlier then divides
/// the weight of the right hypothesis by 400, and does not remove it.
const OUTLIER_SPREAD: f64 = 50.0;

/// Standard deviation of an outlier, in those of the measurement: that of a Gaussian with this spread.
const OUTLIER_STD: f64 = 20.0;

/// Largest standard deviation of a bearing that is an outlier, rad.
const OUTLIER_MAX_RAD: f64 = 0.5;

/// A measurement compared with a hypothesis, to second order.
pub(super) struct Sight {
    pub(super) row: Row,
    /// How far the prediction bends within the hypothesis's standard deviation, m or rad.
    pub(super) bend: f64,
    /// Standard deviation of the measurement without the target's part, m or rad.
    pub(super) own_std: f64,
    /// From the sensor to the estimated target, m.
    pub(super) distance_m: f64,
    /// `S`, m^2 or rad^2.
    pub(super) variance: f64,
    /// `nu^2 / S`.
    pub(super) normalised_square: f64,
    /// `ln` of the probability density that the measurement is an outlier of this value, 1/m or 1/rad.
    pub(super) log_outlier: f64,
}

impl Sight {
    /// Compares with the second-order terms of the prediction. `outlier_share` is the share of measurements taken to be
    /// outliers.
    pub(super) fn of<const N: usize>(
        estimate: &Estimate<N>,
        reading: &Reading,
        chain: &Chain,
        outlier_share: f64,
    ) -> Self {
        let mut row = estimate.row(reading, chain);
        let covariance = estimate.sight_covariance(reading.robot, chain);
        let own_std = estimate.own_std(reading, &row, chain);
        let distance_m = (estimate.target.position() - row.sensor_m).norm();
        let (bend, across_spread) = match reading.kind {
            Kind::Range => bend_of_range(reading, &mut row, &covariance, distance_m),
            // Its second-order terms are in the row already.
            Kind::Bearing => ((row.innovation.noise_variance - reading.std * reading.std).max(0.0).sqrt(), 0.0),
        };
        let variance = estimate.variance(&row, chain);
        let innovation = row.innovation.innovation;
        let normalised_square = innovation * innovation / variance;
        let outlier_density = match reading.kind {
            Kind::Range => (OUTLIER_SPREAD * own_std + (TAU * variance).sqrt() + across_spread).recip(),
            // Half of the outliers are bad measurements of the target, half are of something else.
            Kind::Bearing => {
                let near = variance + outlier_std(reading.kind, own_std).powi(2);
                0.5 * (-0.5 * innovation * innovation / near).exp() / (TAU * near).sqrt() + 0.5 / TAU
            }
        };
        let log_outlier = (outlier_share * outlier_density).ln();
        Self { row, bend, own_std, distance_m, variance, normalised_square, log_outlier }
    }

    /// Standard deviation of an outlier, m or rad, if the hypothesis is wider than that: then an outlier tells something too.
    pub(super) fn wide_outlier_std(&self, reading: &Reading) -> Option<f64> {
        let std = outlier_std(reading.kind, self.own_std);
        (self.variance > std * std).then_some(std)
    }

    /// Largest bend that the second-order terms account for, in the unit of the measurement.
    pub(super) fn is_bent(&self, reading: &Reading, bend_max: f64) -> bool {
        match reading.kind {
            Kind::Range => self.bend > bend_max * self.own_std,
            Kind::Bearing => self.bend > bend_max * self.own_std.min(PI),
        }
    }
}

/// Standard deviation of an outlier, m or rad, given that of a measurement.
fn outlier_std(kind: Kind, own_std: f64) -> f64 {
    match kind {
        Kind::Range => OUTLIER_STD * own_std,
        Kind::Bearing => (OUTLIER_STD * own_std).min(OUTLIER_MAX_RAD),
    }
}

/// Adds the second-order terms of `d(X)` to a range's row. Returns how far the circle bends within the hypothesis,
/// `tr((I - e e^T) P_11) / (2 d)`, m, and the spread of an outlier because of it, m.
///
/// In the plane, where the distance is curved in one direction only, the mean is `d + bend` and the added variance
/// `2 bend^2`. For a sensor at another height, where it is curved in all directions, they come from
/// [`Gaussian::second_order`](crate::filter::Gaussian::second_order).
fn bend_of_range(reading: &Reading, row: &mut Row, covariance: &Matrix2<f64>, distance_m: f64) -> (f64, f64) {
    let (range_m, height_m) = (reading.value, reading.pose.height_m);
    let innovation = &mut row.innovation;
    let e = innovation.gradient;
    let across_m2 = (covariance.trace() - e.dot(&(covariance * e))).max(0.0);
    let (bend_m, bend_variance_m2) = if height_m == 0.0 {
        // A distance changes by no more than the position does.
        let bend_m = (across_m2 / (2.0 * distance_m.min(range_m))).min(across_m2.sqrt());
        (bend_m, 2.0 * bend_m * bend_m)
    } else {
        // No slant distance is less than the height.
        let slant_m = (range_m - innovation.innovation).min(range_m).max(height_m.abs());
        let bend = Gaussian::<2>::second_order(covariance, &e, slant_m);
        (bend.mean_m, bend.variance_m2)
    };
    innovation.innovation -= bend_m;
    innovation.noise_variance += bend_variance_m2;
    // A range that is short beside a wide estimate has the density `r / across_m2`, less than `1 / sqrt(S)`.
    (bend_m, across_m2 / range_m.max(reading.std))
}
