//! Angles.

use std::f64::consts::{PI, TAU};

/// The same direction within `(-pi, pi]`, rad.
#[must_use]
pub fn wrapped_rad(angle_rad: f64) -> f64 {
    if (-PI..=PI).contains(&angle_rad) && angle_rad != -PI {
        return angle_rad;
    }
    let turned = angle_rad.rem_euclid(TAU);
    if turned > PI { turned - TAU } else { turned }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_are_wrapped_into_one_turn() {
        for (angle_rad, expected_rad) in
            [(0.0, 0.0), (PI, PI), (-PI, PI), (4.0, 4.0 - TAU), (-4.0, TAU - 4.0), (7.0 * PI, PI)]
        {
            assert!((wrapped_rad(angle_rad) - expected_rad).abs() < 1e-12, "{angle_rad}");
        }
        assert!(wrapped_rad(f64::NAN).is_nan() && wrapped_rad(f64::INFINITY).is_nan());
    }
}
