//! One robot's curve: the places from which its measurement can tell most.
//!
//! On each ray from the target a measurement tells the more the nearer it is taken, in the Loewner order: neither
//! `1 / (sigma_r(d)^2 + e^T P e)` nor `1 / (d^2 sigma_b^2 + e_p^T P e_p)` grows with the distance. So of all places that the
//! robot can reach those remain that are nearest to the target on their ray and keep the stand-off: the near side of the
//! edge, and the stand-off's circle.

use std::f64::consts::PI;

use smallvec::SmallVec;

use super::information::Information;
use super::leaf::Leaf;
use super::noise::{Noise, is_in_view};
use super::piece::Piece;
use crate::planner::TeamMember;
use crate::planner::range_only::reach::{Reach, Room};
use crate::vector::Vector;

/// Least distance to the target for which it is planned, in steps: on the target there is no direction.
const NEAREST: f64 = 1e-6;

/// The same for a bearing from a known place: from next to the target it would tell everything.
const NEAREST_BEARING: f64 = 1e-2;

/// Samples of a piece at which the field of view is checked; between two of them its end is bisected.
const VIEWS: usize = 16;

/// From one piece's parameter to the next one's.
const PIECE: f64 = 2.0;

/// Robots without neighbours have few pieces, which need no heap.
type Pieces = SmallVec<[Piece; 8]>;

/// The places that count for one robot. Their parameter goes from 0 to 1 in the first piece, from 2 to 3 in the second, and
/// so on. Pieces need not touch: a number between two of them is a place of neither.
#[derive(Debug, Clone)]
pub(super) struct Curve {
    pub(super) pieces: Pieces,
    pub(super) noise: Noise,
    /// Of each piece.
    pub(super) leaves: SmallVec<[Leaf; 8]>,
    /// No place has a lesser `T`.
    pub(super) least_t: f64,
}

impl Curve {
    /// The curve of a robot with this reach; `corners_m` are the corners of all cells.
    pub(super) fn of(member: &TeamMember, reach: &Reach, corners_m: &[Vector]) -> Self {
        let (pieces, noise, leaves) = (Pieces::new(), Noise::of(member), SmallVec::new());
        let mut curve = Self { pieces, noise, leaves, least_t: 0.0 };
        curve.pose(member, reach, corners_m);
        curve
    }

    /// Becomes the curve of a robot, in the memory that it has: curves are too large to be moved about.
    pub(super) fn pose(&mut self, member: &TeamMember, reach: &Reach, corners_m: &[Vector]) {
        self.noise = Noise::of(member);
        let nearest = if self.noise.is_bounded() { NEAREST } else { NEAREST_BEARING };
        let stand_off_m = reach.stand_off_m().max(nearest * reach.step_m);
        let pieces = &mut self.pieces;
        places(reach, corners_m, stand_off_m, pieces);
        if member.sensor.reach_m().is_finite() {
            restrict(pieces, |piece| piece.parts_within(member.sensor.reach_m()).collect());
        }
        if member.sensor.view_rad() < 2.0 * PI && reach.step_m > 0.0 {
            let half_rad = 0.5 * member.sensor.view_rad();
            restrict(pieces, |piece| parts_in_view(piece, reach.to_target_m, half_rad));
        }
        // A place on the target has no direction.
        if pieces.iter().all(|piece| piece.square == [0.0; 3]) {
            // It sees nothing after any step, and comes as near as it may, to see later.
            places(reach, corners_m, stand_off_m, pieces);
            self.blind(reach);
        }
        self.leaves.clear();
        self.leaves.extend(self.pieces.iter().map(|piece| Leaf::of(&self.noise, piece)));
        self.least_t = self.leaves.iter().map(Leaf::least_t).fold(f64::INFINITY, f64::min);
    }

