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
    pub(super) fn support(&self, interval: (f64, f64), m: Vector, slack: f64, near: f64) -> Support {
        let best = Support { bound: f64::NEG_INFINITY, at: interval.0, information: Information::default() };
        let most = f64::NEG_INFINITY;
        let mut climb =
            Climb { curve: self, m, slack, near, open: SmallVec::new(), best, most, enough: most, left_out: most };
        climb.start(interval);
        for _ in 0..SPLITS_MAX {
            let Some(part) = climb.next() else { break };
            climb.search(part);
        }
        climb.end()
    }
}

/// The search for the most on an interval of a curve.
struct Climb<'a> {
    curve: &'a Curve,
    m: Vector,
    slack: f64,
    near: f64,
    open: SmallVec<[Part; 16]>,
    /// The best place.
    best: Support,
    /// What it has.
    most: f64,
    /// Parts whose bound is no more than this are left out.
    enough: f64,
    /// What those parts have at most.
    left_out: f64,
}

impl Climb<'_> {
    /// Opens the parts of all pieces. The piece where the maximum was for another multiplier mostly rules out the others.
    fn start(&mut self, (low, high): (f64, f64)) {
        let (first, last) = (self.curve.piece_at(low).0, self.curve.piece_at(high).0);
        let part = |piece: usize| {
            let base = Curve::base(piece);
            let (low, high) = ((low - base).clamp(0.0, 1.0), (high - base).clamp(0.0, 1.0));
            let (is_tight, bound) = (low == 0.0 && high == 1.0, f64::INFINITY);
            Part { piece, low, high, bound, guess: low, is_tight, is_searched: false }
        };
        let near = self.curve.piece_at(self.near).0;
        let is_climbed = near >= first && near <= last && self.climb_near(part(near));
        for piece in (first..=last).filter(|piece| !(is_climbed && *piece == near)) {
            let part = part(piece);
            let leaf = &self.curve.leaves[piece];
            if part.low == part.high && first < last {
                continue;
            }
            // The bound of a piece holds for its part.
            if leaf.is_at_most(self.enough, self.m) {
                self.left_out = self.left_out.max(self.enough);
            } else {
                let (bound, guess) = leaf.bound(self.m);
                self.open.push(Part { bound, guess, ..part });
            }
        }
    }

    /// Cuts a part at its maximum near where it was for another multiplier; false if it is not found there.
    fn climb_near(&mut self, part: Part) -> bool {
        let near = self.near - Curve::base(part.piece);
        let leaf = &self.curve.leaves[part.piece];
        near > part.low
            && near < part.high
            && leaf.is_divisible
            && match leaf.count {
                5 => self.climb::<5>(part, &self.section(&part), near),
                7 => self.climb::<7>(part, &self.section(&part), near),
                9 => self.climb::<9>(part, &self.section(&part), near),
                _ => false,
            }
    }

    /// Looks for the maximum of a part, and cuts it there.
    fn search(&mut self, part: Part) {
        let leaf = &self.curve.leaves[part.piece];
        match leaf.count {
            _ if !leaf.is_divisible => self.search_hull(part),
            5 => self.search_section::<5>(part),
            7 => self.search_section::<7>(part),
            9 => self.search_section::<9>(part),
            _ => self.search_section::<1>(part),
        }
    }

    /// The open part with the greatest bound, if it may have more than what is enough.
    fn next(&mut self) -> Option<Part> {
        let greatest = (0..self.open.len()).max_by(|a, b| self.open[*a].bound.total_cmp(&self.open[*b].bound))?;
        (self.open[greatest].bound > self.enough).then(|| self.open.swap_remove(greatest))
    }

    fn end(self) -> Support {
        let bound = self.open.iter().map(|part| part.bound).fold(self.most.max(self.left_out), f64::max);
        Support { bound, ..self.best }
    }

    fn look_at(&mut self, piece: usize, u: f64, information: Information) {
        let along = information.along(self.m);
        if along > self.most {
            (self.most, self.enough) = (along, along + self.slack);
            (self.best.at, self.best.information) = (Curve::base(piece) + u, information);
        }
    }

    /// Cuts a part at its maximum near a guess; false if it is not found there.
    fn climb<const N: usize>(&mut self, part: Part, section: &Section<N>, guess: f64) -> bool {
        let Part { piece, low, high, .. } = part;
        let width = high - low;
        let Some((share, halves)) = section.summit((guess - low) / width, self.slack) else { return false };
        let cut = low + width * share;
        if !(cut > low && cut < high) {
            return false;
        }
        self.look_at(piece, cut, self.curve.information_on(piece, cut));
        let is_low = halves.is_at_most(self.enough);
        self.open_halves(Part { is_tight: false, is_searched: true, ..part }, cut, is_low);
        true
    }

    /// The same by slopes; where to cut, if not at an end.
    fn climb_slopes(&mut self, part: &Part, guess: f64, step: f64) -> Option<f64> {
        let (Part { piece, low, high, .. }, curve, m) = (*part, self.curve, self.m);
        let (width, mut here) = (high - low, Information::default());
        let slope = |u: f64| {
            let (information, change) = curve.information_along(piece, u);
            here = information;
            change.along(m)
        };
        let u = summit(slope, (low, high), guess, step * width, 0.5 * self.slack / width);
        self.look_at(piece, u, here);
        let margin = 1e-7 * width;
        (u > low + margin && u < high - margin).then_some(u)
    }

    fn search_section<const N: usize>(&mut self, part: Part) {
        let Part { piece, low, high, mut bound, mut guess, .. } = part;
        let section = self.section::<N>(&part);
        if !part.is_tight {
            let (tight, share) = section.bound();
            (bound, guess) = (bound.min(tight), low + (high - low) * share);
        }
        let is_inside = guess > low && guess < high;
        // The first and the last control point are places.
        if !is_inside {
            self.look_at(piece, guess, self.curve.information_on(piece, guess));
        }
        let mut cut = None;
        if bound > self.enough && !part.is_searched {
            if is_inside && self.climb(part, &section, guess) {
                return;
            }
            cut = self.climb_slopes(&part, guess, STEP);
        }
        let part = Part { bound, guess, is_tight: false, is_searched: cut.is_some(), ..part };
        let cut = cut.unwrap_or(0.5 * (low + high));
        // A single place has its value as its bound.
        if bound <= self.enough || !(cut > low && cut < high) {
            self.left_out = self.left_out.max(bound);
        } else {
            let is_low = section.halves((cut - low) / (high - low)).is_at_most(self.enough);
            self.open_halves(part, cut, is_low);
        }
    }

    /// The same where the parts of a piece have control points of their own.
    fn search_hull(&mut self, part: Part) {
        let Part { piece, low, high, bound, guess, .. } = part;
        let near = self.near - Curve::base(piece);
        let is_near = near > low && near < high && !part.is_searched;
        if !part.is_tight && !is_near {
            return self.open_hull(Part { is_tight: true, ..part });
        }
        if guess == low || guess == high {
            self.look_at(piece, guess, self.curve.information_on(piece, guess));
        }
        let mut cut = None;
        if bound > self.enough && !part.is_searched {
            let (guess, step) = if is_near { (near, NEAR) } else { (guess, STEP) };
            cut = self.climb_slopes(&part, guess, step);
        }
        let is_searched = cut.is_some();
        let cut = cut.unwrap_or(0.5 * (low + high));
        if bound <= self.enough || !(cut > low && cut < high) {
            self.left_out = self.left_out.max(bound);
        } else {
            for (low, high) in [(low, cut), (cut, high)] {
                self.open_hull(Part { low, high, is_tight: true, is_searched, ..part });
            }
        }
    }

    /// Opens a part with its own bound.
    fn open_hull(&mut self, part: Part) {
        let Part { piece, low, high, .. } = part;
        let leaf = Leaf::of(&self.curve.noise, &self.curve.pieces[piece].part(low, high));
        let (bound, share) = leaf.bound(self.m);
        self.open.push(Part { bound: bound.min(part.bound), guess: low + (high - low) * share, ..part });
    }

    /// Opens the parts before and after a cut, but those that have at most enough.
    fn open_halves(&mut self, part: Part, cut: f64, is_low: [bool; 2]) {
        for ((low, high), is_low) in [(part.low, cut), (cut, part.high)].into_iter().zip(is_low) {
            if is_low {
                self.left_out = self.left_out.max(self.enough);
            } else {
                self.open.push(Part { low, high, ..part });
            }
        }
    }

    #[inline]
    fn section<const N: usize>(&self, part: &Part) -> Section<N> {
        self.curve.leaves[part.piece].section(self.m, part.low, part.high)
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
