//! Plane vectors of the planners: bearings as unit vectors, so that no inner loop needs an angle.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI, SQRT_2};
use std::ops::{Add, AddAssign, Mul, Neg, Sub};

use rangehound_shared::measurement::Pose;
use serde::{Deserialize, Serialize};

/// A vector in the plane, or the complex number `x + jy`.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Vector {
    /// Real part.
    pub x: f64,
    /// Imaginary part.
    pub y: f64,
}

impl From<Pose> for Vector {
    fn from(pose: Pose) -> Self {
        Self::new(pose.x_m, pose.y_m)
    }
}

impl Vector {
    /// The vector with these components.
    #[must_use]
    pub const fn new(x: f64, y: f64) -> Self {
        Self { x, y }
    }

    /// The unit vector at this angle.
    #[must_use]
    pub fn from_angle(angle_rad: f64) -> Self {
        let (y, x) = angle_rad.sin_cos();
        Self { x, y }
    }

    /// Its angle in (-pi, pi]; 0 of the zero vector.
    ///
    /// It differs from `atan2` by two units in the last place at most, and has no tables and no branches: in a planner
    /// that runs once a tick, tables would miss the cache and branches would be mispredicted.
    #[must_use]
    pub fn angle_rad(self) -> f64 {
        if self == Self::default() {
            return 0.0;
        }
        let (x, y) = (self.x.abs(), self.y.abs());
        let (less, more) = if x < y { (x, y) } else { (y, x) };
        // The angle from the nearest axis or diagonal is at most a sixteenth of a turn.
        let diagonal = if less > TAN_EIGHTH * more { 1.0 } else { 0.0 };
        let from_axis_rad = FRAC_PI_4 * diagonal + arc_tangent_rad((less - more * diagonal) / (more + less * diagonal));
        // The angle, or its complement to a quarter or half turn. Products, because `else` would be a branch.
        let upright = if x < y { 1.0 } else { 0.0 };
        let from_x_rad = FRAC_PI_2 * upright + from_axis_rad * (1.0 - 2.0 * upright);
        let left = if self.x < 0.0 { 1.0 } else { 0.0 };
        (PI * left + from_x_rad * (1.0 - 2.0 * left)).copysign(self.y)
    }

    /// Scalar product.
    #[must_use]
    pub fn dot(self, other: Self) -> f64 {
        self.x * other.x + self.y * other.y
    }

    /// `self.x other.y - self.y other.x`: positive if `other` lies counter-clockwise of `self`.
    #[must_use]
    pub fn cross(self, other: Self) -> f64 {
        self.x * other.y - self.y * other.x
    }

    /// Squared length.
    #[must_use]
    pub fn norm_squared(self) -> f64 {
        self.dot(self)
    }

    /// Length.
    #[must_use]
    pub fn norm(self) -> f64 {
        self.norm_squared().sqrt()
    }

    /// This direction with length one, or `None` for the zero vector.
    #[must_use]
    pub fn normalised(self) -> Option<Self> {
        let square = self.norm_squared();
        // Root and reciprocal do not depend on each other, so they are computed at the same time.
        (square >= f64::MIN_POSITIVE).then(|| self * (square.sqrt() * square.recip()))
    }

    /// This direction with the given length, or `None` for the zero vector.
    #[must_use]
    pub fn with_length(self, length: f64) -> Option<Self> {
        let square = self.norm_squared();
        // Relaxation waits for this chain of operations. The root takes longest, so only one product follows it.
        (square >= f64::MIN_POSITIVE).then(|| self * length * square.recip() * square.sqrt())
    }

    /// Complex product: adds the angles of unit vectors.
    #[must_use]
    pub fn rotated_by(self, other: Self) -> Self {
        Self::new(self.x * other.x - self.y * other.y, self.x * other.y + self.y * other.x)
    }

    /// Complex conjugate: the opposite angle.
    #[must_use]
    pub fn conjugate(self) -> Self {
        Self::new(self.x, -self.y)
    }

    /// The unit vector at twice the angle of this unit vector.
    #[must_use]
    pub fn doubled(self) -> Self {
        self.rotated_by(self)
    }

    /// The unit vector at half the angle of this one, in (-pi/2, pi/2].
    #[must_use]
    pub fn halved(self) -> Self {
        // From whichever half-angle formula does not cancel.
        if self.x >= 0.0 {
            let cos = ((1.0 + self.x) * 0.5).sqrt();
            Self::new(cos, self.y / (2.0 * cos))
        } else {
            let sin = ((1.0 - self.x) * 0.5).sqrt().copysign(self.y);
            Self::new(self.y / (2.0 * sin), sin)
        }
    }
}

/// `tan(pi/8)`.
const TAN_EIGHTH: f64 = SQRT_2 - 1.0;

/// The arc tangent of a value within [`TAN_EIGHTH`] of zero: the polynomial of Sun's fdlibm.
fn arc_tangent_rad(tangent: f64) -> f64 {
    const ODD: [f64; 6] = [
        3.333_333_333_333_293e-1,
        1.428_571_427_250_346_6e-1,
        9.090_887_133_436_507e-2,
        6.661_073_137_387_531e-2,
        4.976_877_994_615_932_4e-2,
        1.628_582_011_536_578_2e-2,
    ];
    const EVEN: [f64; 5] = [
        -1.999_999_999_987_648_3e-1,
        -1.111_111_040_546_235_6e-1,
        -7.691_876_205_044_83e-2,
        -5.833_570_133_790_573_5e-2,
        -3.653_157_274_421_691_6e-2,
    ];
    let square = tangent * tangent;
    let fourth = square * square;
    let polynomial = |terms: &[f64]| terms.iter().rev().fold(0.0, |sum, term| sum * fourth + term);
    tangent - tangent * (square * polynomial(&ODD) + fourth * polynomial(&EVEN))
}

impl Add for Vector {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self::new(self.x + other.x, self.y + other.y)
    }
}

impl AddAssign for Vector {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl Sub for Vector {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self::new(self.x - other.x, self.y - other.y)
    }
}

impl Mul<f64> for Vector {
    type Output = Self;
    fn mul(self, factor: f64) -> Self {
        Self::new(self.x * factor, self.y * factor)
    }
}

impl Neg for Vector {
    type Output = Self;
    fn neg(self) -> Self {
        Self::new(-self.x, -self.y)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_angle_is_that_of_atan2(angle in -PI..=PI, log_length in -300.0..300.0_f64) {
            let v = Vector::from_angle(angle) * 10.0_f64.powf(log_length);
            let expected = v.y.atan2(v.x);
            prop_assert!((v.angle_rad() - expected).abs() <= 2.0 * f64::EPSILON * expected.abs(), "{v:?}");
        }

        #[test]
        fn halving_undoes_doubling(angle in -1.57..1.57_f64) {
            let unit = Vector::from_angle(angle);
            let back = unit.doubled().halved();
            prop_assert!((back - unit).norm() < 1e-14, "{unit:?} {back:?}");
        }
    }

    #[test]
    fn the_angles_on_axes_and_diagonals_are_those_of_atan2() {
        for x in [-1.0, -0.0, 0.0, 1.0_f64] {
            for y in [-1.0, -0.0, 0.0, 1.0_f64] {
                let expected = if (x, y) == (0.0, 0.0) { 0.0 } else { y.atan2(x) };
                assert_eq!(Vector::new(x, y).angle_rad(), expected, "{x} {y}");
            }
        }
    }
}
