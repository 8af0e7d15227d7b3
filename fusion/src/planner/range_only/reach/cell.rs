//! The cell of a robot with neighbours: a convex polygon within its disc.

use std::f64::consts::{FRAC_PI_2, PI};

use smallvec::SmallVec;

use super::Reach;
use super::polygon::{DISC_CORNERS, edges};
use crate::planner::range_only::arm::Arm;
use crate::vector::Vector;

/// Marks of a cell that fit without the heap: three for each corner, for a disc with up to 256 neighbours.
const MARKS: usize = 3 * (DISC_CORNERS + 256);

impl Reach {
    /// [`Self::motion`] in a cell. Not inlined, so that teams without neighbours do not load its code.
    #[inline(never)]
    pub(super) fn motion_in_cell(&self, bearing: Vector, cell_m: &[Vector]) -> (Vector, f64) {
        let chord = self.chord(bearing, cell_m);
        let place = chord.map(|(near, far)| self.to_target_m - bearing * self.clear_of_target(near, far));
        // Rounding can make the line of an end of the arc miss the cell: then the corner nearest to the line is taken.
        let off_line = |corner: &Vector| bearing.cross(self.to_target_m - *corner).abs();
        let nearest = || cell_m.iter().min_by(|a, b| off_line(a).total_cmp(&off_line(b))).copied();
        self.motion_to(place.or_else(nearest).unwrap_or_default())
    }

    /// Least and greatest signed distance to the target on the line of this bearing within the cell, if
    /// the line meets it.
    fn chord(&self, bearing: Vector, cell_m: &[Vector]) -> Option<(f64, f64)> {
        let (mut near_m, mut far_m) = (f64::INFINITY, f64::NEG_INFINITY);
        for (corner, next) in edges(cell_m) {
            let (from, to) = (self.to_target_m - corner, self.to_target_m - next);
            let (side, next_side) = (bearing.cross(from), bearing.cross(to));
            if side * next_side > 0.0 {
                continue;
            }
            let share = if side == next_side { 0.0 } else { side / (side - next_side) };
            let rho_m = bearing.dot(from + (to - from) * share);
            near_m = near_m.min(rho_m);
            far_m = far_m.max(rho_m);
        }
        (near_m <= far_m).then_some((near_m, far_m))
    }

    /// The arc of the bearings for which the cell has a place outside the stand-off. Of several such arcs, the one
    /// nearest to the line of sight; without any, the bearing of the corner farthest from the target.
    #[inline(never)]
    pub(super) fn arm_of_cell(&self, lambda: f64, cell_m: &[Vector]) -> Arm {
        // Angles from the line of sight, in order. Between two of them, the answer is the same for all bearings.
        let mut marks: SmallVec<[f64; MARKS]> = SmallVec::new();
        let mut mark = |place_m: Vector| {
            let bearing = (self.to_target_m - place_m).rotated_by(self.sight.conjugate());
            if bearing != Vector::default() {
                // Bearings count modulo half a turn.
                marks.push((bearing.y / bearing.x).atan());
            }
        };
        let s = self.stand_off_m;
        for (corner, next) in edges(cell_m) {
            if (self.to_target_m - corner).norm() >= s {
                mark(corner);
            }
            let (from, along) = (self.to_target_m - corner, next - corner);
            let (a, b, c) = (along.norm_squared(), -from.dot(along), from.norm_squared() - s * s);
            let discriminant = b * b - a * c;
            if discriminant > 0.0 && a > 0.0 {
                for share in [(-b - discriminant.sqrt()) / a, (-b + discriminant.sqrt()) / a] {
                    if (0.0..=1.0).contains(&share) {
                        mark(corner + along * share);
                    }
                }
            }
        }
        marks.extend([-FRAC_PI_2, FRAC_PI_2]);
        marks.sort_unstable_by(f64::total_cmp);
        let is_clear = |offset_rad: f64| {
            let chord = self.chord(self.sight.rotated_by(Vector::from_angle(offset_rad)), cell_m);
            chord.is_some_and(|(near_m, far_m)| far_m >= s || near_m <= -s)
        };
        let mut best: Option<(f64, f64)> = None;
        let mut open: Option<(f64, f64)> = None;
        for pair in marks.windows(2) {
            let (from, to) = (pair[0], pair[1]);
            if to <= from {
                continue;
            }
            if is_clear(0.5 * (from + to)) {
                open = Some((open.map_or(from, |(start, _)| start), to));
                let near_zero =
                    |(low, high): (f64, f64)| if low <= 0.0 && high >= 0.0 { 0.0 } else { low.abs().min(high.abs()) };
                if best.is_none_or(|known| near_zero(open.unwrap_or(known)) <= near_zero(known)) {
                    best = open;
                }
            } else {
                open = None;
            }
        }
        match best {
            Some((low, high)) if high - low >= PI - 1e-12 => Arm::circle(lambda, self.sight.doubled()),
            Some((low, high)) => {
                let middle = self.sight.rotated_by(Vector::from_angle(0.5 * (low + high))).doubled();
                Arm::with_half_width(lambda, middle, Vector::from_angle(high - low))
            }
            None => {
                let farthest = cell_m.iter().map(|corner| self.to_target_m - *corner);
                let farthest = farthest.max_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared()));
                let bearing = farthest.and_then(Vector::normalised).unwrap_or(self.sight);
                Arm::with_half_width(lambda, bearing.doubled(), Vector::new(1.0, 0.0))
            }
        }
    }
}
