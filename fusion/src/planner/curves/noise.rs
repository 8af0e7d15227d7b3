//! The information of a robot's measurement, depending on where it is taken.

use std::f64::consts::PI;

use nalgebra::Matrix2;
use rangehound_shared::scenario::SensorSpec;

use super::information::Information;
use crate::planner::TeamMember;
use crate::vector::Vector;

/// Largest angle by which a heading's rounding may turn the target out of the field of view.
const ROUNDING_RAD: f64 = 1e-9;

/// The noise of one robot's measurements and of its own pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::planner) struct Noise {
    /// Standard deviation of a range at distance 0, m, and its growth; `None` without ranges.
    pub(super) range: Option<(f64, f64)>,
    /// Variance of a bearing and of the heading that it is taken from, rad^2; `None` without bearings.
    pub(super) bearing_rad2: Option<f64>,
    /// Covariance of the robot's position, m^2.
    pub(super) position_m2: Matrix2<f64>,
    /// Half the field of view, with room for the rounding of a heading.
    half_view_rad: f64,
    /// Least `1 / d^2` at which it measures.
    nearness_per_m2: f64,
    /// The noise is constant, and the position known.
    is_plain: bool,
    range_per_m2: f64,
    bearing_per_rad2: f64,
}

impl Noise {
    pub(in crate::planner) fn of(member: &TeamMember) -> Self {
        let SensorSpec { range, bearing_std_rad, .. } = member.sensor;
        let heading_rad2 = member.heading_std_rad * member.heading_std_rad;
        let bearing_rad2 = bearing_std_rad.map(|std_rad| std_rad * std_rad + heading_rad2);
        let position_m2 = member.position_covariance_m2;
        // With room for rounding where a curve is cut off.
        let limit_m = member.sensor.reach_m() * (1.0 + 1e-9);
        Self {
            range: range.map(|range| (range.std_m, range.std_per_m)),
            bearing_rad2,
            position_m2,
            half_view_rad: 0.5 * member.sensor.view_rad() + ROUNDING_RAD,
            nearness_per_m2: 1.0 / (limit_m * limit_m),
            is_plain: position_m2 == Matrix2::zeros() && range.is_none_or(|range| range.std_per_m == 0.0),
            range_per_m2: range.map_or(0.0, |range| 1.0 / (range.std_m * range.std_m)),
            bearing_per_rad2: bearing_rad2.map_or(0.0, f64::recip),
        }
    }

    /// The noise of a robot that measures nothing.
    pub(super) fn nothing(self) -> Self {
        let [range_per_m2, bearing_per_rad2] = [0.0; 2];
        Self { range: None, bearing_rad2: None, is_plain: true, range_per_m2, bearing_per_rad2, ..self }
    }

    /// True if there is a limit to what a measurement tells, however near the target is.
    pub(super) fn is_bounded(&self) -> bool {
        self.bearing_rad2.is_none() || self.position_m2.determinant() > 0.0
    }

    /// The information of a measurement with this sight to the target, m:
    /// `a e e^T + c e_p e_p^T`, `a = 1 / (sigma_r(d)^2 + e^T P e)`, `c = 1 / (d^2 (sigma_b^2 + sigma_psi^2) + e_p^T P e_p)`.
    pub(super) fn information(&self, sight_m: Vector) -> Information {
        self.information_over(sight_m, 1.0)
    }

    /// The same after a move this way, which its field of view looks along. At rest its heading is not the planner's to choose:
    /// then the target counts as seen.
    pub(in crate::planner) fn information_after(&self, way_m: Vector, sight_m: Vector) -> Information {
        let is_seen =
            self.half_view_rad >= PI || way_m == Vector::default() || is_in_view(way_m, sight_m, self.half_view_rad);
        if is_seen { self.information(sight_m) } else { Information::default() }
    }

