//! The most that a robot can tell in one direction: the support function of its curve, with a proof.

use smallvec::SmallVec;

use super::curve::Curve;
use super::information::Information;
use super::leaf::{Leaf, Section};
use super::summit::summit;
use crate::vector::Vector;

/// First step towards a maximum, relative to its part: about the distance of two control points.
const STEP: f64 = 0.1;

/// The same from where a maximum has been for another multiplier.
const NEAR: f64 = 0.02;

/// Most parts into which a curve is split for one value.
const SPLITS_MAX: usize = 200;

/// The most of `T + m . S` on an interval of a curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Support {
    /// No place of the interval has more.
    pub(super) bound: f64,
    /// The place that has most, as a parameter of the curve.
    pub(super) at: f64,
    /// Its information.
    pub(super) information: Information,
}

impl Curve {
    /// The most of `T + m . S` on an interval: a place that has it but for `slack`, and a bound.
    ///
    /// The control points of a part that begins or ends at its maximum bound it exactly, since the next one is on the
    /// tangent: so parts are split where the maximum is. It is looked for from `near` first.
    pub(super) fn support(&self, (low, high): (f64, f64), m: Vector, slack: f64, near: f64) -> Support {
        let mut open: SmallVec<[Part; 16]> = SmallVec::new();
        let (first, last) = (self.piece_at(low).0, self.piece_at(high).0);
        for piece in first..=last {
            let base = Self::base(piece);
            let (from, to) = ((low - base).clamp(0.0, 1.0), (high - base).clamp(0.0, 1.0));
            if to > from || first == last {
                // The bound of a piece holds for its part.
                let (bound, guess) = self.leaves[piece].bound(m);
                let is_tight = from == 0.0 && to == 1.0;
                open.push(Part { piece, low: from, high: to, bound, guess, is_tight, is_searched: false });
            }
        }
        let mut best = Support { bound: f64::NEG_INFINITY, at: low, information: Information::default() };
        // The most that is known, and what the parts that are left out have at most.
        let (mut most, mut left_out) = (f64::NEG_INFINITY, f64::NEG_INFINITY);
        let mut look_at = |piece: usize, u: f64, information: Information| {
            if information.along(m) > most {
                most = information.along(m);
                (best.at, best.information) = (Self::base(piece) + u, information);
            }
            most + slack
        };
        let mut enough = f64::NEG_INFINITY;
        for _ in 0..SPLITS_MAX {
            let greatest = (0..open.len()).max_by(|a, b| open[*a].bound.total_cmp(&open[*b].bound));
            let Some(next) = greatest.filter(|next| open[*next].bound > enough) else { break };
            let Part { piece, low, high, mut bound, mut guess, is_tight, is_searched } = open.swap_remove(next);
            let width = high - low;
            let section = || self.section(piece, low, high, m);
            let near = near - Self::base(piece);
            let is_near = near > low && near < high && !is_searched;
            if !is_tight && !is_near {
                let (tight, share) = section().bound();
                (bound, guess) = (bound.min(tight), low + width * share);
            }
            // The first and the last control point are places.
            if (is_tight || !is_near) && (guess == low || guess == high) {
                enough = look_at(piece, guess, self.information_on(piece, guess));
            }
            let (mut cut, mut is_at_maximum) = (0.5 * (low + high), false);
            if bound > enough && !is_searched {
                let mut here = Information::default();
                let slope = |u: f64| {
                    let (information, change) = self.information_along(piece, u);
                    here = information;
                    change.along(m)
                };
                let (guess, step) = if is_near { (near, NEAR) } else { (guess, STEP) };
                let u = summit(slope, (low, high), guess, step * width, 0.5 * slack / width);
                enough = look_at(piece, u, here);
                let margin = 1e-7 * width;
                if u > low + margin && u < high - margin {
                    (cut, is_at_maximum) = (u, true);
                }
            }
            // A single place has its value as its bound.
            if bound <= enough || !(cut > low && cut < high) {
                left_out = left_out.max(bound);
                continue;
            }
            let is_searched = is_at_maximum;
            if self.leaves[piece].is_divisible {
                let is_low = section().is_at_most(enough, (cut - low) / width);
                for ((low, high), is_low) in [(low, cut), (cut, high)].into_iter().zip(is_low) {
                    if is_low {
                        left_out = left_out.max(enough);
                    } else {
                        open.push(Part { piece, low, high, bound, guess, is_tight: false, is_searched });
                    }
                }
            } else {
                for (low, high) in [(low, cut), (cut, high)] {
                    let (bound, share) = self.section(piece, low, high, m).bound();
                    let guess = low + (high - low) * share;
                    open.push(Part { piece, low, high, bound, guess, is_tight: true, is_searched });
                }
            }
        }
        best.bound = open.iter().map(|part| part.bound).fold(most.max(left_out), f64::max);
        best
    }

    /// `T + m . S` along a part of a piece.
    fn section(&self, piece: usize, low: f64, high: f64, m: Vector) -> Section {
        let (leaf, piece) = (&self.leaves[piece], &self.pieces[piece]);
        if leaf.is_divisible {
            leaf.section(m).part(low, high)
        } else {
            Leaf::of(&self.noise, &piece.part(low, high)).section(m)
        }
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
    /// Bound and guess are its own, not those of a greater part.
    is_tight: bool,
    /// It begins or ends at the maximum of a greater part.
    is_searched: bool,
}