    fn blind(&mut self, reach: &Reach) {
        let ends = self.pieces.iter().flat_map(|piece| [0.0, 0.5, 1.0].map(|u| piece.sight_m(u)));
        let nearest = ends.min_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared())).unwrap_or(reach.to_target_m);
        self.pieces.clear();
        self.pieces.push(point(nearest));
        self.noise = self.noise.nothing();
    }

    /// The end of the parameter's interval, which begins at 0.
    pub(super) fn end(&self) -> f64 {
        PIECE * (self.pieces.len() - 1) as f64 + 1.0
    }

    /// The piece at a parameter, and the parameter within it.
    pub(super) fn piece_at(&self, at: f64) -> (usize, f64) {
        let index = ((at.max(0.0) / PIECE) as usize).min(self.pieces.len() - 1);
        (index, (at - Self::base(index)).clamp(0.0, 1.0))
    }

    /// The end of the part before a parameter and the start of the part after it: none of them is a single place.
    pub(super) fn cut_at(&self, at: f64) -> (f64, f64) {
        let (index, u) = self.piece_at(at);
        let base = Self::base(index);
        match u {
            0.0 if index > 0 => (base - PIECE + 1.0, base),
            1.0 => (base + 1.0, base + PIECE),
            _ => (base + u, base + u),
        }
    }

    /// The parameter at which a piece begins.
    pub(super) fn base(piece: usize) -> f64 {
        PIECE * piece as f64
    }

    /// From the place at a parameter to the target, m.
    pub(super) fn sight_m(&self, at: f64) -> Vector {
        let (index, u) = self.piece_at(at);
        self.pieces[index].sight_m(u)
    }

    /// The information of a measurement from the place at a parameter.
    pub(super) fn information(&self, at: f64) -> Information {
        let (index, u) = self.piece_at(at);
        self.information_on(index, u)
    }

    /// The same for a place of a piece.
    #[inline]
    pub(super) fn information_on(&self, piece: usize, u: f64) -> Information {
        let (p, w) = self.pieces[piece].at(u);
        self.noise.information_over(p, w)
    }

    /// The same and its derivative.
    #[inline]
    pub(super) fn information_along(&self, piece: usize, u: f64) -> (Information, Information) {
        let (p, w) = self.pieces[piece].at(u);
        let (dp, dw) = self.pieces[piece].change_at(u);
        self.noise.information_along(p, w, dp, dw)
    }

    /// True if a piece begins where the one before it ends.
    pub(super) fn touches(&self, piece: usize) -> bool {
        piece > 0 && {
            let (end, start) = (self.pieces[piece - 1].sight_m(1.0), self.pieces[piece].sight_m(0.0));
            (end - start).norm_squared() <= 1e-18 * start.norm_squared()
        }
    }

    /// The parameter of the place nearest to the straight way to the target.
    pub(super) fn straight(&self, sight: Vector) -> f64 {
        let places = (0..self.pieces.len()).flat_map(|index| [0.0, 0.5, 1.0].map(|u| Self::base(index) + u));
        let turned = |at: &f64| self.sight_m(*at).normalised().map_or(1.0, |after| -after.dot(sight));
        places.min_by(|a, b| turned(a).total_cmp(&turned(b))).unwrap_or(0.0)
    }
}

/// The near side of the edge of the places that a robot can reach, as far as it keeps the stand-off, and the stand-off's
/// circle within them.
fn places(reach: &Reach, corners_m: &[Vector], stand_off_m: f64, pieces: &mut Pieces) {
    let to_target_m = reach.to_target_m;
    pieces.clear();
    match reach.room() {
        _ if reach.step_m == 0.0 => pieces.push(point(to_target_m)),
        Room::Out(offset_m) => pieces.push(point(to_target_m - *offset_m)),
        Room::Disc => disc(to_target_m, reach.sight, reach.step_m, stand_off_m, pieces),
        Room::Cell(corners) => cell(to_target_m, &corners_m[corners.clone()], stand_off_m, pieces),
    }
    if pieces.is_empty() {
        // It is within the stand-off after any step: straight out.
        let out = match reach.room() {
            Room::Cell(corners) => {
                let sights = corners_m[corners.clone()].iter().map(|corner| to_target_m - *corner);
                sights.max_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared())).unwrap_or(to_target_m)
            }
            _ => to_target_m + reach.sight * reach.step_m,
        };
        pieces.push(point(out));
    }
}

fn point(sight_m: Vector) -> Piece {
    Piece::segment(sight_m, sight_m)
}

/// For a robot at distance `D` from the target, with step `r` and stand-off `s`.
fn disc(to_target_m: Vector, sight: Vector, r: f64, s: f64, pieces: &mut Pieces) {
    let d = to_target_m.norm();
    let bearing_rad = sight.angle_rad();
    let angle = |adjacent: f64, other: f64, opposite: f64| {
        ((adjacent * adjacent + other * other - opposite * opposite) / (2.0 * adjacent * other)).clamp(-1.0, 1.0).acos()
    };
    if s >= d + r {
        return;
    }
    if s <= r - d {
        pieces.extend(Piece::arcs(Vector::default(), s, bearing_rad + PI, bearing_rad - PI));
        return;
    }
    // On the way out to the tangents from the target the near side is the full step: headings from the line of sight.
    let tangent_rad = if d > r && s * s < (d - r) * (d + r) { (r / d).acos() } else { 0.0 };
    let near = |from_rad: f64, to_rad: f64| {
        Piece::arcs(to_target_m, r, bearing_rad + PI + from_rad, bearing_rad + PI + to_rad)
    };
    if s <= d - r {
        pieces.extend(near(-tangent_rad, tangent_rad));
        return;
    }
    let (heading_rad, turned_rad) = (angle(d, r, s), angle(d, s, r));
    if tangent_rad > heading_rad {
        pieces.extend(near(-tangent_rad, -heading_rad));
    }
    pieces.extend(Piece::arcs(Vector::default(), s, bearing_rad + turned_rad, bearing_rad - turned_rad));
    if tangent_rad > heading_rad {
        pieces.extend(near(heading_rad, tangent_rad));
    }
}

