//! A lower bound on `|S|` from the convex hulls of the arcs.

use super::super::Problem;
use super::super::arm::{Arm, Extent};
use crate::vector::Vector;

/// Support points of a distance query: more are never needed in the plane, as each halves an angle.
const QUERIES_MAX: usize = 100;

/// Halvings of a range of directions, after which its ends are the same in floating point.
const HALVINGS_MAX: usize = 60;

/// Teams up to this size are worth a bound of quadratic cost.
pub(super) const ARC_BOUND_ROBOTS_MAX: usize = 16;

/// Lower bound on `|S|` over all directions in the arcs: the distance from the origin to the
/// Minkowski sum of the arcs' convex hulls. O(M) times a few.
#[must_use]
pub fn hull_bound(problem: &Problem) -> f64 {
    let mut hull = Hull::default();
    hull.start(problem.prior, &problem.arms);
    hull.approach(problem.prior, &problem.arms, None, 1e-12 * problem.lambda_sum())
}

/// The point of the hulls' sum nearest the origin, found by the GJK algorithm.
///
/// The sum is never built. For a direction `n`, its lowest point `argmin x . n` is the sum of each
/// hull's lowest point, which lies on the arc and is the one-robot closed form; `x . n` for unit `n` bounds
/// the distance from below. The nearest point of the simplex spanned by the last lowest points gives the
/// next direction and the distance from above.
#[derive(Debug, Clone, Default)]
pub(super) struct Hull {
    /// Corners of the simplex: the point, and each arm's direction in it.
    points: [Vector; 3],
    directions: [Vec<Vector>; 3],
    corners: usize,
    /// Shares of the corners in the nearest point.
    shares: [f64; 3],
    nearest: Vector,
    bound: f64,
}

impl Hull {
    /// Starts a query over these arcs.
    pub(super) fn start(&mut self, prior: Vector, arms: &[Arm]) {
        self.corners = 0;
        self.bound = 0.0;
        // The middles of the arcs show roughly where the sum lies.
        self.nearest = arms.iter().fold(prior, |sum, arm| sum + arm.centre * arm.lambda);
    }

    /// Approaches the origin until the bounds are `tolerance` apart, or until it is clear on which side of `enough` the
    /// distance lies. Returns the lower bound. [`Self::direction`] then gives the nearest point, and another call with
    /// the same arcs continues from there.
    pub(super) fn approach(&mut self, prior: Vector, arms: &[Arm], enough: Option<f64>, tolerance: f64) -> f64 {
        for _ in 0..QUERIES_MAX {
            let distance = self.nearest.norm();
            // If even the upper bound on the distance is below `enough`, the lower bound only puts nodes in order.
            let near_enough = enough.map_or(tolerance, |enough| tolerance.max(0.05 * (enough - distance)));
            let is_known = self.corners > 0 && distance - self.bound <= near_enough;
            if is_known || enough.is_some_and(|enough| self.bound >= enough) {
                break;
            }
            let Some(normal) = self.nearest.normalised() else { break };
            let lowest = self.add_lowest(prior, arms, normal);
            self.bound = self.bound.max(lowest.dot(normal));
            self.nearest = self.reduce();
        }
        self.bound
    }

