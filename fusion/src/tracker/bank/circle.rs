//! The likelihood of a range as a sum of Gaussians along its circle.
//!
//! A slant range `r` of a sensor at height `h` puts the target on the circle of radius `sqrt(r^2 - h^2)` in its plane,
//! and the noise across that circle is `r / radius` times the noise of the range. Near the sensor's foot, where that
//! noise is greater than the radius, the likelihood is a disc.

use std::f64::consts::TAU;

use nalgebra::Vector2;

use super::Piece;

/// Most hypotheses on one circle. With 64 the circle bends by 3e-4 of its radius within one of them.
pub(super) const CIRCLE_MAX: usize = 64;

/// Bend within a new hypothesis, relative to that by which one is split: it is not split again at once.
const BEND_SPLIT: f64 = 0.5;

/// Spacing of the hypotheses on a circle, in their standard deviations: their sum has a ripple of
/// `2 exp(-2 pi^2 / spacing^2)`, 1.4 %.
const SPACING: f64 = 2.0;

/// Least ratio of radial to tangential variance on a circle: far above the rounding of a determinant.
const ASPECT_MIN: f64 = 1e-8;

/// Mean of the absolute value of a standard normal.
const HALF_NORMAL_MEAN: f64 = 0.797_884_560_802_865_4;

/// The square of the horizontal distance is taken to be at most this many standard deviations below zero.
const DISC_SIGMA_MAX: f64 = 5.0;

/// Gaussians along the circle of a range that sum up to its likelihood.
pub(super) struct Circle {
    pub(super) count: usize,
    radius_m: f64,
    radial_variance_m2: f64,
    tangential_variance_m2: f64,
    /// Integral of one Gaussian, m: in the plane, the arc from one centre to the next.
    arc_m: f64,
}

impl Circle {
    /// The circle of a range with this standard deviation, m, measured at this height.
    pub(super) fn of(range_m: f64, range_std_m: f64, height_m: f64, bend_max: f64) -> Self {
        let bend_split = BEND_SPLIT * bend_max;
        if height_m != 0.0 {
            return Self::of_slant_range(range_m, range_std_m, height_m, bend_split);
        }
        let variance_m2 = range_std_m * range_std_m;
        if range_m < range_std_m {
            // The range is smaller than its noise: one Gaussian round the sensor.
            let variance_m2 = variance_m2 + 0.5 * range_m * range_m;
            let (radial_variance_m2, tangential_variance_m2) = (variance_m2, variance_m2);
            let arc_m = TAU * range_std_m;
            return Self { count: 1, radius_m: 0.0, radial_variance_m2, tangential_variance_m2, arc_m };
        }
        let spacing_m = SPACING * (2.0 * range_m * range_std_m * bend_split).sqrt();
        let count = ((TAU * range_m / spacing_m).ceil() as usize).clamp(1, CIRCLE_MAX);
        let arc_m = TAU * range_m / count as f64;
        let tangential_variance_m2 = (arc_m / SPACING) * (arc_m / SPACING);
        let bend_m = tangential_variance_m2 / (2.0 * range_m);
        let radial_variance_m2 = (variance_m2 + bend_m * bend_m).max(ASPECT_MIN * tangential_variance_m2);
        Self { count, radius_m: range_m, radial_variance_m2, tangential_variance_m2, arc_m }
    }

    /// One of its Gaussians: alternately both ways round the sensor, from this direction.
    pub(super) fn piece(&self, sensor_m: Vector2<f64>, towards_rad: f64, index: usize) -> Piece {
        let turn = if index.is_multiple_of(2) { index / 2 } else { self.count - index.div_ceil(2) };
        let (sin, cos) = (towards_rad + TAU * turn as f64 / self.count as f64).sin_cos();
        let along = Vector2::new(cos, sin);
        Piece {
            centre_m: sensor_m + along * self.radius_m,
            along,
            along_variance_m2: self.radial_variance_m2,
            across_variance_m2: self.tangential_variance_m2,
            integral: self.arc_m,
        }
    }

    fn of_slant_range(range_m: f64, range_std_m: f64, height_m: f64, bend_split: f64) -> Self {
        // A range shorter than the height is noise: the target is near the foot.
        let slant_m = range_m.max(height_m.abs());
        // The square of the horizontal distance, and its standard deviation.
        let square_m2 = (range_m - height_m) * (range_m + height_m);
        let square_std_m2 = 2.0 * slant_m * range_std_m;
        if square_m2 < 0.5 * square_std_m2 {
            // A disc round the foot. Its variance on each axis is half of the mean square of the distance. That square
            // is a Gaussian cut off at zero; this formula has its exact mean at zero, and the right limits on both
            // sides.
            let square_m2 = square_m2.max(-DISC_SIGMA_MAX * square_std_m2);
            let spread_m2 = square_std_m2 * HALF_NORMAL_MEAN;
            let mean_square_m2 = 0.5 * (square_m2 + square_m2.hypot(2.0 * spread_m2));
            let variance_m2 = 0.5 * mean_square_m2;
            let (radial_variance_m2, tangential_variance_m2) = (variance_m2, variance_m2);
            return Self { count: 1, radius_m: 0.0, radial_variance_m2, tangential_variance_m2, arc_m: TAU * slant_m };
        }
        let radius_m = square_m2.sqrt();
        let radial_std_m = range_std_m * slant_m / radius_m;
        let spacing_m = SPACING * (2.0 * radius_m * radial_std_m * bend_split).sqrt();
        let count = ((TAU * radius_m / spacing_m).ceil() as usize).clamp(1, CIRCLE_MAX);
        let along_m = TAU * radius_m / count as f64;
        let tangential_variance_m2 = (along_m / SPACING) * (along_m / SPACING);
        let bend_m = tangential_variance_m2 / (2.0 * radius_m);
        let radial_variance_m2 =
            (radial_std_m * radial_std_m + bend_m * bend_m).max(ASPECT_MIN * tangential_variance_m2);
        // The integral of the likelihood over the plane is the circumference for the slant range.
        let arc_m = TAU * slant_m / count as f64;
        Self { count, radius_m, radial_variance_m2, tangential_variance_m2, arc_m }
    }
}
