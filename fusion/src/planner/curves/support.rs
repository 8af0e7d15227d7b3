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
        let mut open: SmallVec<[(usize, Leaf, bool); 8]> = SmallVec::new();
        let (first, last) = (self.piece_at(low).0, self.piece_at(high).0);
        for index in first..=last {
            let base = Self::base(index);
            let (from, to) = ((low - base).clamp(0.0, 1.0), (high - base).clamp(0.0, 1.0));
            if from == 0.0 && to == 1.0 {
                open.push((index, self.leaves[index], false));
            } else if to > from || first == last {
                open.push((index, Leaf::of(&self.noise, &self.pieces[index], from, to), false));
            }
        }
        let mut best = Support { bound: f64::NEG_INFINITY, at: low, information: Information::default() };
        let mut most = f64::NEG_INFINITY;
        for _ in 0..SPLITS_MAX {
            let bounds = open.iter().map(|(_, leaf, _)| leaf.bound(m));
            let Some((next, (bound, guess))) = bounds.enumerate().max_by(|a, b| a.1.0.total_cmp(&b.1.0)) else { break };
            if bound <= most + slack {
                best.bound = bound.max(most);
                return best;
            }
            let (index, leaf, is_searched) = open.swap_remove(next);
            let (mut cut, mut is_at_maximum) = (0.5 * (leaf.low + leaf.high), false);
            // The first and the last control point are places.
            if guess == leaf.low || guess == leaf.high {
                let information = self.information_on(index, guess);
                if information.along(m) > most {
                    most = information.along(m);
                    (best.at, best.information) = (Self::base(index) + guess, information);
                }
                if bound <= most + slack {
                    best.bound = bound.max(most);
                    return best;
                }
            }
            if !is_searched {
                let value = |u: f64| -self.information_on(index, u).along(m);
                let u = minimum(value, (leaf.low, leaf.high), guess, ACCURACY);
                let information = self.information_on(index, u);
                if information.along(m) > most {
                    most = information.along(m);
                    (best.at, best.information) = (Self::base(index) + u, information);
                }
                let margin = 1e-7 * (leaf.high - leaf.low);
                if u > leaf.low + margin && u < leaf.high - margin {
                    (cut, is_at_maximum) = (u, true);
                } else if bound <= most + slack {
                    open.push((index, leaf, true));
                    continue;
                }
            }
            if !(cut > leaf.low && cut < leaf.high) {
                // A single place: its value is its bound.
                continue;
            }
            for (from, to) in [(leaf.low, cut), (cut, leaf.high)] {
                open.push((index, Leaf::of(&self.noise, &self.pieces[index], from, to), is_at_maximum));
            }
        }
        let bounds = open.iter().map(|(_, leaf, _)| leaf.bound(m).0);
        best.bound = bounds.fold(most, f64::max);
        best
    }
}
