//! Convex polygons, and the half-planes that cut them.

use std::f64::consts::PI;

use crate::vector::Vector;

/// Corners of the polygon that stands for the disc of a robot with neighbours: its inradius, and so
/// the speed given away at worst, is 0.2 % less.
pub(super) const DISC_CORNERS: usize = 48;

/// The polygon that stands for a disc round the robot.
pub(super) fn disc(radius_m: f64) -> impl Iterator<Item = Vector> {
    (0..DISC_CORNERS).map(move |k| Vector::from_angle(2.0 * PI * k as f64 / DISC_CORNERS as f64) * radius_m)
}

/// A half-plane that a robot stays in: `normal . offset <= offset_m`, offset from where it is.
#[derive(Debug, Clone, Copy)]
pub(in crate::planner) struct Limit {
    pub(super) normal: Vector,
    pub(super) offset_m: f64,
}

pub(super) fn edges(polygon: &[Vector]) -> impl Iterator<Item = (Vector, Vector)> {
    polygon.iter().copied().zip(polygon.iter().copied().cycle().skip(1))
}

pub(in crate::planner) fn is_inside(polygon: &[Vector], place: Vector) -> bool {
    edges(polygon).all(|(corner, next)| (next - corner).cross(place - corner) >= 0.0)
}

/// Cuts off the part of the polygon `corners[start..]` that is beyond the limit.
pub(super) fn clip(corners: &mut Vec<Vector>, start: usize, limit: Limit, scratch: &mut Vec<Vector>) {
    scratch.clear();
    scratch.extend_from_slice(&corners[start..]);
    corners.truncate(start);
    for (corner, next) in edges(scratch) {
        let (over, next_over) = (limit.normal.dot(corner) - limit.offset_m, limit.normal.dot(next) - limit.offset_m);
        if over <= 0.0 {
            corners.push(corner);
        }
        if over * next_over < 0.0 {
            corners.push(corner + (next - corner) * (over / (over - next_over)));
        }
    }
}
