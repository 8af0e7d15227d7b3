//! Where a robot may be after the step, and the arc of bearings that this leaves it.

use std::f64::consts::{FRAC_PI_2, PI};
use std::ops::Range;

use rangehound_shared::ROBOTS_MAX;
use rangehound_shared::scenario::Clearance;

use super::TeamMember;
use super::arm::Arm;
use super::vector::Vector;

/// Corners of the polygon that stands for the disc of a robot with neighbours: its inradius, and so
/// the speed given away at worst, is 0.2 % less.
const DISC_CORNERS: usize = 48;

/// A place nearer to the predicted target than this, in steps, has no bearing worth the name.
const ON_TARGET: f64 = 1e-6;

/// A stand-off that is kept but for this share of it is kept.
const ROUNDED: f64 = 1e-12;

/// A target whose distance is one step but for this share of it is exactly one step away.
const ONE_STEP: f64 = 1e-12;

/// One robot's next step in the plane.
///
/// Bearings are written as offsets from the line of sight; a place after the step is named by its
/// bearing `b` and its signed distance `rho` to the predicted target: `target - rho b`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Reach {
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
enum Room {
    /// All within its step.
    Disc,
    /// A convex polygon: the part of the disc that its neighbours leave it.
    Cell(Range<usize>),
    /// One place only: it is closer to another than it should be, and moves out.
    Out(Vector),
}

impl Reach {
    pub(super) fn new(member: &TeamMember, target_m: Vector, time_step_s: f64, stand_off_m: f64) -> Self {
        let to_target_m = target_m - member.position_m;
        let step_m = member.max_speed_mps * time_step_s;
        Self {
            to_target_m,
            sight: to_target_m.normalised().unwrap_or(Vector::new(1.0, 0.0)),
            step_m,
            speed_mps: member.max_speed_mps,
            // What is less than the room that every bearing needs is kept without being asked for.
            stand_off_m: if stand_off_m < ON_TARGET * step_m { 0.0 } else { stand_off_m },
            room: Room::Disc,
        }
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

    /// Half-width `eta` of the bearings round the line of sight as a unit vector, less than a quarter
    /// turn; `None` if all bearings can be had.
    fn half_width(&self) -> Option<Vector> {
        let (d, r, s) = (self.to_target_m.norm(), self.step_m, self.stand_off_m);
        if d == 0.0 {
            // On the target all ways out are alike.
            (r == 0.0).then_some(Vector::new(1.0, 0.0))
        } else if s == 0.0 && (d - r).abs() <= ONE_STEP * r {
            // All bearings but the one across, which only the target itself would have.
            Some(Vector::new(ON_TARGET, ((1.0 - ON_TARGET) * (1.0 + ON_TARGET)).sqrt()))
        } else if s >= d + r {
            // Straight out is all that is left.
            Some(Vector::new(1.0, 0.0))
        } else if d > r && s * s <= (d - r) * (d + r) {
            // Eq. 18: the tangents from the target to the disc.
            let sin = r / d;
            Some(Vector::new(((1.0 - sin) * (1.0 + sin)).sqrt(), sin))
        } else if s <= r - d {
            None
        } else {
            // Where the disc's edge leaves the stand-off: triangle of sides d, s, r.
            let cos = ((d * d + s * s - r * r) / (2.0 * d * s)).min(1.0);
            (cos > 0.0).then(|| Vector::new(cos, ((1.0 - cos) * (1.0 + cos)).sqrt()))
        }
    }

    /// Heading, as a unit vector, and speed after which the predicted target bears along `direction` (a
    /// doubled bearing): of all places on that line the nearest to the target that the clearances
    /// allow, at full speed without them (Eq. 16).
    pub(super) fn motion(&self, direction: Vector, corners_m: &[Vector]) -> (Vector, f64) {
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
        // To end on the line through the target, the move's part across the bearing is given: xi.
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

    /// [`Self::motion`] in a cell; by itself, so that teams without neighbours need not fetch its code.
    #[inline(never)]
    fn motion_in_cell(&self, bearing: Vector, cell_m: &[Vector]) -> (Vector, f64) {
        let chord = self.chord(bearing, cell_m);
        let place = chord.map(|(near, far)| self.to_target_m - bearing * self.clear_of_target(near, far));
        // Rounding can make the line of an end of the arc miss the cell: then the corner nearest to it.
        let off_line = |corner: &Vector| bearing.cross(self.to_target_m - *corner).abs();
        let nearest = || cell_m.iter().min_by(|a, b| off_line(a).total_cmp(&off_line(b))).copied();
        self.motion_to(place.or_else(nearest).unwrap_or_default())
    }

    /// Of the distances from `near_m` to `far_m` (negative beyond the target) the least that keeps the
    /// stand-off, on this side of the target if it can be; the farthest if none does.
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

    fn motion_to(&self, offset_m: Vector) -> (Vector, f64) {
        let length_m = offset_m.norm();
        let heading = offset_m.normalised().unwrap_or(self.sight);
        (heading, if self.step_m > 0.0 { self.speed_mps * (length_m / self.step_m).min(1.0) } else { 0.0 })
    }

    /// Doubled bearing to the predicted target after a move at full speed along this heading (Eqs. 7, 8).
    pub(super) fn direction_after(&self, heading: Vector) -> Vector {
        let sight_m = self.to_target_m - heading * self.step_m;
        sight_m.normalised().unwrap_or(Vector::new(1.0, 0.0)).doubled()
    }

    /// True if a move at full speed along this heading keeps all clearances.
    pub(super) fn is_clear_after(&self, heading: Vector, corners_m: &[Vector]) -> bool {
        let offset_m = heading * self.step_m;
        let keeps_off = (self.to_target_m - offset_m).norm() >= self.stand_off_m;
        match &self.room {
            Room::Disc => keeps_off,
            Room::Cell(corners) => keeps_off && is_inside(&corners_m[corners.clone()], offset_m),
            Room::Out(_) => false,
        }
    }

    /// Clips the room by what the neighbours leave: the buffered Voronoi cell. Appends its corners.
    pub(super) fn separate(
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
                corners_m.extend(
                    (0..DISC_CORNERS)
                        .map(|k| Vector::from_angle(2.0 * PI * k as f64 / DISC_CORNERS as f64) * self.step_m),
                );
            }
            away += limit.normal * limit.offset_m.min(0.0);
            clip(corners_m, start, limit, scratch_m);
        }
        if !is_limited {
            return;
        }
        // The stand-off that it has, it keeps; who is inside comes no nearer.
        let kept_m = self.stand_off_m.min(self.to_target_m.norm());
        let keeps_off = |place_m: Vector| (self.to_target_m - place_m).norm() >= kept_m;
        self.room = if corners_m[start..].iter().any(|corner| keeps_off(*corner)) {
            Room::Cell(start..corners_m.len())
        } else {
            corners_m.truncate(start);
            Room::Out(self.way_out(limits, away.normalised().unwrap_or_default(), kept_m))
        };
    }

