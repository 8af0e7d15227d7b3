//! Branch and bound over parts of the arcs.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use super::super::Problem;
use super::super::arm::{Arm, Extent};
use super::super::pair::best_pair;
use super::super::vector::Vector;
use super::bound::{ARC_BOUND_ROBOTS_MAX, Hull, arc_bound, arc_information};

/// Nodes closer than this to the best answer are not looked into, relative to the sum of all lambda: a
/// tenth of what a certificate allows.
const PRUNE: f64 = 1e-10;

/// The same relative to `T - |S|`, which makes it an error of the trace.
const TRACE: f64 = 1e-8;

/// What sums of positive terms can have rounded away of `T - |S|`, the prior's share among them, where its covariance is as
/// good as singular.
const ROUNDED: f64 = 1e-9;

/// A sum that is zero but for rounding, relative to the sum of all lambda.
const CLOSED: f64 = 1e-15;

/// Memory reserved at once; larger budgets grow into theirs.
const RESERVED_NODES_MAX: usize = 10_000;

/// Cycles of a descent; each ends where it no longer moves, which is mostly sooner.
const CYCLES_MAX: usize = 20;

/// Newton converges in a few steps or not at all.
const NEWTON_STEPS_MAX: usize = 12;

/// A sum this small, relative to the sum of all lambda, may be one that can be closed.
const NEARLY_CLOSED: f64 = 0.05;

/// Teams up to this size try all pairs of robots, larger ones each robot with the next.
const ALL_PAIRS_MAX: usize = 8;

/// What is made as small as can be; values and bounds of the search are in it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Measure {
    /// `|S|`.
    Length,
    /// `|S| - T`, less the least information: the same, but not as a difference.
    Information,
}

/// The search and its memory.
#[derive(Debug, Clone)]
pub(super) struct Search {
    nodes_max: usize,
    measure: Measure,
    nodes: Vec<Node>,
    open: BinaryHeap<Open>,
    hull: Hull,
    /// The arcs of the root. A circle among others that are alike is an arc of a whole turn, which begins at
    /// one place for all of them: cuts keep them in an order.
    whole: Vec<Arm>,
    /// The arcs of the node at hand.
    arms: Vec<Arm>,
    /// The arms by number, those that are alike side by side, and where each stands in that.
    order: Vec<usize>,
    place: Vec<usize>,
    /// The node's hulls' nearest point, by arm.
    in_hull: Vec<Vector>,
    candidate: Vec<Vector>,
    trial: Vec<Vector>,
    path: Vec<Cut>,
    looked_into: usize,
}

/// A part of the search space: its parent's, cut at a direction within one arm's arc.
#[derive(Debug, Clone, Copy)]
struct Node {
    parent: usize,
    cut: Cut,
    /// Where to cut next.
    next: (usize, Vector),
}

