//! The most that a robot can tell in one direction: the support function of its curve, with a proof.

use smallvec::SmallVec;

use super::curve::Curve;
use super::information::Information;
use super::leaf::{Leaf, Section};
use super::summit::summit;
use crate::vector::Vector;

/// First step towards a maximum, relative to its part: about the distance of two control points.
const STEP: f64 = 0.1;

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
        let (first, last) = (self.piece_at(low).0, self.piece_at(high).0);
        for piece in first..=last {
            let base = Self::base(piece);
            let (from, to) = ((low - base).clamp(0.0, 1.0), (high - base).clamp(0.0, 1.0));
            if to > from || first == last {
                // What bounds a piece bounds its part.
                let bound = self.leaves[piece].bound(m);
                open.push(Part::of(piece, from, to, bound, None));
            }
        }
        let mut best = Support { bound: f64::NEG_INFINITY, at: low, information: Information::default() };
        let mut most = f64::NEG_INFINITY;
        let mut look_at = |piece: usize, u: f64, information: Information| {
            if information.along(m) > most {
                most = information.along(m);
                (best.at, best.information) = (Self::base(piece) + u, information);
            }
            most + slack
        };
        let (mut enough, mut closed) = (f64::NEG_INFINITY, f64::NEG_INFINITY);
        for _ in 0..SPLITS_MAX {
            let greatest = (0..open.len()).max_by(|a, b| open[*a].bound.total_cmp(&open[*b].bound));
            let Some(next) = greatest.filter(|next| open[*next].bound > enough) else { break };
            let Part { piece, low, high, bound, guess, is_searched, .. } = open[next];
            if open[next].section.is_none() && (low > 0.0 || high < 1.0) {
                open[next] = Part::with(piece, low, high, self.section(piece, low, high, m));
                continue;
            }
            // The first and the last control point are places.
            if guess == low || guess == high {
                enough = look_at(piece, guess, self.information_on(piece, guess));
                if bound <= enough {
                    break;
                }
            }
            let (mut cut, mut is_at_maximum) = (0.5 * (low + high), false);
            if !is_searched {
                let mut here = Information::default();
                let slope = |u: f64| {
                    let (information, change) = self.information_along(piece, u);
                    here = information;
                    change.along(m)
                };
                let width = high - low;
                let u = summit(slope, (low, high), guess, STEP * width, 0.5 * slack / width);
                enough = look_at(piece, u, here);
                if bound <= enough {
                    break;
                }
                let margin = 1e-7 * width;
                if u > low + margin && u < high - margin {
                    (cut, is_at_maximum) = (u, true);
                }
            }
            // A single place has its value as its bound.
            if !(cut > low && cut < high) {
                open.swap_remove(next);
                continue;
            }
            let whole;
            let section = match &open[next].section {
                Some(section) => section,
                None => {
                    whole = self.leaves[piece].section(m);
                    &whole
                }
            };
            let sections = if section.is_divisible {
                section.cut((cut - low) / (high - low))
            } else {
                [(low, cut), (cut, high)].map(|(low, high)| self.section(piece, low, high, m))
            };
            open.swap_remove(next);
            for ((low, high), section) in [(low, cut), (cut, high)].into_iter().zip(sections) {
                if section.is_at_most(enough) {
                    closed = enough;
                } else {
                    open.push(Part { is_searched: is_at_maximum, ..Part::with(piece, low, high, section) });
                }
            }
        }
        best.bound = open.iter().map(|part| part.bound).fold(most.max(closed), f64::max);
        best
    }

    /// `T + m . S` along a part of a piece.
    fn section(&self, piece: usize, low: f64, high: f64, m: Vector) -> Section {
        let section = self.leaves[piece].section(m);
        if section.is_divisible {
            section.part(low, high)
        } else {
            Leaf::of(&self.noise, &self.pieces[piece].part(low, high)).section(m)
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
    /// It begins or ends at the maximum of a greater part.
    is_searched: bool,
    /// `None` of a piece whose bound is known otherwise.
    section: Option<Section>,
}

impl Part {
    fn of(piece: usize, low: f64, high: f64, (bound, share): (f64, f64), section: Option<Section>) -> Self {
        Self { piece, low, high, bound, guess: low + (high - low) * share, is_searched: false, section }
    }

    fn with(piece: usize, low: f64, high: f64, section: Section) -> Self {
        Self::of(piece, low, high, section.bound(), Some(section))
    }
}