    /// The same with the sight `p / w`: where the position is known, one division is enough.
    #[inline]
    pub(super) fn information_over(&self, p: Vector, w: f64) -> Information {
        let (x2, y2, xy) = (p.x * p.x, p.y * p.y, p.x * p.y);
        let per_square = 1.0 / (x2 + y2);
        // The pieces of a curve end at the greatest range, but for rounding.
        if per_square * w * w < self.nearness_per_m2 || per_square == f64::INFINITY {
            return Information::default();
        }
        let (range, bearing) = if self.is_plain {
            (self.range_per_m2, self.bearing_per_rad2 * (per_square * w * w))
        } else {
            self.general(x2 * per_square, y2 * per_square, xy * per_square, (x2 + y2) / (w * w))
        };
        let doubled = Vector::new(x2 - y2, 2.0 * xy) * per_square;
        Information { t: range + bearing, s: doubled * (range - bearing) }
    }

    /// The same, and how it changes along a curve: `dp` and `dw` are the derivatives of `p` and `w`.
    #[inline]
    pub(super) fn information_along(&self, p: Vector, w: f64, dp: Vector, dw: f64) -> (Information, Information) {
        let per_square = 1.0 / p.norm_squared();
        let nearness_per_m2 = per_square * w * w;
        if nearness_per_m2 < self.nearness_per_m2 || per_square == f64::INFINITY {
            return Default::default();
        }
        let doubled = p.doubled() * per_square;
        let turning = Vector::new(-doubled.y, doubled.x) * (2.0 * p.cross(dp) * per_square);
        // The derivative of the logarithm of the squared distance.
        let growth = 2.0 * (p.dot(dp) * per_square - dw / w);
        let (range, bearing, range_change, bearing_change) = if self.is_plain {
            let bearing = self.bearing_per_rad2 * nearness_per_m2;
            (self.range_per_m2, bearing, 0.0, -growth * bearing)
        } else {
            let m2 = &self.position_m2;
            let (mean_m2, part_m2) =
                (0.5 * (m2[(0, 0)] + m2[(1, 1)]), Vector::new(0.5 * (m2[(0, 0)] - m2[(1, 1)]), m2[(0, 1)]));
            let (turned_m2, turning_m2) = (part_m2.dot(doubled), part_m2.dot(turning));
            let squared_m2 = nearness_per_m2.recip();
            let (range, range_change) = self.range.map_or((0.0, 0.0), |(std_m, std_per_m)| {
                let growing_m = std_per_m * squared_m2.sqrt();
                let std_m = std_m + growing_m;
                let range = 1.0 / (std_m * std_m + mean_m2 + turned_m2);
                (range, -range * range * (std_m * growing_m * growth + turning_m2))
            });
            let (bearing, bearing_change) = self.bearing_rad2.map_or((0.0, 0.0), |rad2| {
                let bearing = 1.0 / (squared_m2 * rad2 + mean_m2 - turned_m2);
                (bearing, -bearing * bearing * (squared_m2 * rad2 * growth - turning_m2))
            });
            (range, bearing, range_change, bearing_change)
        };
        let information = Information { t: range + bearing, s: doubled * (range - bearing) };
        let s = doubled * (range_change - bearing_change) + turning * (range - bearing);
        (information, Information { t: range_change + bearing_change, s })
    }

    /// The information of range and bearing, given the products of the components of the sight's direction and its squared length.
    fn general(&self, x2: f64, y2: f64, xy: f64, squared_m2: f64) -> (f64, f64) {
        let p = &self.position_m2;
        let mixed_m2 = 2.0 * xy * p[(0, 1)];
        let along_m2 = x2 * p[(0, 0)] + mixed_m2 + y2 * p[(1, 1)];
        let across_m2 = y2 * p[(0, 0)] - mixed_m2 + x2 * p[(1, 1)];
        let range = self.range.map_or(0.0, |(std_m, std_per_m)| {
            let std_m = std_m + std_per_m * squared_m2.sqrt();
            1.0 / (std_m * std_m + along_m2)
        });
        let bearing = self.bearing_rad2.map_or(0.0, |rad2| 1.0 / (squared_m2 * rad2 + across_m2));
        (range, bearing)
    }
}

/// True if the target is within half the field of view after this way.
pub(super) fn is_in_view(way_m: Vector, sight_m: Vector, half_rad: f64) -> bool {
    way_m.cross(sight_m).abs().atan2(way_m.dot(sight_m)) <= half_rad
}