/// One arm kept to the part of its arc before or after a direction. Arms that are all alike are kept in
/// order of their directions, for every permutation of them is as good: so those before it in the
/// order are kept before the direction too, those after it after.
#[derive(Debug, Clone, Copy)]
struct Cut {
    arm: usize,
    at: Vector,
    side: Side,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Side {
    Before,
    After,
}

/// A node that may hold something better; the heap gives the one with the least bound first.
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
            nodes: Vec::with_capacity(2 * reserved + 1),
            open: BinaryHeap::with_capacity(2 * reserved + 1),
            hull: Hull::default(),
            whole: Vec::new(),
            arms: Vec::new(),
            order: Vec::new(),
            place: Vec::new(),
            in_hull: Vec::new(),
            candidate: Vec::new(),
            trial: Vec::new(),
            path: Vec::new(),
            looked_into: 0,
        }
    }

    /// Nodes that the last search looked into; 0 if it needed none.
    #[cfg(test)]
    pub(super) fn looked_into(&self) -> usize {
        self.looked_into
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
        // What adding up M vectors can have rounded away: a bound must hold in spite of it.
        let rounding = 4.0 * f64::EPSILON * problem.len() as f64 * total;
        let bound = self.search(problem, directions, total, rounding);
        (bound - rounding).max(0.0)
    }

    /// [`Self::improve`] where `T - |S|` is so small beside `T` that rounding of `|S|` would tell in it. Returns an upper
    /// bound on every `T - |S|`.
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
        self.looked_into = 0;
        // One vector that outweighs all others: what they cannot make up for.
        let heaviest = problem.arms.iter().fold(problem.prior.norm(), |heaviest, arm| heaviest.max(arm.lambda));
        let floor = (heaviest - (total - heaviest)).max(0.0);
        let mut best = problem.sum(directions).norm();
        if best - floor <= rounding {
            return floor;
        }
        best = descend(problem, directions, &mut self.trial);
        // The trace goes with 1 / (T - |S|): where one robot knows nearly all, the last digits of |S| count.
        let tolerance = (PRUNE * total).min(TRACE * problem.uncertainty(directions)).max(rounding);
        if best - floor <= tolerance {
            return floor;
        }
        let mut answer = Answer { best, least: best, tolerance, measure: self.measure, directions };
        self.branch(problem, floor, &mut answer)
    }

    /// Improves the answer until nothing better can be left, or the budget is spent. Returns the bound.
    fn branch(&mut self, problem: &Problem, floor: f64, answer: &mut Answer) -> f64 {
        self.nodes.clear();
        self.open.clear();
        self.put_in_order(&problem.arms);
        self.arms.clear();
        self.arms.extend_from_slice(&self.whole);
        let nowhere = Cut { arm: 0, at: Vector::default(), side: Side::Before };
        self.look_into(problem, 0, nowhere, floor, answer);
        self.looked_into = 1;
        if !self.open.is_empty() && self.measure == Measure::Length && problem.len() <= ALL_PAIRS_MAX {
            self.try_ends(problem, answer);
        }
        while let Some(Open { bound, node }) = self.open.pop() {
            if bound >= answer.enough() || self.looked_into >= self.nodes_max {
                answer.set_aside(bound);
                break;
            }
            let (arm, at) = self.nodes[node].next;
            for side in [Side::Before, Side::After] {
                let cut = Cut { arm, at, side };
                self.restrict(node, cut);
                self.look_into(problem, node, cut, bound, answer);
                self.looked_into += 1;
            }
        }
        answer.least.min(answer.best)
    }

    /// Puts arms that are alike side by side.
    fn put_in_order(&mut self, arms: &[Arm]) {
        let key = |i: usize| [arms[i].lambda, arms[i].centre.x, arms[i].centre.y, arms[i].low.x];
        self.order.clear();
        self.order.extend(0..arms.len());
        self.order.sort_unstable_by(|&i, &j| {
            let keys = key(i).into_iter().zip(key(j)).map(|(a, b)| a.total_cmp(&b));
            keys.fold(Ordering::Equal, Ordering::then).then(i.cmp(&j))
        });
        self.place.clear();
        self.place.resize(arms.len(), 0);
        self.whole.clear();
        self.whole.extend_from_slice(arms);
        for (place, &arm) in self.order.iter().enumerate() {
            self.place[arm] = place;
            let neighbours = [place.wrapping_sub(1), place + 1];
            let is_alike = |other: usize| self.order.get(other).is_some_and(|&other| arms[other] == arms[arm]);
            if arms[arm].extent == Extent::Circle && neighbours.into_iter().any(is_alike) {
                self.whole[arm].extent = Extent::Wide;
            }
        }
    }

    /// Tries each robot at each end of its arc with the others turned to suit: an optimum that one
    /// descent misses mostly has a robot there.
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

    /// Puts the arcs of a node and of one more cut in place.
    fn restrict(&mut self, node: usize, cut: Cut) {
        self.path.clear();
        self.path.push(cut);
        let mut at = node;
        while at != 0 {
            self.path.push(self.nodes[at].cut);
            at = self.nodes[at].parent;
        }
        self.arms.copy_from_slice(&self.whole);
        while let Some(Cut { arm, at, side }) = self.path.pop() {
            let alike = |other: usize| self.whole[other] == self.whole[arm];
            let place = self.place[arm];
            self.arms[arm] = self.arms[arm].part(at, side);
            let (before, after) = (self.order[..place].iter().rev(), self.order[place + 1..].iter());
            let others: &mut dyn Iterator<Item = &usize> = match side {
                Side::Before => &mut before.take_while(|other| alike(**other)),
                Side::After => &mut after.take_while(|other| alike(**other)),
            };
            for &other in others {
                if self.arms[other].contains(at) {
                    self.arms[other] = self.arms[other].part(at, side);
                }
            }
        }
    }

    /// Bounds the node whose arcs are in place, tries the answer that its hulls suggest, and opens it if
    /// it may hold a better one.
    fn look_into(&mut self, problem: &Problem, parent: usize, cut: Cut, parents_bound: f64, answer: &mut Answer) {
        self.hull.start(problem.prior, &self.arms);
        let mut bound = parents_bound;
        let (mut largest_loss, mut split);
        loop {
            let enough = answer.enough();
            bound = bound.max(match self.measure {
                Measure::Length => self.hull.approach(problem.prior, &self.arms, Some(enough), 0.1 * answer.tolerance),
                Measure::Information => -self.hull.approach_information(problem, &self.arms, -enough),
            });
            if bound >= answer.enough() {
                return answer.set_aside(bound);
            }
            self.share_out();
            self.candidate.clear();
            (largest_loss, split) = (0.0, 0);
            for (i, (arm, original)) in self.arms.iter().zip(&problem.arms).enumerate() {
                let loss = match self.measure {
                    Measure::Length => arm.lambda * (1.0 - self.in_hull[i].norm()),
                    Measure::Information => arm.lambda * self.hull.depth(i),
                };
                if loss > largest_loss {
                    (largest_loss, split) = (loss, i);
                }
                self.candidate.push(original.nearest(self.in_hull[i], arm.centre));
            }
            // A better answer asks for a better bound, and may close the node that led to it.
            if !self.offer_candidate(problem, answer) {
                break;
            }
        }
        if self.measure == Measure::Information && (largest_loss == 0.0 || bound <= -problem.information_trace) {
            // The hulls hold the origin, and tell nothing of where they do.
            for (i, arm) in self.arms.iter().enumerate() {
                let loss = 0.5 * arm.lambda * (arm.centre - arm.low).norm_squared();
                if loss > largest_loss {
                    (largest_loss, split) = (loss, i);
                }
            }
        }
        if bound < answer.enough() && largest_loss > 0.0 && problem.len() <= ARC_BOUND_ROBOTS_MAX {
            bound = bound.max(match self.measure {
                Measure::Length => arc_bound(&mut self.hull, problem.prior, &mut self.arms, split, answer.enough()),
                Measure::Information => self.arc_information(problem, split, answer),
            });
        }
        if bound >= answer.enough() || largest_loss == 0.0 {
            return answer.set_aside(bound);
        }
        let is_alone = self.run_of(self.place[split]).len() == 1;
        let at = self.arms[split].middle(if is_alone { self.in_hull[split] } else { Vector::default() });
        self.nodes.push(Node { parent, cut, next: (split, at) });
        self.open.push(Open { bound, node: self.nodes.len() - 1 });
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
        let arm = self.arms[which];
        let mut most = arc_information(problem, &self.arms, which, &mut self.candidate);
        self.offer_candidate(problem, answer);
        let ends = if arm.extent == Extent::Circle { &[][..] } else { &[arm.low, arm.high] };
        for &end in ends {
            self.arms[which] = Arm { centre: end, low: end, high: end, extent: Extent::Narrow, ..arm };
            most = most.max(self.hull.approach_information(problem, &self.arms, -answer.enough()));
            self.candidate.clear();
            for (i, arm) in problem.arms.iter().enumerate() {
                self.candidate.push(arm.nearest(self.hull.direction(i), self.arms[i].centre));
            }
            self.offer_candidate(problem, answer);
        }
        self.arms[which] = arm;
        -most
    }

    /// The places of the arms round this one that are alike in this node too.
    fn run_of(&self, place: usize) -> std::ops::Range<usize> {
        let arm = &self.arms[self.order[place]];
        let alike = |other: &&usize| self.arms[**other] == *arm;
        let start = place - self.order[..place].iter().rev().take_while(alike).count();
        start..place + self.order[place..].iter().take_while(alike).count()
    }

    /// Shares the hulls' nearest point out to the arms. Arms that are alike have the same share in it each;
    /// the same sum comes of some at the one end of their arc, some at the other, and one or two between:
    /// those are the only ones that leave their arcs.
    fn share_out(&mut self) {
        self.in_hull.clear();
        self.in_hull.extend((0..self.arms.len()).map(|i| self.hull.direction(i)));
        let mut place = 0;
        while place < self.order.len() {
            let run = self.run_of(place);
            place = run.end;
            let first = self.order[run.start];
            if run.len() > 1 && self.in_hull[first].norm_squared() < 1.0 - 1e-12 {
                let arm = self.arms[first];
                let mut corners = self.hull.corners_of(first);
                // In order along the arc, as the arms are.
                let along = |v: Vector| v.rotated_by(arm.low.conjugate()).angle_rad().rem_euclid(std::f64::consts::TAU);
                corners.sort_unstable_by(|a, b| along(a.0).total_cmp(&along(b.0)));
                let count = run.len() as f64;
                for (index, slot) in run.enumerate() {
                    let (from, to) = (index as f64, index as f64 + 1.0);
                    let mut shared = 0.0;
                    let mut sum = Vector::default();
                    for (direction, share) in corners {
                        let (start, end) = (shared * count, (shared + share) * count);
                        sum += direction * (end.min(to) - start.max(from)).max(0.0);
                        shared += share;
                    }
                    self.in_hull[self.order[slot]] = sum;
                }
            }
        }
    }
}

