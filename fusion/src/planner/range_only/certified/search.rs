//! Branch and bound over parts of the arcs.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use super::answer::{Answer, Measure, TRACE};
use super::bound::{ARC_BOUND_ROBOTS_MAX, Hull, arc_bound, arc_information};
use super::descent::{ALL_PAIRS_MAX, descend, settle, turn_pairs};
use super::parts::{Cut, Node, Parts, Side};
use crate::planner::range_only::Problem;
use crate::planner::range_only::arm::{Arm, Extent};
use crate::planner::range_only::pair::best_pair;
use crate::vector::Vector;

/// Nodes whose bounds are closer than this to the best answer are not examined. It is relative to the sum of all
/// lambda, and a tenth of what a certificate allows.
const PRUNE: f64 = 1e-10;

/// Relative rounding of `T - |S|` as a sum of positive terms, with the prior's term of a nearly singular covariance.
const ROUNDED: f64 = 1e-9;

/// Nodes for which memory is reserved at the start; larger searches grow.
const RESERVED_NODES_MAX: usize = 10_000;

/// The search and its memory.
#[derive(Debug, Clone)]
pub(super) struct Search {
    nodes_max: usize,
    measure: Measure,
    parts: Parts,
    open: BinaryHeap<Open>,
    hull: Hull,
    /// The nearest point of the node's hulls: each arm's vector in it.
    in_hull: Vec<Vector>,
    candidate: Vec<Vector>,
    trial: Vec<Vector>,
    examined: usize,
}

/// A node that may contain a better answer; the heap returns the one with the least bound first.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Open {
    bound: f64,
    node: usize,
}

impl Eq for Open {}

impl Ord for Open {
    fn cmp(&self, other: &Self) -> Ordering {
        other.bound.total_cmp(&self.bound).then(other.node.cmp(&self.node))
    }
}

impl PartialOrd for Open {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Search {
    pub(super) fn new(nodes_max: usize) -> Self {
        let reserved = nodes_max.min(RESERVED_NODES_MAX);
        Self {
            nodes_max,
            measure: Measure::Length,
            parts: Parts::with_capacity(2 * reserved + 1),
            open: BinaryHeap::with_capacity(2 * reserved + 1),
            hull: Hull::default(),
            in_hull: Vec::new(),
            candidate: Vec::new(),
            trial: Vec::new(),
            examined: 0,
        }
    }

    /// Nodes that the last search examined; 0 if it needed none.
    #[cfg(test)]
    pub(super) fn examined(&self) -> usize {
        self.examined
    }

    /// Improves `directions`, which must lie in their arcs, to the optimum as far as the budget
    /// reaches. Returns a lower bound on every `|S|`.
    pub(super) fn improve(&mut self, problem: &Problem, directions: &mut [Vector]) -> f64 {
        match (problem.arms.as_slice(), &mut *directions) {
            ([], _) => return problem.prior.norm(),
            ([only], [direction]) => {
                *direction = only.nearest(-problem.prior, *direction);
                return problem.sum(directions).norm();
            }
            ([first, second], [u1, u2]) => {
                [*u1, *u2] = best_pair(problem.prior, first, second);
                return problem.sum(directions).norm();
            }
            _ => {}
        }
        let total = problem.lambda_sum();
        // Rounding of a sum of M vectors: the bound must hold in spite of it.
        let rounding = 4.0 * f64::EPSILON * problem.len() as f64 * total;
        let bound = self.search(problem, directions, total, rounding);
        (bound - rounding).max(0.0)
    }

    /// [`Self::improve`] for problems in which `T - |S|` is so small beside `T` that rounding of `|S|` would dominate
    /// it. Returns an upper bound on every `T - |S|`.
    pub(super) fn improve_information(&mut self, problem: &Problem, directions: &mut [Vector]) -> f64 {
        self.measure = Measure::Information;
        self.candidate.clear();
        self.candidate.extend_from_slice(directions);
        let best = -problem.uncertainty(directions);
        let mut answer = Answer { best, least: best, tolerance: 0.0, measure: self.measure, directions };
        self.offer_candidate(problem, &mut answer);
        answer.tolerance = TRACE * answer.best.abs();
        let bound = self.branch(problem, f64::NEG_INFINITY, &mut answer);
        -bound * (1.0 + ROUNDED)
    }

    fn search(&mut self, problem: &Problem, directions: &mut [Vector], total: f64, rounding: f64) -> f64 {
        self.measure = Measure::Length;
        self.examined = 0;
        // If one vector is longer than all others together, the difference remains.
        let heaviest = problem.arms.iter().fold(problem.prior.norm(), |heaviest, arm| heaviest.max(arm.lambda));
        let floor = (heaviest - (total - heaviest)).max(0.0);
        let mut best = problem.sum(directions).norm();
        if best - floor <= rounding {
            return floor;
        }
        best = descend(problem, directions, &mut self.trial);
        // The trace goes with 1 / (T - |S|): if one robot has nearly all information, the last digits of |S| count.
        let tolerance = (PRUNE * total).min(TRACE * problem.uncertainty(directions)).max(rounding);
        if best - floor <= tolerance {
            return floor;
        }
        let mut answer = Answer { best, least: best, tolerance, measure: self.measure, directions };
        self.branch(problem, floor, &mut answer)
    }

