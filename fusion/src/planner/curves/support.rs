//! The most that a robot can tell in one direction: the support function of its curve, with a proof.

use smallvec::SmallVec;

use super::curve::Curve;
use super::information::Information;
use super::leaf::Leaf;
use super::minimum::minimum;
use crate::vector::Vector;

/// Accuracy of the place of a maximum, relative to its part: the more accurate, the tighter the bound.
const ACCURACY: f64 = 1e-8;

/// Most parts into which a curve is split for one value.
const SPLITS_MAX: usize = 200;

/// The most of `T + m . S` on an interval of a curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Support {
    /// No place of the interval has more.
    pub(super) bound: f64,
    /// The place that has most, as a parameter of the curve.
    pub(super) at: f64,
    /// What it tells.
    pub(super) information: Information,
}

impl Curve {
    /// The most of `T + m . S` on an interval: a place that has it but for `slack`, and a bound.
    ///
    /// The control points of a part that begins or ends at its maximum bound it exactly, since the next one is on the
    /// tangent: so parts are split where the maximum is.
    pub(super) fn support(&self, (low, high): (f64, f64), m: Vector, slack: f64) -> Support {
        let mut open: SmallVec<[Part; 8]> = SmallVec::new();
        let part = |piece: usize, low: f64, high: f64, is_searched: bool| {
            let leaf = Leaf::of(&self.noise, &self.pieces[piece], low, high);
            Part::of(piece, &leaf, m, is_searched)
        };
        let (first, last) = (self.piece_at(low).0, self.piece_at(high).0);
        for piece in first..=last {
            let base = Self::base(piece);
            let (from, to) = ((low - base).clamp(0.0, 1.0), (high - base).clamp(0.0, 1.0));
            if from == 0.0 && to == 1.0 {
                open.push(Part::of(piece, &self.leaves[piece], m, false));
            } else if to > from || first == last {
                open.push(part(piece, from, to, false));
            }
        }
        let mut best = Support { bound: f64::NEG_INFINITY, at: low, information: Information::default() };
        let mut most = f64::NEG_INFINITY;
        let mut look_at = |piece: usize, u: f64, most: &mut f64| {
            let information = self.information_on(piece, u);
            if information.along(m) > *most {
                *most = information.along(m);
                (best.at, best.information) = (Self::base(piece) + u, information);
            }
        };
        for _ in 0..SPLITS_MAX {
            let Some((next, now)) = open.iter().copied().enumerate().max_by(|a, b| a.1.bound.total_cmp(&b.1.bound))
            else {
                break;
            };
            if now.bound <= most + slack {
                break;
            }
            // The first and the last control point are places.
            if now.guess == now.low || now.guess == now.high {
                look_at(now.piece, now.guess, &mut most);
                if now.bound <= most + slack {
                    break;
                }
            }
            let (mut cut, mut is_at_maximum) = (0.5 * (now.low + now.high), false);
            if !now.is_searched {
                let value = |u: f64| -self.information_on(now.piece, u).along(m);
                let u = minimum(value, (now.low, now.high), now.guess, ACCURACY);
                look_at(now.piece, u, &mut most);
                if now.bound <= most + slack {
                    break;
                }
                let margin = 1e-7 * (now.high - now.low);
                if u > now.low + margin && u < now.high - margin {
                    (cut, is_at_maximum) = (u, true);
                }
            }
            open.swap_remove(next);
            // A single place has its value as its bound.
            if cut > now.low && cut < now.high {
                open.push(part(now.piece, now.low, cut, is_at_maximum));
                open.push(part(now.piece, cut, now.high, is_at_maximum));
            }
        }
        best.bound = open.iter().map(|part| part.bound).fold(most, f64::max);
        best
    }
}

/// A part of a curve on which the maximum may be.
#[derive(Debug, Clone, Copy)]
struct Part {
    piece: usize,
    low: f64,
    high: f64,
    /// None of its places has more.
    bound: f64,
    /// Where the maximum may be.
    guess: f64,
    /// It begins or ends at the maximum of a greater part.
    is_searched: bool,
}

impl Part {
    fn of(piece: usize, leaf: &Leaf, m: Vector, is_searched: bool) -> Self {
        let (bound, guess) = leaf.bound(m);
        Self { piece, low: leaf.low, high: leaf.high, bound, guess, is_searched }
    }
}