/// The best answer so far, and what has been proven.
struct Answer<'a> {
    best: f64,
    directions: &'a mut [Vector],
    /// Least bound of the nodes that were set aside.
    least: f64,
    tolerance: f64,
    measure: Measure,
}

impl Answer<'_> {
    /// A bound from which on a node holds nothing worth looking for.
    fn enough(&self) -> f64 {
        self.best - self.tolerance
    }

    fn set_aside(&mut self, bound: f64) {
        self.least = self.least.min(bound);
    }

    /// Takes an answer if it is better.
    fn offer(&mut self, value: f64, directions: &[Vector]) -> bool {
        let is_better = value < self.best;
        if is_better {
            self.best = value;
            self.directions.copy_from_slice(directions);
            if self.measure == Measure::Information {
                self.tolerance = TRACE * value.abs();
            }
        }
        is_better
    }
}

/// Turns one robot after the other, and then pairs of them, to their closed-form optimum until
/// nothing moves; returns `|S|`, which never grows.
fn descend(problem: &Problem, directions: &mut [Vector], trial: &mut Vec<Vector>) -> f64 {
    let mut value = problem.sum(directions).norm();
    for _ in 0..CYCLES_MAX {
        let before = value;
        let mut sum = problem.sum(directions);
        for (arm, direction) in problem.arms.iter().zip(directions.iter_mut()) {
            let rest = sum - *direction * arm.lambda;
            *direction = arm.nearest(-rest, *direction);
            sum = rest + *direction * arm.lambda;
        }
        value = problem.sum(directions).norm();
        if value >= before * (1.0 - 1e-3) {
            value = turn_pairs(problem, directions, None);
            if value >= before * (1.0 - 1e-9) {
                break;
            }
        }
    }
    let total = problem.lambda_sum();
    if value > CLOSED * total && value < NEARLY_CLOSED * total {
        return close(problem, directions, trial, value);
    }
    value
}

