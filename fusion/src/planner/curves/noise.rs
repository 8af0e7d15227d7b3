//! What a robot's measurement tells, depending on where it is taken.

use nalgebra::Matrix2;

use super::information::Information;
use crate::planner::{Sensor, TeamMember};
use crate::vector::Vector;

/// The noise of one robot's measurements and of its own pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Noise {
    /// Standard deviation of a range at distance 0, m, and its growth; `None` without ranges.
    pub(super) range: Option<(f64, f64)>,
    /// Variance of a bearing and of the heading that it is taken from, rad^2; `None` without bearings.
    pub(super) bearing_rad2: Option<f64>,
    /// Covariance of the robot's position, m^2.
    pub(super) position_m2: Matrix2<f64>,
    pub(super) max_range_m: f64,
}

impl Noise {
    pub(super) fn of(member: &TeamMember) -> Self {
        let Sensor { range, bearing_std_rad, max_range_m, .. } = member.sensor;
        let heading_rad2 = member.heading_std_rad * member.heading_std_rad;
        Self {
            range: range.map(|range| (range.std_m, range.std_per_m)),
            bearing_rad2: bearing_std_rad.map(|std_rad| std_rad * std_rad + heading_rad2),
            position_m2: member.position_covariance_m2,
            max_range_m,
        }
    }

    /// What a measurement tells with this sight to the target:
    /// `a e e^T + c e_p e_p^T`, `a = 1 / (sigma_r(d)^2 + e^T P e)`, `c = 1 / (d^2 (sigma_b^2 + sigma_psi^2) + e_p^T P e_p)`.
    pub(super) fn information(&self, sight_m: Vector) -> Information {
        let squared_m2 = sight_m.norm_squared();
        let distance_m = squared_m2.sqrt();
        // The pieces of a curve end at the greatest range, but for rounding.
        if squared_m2 == 0.0 || distance_m > self.max_range_m * (1.0 + 1e-9) {
            return Information::default();
        }
        let (x2, y2, xy) = (sight_m.x * sight_m.x, sight_m.y * sight_m.y, sight_m.x * sight_m.y);
        let doubled = Vector::new(x2 - y2, 2.0 * xy) * (1.0 / squared_m2);
        let p = &self.position_m2;
        let across = 2.0 * xy * p[(0, 1)];
        let along_m2 = (x2 * p[(0, 0)] + across + y2 * p[(1, 1)]) / squared_m2;
        let across_m2 = (y2 * p[(0, 0)] - across + x2 * p[(1, 1)]) / squared_m2;
        let range = self.range.map_or(0.0, |(std_m, std_per_m)| {
            let std_m = std_m + std_per_m * distance_m;
            1.0 / (std_m * std_m + along_m2)
        });
        let bearing = self.bearing_rad2.map_or(0.0, |rad2| 1.0 / (squared_m2 * rad2 + across_m2));
        Information { t: range + bearing, s: doubled * (range - bearing) }
    }

    /// True if it measures nothing farther away than this, m.
    pub(super) fn max_range_m(&self) -> f64 {
        self.max_range_m
    }
}
