//! The places that a robot can reach in a step, and the resulting arc of bearings.
//!
//! Without neighbours the places are a disc less the stand-off: this file. With neighbours they are a cell: [`cell`].
//! [`separation`] computes the cell.

mod cell;
mod polygon;
mod separation;

use std::ops::Range;

use rangehound_shared::message::Command;
use rangehound_shared::scenario::Clearance;

use super::arm::Arm;
use crate::planner::TeamMember;
use crate::vector::Vector;
pub(in crate::planner) use polygon::{Limit, is_inside};

/// A place nearer to the predicted target than this, in steps, has a degenerate bearing.
const ON_TARGET: f64 = 1e-6;

/// A target counts as exactly one step away if its distance differs from the step by at most this share.
const ONE_STEP: f64 = 1e-12;

/// One robot's next step in the plane.
///
/// Bearings are written as offsets from the line of sight; a place after the step is named by its
/// bearing `b` and its signed distance `rho` to the predicted target: `target - rho b`.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::planner) struct Reach {
    /// From the robot to the predicted target, m.
    pub to_target_m: Vector,
    /// The same with length one; (1, 0) if the robot is on the target.
    pub sight: Vector,
    /// How far it can move, `r = v dt`, m.
    pub step_m: f64,
    /// Its speed limit, m/s.
    pub speed_mps: f64,
    /// Least distance to the predicted target after the step, m; 0 in the paper.
    stand_off_m: f64,
    room: Room,
}

/// The places that the robot can get to, relative to where it is.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::planner) enum Room {
    /// All within its step.
    Disc,
    /// A convex polygon: the part of the disc that its neighbours leave it.
    Cell(Range<usize>),
    /// One place only: it is closer to another than it should be, and moves out.
    Out(Vector),
}

impl Reach {
    pub(in crate::planner) fn new(member: &TeamMember, target_m: Vector, time_step_s: f64, stand_off_m: f64) -> Self {
        let to_target_m = target_m - member.position_m;
        let step_m = member.max_speed_mps * time_step_s;
        Self {
            to_target_m,
            sight: to_target_m.normalised().unwrap_or(Vector::new(1.0, 0.0)),
            step_m,
            speed_mps: member.max_speed_mps,
            // Every bearing needs this much room anyway: a smaller clearance has no effect.
            stand_off_m: if stand_off_m < ON_TARGET * step_m { 0.0 } else { stand_off_m },
            room: Room::Disc,
        }
    }

    /// Least distance to the predicted target after the step, m.
    pub(in crate::planner) fn stand_off_m(&self) -> f64 {
        self.stand_off_m
    }

    /// The places that the robot can get to.
    pub(in crate::planner) fn room(&self) -> &Room {
        &self.room
    }

    /// Constraint (18), narrowed by the clearances: the bearings that the robot can have after the step.
    pub(super) fn arm(&self, lambda: f64, corners_m: &[Vector]) -> Arm {
        let centre = self.sight.doubled();
        match &self.room {
            Room::Disc => match self.half_width() {
                Some(half_width) => Arm::with_half_width(lambda, centre, half_width.doubled()),
                None => Arm::circle(lambda, centre),
            },
            Room::Cell(corners) => self.arm_of_cell(lambda, &corners_m[corners.clone()]),
            Room::Out(offset_m) => {
                let after = (self.to_target_m - *offset_m).normalised().unwrap_or(self.sight);
                Arm::with_half_width(lambda, after.doubled(), Vector::new(1.0, 0.0))
            }
        }
    }

    /// True without a line of sight now and after the step: at rest on the target.
    pub(super) fn is_blind(&self) -> bool {
        self.to_target_m == Vector::default() && self.step_m == 0.0
    }

    /// Half-width `eta` of the bearings round the line of sight as a unit vector, less than a quarter turn; `None` if
    /// all bearings are possible.
    fn half_width(&self) -> Option<Vector> {
        let (d, r, s) = (self.to_target_m.norm(), self.step_m, self.stand_off_m);
        if d == 0.0 {
            // On the target all directions are equivalent.
            (r == 0.0).then_some(Vector::new(1.0, 0.0))
        } else if s == 0.0 && (d - r).abs() <= ONE_STEP * r {
            // All bearings except the perpendicular one, which only the target's own position would have.
            Some(Vector::new(ON_TARGET, ((1.0 - ON_TARGET) * (1.0 + ON_TARGET)).sqrt()))
        } else if s >= d + r {
            // Only the motion straight away from the target is left.
            Some(Vector::new(1.0, 0.0))
        } else if d > r && s * s <= (d - r) * (d + r) {
            // Eq. 18: the tangents from the target to the disc.
            let sin = r / d;
            Some(Vector::new(((1.0 - sin) * (1.0 + sin)).sqrt(), sin))
        } else if s <= r - d {
            None
        } else {
            // The edge of the disc meets the stand-off's circle: triangle of sides d, s, r.
            let cos = ((d * d + s * s - r * r) / (2.0 * d * s)).min(1.0);
            (cos > 0.0).then(|| Vector::new(cos, ((1.0 - cos) * (1.0 + cos)).sqrt()))
        }
    }