/// Turns one robot after the other as [`descend`] does, with each rest added up anew: a difference from the sum would
/// have lost the robots that know little. Returns `|S| - T`.
fn settle(problem: &Problem, directions: &mut [Vector]) -> f64 {
    let mut value = -problem.uncertainty(directions);
    for _ in 0..CYCLES_MAX {
        let before = value;
        for i in 0..directions.len() {
            let others = problem.arms.iter().zip(&*directions).enumerate().filter(|(other, _)| *other != i);
            let rest = others.fold(problem.prior, |sum, (_, (arm, u))| sum + *u * arm.lambda);
            directions[i] = problem.arms[i].nearest(-rest, directions[i]);
        }
        value = -problem.uncertainty(directions);
        if value >= before * (1.0 + 1e-12) {
            break;
        }
    }
    value
}

/// Where a sum of zero seems within reach, goes there by Newton's method on all directions at once, the
/// shortest such step: turning one or two at a time takes very long where many are nearly aligned.
/// Returns `|S|`; `directions` are left as they are unless that is less.
fn close(problem: &Problem, directions: &mut [Vector], trial: &mut Vec<Vector>, value: f64) -> f64 {
    trial.clear();
    trial.extend_from_slice(directions);
    let mut best = value;
    for _ in 0..NEWTON_STEPS_MAX {
        let sum = problem.sum(trial);
        // The sum moves by `J delta`, whose columns are `lambda_i j u_i`; here J J^T, which is 2 x 2.
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for (arm, u) in problem.arms.iter().zip(trial.iter()) {
            let (x, y) = (-u.y * arm.lambda, u.x * arm.lambda);
            (xx, xy, yy) = (xx + x * x, xy + x * y, yy + y * y);
        }
        let determinant = xx * yy - xy * xy;
        if determinant <= 0.0 {
            break;
        }
        let w = Vector::new(xy * sum.y - yy * sum.x, xy * sum.x - xx * sum.y) * determinant.recip();
        for (arm, u) in problem.arms.iter().zip(trial.iter_mut()) {
            let turn = arm.lambda * u.cross(w);
            let turned = *u + Vector::new(-u.y, u.x) * turn.clamp(-1.0, 1.0);
            *u = arm.nearest(turned, *u);
        }
        let value = problem.sum(trial).norm();
        if value < best {
            best = value;
            directions.copy_from_slice(trial);
        }
        if best <= CLOSED * problem.lambda_sum() {
            break;
        }
    }
    best
}

