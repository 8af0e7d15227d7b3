//! The team's problem: a curve for each robot, and what is known without them.

use rangehound_shared::scenario::Criterion;

use super::curve::Curve;
use super::information::{Cost, Information, ROUNDING};
use super::summit::summit;
use super::support::Support;
use crate::planner::Situation;
use crate::planner::range_only::Problem;
use crate::vector::Vector;

/// Sampled places of each piece, from which a robot's best place is looked for.
const SAMPLES: usize = 4;

/// Sweeps over the team at most.
const SWEEPS_MAX: usize = 60;

/// A sweep that improves the cost by less than this share is the last.
const SETTLED: f64 = 1e-9;

/// How far a robot's place moves in a sweep after the first, in pieces.
const NEAR: f64 = 0.1;

/// Slope of a place that counts as best, relative to what the others tell.
const FLAT: f64 = 1e-6;

/// Minimise the criterion's cost of `prior + sum_i information_i`, each robot on its curve.
#[derive(Debug, Default)]
pub(super) struct Team {
    pub(super) criterion: Criterion,
    pub(super) prior: Information,
    pub(super) curves: Vec<Curve>,
    /// Every robot's whole curve, as intervals.
    pub(super) whole: Vec<(f64, f64)>,
    /// False for a robot whose measurement will not be fused: it is placed last and counts for nothing.
    pub(super) is_fused: Vec<bool>,
    /// The robots that are alike and stand on one spot have the same number.
    pub(super) group: Vec<usize>,
}

impl Team {
    pub(super) fn pose(&mut self, situation: &Situation, problem: &Problem) {
        let team = &situation.team;
        self.criterion = situation.criterion;
        self.prior = Information::of_covariance(&situation.belief.position_covariance_m2());
        self.curves.truncate(team.len());
        for (i, (member, reach)) in team.iter().zip(&problem.reaches).enumerate() {
            match self.curves.get_mut(i) {
                Some(curve) => curve.pose(member, reach, &problem.corners_m),
                None => self.curves.push(Curve::of(member, reach, &problem.corners_m)),
            }
        }
        self.whole.clear();
        self.whole.extend(self.curves.iter().map(|curve| (0.0, curve.end())));
        self.is_fused.clear();
        self.is_fused.extend(team.iter().map(|member| member.is_fused));
        self.group.clear();
        let separates = situation.clearance.separation_m > 0.0;
        self.group.extend(team.iter().enumerate().map(|(i, member)| {
            let is_like = |other: &usize| !separates && team[*other] == *member;
            (0..i).find(is_like).unwrap_or(i)
        }));
    }

    /// A bound of the cost, by the multiplier of this information.
    pub(super) fn bound(&self, criterion: Criterion, information: Information) -> f64 {
        let m = criterion.multiplier(information);
        let slack = 1e-9 * information.along(m).abs() / self.curves.len().max(1) as f64;
        let (h, _) = self.supports(self.fused(), &self.whole, m, slack, |_| 0.0, |_, _| ());
        criterion.bound(m, h)
    }

    /// The most that `T + m . S` of the prior and these robots can be on these intervals, with room for rounding; and what is
    /// known after measurements from the places that have most, which are looked for from `near` first, and which `visit` is called with.
    pub(super) fn supports(
        &self,
        robots: impl Iterator<Item = usize>,
        intervals: &[(f64, f64)],
        m: Vector,
        slack: f64,
        near: impl Fn(usize) -> f64,
        mut visit: impl FnMut(usize, Support),
    ) -> (f64, Information) {
        let (mut h, mut total) = (self.prior.along(m), self.prior);
        for i in robots {
            let support = self.curves[i].support(intervals[i], m, slack, near(i));
            h += support.bound;
            total += support.information;
            visit(i, support);
        }
        (h + ROUNDING * (1 + self.curves.len()) as f64 * total.t, total)
    }

    /// The robots that count.
    pub(super) fn fused(&self) -> impl Iterator<Item = usize> {
        (0..self.curves.len()).filter(|i| self.is_fused[*i])
    }

    /// The information after measurements from these places.
    pub(super) fn total(&self, at: &[f64]) -> Information {
        self.fused().fold(self.prior, |sum, i| sum + self.curves[i].information(at[i]))
    }

    /// The best place for one robot on an interval of its curve, given what the others tell; `now` if none is better.
    pub(super) fn respond(&self, robot: usize, rest: Information, interval: (f64, f64), now: f64) -> f64 {
        let now = Place { at: now, information: self.curves[robot].information(now) };
        self.respond_from(robot, rest, interval, now).at
    }

    fn respond_from(&self, robot: usize, rest: Information, (low, high): (f64, f64), now: Place) -> Place {
        let curve = &self.curves[robot];
        let (first, last) = (curve.piece_at(low).0, curve.piece_at(high).0);
        let (mut best, mut best_cost) = (now, self.criterion.cost(rest + now.information));
        for index in first..=last {
            let base = Curve::base(index);
            let (from, to) = ((low - base).max(0.0), (high - base).min(1.0));
            for k in 0..=SAMPLES {
                let u = from + (to - from) * (k as f64 / SAMPLES as f64);
                let information = curve.information_on(index, u);
                let cost = self.criterion.cost(rest + information);
                if cost < best_cost {
                    (best, best_cost) = (Place { at: base + u, information }, cost);
                }
            }
        }
        self.refine(robot, rest, (low, high), best, 1.0 / SAMPLES as f64)
    }

    /// The best place near the present one.
    fn refine(&self, robot: usize, rest: Information, (low, high): (f64, f64), now: Place, width: f64) -> Place {
        let curve = &self.curves[robot];
        let (index, u) = curve.piece_at(now.at);
        let base = Curve::base(index);
        let (from, to) = ((low - base).max(u - width).max(0.0), (high - base).min(u + width).min(1.0));
        if from >= to {
            return now;
        }
        let mut here = Information::default();
        // How much the cost falls along the curve.
        let fall = |u: f64| {
            let (information, change) = curve.information_along(index, u);
            here = information;
            change.along(self.criterion.multiplier(rest + information))
        };
        let better = summit(fall, (from, to), u, 0.1 * width, FLAT * rest.t);
        let cost = |information: Information| self.criterion.cost(rest + information);
        if better != u && cost(here) < cost(now.information) {
            Place { at: base + better, information: here }
        } else {
            now
        }
    }

    /// Improves the places robot by robot until nothing changes; returns what is known then. The first sweep looks at whole
    /// intervals, the others near the places; one at an end of its piece may go on to the next.
    pub(super) fn descend(&self, intervals: &[(f64, f64)], at: &mut [f64]) -> Information {
        let mut total = self.total(at);
        let mut cost = self.criterion.cost(total);
        for sweep in 0..SWEEPS_MAX {
            // Summed anew: differences of sums would drift.
            let mut sum = self.prior;
            for i in self.fused() {
                let now = Place { at: at[i], information: self.curves[i].information(at[i]) };
                let rest = total - now.information;
                let is_between = at[i] == at[i].trunc();
                let best = if sweep == 0 || is_between {
                    self.respond_from(i, rest, intervals[i], now)
                } else {
                    self.refine(i, rest, intervals[i], now, NEAR)
                };
                at[i] = best.at;
                total = rest + best.information;
                sum += best.information;
            }
            total = sum;
            let after = self.criterion.cost(total);
            if cost - after <= SETTLED * after {
                break;
            }
            cost = after;
        }
        total
    }
}

/// A place of a robot's curve.
#[derive(Debug, Clone, Copy)]
struct Place {
    at: f64,
    information: Information,
}
