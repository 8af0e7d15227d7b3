//! Information about a position: a symmetric 2x2 matrix as the planners write it.

use std::ops::{Add, AddAssign, Mul, Sub};

use nalgebra::Matrix2;
use rangehound_shared::scenario::Criterion;

use crate::vector::Vector;

/// Smoothing of the largest eigenvalue where the two eigenvalues meet, relative to the trace of the information.
const SMOOTHING: f64 = 1e-7;

/// Largest error of sums of information, relative to their trace: an eigenvalue below that is not known.
pub(super) const ROUNDING: f64 = 64.0 * f64::EPSILON;

/// A symmetric 2x2 matrix `J` as `T = tr J` and `S = (J_11 - J_22, 2 J_12)`, 1/m^2.
///
/// Its eigenvalues are `(T + |S|) / 2` and `(T - |S|) / 2`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(in crate::planner) struct Information {
    pub(in crate::planner) t: f64,
    pub(in crate::planner) s: Vector,
}

impl Information {
    /// The inverse of a covariance, m^2.
    pub(in crate::planner) fn of_covariance(p: &Matrix2<f64>) -> Self {
        let scale = 1.0 / p.determinant().max(f64::MIN_POSITIVE);
        let s = Vector::new(p[(1, 1)] - p[(0, 0)], -2.0 * p[(0, 1)]) * scale;
        Self { t: (p[(0, 0)] + p[(1, 1)]) * scale, s }
    }

    /// `T - |S|`, twice the least eigenvalue; no less than rounding leaves of it.
    pub(super) fn least(self) -> f64 {
        (self.t - self.s.norm()).max(ROUNDING * self.t)
    }

    /// The size of a difference of information along a multiplier and across.
    pub(super) fn size(self, m: Vector) -> f64 {
        self.along(m).abs() + self.s.norm()
    }

    /// `T + m . S` for a multiplier `m` with `|m| <= 1`.
    pub(super) fn along(self, m: Vector) -> f64 {
        self.t + m.dot(self.s)
    }

    /// Trace of the inverse: `4 T / (T^2 - |S|^2)`, m^2.
    pub(super) fn position_trace_m2(self) -> f64 {
        4.0 * self.t / (self.least() * (self.t + self.s.norm()))
    }
}

impl Add for Information {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self { t: self.t + other.t, s: self.s + other.s }
    }
}

impl AddAssign for Information {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl Sub for Information {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self { t: self.t - other.t, s: self.s - other.s }
    }
}

impl Mul<f64> for Information {
    type Output = Self;
    fn mul(self, factor: f64) -> Self {
        Self { t: self.t * factor, s: self.s * factor }
    }
}

/// A criterion's value of information: a cost that falls when information is added, convex in it.
///
/// Every multiplier `m` gives a bound from `H(m)`, the most that `T + m . S` can be: no information in the convex hull costs
/// less. The bound is reached at [`Cost::multiplier`].
pub(in crate::planner) trait Cost {
    /// The cost of this information.
    fn cost(self, information: Information) -> f64;

    /// The multiplier at which the bound of this information's tangent plane is its cost.
    fn multiplier(self, information: Information) -> Vector;

    /// The least cost, given that `T + m . S` is at most `h`.
    fn bound(self, m: Vector, h: f64) -> f64;

    /// The same without a root: with `m = 2 q / (1 + |q|^2)` the cost is at least `c` if
    /// `price(c) ((1 + |q|^2) T + 2 q . S) <= value(q, q)`, and `value` is linear in each of its two.
    fn value(self, q: Vector, other: Vector) -> f64;

    /// See [`Cost::value`].
    fn price(self, cost: f64) -> f64;
}

impl Cost for Criterion {
    fn cost(self, information: Information) -> f64 {
        let (t, s) = (information.t, information.s.norm());
        match self {
            Self::Trace => information.position_trace_m2(),
            Self::Eigenvalue => 2.0 / (t - s.hypot(SMOOTHING * t)).max(ROUNDING * t),
            Self::Determinant => 4.0 / (information.least() * (t + s)),
        }
    }

    fn multiplier(self, information: Information) -> Vector {
        let (t, s) = (information.t, information.s);
        s * -match self {
            Self::Trace => 2.0 * t / (t * t + s.norm_squared()),
            Self::Eigenvalue => 1.0 / s.norm().hypot(SMOOTHING * t),
            Self::Determinant => 1.0 / t,
        }
    }

    fn bound(self, m: Vector, h: f64) -> f64 {
        let rest = (1.0 - m.norm_squared()).max(0.0);
        match self {
            Self::Trace => 2.0 * (1.0 + rest.sqrt()) / h,
            Self::Eigenvalue => 2.0 / h,
            Self::Determinant => 4.0 * rest / (h * h),
        }
    }

    fn value(self, q: Vector, other: Vector) -> f64 {
        match self {
            Self::Trace => 4.0,
            Self::Eigenvalue => 2.0 + 2.0 * q.dot(other),
            Self::Determinant => 2.0 - 2.0 * q.dot(other),
        }
    }

    fn price(self, cost: f64) -> f64 {
        if self == Self::Determinant { cost.sqrt() } else { cost }
    }
}