/// Turns pairs of robots where that helps, but for the robot `held`; returns `|S|`.
fn turn_pairs(problem: &Problem, directions: &mut [Vector], held: Option<usize>) -> f64 {
    let robots = problem.len();
    let mut sum = problem.sum(directions);
    for i in 0..robots {
        let last = if robots <= ALL_PAIRS_MAX { robots } else { (i + 2).min(robots) };
        for j in i + 1..last {
            if held == Some(i) || held == Some(j) {
                continue;
            }
            let (first, second) = (&problem.arms[i], &problem.arms[j]);
            let rest = sum - directions[i] * first.lambda - directions[j] * second.lambda;
            let [u1, u2] = best_pair(rest, first, second);
            let turned = rest + u1 * first.lambda + u2 * second.lambda;
            if turned.norm_squared() < sum.norm_squared() {
                sum = turned;
                [directions[i], directions[j]] = [u1, u2];
            }
        }
    }
    problem.sum(directions).norm()
}

impl Arm {
    /// Where to cut the arc: in the middle; a full circle across from `towards`, so that one half has it
    /// in its middle, or where its ends meet and across from there if `towards` is zero.
    fn middle(&self, towards: Vector) -> Vector {
        match (self.extent, towards.normalised()) {
            (Extent::Circle, Some(towards)) => towards.rotated_by(Vector::new(0.0, 1.0)),
            _ => self.centre,
        }
    }

