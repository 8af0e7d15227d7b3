//! The likelihood of a bearing as a sum of Gaussians along its ray.
//!
//! A bearing puts the target on a ray, within the angle of its noise. The Gaussians have standard deviations in proportion to
//! their distances, so their distances are in a geometric series.

use nalgebra::Vector2;

use super::Piece;

/// Standard deviation of a Gaussian along the ray, relative to its distance. A bearing is nearly linear within it, so that
/// it is not split again at once.
const ALONG_SHARE: f64 = 0.2;

/// Ratio of successive distances: they are two standard deviations apart, as the Gaussians of a circle.
const RATIO: f64 = 1.0 + 2.0 * ALONG_SHARE;

/// Distances that a start covers, m.
const NEAR_M: f64 = 0.1;
const FAR_M: f64 = 1e4;

/// Largest standard deviation of a bearing by which a ray is made, rad: a Gaussian is no sector beyond it.
const STD_MAX_RAD: f64 = 0.5;

/// Gaussians along the ray of a bearing that sum up to its likelihood.
pub(super) struct Ray {
    pub(super) count: usize,
    along: Vector2<f64>,
    std_rad: f64,
    nearest_m: f64,
}

impl Ray {
    /// The ray of a bearing from the x axis with this standard deviation, rad, between two distances, m.
    pub(super) fn of(bearing_rad: f64, std_rad: f64, (near_m, far_m): (f64, f64)) -> Self {
        let (sin, cos) = bearing_rad.sin_cos();
        let nearest_m = near_m.clamp(NEAR_M, FAR_M);
        let steps = (far_m.clamp(nearest_m, FAR_M) / nearest_m).ln() / RATIO.ln();
        let count = 1 + steps.ceil() as usize;
        Self { count, along: Vector2::new(cos, sin), std_rad: std_rad.min(STD_MAX_RAD), nearest_m }
    }

    /// The whole ray.
    pub(super) fn whole(bearing_rad: f64, std_rad: f64) -> Self {
        Self::of(bearing_rad, std_rad, (NEAR_M, FAR_M))
    }

    /// One of its Gaussians, from near to far.
    pub(super) fn piece(&self, sensor_m: Vector2<f64>, index: usize) -> Piece {
        let distance_m = self.nearest_m * RATIO.powi(index as i32);
        let across_m = distance_m * self.std_rad;
        Piece {
            centre_m: sensor_m + self.along * distance_m,
            along: self.along,
            along_variance_m2: (ALONG_SHARE * distance_m) * (ALONG_SHARE * distance_m),
            across_variance_m2: across_m * across_m,
            // The step along the ray times the width of a radian there.
            integral: 2.0 * ALONG_SHARE * distance_m * distance_m,
        }
    }

    /// Share of the area of a Gaussian in this one: with it all distances are equally likely on a logarithmic scale.
    pub(super) fn per_area(&self, index: usize) -> f64 {
        RATIO.powi(-2 * index as i32)
    }
}
