//! A bound for one robot that outweighs the others: the multiplier follows it along its curve.
//!
//! One multiplier for a whole interval bounds the robot by its convex hull, in whose inside no place lies. With a multiplier
//! for each place there is no hull of this robot, only of the others. Let `m = 2 q / (1 + |q|^2)`, and `q` linear along a part
//! of the curve. Then the multiplied information is a quadratic,
//!
//! ```text
//! (1 + |q|^2) T + 2 q . S = sum_j B_j (g_j T + h_j . S),   g = 1 + q_a.q_a, 1 + q_a.q_b, 1 + q_b.q_b,   h = 2 q_a, q_a + q_b, 2 q_b
//! ```
//!
//! in the Bernstein basis `B_j`, whose members are positive. So what the others tell is at most `sum_j B_j H_j`, where `H_j` is
//! the most that they can have of `g_j T + h_j . S`. With that, a polynomial is left that must not be negative.

use std::cell::Cell;

use smallvec::SmallVec;

use super::curve::Curve;
use super::information::{Cost, Information, ROUNDING};
use super::search::{Answer, SLACK};
use super::team::Team;
use crate::vector::Vector;

/// Parts of the curve that are looked at for one node.
const PARTS_MAX: usize = 64;

/// Multipliers that are tried for one place.
const MULTIPLIERS_MAX: usize = 2;

/// Narrowest part.
const NARROWEST: f64 = 1e-4;

/// A place of the robot, and a multiplier for it.
#[derive(Debug, Clone, Copy)]
struct Stop {
    /// Its parameter within the piece.
    u: f64,
    q: Vector,
    /// The most of `(1 + |q|^2) T + 2 q . S` without the robot.
    rest: f64,
    /// About what the others tell then.
    others: Information,
    /// The cost with the robot at this place is at least the aim.
    is_closed: bool,
}

/// The problem with one robot's interval open, and the cost that is to be proven.
struct Follow<'a> {
    team: &'a Team,
    intervals: &'a [(f64, f64)],
    robot: usize,
    aim: f64,
    /// The others have no lesser `T`.
    least_t: f64,
    /// Where the other robots had most at the last multiplier: the next one is not far from it.
    near: &'a [Cell<f64>],
}

/// The part of the robot's interval in which the cost may be less than `aim`; `None` if it cannot anywhere. `rest` is about
/// what the others tell.
pub(super) fn open_part(
    team: &Team,
    intervals: &[(f64, f64)],
    robot: usize,
    rest: Information,
    answer: &Answer,
    aim: f64,
    near: &mut Vec<Cell<f64>>,
) -> Option<(f64, f64)> {
    let others = || team.fused().filter(|i| *i != robot);
    let least_t = others().fold(team.prior.t, |sum, i| sum + team.curves[i].least_t);
    near.clear();
    near.extend(answer.at.iter().copied().map(Cell::new));
    let follow = Follow { team, intervals, robot, aim, least_t, near };
    let at = answer.at[robot];
    let curve = &team.curves[robot];
    let (low, high) = intervals[robot];
    let (first, last) = (curve.piece_at(low).0, curve.piece_at(high).0);
    if at >= low && at <= high {
        let (piece, u) = curve.piece_at(at);
        // No part with this place can be closed, unless the others are bounded better.
        if !follow.stop(piece, u, rest).is_closed {
            return Some((low, high));
        }
    }
    let mut left: Option<(f64, f64)> = None;
    let mut open: SmallVec<[(Stop, Stop); 16]> = SmallVec::new();
    let mut before = None;
    let mut count = 0;
    for piece in first..=last {
        let base = Curve::base(piece);
        let (from, to) = ((low - base).clamp(0.0, 1.0), (high - base).clamp(0.0, 1.0));
        if from == to && first < last {
            continue;
        }
        let start = match before.filter(|_| from == 0.0 && curve.touches(piece)) {
            Some(stop) => Stop { u: 0.0, ..stop },
            None => follow.stop(piece, from, rest),
        };
        let end = follow.stop(piece, to, rest);
        before = Some(end);
        open.push((start, end));
        while let Some((a, b)) = open.pop() {
            count += 1;
            let can_close = a.is_closed && b.is_closed;
            if can_close && follow.is_closed(piece, a, b) {
                continue;
            }
            let middle = 0.5 * (a.u + b.u);
            if b.u - a.u > NARROWEST && count < PARTS_MAX && can_close {
                let stop = follow.stop(piece, middle, (a.others + b.others) * 0.5);
                open.push((stop, b));
                open.push((a, stop));
                continue;
            }
            let (start, end) = (base + a.u, base + b.u);
            left = Some(left.map_or((start, end), |(low, high)| (low.min(start), high.max(end))));
        }
    }
    left
}

impl Follow<'_> {
    /// The stop at a parameter of a piece.
    fn stop(&self, piece: usize, u: f64, mut rest: Information) -> Stop {
        let criterion = self.team.criterion;
        let information = self.team.curves[self.robot].information_on(piece, u);
        let mut stop = Stop { u, q: Vector::default(), rest: 0.0, others: rest, is_closed: false };
        for _ in 0..MULTIPLIERS_MAX {
            let m = criterion.multiplier(rest + information);
            let (h, total) = self.others(m, rest + information);
            let q = m * (1.0 / (1.0 + (1.0 - m.norm_squared()).max(0.0).sqrt()));
            let is_closed = criterion.bound(m, h + information.along(m)) >= self.aim;
            stop = Stop { u, q, rest: (1.0 + q.norm_squared()) * h, others: total, is_closed };
            if is_closed {
                break;
            }
            rest = total;
        }
        stop
    }

    fn others(&self, m: Vector, total: Information) -> (f64, Information) {
        let team = self.team;
        let slack = SLACK * total.along(m).abs() / team.curves.len() as f64;
        team.supports(
            team.fused().filter(|i| *i != self.robot),
            self.intervals,
            m,
            slack,
            |i| self.near[i].get(),
            |i, support| self.near[i].set(support.at),
        )
    }

    /// True if no place between two stops costs less than the aim.
    fn is_closed(&self, piece: usize, a: Stop, b: Stop) -> bool {
        let Team { criterion, curves, .. } = self.team;
        let curve = &curves[self.robot];
        let price = criterion.price(self.aim);
        let quadratic = |p: Vector, q: Vector, rest: f64| {
            let value = criterion.value(p, q) - price * rest;
            (value, -price * (1.0 + p.dot(q) + ROUNDING), (p + q) * -price)
        };
        let apart = a.q + b.q * -1.0;
        // Between them, `H` of the product is at most that of the mean of both, less `|q_a - q_b|^2 / 2` of the least `T`.
        let rest = 0.5 * (a.rest + b.rest - apart.norm_squared() * self.least_t);
        let quadratics = [quadratic(a.q, a.q, a.rest), quadratic(a.q, b.q, rest), quadratic(b.q, b.q, b.rest)];
        let part = curve.leaves[piece].part(&curve.noise, &curve.pieces[piece], a.u, b.u);
        part.is_never_negative(&quadratics)
    }
}
