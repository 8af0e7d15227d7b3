//! Plane vectors of the planners: bearings as unit vectors, so that no inner loop needs an angle.

use std::ops::{Add, AddAssign, Mul, Neg, Sub};

use serde::{Deserialize, Serialize};

/// A vector in the plane, or the complex number `x + jy`.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Vector {
    /// Real part.
    pub x: f64,
    /// Imaginary part.
    pub y: f64,
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

    /// Its angle in (-pi, pi].
    #[must_use]
    pub fn angle_rad(self) -> f64 {
        self.y.atan2(self.x)
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
        // Root and reciprocal side by side: they are waited for.
        (square >= f64::MIN_POSITIVE).then(|| self * (square.sqrt() * square.recip()))
    }

    /// This direction with the given length, or `None` for the zero vector.
    #[must_use]
    pub fn with_length(self, length: f64) -> Option<Self> {
        let square = self.norm_squared();
        // The root is the last to be known: one product behind it, the relaxations wait for this chain.
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
        fn halving_undoes_doubling(angle in -1.57..1.57_f64) {
            let unit = Vector::from_angle(angle);
            let back = unit.doubled().halved();
            prop_assert!((back - unit).norm() < 1e-14, "{unit:?} {back:?}");
        }
    }
}