/// For a robot whose neighbours leave it a convex polygon, counter-clockwise.
fn cell(to_target_m: Vector, corners_m: &[Vector], s: f64, pieces: &mut Pieces) {
    let mut marks_rad: SmallVec<[f64; 16]> = SmallVec::new();
    let next = |k: usize| corners_m[(k + 1) % corners_m.len()];
    for (k, corner) in corners_m.iter().enumerate() {
        let (from, to) = (to_target_m - *corner, to_target_m - next(k));
        let edge = Piece::segment(from, to);
        // Squared distance less s^2 is a u^2 + b u + c.
        let (along, c) = (to - from, from.norm_squared() - s * s);
        let (a, b) = (along.norm_squared(), 2.0 * from.dot(along));
        let discriminant = b * b - 4.0 * a * c;
        let mut cuts = [0.0, 0.0, 0.0, 1.0];
        if discriminant > 0.0 && a > 0.0 {
            let root = discriminant.sqrt();
            for (cut, u) in cuts[1..3].iter_mut().zip([(-b - root) / (2.0 * a), (-b + root) / (2.0 * a)]) {
                if u > 0.0 && u < 1.0 {
                    marks_rad.push(edge.sight_m(u).angle_rad());
                    *cut = u;
                }
            }
        }
        cuts.sort_unstable_by(f64::total_cmp);
        // The target is on the outer side of an edge whose places are the nearest on their rays.
        if (next(k) - *corner).cross(from) < 0.0 {
            for pair in cuts.windows(2).filter(|pair| pair[1] > pair[0]) {
                if edge.sight_m(0.5 * (pair[0] + pair[1])).norm() >= s {
                    pieces.push(edge.part(pair[0], pair[1]));
                }
            }
        }
    }
    marks_rad.sort_unstable_by(f64::total_cmp);
    let first = marks_rad.first().copied().unwrap_or(-PI);
    marks_rad.push(first + 2.0 * PI);
    let mut from_rad = first;
    for to_rad in marks_rad.iter().copied().filter(|to_rad| *to_rad > first) {
        let middle = to_target_m - Vector::from_angle(0.5 * (from_rad + to_rad)) * s;
        if crate::planner::range_only::reach::is_inside(corners_m, middle) {
            pieces.extend(Piece::arcs(Vector::default(), s, from_rad, to_rad));
        }
        from_rad = to_rad;
    }
}

/// Replaces each piece by parts of it.
fn restrict(pieces: &mut Pieces, parts: impl Fn(&Piece) -> Pieces) {
    *pieces = pieces.iter().flat_map(&parts).collect();
}

/// The parts of a piece from which the target is within half the field of view, which is centred on the way there.
fn parts_in_view(piece: &Piece, to_target_m: Vector, half_rad: f64) -> Pieces {
    let is_seen = |u: f64| {
        let sight_m = piece.sight_m(u);
        is_in_view(to_target_m - sight_m, sight_m, half_rad)
    };
    let crossing = |mut seen: f64, mut unseen: f64| {
        for _ in 0..40 {
            let middle = 0.5 * (seen + unseen);
            *if is_seen(middle) { &mut seen } else { &mut unseen } = middle;
        }
        seen
    };
    let mut parts = Pieces::new();
    let mut start = is_seen(0.0).then_some(0.0);
    for k in 1..=VIEWS {
        let (before, at) = ((k - 1) as f64 / VIEWS as f64, k as f64 / VIEWS as f64);
        match (start, is_seen(at)) {
            (None, true) => start = Some(crossing(at, before)),
            (Some(from), false) => {
                parts.push(piece.part(from, crossing(before, at)));
                start = None;
            }
            _ => {}
        }
    }
    if let Some(from) = start {
        parts.push(piece.part(from, 1.0));
    }
    parts
}
