//! The team's problem: a curve for each robot, and what is known without them.

use rangehound_shared::scenario::Criterion;

use super::curve::Curve;
use super::information::{Cost, Information};
use super::minimum::minimum;
use crate::planner::Situation;
use crate::planner::range_only::Problem;

/// Sampled places of each piece, from which a robot's best place is looked for.
const SAMPLES: usize = 4;

/// Sweeps over the team at most.
const SWEEPS_MAX: usize = 60;

/// A sweep that improves the cost by less than this share is the last.
const SETTLED: f64 = 1e-12;

/// Minimise the criterion's cost of `prior + sum_i information_i`, each robot on its curve.
#[derive(Debug, Default)]
pub(super) struct Team {
    pub(super) criterion: Criterion,
    pub(super) prior: Information,
    pub(super) curves: Vec<Curve>,
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
        self.curves.clear();
        self.curves.extend(
            team.iter().zip(&problem.reaches).map(|(member, reach)| Curve::of(member, reach, &problem.corners_m)),
        );
        self.is_fused.clear();
        self.is_fused.extend(team.iter().map(|member| member.is_fused));
        self.group.clear();
        let separates = situation.clearance.separation_m > 0.0;
        self.group.extend(team.iter().enumerate().map(|(i, member)| {
            let is_like = |other: &usize| !separates && team[*other] == *member;
            (0..i).find(is_like).unwrap_or(i)
        }));
    }

    /// Every robot's whole curve.
    pub(super) fn whole(&self) -> Vec<(f64, f64)> {
        self.curves.iter().map(|curve| (0.0, curve.end())).collect()
    }

    /// A bound of the cost, by the multiplier of this information.
    pub(super) fn bound(&self, criterion: Criterion, information: Information) -> f64 {
        let m = criterion.multiplier(information);
        let slack = 1e-9 * information.along(m).abs() / self.curves.len().max(1) as f64;
        let support = |i: usize| self.curves[i].support((0.0, self.curves[i].end()), m, slack).bound;
        criterion.bound(m, self.fused().fold(self.prior.along(m), |sum, i| sum + support(i)))
    }

    /// The robots that count.
    pub(super) fn fused(&self) -> impl Iterator<Item = usize> {
        (0..self.curves.len()).filter(|i| self.is_fused[*i])
    }

    /// What is known after measurements from these places.
    pub(super) fn total(&self, at: &[f64]) -> Information {
        self.fused().fold(self.prior, |sum, i| sum + self.curves[i].information(at[i]))
    }

    /// The best place for one robot on an interval of its curve, given what the others tell; `now` if none is better.
    pub(super) fn respond(&self, robot: usize, rest: Information, (low, high): (f64, f64), now: f64) -> f64 {
        let curve = &self.curves[robot];
        let cost = |at: f64| self.criterion.cost(rest + curve.information(at));
        let (mut best, mut best_cost) = (now, cost(now));
        let (first, last) = (curve.piece_at(low).0, curve.piece_at(high).0);
        let mut bracket = None;
        for index in first..=last {
            let (from, to) = (low.max(index as f64), high.min(index as f64 + 1.0));
            for k in 0..=SAMPLES {
                let at = from + (to - from) * (k as f64 / SAMPLES as f64);
                let at_cost = cost(at);
                if at_cost < best_cost {
                    (best, best_cost) = (at, at_cost);
                    bracket = Some(index);
                }
            }
        }
        // The present place is refined too.
        let index = bracket.unwrap_or(curve.piece_at(best).0);
        let (from, to) = (low.max(index as f64), high.min(index as f64 + 1.0));
        let width = (to - from) / SAMPLES as f64;
        let (near, far) = ((best - width).max(from), (best + width).min(to));
        if near < far {
            let at = minimum(cost, near, far, best);
            if cost(at) < best_cost {
                best = at;
            }
        }
        best
    }

    /// Improves the places robot by robot until nothing changes; returns what is known then.
    pub(super) fn descend(&self, intervals: &[(f64, f64)], at: &mut [f64]) -> Information {
        let mut total = self.total(at);
        let mut cost = self.criterion.cost(total);
        for _ in 0..SWEEPS_MAX {
            for i in self.fused() {
                let rest = total - self.curves[i].information(at[i]);
                at[i] = self.respond(i, rest, intervals[i], at[i]);
                total = rest + self.curves[i].information(at[i]);
            }
            // Summed anew: differences of sums would drift.
            total = self.total(at);
            let after = self.criterion.cost(total);
            if cost - after <= SETTLED * after {
                break;
            }
            cost = after;
        }
        total
    }
}