    /// The part of the arc before or after a direction in it.
    fn part(&self, at: Vector, side: Side) -> Self {
        let (low, high) = match (self.extent, side) {
            // A circle begins and ends across from the cut.
            (Extent::Circle, Side::Before) => (-at, at),
            (Extent::Circle, Side::After) => (at, -at),
            (_, Side::Before) => (self.low, at),
            (_, Side::After) => (at, self.high),
        };
        // From `low` counter-clockwise to `high`: at most half a turn if that is to the left. Circles are halved.
        let is_narrow = self.extent != Extent::Wide || low.cross(high) >= 0.0;
        // The middle lies across the chord and along the sum of the ends: whichever has not cancelled tells.
        let (chord, sum) = (high - low, low + high);
        let middle = if chord.norm_squared() > sum.norm_squared() {
            Vector::new(chord.y, -chord.x)
        } else if is_narrow {
            sum
        } else {
            -sum
        };
        let centre = middle.normalised().unwrap_or(self.centre);
        let extent = if is_narrow { Extent::Narrow } else { Extent::Wide };
        Self { centre, low, high, extent, ..*self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f64::consts::{PI, TAU};

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(3_000))]

        /// Whatever is cut where, a configuration with alike robots in order is in one of the two parts.
        #[test]
        fn cuts_lose_no_configuration(
            groups in proptest::collection::vec((1..5_usize, -PI..PI, prop_oneof![Just(PI), 0.1..3.1_f64]), 1..4),
            places in proptest::collection::vec(0.0..1.0_f64, 16),
            cuts in proptest::collection::vec((any::<prop::sample::Index>(), -PI..PI), 1..20),
        ) {
            let mut arms = Vec::new();
            let mut widths = Vec::new();
            for (count, centre, half) in groups {
                let centre = Vector::from_angle(centre);
                let arm = if half == PI { Arm::circle(1.0, centre) } else { Arm::with_half_width(1.0, centre, Vector::from_angle(half)) };
                arms.extend(std::iter::repeat_n(arm, count));
                widths.extend(std::iter::repeat_n(2.0 * half, count));
            }
            let problem = Problem::of_arms(Vector::default(), arms);
            let mut search = Search::new(100);
            search.put_in_order(&problem.arms);
            search.arms = search.whole.clone();
            // Alike robots in order of their directions along the arc.
            let mut shares: Vec<f64> = places[..problem.len()].to_vec();
            let order = search.order.clone();
            for run in order.chunk_by(|&i, &j| problem.arms[i] == problem.arms[j]) {
                let mut sorted: Vec<f64> = run.iter().map(|&i| shares[i]).collect();
                sorted.sort_by(f64::total_cmp);
                run.iter().zip(sorted).for_each(|(&i, share)| shares[i] = share);
            }
            let configuration: Vec<Vector> = (0..problem.len())
                .map(|i| search.whole[i].low.rotated_by(Vector::from_angle((shares[i] * widths[i]).min(TAU - 1e-9))))
                .collect();
            let is_in = |arm: &Arm, u: Vector| (arm.nearest(u, u) - u).norm() < 1e-9;
            let nowhere = Cut { arm: 0, at: Vector::default(), side: Side::Before };
            search.nodes.push(Node { parent: 0, cut: nowhere, next: (0, Vector::default()) });
            let mut parent = 0;
            for (which, towards) in cuts {
                let arm = which.index(problem.len());
                let is_alone = search.run_of(search.place[arm]).len() == 1;
                let at = search.arms[arm].middle(if is_alone { Vector::from_angle(towards) } else { Vector::default() });
                let before = search.arms[arm].part(at, Side::Before);
                let side = if is_in(&before, configuration[arm]) { Side::Before } else { Side::After };
                let cut = Cut { arm, at, side };
                search.restrict(parent, cut);
                for (arm, u) in search.arms.iter().zip(&configuration) {
                    prop_assert!(is_in(arm, *u), "{arm:?} {u:?}");
                }
                search.nodes.push(Node { parent, cut, next: (0, Vector::default()) });
                parent = search.nodes.len() - 1;
            }
        }
    }
}
