//! The ellipse that shows the uncertainty of a position.

use std::f64::consts::TAU;

use nalgebra::{Matrix2, Vector2};

/// The covariance ellipse of a position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ellipse {
    centre_m: Vector2<f64>,
    half_m: Vector2<f64>,
    /// Directions of the axes, in columns.
    axes: Matrix2<f64>,
}

impl Ellipse {
    /// The ellipse of this many standard deviations; a point if the covariance is not finite.
    #[must_use]
    pub fn new(centre_m: Vector2<f64>, covariance_m2: &Matrix2<f64>, sigmas: f64) -> Self {
        if !covariance_m2.iter().all(|value| value.is_finite()) {
            return Self { centre_m, half_m: Vector2::zeros(), axes: Matrix2::identity() };
        }
        let eigen = covariance_m2.symmetric_eigen();
        let half_m = eigen.eigenvalues.map(|variance| sigmas * variance.max(0.0).sqrt());
        Self { centre_m, half_m, axes: eigen.eigenvectors }
    }

    /// Half the lengths of its axes, m.
    #[must_use]
    pub fn half_m(&self) -> [f64; 2] {
        self.half_m.into()
    }

    /// Direction of the first axis, anticlockwise from east.
    #[must_use]
    pub fn angle_rad(&self) -> f64 {
        self.axes[(1, 0)].atan2(self.axes[(0, 0)])
    }

    /// Points on the ellipse in this many steps; the last point equals the first.
    pub fn outline_m(self, steps: u32) -> impl Iterator<Item = Vector2<f64>> {
        let Self { centre_m, half_m, axes } = self;
        (0..=steps).map(move |step| {
            let (sin, cos) = (TAU * f64::from(step) / f64::from(steps)).sin_cos();
            centre_m + axes * Vector2::new(half_m.x * cos, half_m.y * sin)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_point_is_as_many_standard_deviations_away() {
        let (centre_m, covariance_m2) = (Vector2::new(1.0, -2.0), Matrix2::new(4.0, 1.2, 1.2, 1.0));
        let ellipse = Ellipse::new(centre_m, &covariance_m2, 3.0);
        let information = covariance_m2.try_inverse().unwrap();
        for point_m in ellipse.outline_m(16) {
            let away_m = point_m - centre_m;
            assert!((away_m.dot(&(information * away_m)) - 9.0).abs() < 1e-9);
        }
        // As a viewer draws it from its axes.
        let ([a_m, _], angle_rad) = (ellipse.half_m(), ellipse.angle_rad());
        let first_m = ellipse.outline_m(16).next().unwrap();
        let drawn_m = centre_m + a_m * Vector2::new(angle_rad.cos(), angle_rad.sin());
        assert!((first_m - drawn_m).norm() < 1e-9);
        assert_eq!(Ellipse::new(centre_m, &Matrix2::repeat(f64::NAN), 3.0).outline_m(4).last(), Some(centre_m));
    }
}
