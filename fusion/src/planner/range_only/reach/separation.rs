//! The space that neighbours leave to a robot, and its way out if they leave none.

use std::f64::consts::PI;

use super::polygon::{Limit, clip, disc};
use super::{Reach, Room};
use crate::vector::Vector;

/// Relative tolerance of the stand-off.
const ROUNDED: f64 = 1e-12;

impl Limit {
    /// The limit that neighbour `other` sets to robot `me`: half of the distance between them, less half of the separation.
    /// While both respect it they keep the separation; if they are too close, it moves both apart.
    pub(in crate::planner) fn between(
        me: (usize, Vector),
        other: (usize, Vector),
        separation_m: f64,
        robots: usize,
    ) -> Self {
        let apart = other.1 - me.1;
        let distance_m = apart.norm();
        // Robots at the same place leave in different directions.
        let spoke = |id: usize| Vector::from_angle(2.0 * PI * id as f64 / robots as f64);
        let normal = apart.normalised().or_else(|| (spoke(other.0) - spoke(me.0)).normalised());
        Self { normal: normal.unwrap_or(Vector::new(1.0, 0.0)), offset_m: 0.5 * (distance_m - separation_m) }
    }
}

impl Reach {
    /// Clips the places to the buffered Voronoi cell that the neighbours leave. Appends its corners.
    pub(in crate::planner) fn separate(
        &mut self,
        limits: impl Iterator<Item = Limit> + Clone,
        corners_m: &mut Vec<Vector>,
        scratch_m: &mut Vec<Vector>,
    ) {
        let start = corners_m.len();
        let mut away = Vector::default();
        let mut is_limited = false;
        for limit in limits.clone().filter(|limit| limit.offset_m < self.step_m) {
            if !is_limited {
                is_limited = true;
                corners_m.extend(disc(self.step_m));
            }
            away += limit.normal * limit.offset_m.min(0.0);
            clip(corners_m, start, limit, scratch_m);
        }
        if !is_limited {
            return;
        }
        // A robot within the stand-off need not leave it, but comes no nearer.
        let kept_m = self.stand_off_m.min(self.to_target_m.norm());
        let keeps_off = |place_m: Vector| (self.to_target_m - place_m).norm() >= kept_m;
        self.room = if corners_m[start..].iter().any(|corner| keeps_off(*corner)) {
            Room::Cell(start..corners_m.len())
        } else {
            corners_m.truncate(start);
            Room::Out(self.way_out(limits, away.normalised().unwrap_or_default(), kept_m))
        };
    }

    /// Where to go if the cell cannot be reached, or lies within the stand-off. There are three candidates: straight away from
    /// the neighbours, up to the stand-off, and the two ends of the step on the stand-off's circle. The one that violates the
    /// limits least is taken. None violates a limit that is respected now.
    fn way_out(&self, limits: impl Iterator<Item = Limit> + Clone, away: Vector, kept_m: f64) -> Vector {
        // How far a move in this direction may go before it violates a limit.
        let free_m = |along: Vector, most_m: f64| {
            let met = limits.clone().filter(|limit| limit.normal.dot(along) > 0.0);
            met.fold(most_m, |free, limit| free.min(limit.offset_m.max(0.0) / limit.normal.dot(along)))
        };
        let worst_m = |place_m: Vector| {
            let over_m = limits.clone().map(|limit| limit.normal.dot(place_m) - limit.offset_m);
            over_m.fold(f64::NEG_INFINITY, f64::max)
        };
        // As far as the limit that is violated most asks for, but not beyond another one.
        let straight = away * worst_m(Vector::default()).max(0.0).min(free_m(away, self.step_m));
        let mut best = Vector::default();
        let mut consider = |place_m: Vector| {
            let is_clear = (self.to_target_m - place_m).norm() >= kept_m * (1.0 - ROUNDED);
            if is_clear && worst_m(place_m) < worst_m(best) {
                best = place_m;
            }
        };
        consider(self.up_to_the_stand_off(straight, kept_m));
        // The ends of the step on the stand-off's circle: triangle of sides d, kept, r.
        let (d, r) = (self.to_target_m.norm(), self.step_m);
        let cos = (d * d + kept_m * kept_m - r * r) / (2.0 * d * kept_m);
        if cos.abs() < 1.0 {
            let sin = ((1.0 - cos) * (1.0 + cos)).sqrt();
            for turn in [Vector::new(cos, sin), Vector::new(cos, -sin)] {
                let along = self.to_target_m - self.sight.rotated_by(turn) * kept_m;
                if free_m(along, 1.0) >= 1.0 {
                    consider(along);
                }
            }
        }
        best
    }

    /// The part of a move up to the point where it would come nearer to the target than `kept_m`.
    fn up_to_the_stand_off(&self, move_m: Vector, kept_m: f64) -> Vector {
        let (a, b) = (move_m.norm_squared(), move_m.dot(self.to_target_m));
        let c = (self.to_target_m.norm_squared() - kept_m * kept_m).max(0.0);
        let discriminant = b * b - a * c;
        if b <= 0.0 || discriminant <= 0.0 {
            return move_m;
        }
        move_m * (c / (b + discriminant.sqrt())).min(1.0)
    }
}