    /// An upper bound on `T - |S|` over these arcs, for the same reason: for unit `n` it is at most `T - x . n` of the
    /// lowest point `x`, which is a sum of positive terms. So no digit is lost if `|S|` nearly equals `T`. Halves the
    /// range of `n` down to the resolution of floating point, or until the bound is at most `enough`.
    /// [`Self::direction`] then gives the nearest point.
    pub(super) fn approach_information(&mut self, problem: &Problem, arms: &[Arm], enough: f64) -> f64 {
        self.corners = 0;
        let towards = arms.iter().fold(problem.prior, |sum, arm| sum + arm.centre * arm.lambda);
        let mut normal = towards.normalised().unwrap_or(Vector::new(1.0, 0.0));
        let (mut bound, lowest) = self.evaluate_along(problem, arms, normal);
        let Some(start) = lowest.normalised() else { return bound };
        // A better `n` has `x . n > 0` for every lowest point `x`, and lies on the side of `normal` on which the lowest
        // point of `normal` lies.
        let quarter = Vector::new(0.0, 1.0);
        let mut range = [start.rotated_by(-quarter), start.rotated_by(quarter)];
        let mut is_known = [false; 2];
        normal = start;
        for _ in 0..HALVINGS_MAX {
            if bound <= enough {
                break;
            }
            let (value, lowest) = self.evaluate_along(problem, arms, normal);
            bound = bound.min(value);
            let side = usize::from(normal.cross(lowest) < 0.0);
            range[side] = normal;
            is_known[side] = true;
            self.points[side] = lowest;
            self.directions.swap(side, 2);
            let Some(middle) = (range[0] + range[1]).normalised() else { break };
            if range.contains(&middle) {
                break;
            }
            normal = middle;
        }
        // The nearest point is the mixture of the two lowest points that lies along `normal`.
        let [left, right] = [0, 1].map(|side| normal.cross(self.points[side]).abs());
        let share = if left + right > 0.0 { (left / (left + right)).clamp(0.05, 0.95) } else { 0.5 };
        self.shares = [1.0 - share, share, 0.0];
        self.corners = 2;
        match is_known {
            [true, true] => {}
            [_, false] => (self.shares, self.corners) = ([1.0, 0.0, 0.0], 1),
            [false, true] => {
                self.directions.swap(0, 1);
                (self.shares, self.corners) = ([1.0, 0.0, 0.0], 1);
            }
        }
        bound
    }

    /// `T - x . n` of the lowest point `x` along the unit vector `n`, and `x`; each arm's direction is stored in the
    /// last corner.
    fn evaluate_along(&mut self, problem: &Problem, arms: &[Arm], n: Vector) -> (f64, Vector) {
        let directions = &mut self.directions[2];
        directions.clear();
        let (mut value, mut sum) = (problem.prior_across(n), problem.prior);
        for arm in arms {
            let u = arm.farthest_along(-n);
            value += 0.5 * arm.lambda * (u - n).norm_squared();
            sum += u * arm.lambda;
            directions.push(u);
        }
        (value, sum)
    }

    /// Adds the lowest point in direction `normal` to the simplex.
    fn add_lowest(&mut self, prior: Vector, arms: &[Arm], normal: Vector) -> Vector {
        let directions = &mut self.directions[self.corners];
        directions.clear();
        let mut sum = prior;
        for arm in arms {
            let direction = arm.farthest_along(-normal);
            sum += direction * arm.lambda;
            directions.push(direction);
        }
        self.points[self.corners] = sum;
        self.corners += 1;
        sum
    }

    /// Keeps the corners that the simplex's nearest point to the origin needs; returns that point.
    fn reduce(&mut self) -> Vector {
        match self.corners {
            1 => {
                self.shares = [1.0, 0.0, 0.0];
                self.points[0]
            }
            2 => {
                let (share, nearest) = nearest_of_segment(self.points[0], self.points[1]);
                self.keep_pair(0, 1, share);
                nearest
            }
            _ => {
                let [a, b, c] = self.points;
                let (abc, pbc, apc, abp) = ((b - a).cross(c - a), b.cross(c), c.cross(a), a.cross(b));
                if abc != 0.0 && pbc * abc >= 0.0 && apc * abc >= 0.0 && abp * abc >= 0.0 {
                    self.shares = [pbc / abc, apc / abc, abp / abc];
                    return Vector::default();
                }
                // The nearest of the edges at the new corner, or the old edge if rounding makes it the nearest.
                let edges = [(0, 2), (1, 2), (0, 1)];
                let solved = edges.map(|(i, j)| nearest_of_segment(self.points[i], self.points[j]));
                let best =
                    (0..3).fold(
                        0,
                        |best, k| {
                            if solved[k].1.norm_squared() < solved[best].1.norm_squared() { k } else { best }
                        },
                    );
                let (i, j) = edges[best];
                self.keep_pair(i, j, solved[best].0);
                solved[best].1
            }
        }
    }