    /// Where to go if the room that the neighbours leave cannot be reached, or is all too near the target: of the way straight
    /// out of them, which ends at the stand-off, and both ways along the stand-off, the one that comes nearest to that
    /// room. None goes into another's.
    fn way_out(&self, limits: impl Iterator<Item = Limit> + Clone, away: Vector, kept_m: f64) -> Vector {
        // The limits that a move in this direction meets, and how far it may go.
        let free_m = |along: Vector, most_m: f64| {
            let met = limits.clone().filter(|limit| limit.normal.dot(along) > 0.0);
            met.fold(most_m, |free, limit| free.min(limit.offset_m.max(0.0) / limit.normal.dot(along)))
        };
        let worst_m = |place_m: Vector| {
            let over_m = limits.clone().map(|limit| limit.normal.dot(place_m) - limit.offset_m);
            over_m.fold(f64::NEG_INFINITY, f64::max)
        };
        // As far as the worst of them asks for, but not into another.
        let straight = away * worst_m(Vector::default()).max(0.0).min(free_m(away, self.step_m));
        let mut best = Vector::default();
        let mut consider = |place_m: Vector| {
            let is_clear = (self.to_target_m - place_m).norm() >= kept_m * (1.0 - ROUNDED);
            if is_clear && worst_m(place_m) < worst_m(best) {
                best = place_m;
            }
        };
        consider(self.up_to_the_stand_off(straight, kept_m));
        // Where the step ends on the stand-off: triangle of sides d, kept, r.
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

    /// The part of a move before it comes nearer to the target than `kept_m`.
    fn up_to_the_stand_off(&self, move_m: Vector, kept_m: f64) -> Vector {
        let (a, b) = (move_m.norm_squared(), move_m.dot(self.to_target_m));
        let c = (self.to_target_m.norm_squared() - kept_m * kept_m).max(0.0);
        let discriminant = b * b - a * c;
        if b <= 0.0 || discriminant <= 0.0 {
            return move_m;
        }
        move_m * (c / (b + discriminant.sqrt())).min(1.0)
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

    /// The arc of the bearings at which the cell has a place clear of the target: of several such arcs
    /// the one nearest to the line of sight. If there is none, the bearing of the farthest corner.
    #[inline(never)]
    fn arm_of_cell(&self, lambda: f64, cell_m: &[Vector]) -> Arm {
        // Offsets from the line of sight between which nothing changes, in order.
        let mut marks = [FRAC_PI_2; 3 * (DISC_CORNERS + ROBOTS_MAX)];
        let mut count = 0;
        let mut mark = |place_m: Vector| {
            let bearing = (self.to_target_m - place_m).rotated_by(self.sight.conjugate());
            if count + 2 < marks.len() && bearing != Vector::default() {
                // Bearings count modulo half a turn.
                marks[count] = (bearing.y / bearing.x).atan();
                count += 1;
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
        marks[count] = -FRAC_PI_2;
        count += 2;
        let marks = &mut marks[..count];
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

/// A half-plane that a robot stays in: `normal . offset <= offset_m`, offset from where it is.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limit {
    normal: Vector,
    offset_m: f64,
}

impl Limit {
    /// What robot `me` leaves to its neighbour `other`: half of the room between them, less half of the
    /// separation. While both keep to it they stay apart; where they are too close, both move out.
    pub(super) fn between(me: (usize, Vector), other: (usize, Vector), separation_m: f64, robots: usize) -> Self {
        let apart = other.1 - me.1;
        let distance_m = apart.norm();
        // On one spot, each has a way out of its own.
        let spoke = |id: usize| Vector::from_angle(2.0 * PI * id as f64 / robots as f64);
        let normal = apart.normalised().or_else(|| (spoke(other.0) - spoke(me.0)).normalised());
        Self { normal: normal.unwrap_or(Vector::new(1.0, 0.0)), offset_m: 0.5 * (distance_m - separation_m) }
    }
}

/// The clearance that counts at this step: the least distance to the target, m.
pub(super) fn stand_off_m(clearance: &Clearance, position_trace_m2: f64) -> f64 {
    clearance.stand_off_m.max(clearance.stand_off_sigma * position_trace_m2.max(0.0).sqrt())
}

fn edges(polygon: &[Vector]) -> impl Iterator<Item = (Vector, Vector)> {
    polygon.iter().copied().zip(polygon.iter().copied().cycle().skip(1))
}

fn is_inside(polygon: &[Vector], place: Vector) -> bool {
    edges(polygon).all(|(corner, next)| (next - corner).cross(place - corner) >= 0.0)
}

/// Cuts off the part of the polygon `corners[start..]` that is beyond the limit.
fn clip(corners: &mut Vec<Vector>, start: usize, limit: Limit, scratch: &mut Vec<Vector>) {
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

#[cfg(test)]
mod tests {
    use super::super::Extent;
    use super::*;
    use proptest::prelude::*;

    const DT_S: f64 = 0.1;

    fn reach(x: f64, y: f64, speed_mps: f64, stand_off_m: f64) -> Reach {
        let member = TeamMember { position_m: Vector::new(x, y), max_speed_mps: speed_mps, range_std_m: 1.0 };
        Reach::new(&member, Vector::default(), DT_S, stand_off_m)
    }

    /// From where the robot is after this motion to the target.
    fn sight_after(reach: &Reach, (heading, speed_mps): (Vector, f64)) -> Vector {
        reach.to_target_m - heading * (speed_mps * DT_S)
    }

    /// A direction in the arc: -1 is its clockwise end, 1 the other.
    fn direction_at(arm: &Arm, fraction: f64) -> Vector {
        let half_rad = match arm.extent {
            Extent::Circle => PI,
            Extent::Narrow => arm.low.cross(arm.centre).atan2(arm.low.dot(arm.centre)),
            Extent::Wide => PI - (-arm.centre).cross(arm.low).atan2((-arm.centre).dot(arm.low)).abs(),
        };
        arm.centre.rotated_by(Vector::from_angle(fraction * half_rad))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2_000))]

        /// Eq. 16: the move ends on the line through the target along the bearing, at full speed.
        #[test]
        fn a_heading_realises_its_bearing(
            x in -30.0..30.0_f64, y in -30.0..30.0_f64, speed in 0.0..200.0_f64, fraction in -1.0..1.0_f64,
        ) {
            let reach = reach(x, y, speed, 0.0);
            let direction = direction_at(&reach.arm(1.0, &[]), fraction);
            let motion = reach.motion(direction, &[]);
            prop_assert!((motion.0.norm() - 1.0).abs() < 1e-9);
            prop_assert_eq!(motion.1, speed);
            // The bearing is ill-defined where the step ends on the target itself.
            let sight_m = sight_after(&reach, motion);
            let after = sight_m.normalised().unwrap_or(direction).doubled();
            prop_assert!((after - direction).norm() * sight_m.norm() < 1e-6, "{after:?} {direction:?}");
        }

        /// Whatever its bearing in the arc, a robot ends outside the stand-off if it can get there.
        #[test]
        fn every_bearing_of_the_arc_keeps_the_stand_off(
            distance in 0.0..12.0_f64, angle in -PI..PI, speed in 0.1..60.0_f64, stand_off in 0.1..10.0_f64,
            fraction in -1.0..=1.0_f64,
        ) {
            let at = Vector::from_angle(angle) * distance;
            let reach = reach(at.x, at.y, speed, stand_off);
            let direction = direction_at(&reach.arm(1.0, &[]), fraction);
            let motion = reach.motion(direction, &[]);
            prop_assert!(motion.1 <= speed);
            let sight_m = sight_after(&reach, motion);
            let most_m = stand_off.min(distance + reach.step_m);
            prop_assert!(sight_m.norm() >= most_m - 1e-9, "{} {}", sight_m.norm(), most_m);
            let after = sight_m.normalised().unwrap_or(direction).doubled();
            prop_assert!((after - direction).norm() < 1e-6, "{after:?} {direction:?}");
        }

        /// No place that the robot can get to outside the stand-off has a bearing outside the arc.
        #[test]
        fn the_arc_leaves_nothing_out(
            distance in 0.1..12.0_f64, speed in 0.1..60.0_f64, kept in 0.0..1.0_f64,
            heading in -PI..PI, share in 0.0..1.0_f64,
        ) {
            let motion = (Vector::from_angle(heading), speed * share);
            let sight_m = sight_after(&reach(distance, 0.0, speed, 0.0), motion);
            let arm = reach(distance, 0.0, speed, kept * sight_m.norm()).arm(1.0, &[]);
            let direction = sight_m.normalised().unwrap_or(arm.centre).doubled();
            prop_assert!((arm.nearest(direction, direction) - direction).norm() < 1e-6, "{arm:?} {direction:?}");
        }

        /// Neighbours that are apart stay apart, and such that are too close do not come closer.
        #[test]
        fn robots_stay_apart(
            places in proptest::collection::vec((-4.0..4.0_f64, -4.0..4.0_f64), 2..9),
            fractions in proptest::collection::vec(-1.0..=1.0_f64, 8),
            separation in 0.1..2.0_f64, stand_off in prop_oneof![Just(0.0), 0.5..4.0_f64], speed in 1.0..30.0_f64,
        ) {
            let mut problem = super::super::Problem::default();
            let clearance = Clearance { stand_off_m: stand_off, stand_off_sigma: 0.0, separation_m: separation };
            let positions: Vec<Vector> = places.iter().map(|&(x, y)| Vector::new(x, y)).collect();
            let (prior, target) = (nalgebra::Matrix2::identity(), Vector::new(0.3, 0.2));
            problem.pose(&prior, target, DT_S, &clearance, positions.iter().map(|&position_m| TeamMember {
                position_m, max_speed_mps: speed, range_std_m: 1.0,
            }));
            let ends: Vec<Vector> = positions.iter().enumerate().map(|(i, at)| {
                let direction = direction_at(&problem.arms()[i], fractions[i]);
                let (heading, speed_mps) = problem.motion(i, direction);
                *at + heading * (speed_mps * DT_S)
            }).collect();
            // Who is too close to another gets out of that as far as the others leave room.
            let crowded = positions.iter().enumerate().any(|(k, at)| {
                positions[..k].iter().any(|other| (*at - *other).norm() < separation)
            });
            for i in 0..ends.len() {
                let (before_m, after_m) = ((target - positions[i]).norm(), (target - ends[i]).norm());
                prop_assert!(after_m >= stand_off.min(before_m) - 1e-9, "{i}: {before_m} {after_m}");
                for j in 0..i {
                    let (before_m, after_m) = ((positions[i] - positions[j]).norm(), (ends[i] - ends[j]).norm());
                    // Even where they are many, and near the target.
                    prop_assert!(after_m >= separation.min(before_m) - 1e-9, "{i} {j}: {before_m} {after_m}");
                    if crowded && ends.len() == 2 && stand_off == 0.0 {
                        prop_assert!(after_m >= separation.min(before_m + 2.0 * speed * DT_S * 0.997) - 1e-9);
                    }
                }
            }
        }
    }

    /// Two robots that are too close, the one between the other and the target.
    #[test]
    fn who_makes_way_keeps_the_stand_off_that_it_had() {
        let mut positions_m = [Vector::new(5.2, 0.0), Vector::new(6.2, 0.0)];
        let clearance = Clearance { stand_off_m: 5.0, stand_off_sigma: 0.0, separation_m: 4.0 };
        let mut problem = super::super::Problem::default();
        for _ in 0..20 {
            let team = positions_m.map(|position_m| TeamMember { position_m, max_speed_mps: 10.0, range_std_m: 1.0 });
            problem.pose(&nalgebra::Matrix2::identity(), Vector::default(), DT_S, &clearance, team);
            for (i, position_m) in positions_m.iter_mut().enumerate() {
                let (heading, speed_mps) = problem.motion(i, problem.arms()[i].centre);
                *position_m += heading * (speed_mps * DT_S);
                assert!(position_m.norm() >= 5.0 - 1e-9, "{i}: {position_m:?}");
            }
        }
        assert!((positions_m[0] - positions_m[1]).norm() >= 4.0 - 1e-9, "{positions_m:?}");
    }

    /// A stand-off of next to nothing is none: what the arc says is what the motion leads to.
    #[test]
    fn a_stand_off_of_next_to_nothing_changes_nothing() {
        for stand_off_m in [1e-300, 1e-15, 1e-9, 1e-6, 1e-4] {
            let reach = reach(0.3, 0.1, 10.0, stand_off_m);
            let arm = reach.arm(1.0, &[]);
            for k in 0..=40 {
                let direction = direction_at(&arm, f64::from(k) / 20.0 - 1.0);
                let sight_m = sight_after(&reach, reach.motion(direction, &[]));
                assert!(sight_m.norm() >= stand_off_m - 1e-9);
                let after = sight_m.normalised().unwrap().doubled();
                assert!((after - direction).norm() < 1e-8, "{stand_off_m}: {after:?} {direction:?}");
            }
        }
    }

    #[test]
    fn of_the_two_headings_the_nearer_end_is_taken() {
        let reach = reach(-3.0, 0.0, 10.0, 0.0);
        let bearing = Vector::from_angle(0.2);
        let end_m = sight_after(&reach, reach.motion(bearing.doubled(), &[])).norm();
        let xi = bearing.cross(reach.to_target_m) / reach.step_m;
        let other_end = sight_after(&reach, (Vector::from_angle(0.2 + PI - xi.asin()), 10.0));
        assert!(bearing.cross(other_end).abs() < 1e-12, "the other solution is a solution");
        assert!(end_m < other_end.norm());
    }

    #[test]
    fn a_robot_exactly_one_step_away_does_not_end_on_the_target() {
        let reach = reach(1.0, 0.0, 10.0, 0.0);
        let direction = Vector::from_angle(0.7);
        let sight_m = sight_after(&reach, reach.motion(direction, &[]));
        assert!((sight_m.normalised().unwrap().doubled() - direction).norm() < 1e-9, "{sight_m:?}");
    }

    #[test]
    fn a_robot_inside_the_stand_off_moves_straight_out() {
        let reach = reach(0.5, 0.0, 10.0, 4.0);
        let arm = reach.arm(1.0, &[]);
        assert_eq!(arm.low, arm.high);
        let (heading, speed_mps) = reach.motion(arm.centre, &[]);
        assert!((heading - Vector::new(1.0, 0.0)).norm() < 1e-12);
        assert_eq!(speed_mps, 10.0);
    }

    #[test]
    fn robots_on_one_spot_part_in_all_directions() {
        let mut problem = super::super::Problem::default();
        let clearance = Clearance { separation_m: 1.0, ..Clearance::default() };
        let start = TeamMember { position_m: Vector::new(15.0, 0.0), max_speed_mps: 10.0, range_std_m: 1.0 };
        problem.pose(&nalgebra::Matrix2::identity(), Vector::default(), DT_S, &clearance, [start; 5]);
        let ends: Vec<Vector> = (0..5)
            .map(|i| {
                let (heading, speed_mps) = problem.motion(i, problem.arms()[i].centre);
                heading * (speed_mps * DT_S)
            })
            .collect();
        for i in 0..5 {
            for j in 0..i {
                assert!((ends[i] - ends[j]).norm() > 0.9, "{ends:?}");
            }
        }
    }
}