    /// The motion that leads to this doubled bearing.
    pub(super) fn command(&self, direction: Vector, corners_m: &[Vector]) -> Command {
        let (heading, speed_mps) = self.motion(direction, corners_m);
        Command { heading_rad: heading.angle_rad(), speed_mps }
    }

    /// Heading, as a unit vector, and speed after which the predicted target bears along `direction` (a doubled
    /// bearing). The robot goes to the place on that line nearest to the target that the clearances allow; without
    /// clearances, that is at full speed (Eq. 16).
    fn motion(&self, direction: Vector, corners_m: &[Vector]) -> (Vector, f64) {
        if self.step_m == 0.0 {
            return (self.sight, 0.0);
        }
        // The bearing within a quarter turn of the present one, from the doubled difference.
        let bearing = self.sight.rotated_by(direction.rotated_by(self.sight.doubled().conjugate()).halved());
        match &self.room {
            Room::Disc => self.motion_in_disc(bearing),
            Room::Cell(corners) => self.motion_in_cell(bearing, &corners_m[corners.clone()]),
            Room::Out(offset_m) => self.motion_to(*offset_m),
        }
    }

    fn motion_in_disc(&self, bearing: Vector) -> (Vector, f64) {
        // The move must end on the line through the target, so its component across the bearing is given: xi.
        let xi = (bearing.cross(self.to_target_m) / self.step_m).clamp(-1.0, 1.0);
        let along = ((1.0 - xi) * (1.0 + xi)).sqrt();
        let middle_m = bearing.dot(self.to_target_m);
        let half_m = along * self.step_m;
        let rho_m = self.clear_of_target(middle_m - half_m, middle_m + half_m);
        if rho_m == middle_m - half_m {
            (Vector::new(along, xi).rotated_by(bearing), self.speed_mps)
        } else if rho_m == middle_m + half_m {
            (Vector::new(-along, xi).rotated_by(bearing), self.speed_mps)
        } else {
            self.motion_to(self.to_target_m - bearing * rho_m)
        }
    }

    /// The least distance from `near_m` to `far_m` (negative beyond the target) that keeps the stand-off, on this side
    /// of the target if possible. If none keeps it, the farthest.
    fn clear_of_target(&self, near_m: f64, far_m: f64) -> f64 {
        let s = self.stand_off_m;
        if s == 0.0 && near_m.abs() <= ON_TARGET * self.step_m {
            // On the target there is no bearing.
            far_m
        } else if s == 0.0 || near_m >= s {
            near_m
        } else if far_m >= s {
            s
        } else if near_m <= -s {
            far_m.min(-s)
        } else if far_m >= -near_m {
            far_m
        } else {
            near_m
        }
    }

    /// Heading and speed that lead to this place, relative to where the robot is.
    pub(in crate::planner) fn motion_to(&self, offset_m: Vector) -> (Vector, f64) {
        let length_m = offset_m.norm();
        let heading = offset_m.normalised().unwrap_or(self.sight);
        (heading, if self.step_m > 0.0 { self.speed_mps * (length_m / self.step_m).min(1.0) } else { 0.0 })
    }

    /// Heading, as a unit vector, and speed of a move along this heading: at full speed if that keeps all clearances, else to the
    /// nearest bearing that does.
    pub(in crate::planner) fn motion_along(&self, heading: Vector, corners_m: &[Vector]) -> (Vector, f64) {
        if self.is_clear_after(heading, corners_m) {
            return (heading, self.speed_mps);
        }
        let arm = self.arm(1.0, corners_m);
        self.motion(arm.nearest(self.direction_after(heading * self.step_m), arm.centre), corners_m)
    }

    /// Doubled bearing to the predicted target after this way (Eqs. 7, 8).
    pub(super) fn direction_after(&self, way_m: Vector) -> Vector {
        let sight_m = self.to_target_m - way_m;
        sight_m.normalised().unwrap_or(Vector::new(1.0, 0.0)).doubled()
    }

    /// True if a move at full speed along this heading keeps all clearances.
    pub(super) fn is_clear_after(&self, heading: Vector, corners_m: &[Vector]) -> bool {
        let offset_m = heading * self.step_m;
        (self.to_target_m - offset_m).norm() >= self.stand_off_m && self.holds(offset_m, corners_m)
    }

    /// True if its neighbours leave it this place, relative to where it is and within its step.
    pub(in crate::planner) fn holds(&self, offset_m: Vector, corners_m: &[Vector]) -> bool {
        match &self.room {
            Room::Disc => true,
            Room::Cell(corners) => polygon::is_inside(&corners_m[corners.clone()], offset_m),
            Room::Out(_) => false,
        }
    }
}

/// The clearance that counts at this step: the least distance to the target, m.
pub(in crate::planner) fn stand_off_m(clearance: &Clearance, position_trace_m2: f64) -> f64 {
    clearance.stand_off_m.max(clearance.stand_off_sigma * position_trace_m2.max(0.0).sqrt())
}

#[cfg(test)]
mod tests;