    /// Reduces the simplex to corners `i < j` with shares `1 - share` and `share`.
    fn keep_pair(&mut self, i: usize, j: usize, share: f64) {
        self.points.swap(0, i);
        self.directions.swap(0, i);
        self.points.swap(1, j);
        self.directions.swap(1, j);
        self.shares = [1.0 - share, share, 0.0];
        self.corners = 2;
        if share == 1.0 {
            self.points.swap(0, 1);
            self.directions.swap(0, 1);
            self.shares = [1.0, 0.0, 0.0];
        }
        if self.shares[0] == 1.0 {
            self.corners = 1;
        }
    }

    /// Arm `i`'s directions in the corners, and the corners' shares.
    pub(super) fn corners_of(&self, i: usize) -> [(Vector, f64); 3] {
        std::array::from_fn(
            |k| if k < self.corners { (self.directions[k][i], self.shares[k]) } else { Default::default() },
        )
    }

    /// How far inside its arc arm `i`'s vector over lambda is in the nearest point of two corners: `1 - |y|^2`.
    pub(super) fn depth(&self, i: usize) -> f64 {
        let [(a, to_a), (b, to_b), _] = self.corners_of(i);
        to_a * to_b * (a - b).norm_squared()
    }

    /// Arm `i`'s vector over lambda in the nearest point: of length one if it lies on its arc, shorter
    /// if only in its hull.
    pub(super) fn direction(&self, i: usize) -> Vector {
        let parts = self.directions.iter().zip(self.shares).take(self.corners);
        parts.fold(Vector::default(), |sum, (directions, share)| sum + directions[i] * share)
    }
}

/// Lower bound with one arm taken as the arc that it is, the others as hulls; for small teams.
///
/// For a fixed sum `R` of the others, the best direction of the arm is an end of its arc, or `-R` over `|R|` if that is
/// inside, which leaves `lambda - |R|` at least. So the bound is the least of two distance queries with the arm held at
/// its ends, and of `lambda` less the longest `R` opposite to its arc. It decides what hulls cannot: a robot that
/// outweighs the others and points away from the origin, so that its hull is far from its arc.
pub(super) fn arc_bound(hull: &mut Hull, prior: Vector, arms: &mut [Arm], which: usize, enough: f64) -> f64 {
    let arm = arms[which];
    let others = arms.iter().enumerate().filter(|(i, _)| *i != which).map(|(_, other)| other);
    let mut bound = arm.lambda - longest(prior, others, &arm);
    let ends = if arm.extent == Extent::Circle { &[][..] } else { &[arm.low, arm.high] };
    for &end in ends {
        if bound < enough {
            break;
        }
        arms[which] = Arm { centre: end, low: end, high: end, extent: Extent::Narrow, ..arm };
        hull.start(prior, arms);
        bound = bound.min(hull.approach(prior, arms, Some(enough), 0.0));
    }
    arms[which] = arm;
    bound
}

/// [`arc_bound`] as an upper bound on `T - |S|`: returns it, and stores in `best` the directions that correspond to it.
pub(super) fn arc_information(problem: &Problem, arms: &[Arm], which: usize, best: &mut Vec<Vector>) -> f64 {
    let arm = arms[which];
    let others = || arms.iter().enumerate().filter(|(i, _)| *i != which).map(|(_, other)| other);
    // The most information of the others across the axis along which this one measures.
    let value = |n: Vector| {
        let known = |other: &Arm| 0.5 * other.lambda * (other.farthest_along(-n) - n).norm_squared();
        others().fold(problem.prior_across(n), |sum, other| sum + known(other))
    };
    let (mut most, mut along) = (f64::NEG_INFINITY, arm.centre);
    pieces(problem.prior, others(), &arm, |piece| {
        let peak = if piece.has_peak { piece.fixed.normalised() } else { None };
        for opposite in [Some(piece.at(0.0)), peak, Some(piece.at(1.0))].into_iter().flatten() {
            let value = value(-opposite);
            if value > most {
                (most, along) = (value, -opposite);
            }
        }
    });
    best.clear();
    best.extend(arms.iter().map(|other| other.farthest_along(-along)));
    best[which] = arm.nearest(along, arm.centre);
    most
}