    /// Improves the answer until no better one can exist, or the budget is spent. Returns the bound.
    fn branch(&mut self, problem: &Problem, floor: f64, answer: &mut Answer) -> f64 {
        self.open.clear();
        self.parts.begin(&problem.arms);
        let nowhere = Cut { arm: 0, at: Vector::default(), side: Side::Before };
        self.examine(problem, 0, nowhere, floor, answer);
        self.examined = 1;
        if !self.open.is_empty() && self.measure == Measure::Length && problem.len() <= ALL_PAIRS_MAX {
            self.try_ends(problem, answer);
        }
        while let Some(Open { bound, node }) = self.open.pop() {
            if bound >= answer.enough() || self.examined >= self.nodes_max {
                answer.set_aside(bound);
                break;
            }
            let (arm, at) = self.parts.next(node);
            for side in [Side::Before, Side::After] {
                let cut = Cut { arm, at, side };
                self.parts.restrict(node, cut);
                self.examine(problem, node, cut, bound, answer);
                self.examined += 1;
            }
        }
        answer.least.min(answer.best)
    }

    /// Tries each robot at each end of its arc, and descends from there: an optimum that the first descent misses
    /// usually has a robot at an end.
    fn try_ends(&mut self, problem: &Problem, answer: &mut Answer) {
        for (i, arm) in problem.arms.iter().enumerate() {
            for end in [arm.low, arm.high] {
                if answer.best <= answer.tolerance {
                    return;
                }
                self.candidate.clear();
                self.candidate.extend_from_slice(answer.directions);
                self.candidate[i] = end;
                turn_pairs(problem, &mut self.candidate, Some(i));
                let value = descend(problem, &mut self.candidate, &mut self.trial);
                answer.offer(value, &self.candidate);
            }
        }
    }

    /// Bounds the node whose arcs were restored last, tries the answer that its hulls suggest, and adds the node to the
    /// heap if it may contain a better one.
    fn examine(&mut self, problem: &Problem, parent: usize, cut: Cut, parents_bound: f64, answer: &mut Answer) {
        self.hull.start(problem.prior, &self.parts.arms);
        let mut bound = parents_bound;
        let (mut largest_loss, mut split);
        loop {
            let enough = answer.enough();
            bound = bound.max(match self.measure {
                Measure::Length => {
                    self.hull.approach(problem.prior, &self.parts.arms, Some(enough), 0.1 * answer.tolerance)
                }
                Measure::Information => -self.hull.approach_information(problem, &self.parts.arms, -enough),
            });
            if bound >= answer.enough() {
                return answer.set_aside(bound);
            }
            self.parts.share_out(&self.hull, &mut self.in_hull);
            self.candidate.clear();
            (largest_loss, split) = (0.0, 0);
            for (i, (arm, original)) in self.parts.arms.iter().zip(&problem.arms).enumerate() {
                let loss = match self.measure {
                    Measure::Length => arm.lambda * (1.0 - self.in_hull[i].norm()),
                    Measure::Information => arm.lambda * self.hull.depth(i),
                };
                if loss > largest_loss {
                    (largest_loss, split) = (loss, i);
                }
                self.candidate.push(original.nearest(self.in_hull[i], arm.centre));
            }
            // With a better answer the bound is improved again: it may now exclude this node.
            if !self.offer_candidate(problem, answer) {
                break;
            }
        }
        if self.measure == Measure::Information && (largest_loss == 0.0 || bound <= -problem.information_trace) {
            // The hulls contain the origin, so their nearest point does not show which arm to split.
            for (i, arm) in self.parts.arms.iter().enumerate() {
                let loss = 0.5 * arm.lambda * (arm.centre - arm.low).norm_squared();
                if loss > largest_loss {
                    (largest_loss, split) = (loss, i);
                }
            }
        }
        if bound < answer.enough() && largest_loss > 0.0 && problem.len() <= ARC_BOUND_ROBOTS_MAX {
            bound = bound.max(match self.measure {
                Measure::Length => {
                    arc_bound(&mut self.hull, problem.prior, &mut self.parts.arms, split, answer.enough())
                }
                Measure::Information => self.arc_information(problem, split, answer),
            });
        }
        if bound >= answer.enough() || largest_loss == 0.0 {
            return answer.set_aside(bound);
        }
        let at = self.parts.middle(split, self.in_hull[split]);
        let node = self.parts.add(Node { parent, cut, next: (split, at) });
        self.open.push(Open { bound, node });
    }

    /// Improves the candidate and offers it.
    fn offer_candidate(&mut self, problem: &Problem, answer: &mut Answer) -> bool {
        let value = match self.measure {
            Measure::Length => descend(problem, &mut self.candidate, &mut self.trial),
            Measure::Information => settle(problem, &mut self.candidate),
        };
        answer.offer(value, &self.candidate)
    }

    /// [`arc_bound`] of the information, with the answers that it suggests.
    fn arc_information(&mut self, problem: &Problem, which: usize, answer: &mut Answer) -> f64 {
        let arm = self.parts.arms[which];
        let mut most = arc_information(problem, &self.parts.arms, which, &mut self.candidate);
        self.offer_candidate(problem, answer);
        let ends = if arm.extent == Extent::Circle { &[][..] } else { &[arm.low, arm.high] };
        for &end in ends {
            self.parts.arms[which] = Arm { centre: end, low: end, high: end, extent: Extent::Narrow, ..arm };
            most = most.max(self.hull.approach_information(problem, &self.parts.arms, -answer.enough()));
            self.candidate.clear();
            for (i, arm) in problem.arms.iter().enumerate() {
                self.candidate.push(arm.nearest(self.hull.direction(i), self.parts.arms[i].centre));
            }
            self.offer_candidate(problem, answer);
        }
        self.parts.arms[which] = arm;
        -most
    }
}
