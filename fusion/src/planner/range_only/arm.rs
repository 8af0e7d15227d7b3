//! One robot's vector in the sum: a length and the arc of its directions.

use crate::vector::Vector;

/// One robot's vector: its length `lambda = sigma^-2` and the arc that its direction may take.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arm {
    /// Length, 1/m^2.
    pub lambda: f64,
    /// Middle of the arc: the doubled bearing to the predicted target from where the robot is now.
    pub centre: Vector,
    /// Clockwise end of the arc.
    pub low: Vector,
    /// Counter-clockwise end of the arc.
    pub high: Vector,
    /// How wide the arc is.
    pub extent: Extent,
}

/// How wide an arc is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Extent {
    /// At most half a turn.
    Narrow,
    /// More than half a turn.
    Wide,
    /// All directions.
    Circle,
}

impl Arm {
    /// The arc round `centre` whose half-width is the angle of the unit vector `half_width`.
    #[must_use]
    pub fn with_half_width(lambda: f64, centre: Vector, half_width: Vector) -> Self {
        let extent = if half_width.x >= 0.0 { Extent::Narrow } else { Extent::Wide };
        let low = centre.rotated_by(half_width.conjugate());
        Self { lambda, centre, low, high: centre.rotated_by(half_width), extent }
    }

    /// An arm that may point anywhere.
    #[must_use]
    pub fn circle(lambda: f64, centre: Vector) -> Self {
        Self { lambda, centre, low: -centre, high: -centre, extent: Extent::Circle }
    }

    /// True if the direction of `v` (of any length) lies in the arc.
    #[must_use]
    pub fn contains(&self, v: Vector) -> bool {
        self.end_before(v).is_none()
    }

    /// The direction in the arc nearest to that of `goal` (of any length); `held` if `goal` is zero.
    #[must_use]
    pub fn nearest(&self, goal: Vector, held: Vector) -> Vector {
        self.end_before(goal).unwrap_or_else(|| goal.normalised().unwrap_or(held))
    }

    /// The end of the arc that is nearest to the direction of `v` (of any length), if that direction is outside the
    /// arc.
    #[inline]
    pub(super) fn end_before(&self, v: Vector) -> Option<Vector> {
        if self.extent == Extent::Circle {
            return None;
        }
        // Less than half a turn from the centre on either side: the sign of a sine decides.
        let (end, sine) =
            if self.centre.cross(v) >= 0.0 { (self.high, v.cross(self.high)) } else { (self.low, self.low.cross(v)) };
        // An arc of no width does not contain the opposite direction.
        let is_inside = sine > 0.0 || (sine == 0.0 && v.dot(self.centre) >= 0.0);
        (!is_inside).then_some(end)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f64::consts::PI;

    proptest! {
        #[test]
        fn the_nearest_direction_is_in_the_arc_and_nearest(
            centre in -PI..PI, half in 0.0..PI, goal in -PI..PI, probe in -1.0..1.0_f64,
        ) {
            let arm = Arm::with_half_width(1.0, Vector::from_angle(centre), Vector::from_angle(half));
            let goal = Vector::from_angle(goal) * 2.5;
            let nearest = arm.nearest(goal, arm.centre);
            prop_assert!(nearest.dot(arm.centre) >= half.cos() - 1e-12);
            let other = Vector::from_angle(centre + probe * half);
            prop_assert!(nearest.dot(goal) >= other.dot(goal) - 1e-12);
        }
    }
}