/// The largest `max R . n` of the sums `R` of these arms over all `n` opposite to the arc of `arm`: no `R`
/// that points there is longer.
fn longest<'a>(prior: Vector, arms: impl Iterator<Item = &'a Arm> + Clone, arm: &Arm) -> f64 {
    let mut longest = f64::NEG_INFINITY;
    pieces(prior, arms, arm, |piece| {
        let fixed = piece.fixed;
        let along = if piece.has_peak { fixed.norm() } else { fixed.dot(piece.at(0.0)).max(fixed.dot(piece.at(1.0))) };
        longest = longest.max(along + piece.turning);
    });
    longest
}

/// A range of directions `n` in which `max R . n = fixed . n + turning` for the sums `R` of some arms.
struct Piece {
    fixed: Vector,
    turning: f64,
    /// True if `fixed` itself points there.
    has_peak: bool,
    start: Vector,
    range_rad: (f64, f64),
}

impl Piece {
    /// Its first direction at 0, its last at 1.
    fn at(&self, share: f64) -> Vector {
        let (from_rad, to_rad) = self.range_rad;
        self.start.rotated_by(Vector::from_angle(from_rad + share * (to_rad - from_rad)))
    }
}

/// Visits the pieces that make up all directions opposite to the arc of `arm`.
fn pieces<'a>(prior: Vector, arms: impl Iterator<Item = &'a Arm> + Clone, arm: &Arm, mut visit: impl FnMut(&Piece)) {
    use std::f64::consts::TAU;
    let start = if arm.extent == Extent::Circle { Vector::new(1.0, 0.0) } else { -arm.low };
    // Angles from the start of that arc, in [0, 2 pi).
    let angle = |v: Vector| v.rotated_by(start.conjugate()).angle_rad().rem_euclid(TAU);
    let is_complete = arm.extent == Extent::Circle || (arm.extent == Extent::Wide && arm.low == arm.high);
    let width = if is_complete { TAU } else { angle(-arm.high) };
    // Between these, each arm's farthest direction is one and the same end, or `n` itself.
    let mut marks = [width; 3 * ARC_BOUND_ROBOTS_MAX + 2];
    let mut count = 1;
    marks[0] = 0.0;
    for other in arms.clone().filter(|other| other.extent != Extent::Circle) {
        for mark in [other.low, other.high, -other.centre].map(angle) {
            if mark < width && count + 1 < marks.len() {
                marks[count] = mark;
                count += 1;
            }
        }
    }
    let marks = &mut marks[..=count];
    marks.sort_unstable_by(f64::total_cmp);
    for pair in marks.windows(2) {
        let mut piece = Piece { fixed: prior, turning: 0.0, has_peak: false, start, range_rad: (pair[0], pair[1]) };
        let middle = piece.at(0.5);
        for other in arms.clone() {
            let farthest = other.farthest_along(middle);
            if farthest == middle {
                piece.turning += other.lambda;
            } else {
                piece.fixed += farthest * other.lambda;
            }
        }
        piece.has_peak = (pair[0]..=pair[1]).contains(&angle(piece.fixed));
        visit(&piece);
    }
}

impl Arm {
    /// The direction in the arc with the largest component along the unit vector `u`.
    fn farthest_along(&self, u: Vector) -> Vector {
        if self.extent == Extent::Circle || self.contains(u) {
            u
        } else if self.centre.cross(u) >= 0.0 {
            self.high
        } else {
            self.low
        }
    }
}

/// Share of `b` in the point of the segment nearest the origin, and that point.
fn nearest_of_segment(a: Vector, b: Vector) -> (f64, Vector) {
    let along = b - a;
    let length_squared = along.norm_squared();
    if length_squared == 0.0 {
        return (0.0, a);
    }
    let share = (-a.dot(along) / length_squared).clamp(0.0, 1.0);
    if share == 0.0 {
        return (0.0, a);
    }
    if share == 1.0 {
        return (1.0, b);
    }
    let point = a + along * share;
    if point.norm_squared() >= length_squared {
        return (share, point);
    }
    // A long segment near the origin: its normal is more precise than the point, in which digits have cancelled.
    (share, Vector::new(along.y, -along.x) * (a.cross(b) / length_squared))
}
