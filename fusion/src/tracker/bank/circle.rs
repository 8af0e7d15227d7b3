//! The likelihood of a range as a sum of Gaussians along its circle.

use std::f64::consts::TAU;

use super::super::Reading;

/// Most hypotheses on one circle. With 64 the circle bends by 3e-4 of its radius within one of them.
pub(super) const CIRCLE_MAX: usize = 64;

/// The same bend within a new hypothesis: below [`BEND_MAX`](super::BEND_MAX), or it would be split again at once.
const BEND_SPLIT: f64 = 0.5;

/// Spacing of the hypotheses on a circle, in their standard deviations: their sum has a ripple of
/// `2 exp(-2 pi^2 / spacing^2)`, 1.4 %.
const SPACING: f64 = 2.0;

/// Least ratio of radial to tangential variance on a circle: far above the rounding of a determinant.
const ASPECT_MIN: f64 = 1e-8;

/// Gaussians along the circle of a range that sum up to its likelihood.
pub(super) struct Circle {
    pub(super) count: usize,
    pub(super) radius_m: f64,
    pub(super) radial_variance_m2: f64,
    pub(super) tangential_variance_m2: f64,
    /// From one centre to the next, m.
    pub(super) arc_m: f64,
}

impl Circle {
    pub(super) fn of(reading: &Reading) -> Self {
        let Reading { range_m, range_std_m, .. } = *reading;
        let variance_m2 = range_std_m * range_std_m;
        if range_m < range_std_m {
            // Smaller than its own noise: one Gaussian about the sensor.
            let variance_m2 = variance_m2 + 0.5 * range_m * range_m;
            let (radial_variance_m2, tangential_variance_m2) = (variance_m2, variance_m2);
            let arc_m = TAU * range_std_m;
            return Self { count: 1, radius_m: 0.0, radial_variance_m2, tangential_variance_m2, arc_m };
        }
        let spacing_m = SPACING * (2.0 * range_m * range_std_m * BEND_SPLIT).sqrt();
        let count = ((TAU * range_m / spacing_m).ceil() as usize).clamp(1, CIRCLE_MAX);
        let arc_m = TAU * range_m / count as f64;
        let tangential_variance_m2 = (arc_m / SPACING) * (arc_m / SPACING);
        let bend_m = tangential_variance_m2 / (2.0 * range_m);
        let radial_variance_m2 = (variance_m2 + bend_m * bend_m).max(ASPECT_MIN * tangential_variance_m2);
        Self { count, radius_m: range_m, radial_variance_m2, tangential_variance_m2, arc_m }
    }
}
