//! Branch and bound over parts of the arcs.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use super::super::Problem;
use super::super::arm::{Arm, Extent};
use super::super::pair::best_pair;
use super::super::vector::Vector;
use super::bound::{ARC_BOUND_ROBOTS_MAX, Hull, arc_bound};

/// Nodes closer than this to the best answer are not looked into, relative to the sum of all lambda: a
/// tenth of what a certificate allows.
const PRUNE: f64 = 1e-10;

/// Memory reserved at once; larger budgets grow into theirs.
const RESERVED_NODES_MAX: usize = 10_000;

/// Cycles of a descent; each ends where it no longer moves, which is mostly sooner.
const CYCLES_MAX: usize = 20;

/// Teams up to this size try all pairs of robots, larger ones each robot with the next.
const ALL_PAIRS_MAX: usize = 8;

/// The search and its memory.
#[derive(Debug, Clone)]
pub(super) struct Search {
    nodes_max: usize,
    nodes: Vec<Node>,
    open: BinaryHeap<Open>,
    hull: Hull,
    /// The arcs of the node at hand.
    arms: Vec<Arm>,
    candidate: Vec<Vector>,
    pub(super) looked_into: usize,
}

/// A part of the search space: its parent's, with one arm kept to a part of its arc.
#[derive(Debug, Clone, Copy)]
struct Node {
    parent: usize,
    arm: usize,
    kept: Arm,
    /// The arm to split next, and where its vector points in the nearest point of the hulls.
    split: usize,
    split_at: Vector,
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
            nodes: Vec::with_capacity(2 * reserved + 1),
            open: BinaryHeap::with_capacity(2 * reserved + 1),
            hull: Hull::default(),
            arms: Vec::new(),
            candidate: Vec::new(),
            looked_into: 0,
        }
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
        let bound = self.search(problem, directions, PRUNE * total);
        (bound - rounding).max(0.0)
    }

    fn search(&mut self, problem: &Problem, directions: &mut [Vector], tolerance: f64) -> f64 {
        self.looked_into = 0;
        let mut best = descend(problem, directions);
        // One robot that outweighs all others: what they cannot make up for.
        let total = problem.lambda_sum();
        let heaviest = problem.arms.iter().fold(problem.prior.norm(), |heaviest, arm| heaviest.max(arm.lambda));
        let floor = (heaviest - (total - heaviest)).max(0.0);
        if best - floor <= tolerance {
            return floor;
        }
        self.arms.clear();
        self.arms.extend_from_slice(&problem.arms);
        self.nodes.clear();
        self.open.clear();
        // Bounds of what has been set aside.
        let mut least = best;
        let root = Node { parent: 0, arm: 0, kept: problem.arms[0], split: 0, split_at: Vector::default() };
        self.look_into(problem, root, floor, &mut best, &mut least, directions, tolerance);
        self.looked_into = 1;
        if !self.open.is_empty() && problem.len() <= ALL_PAIRS_MAX {
            self.try_ends(problem, &mut best, directions, tolerance);
        }
        while let Some(Open { bound, node }) = self.open.pop() {
            if bound >= best - tolerance || self.looked_into >= self.nodes_max {
                least = least.min(bound);
                break;
            }
            self.restrict(problem, node);
            let Node { split, split_at, .. } = self.nodes[node];
            let whole = self.arms[split];
            for kept in whole.halves(split_at) {
                self.arms[split] = kept;
                let child = Node { parent: node, arm: split, kept, split: 0, split_at: Vector::default() };
                self.look_into(problem, child, bound, &mut best, &mut least, directions, tolerance);
                self.looked_into += 1;
            }
        }
        least.min(best)
    }

    /// Tries each robot at each end of its arc with the others turned to suit: an optimum that one
    /// descent misses mostly has a robot there.
    fn try_ends(&mut self, problem: &Problem, best: &mut f64, directions: &mut [Vector], tolerance: f64) {
        for (i, arm) in problem.arms.iter().enumerate() {
            for end in [arm.low, arm.high] {
                if *best <= tolerance {
                    return;
                }
                self.candidate.clear();
                self.candidate.extend_from_slice(directions);
                self.candidate[i] = end;
                turn_pairs(problem, &mut self.candidate, Some(i));
                let value = descend(problem, &mut self.candidate);
                if value < *best {
                    *best = value;
                    directions.copy_from_slice(&self.candidate);
                }
            }
        }
    }

    /// Puts the arcs of a node in place.
    fn restrict(&mut self, problem: &Problem, node: usize) {
        self.arms.copy_from_slice(&problem.arms);
        // From the node up, a part seen first is the smallest.
        let mut at = node;
        while at != 0 {
            let Node { parent, arm, kept, .. } = self.nodes[at];
            if self.arms[arm] == problem.arms[arm] {
                self.arms[arm] = kept;
            }
            at = parent;
        }
    }

    /// Bounds the node whose arcs are in place, tries the answer that its hulls suggest, and opens it if
    /// it may hold a better one.
    #[expect(clippy::too_many_arguments, reason = "the state of one search, which has no other user")]
    fn look_into(
        &mut self,
        problem: &Problem,
        mut node: Node,
        parents_bound: f64,
        best: &mut f64,
        least: &mut f64,
        directions: &mut [Vector],
        tolerance: f64,
    ) {
        self.hull.start(problem.prior, &self.arms);
        let bound = self.hull.approach(problem.prior, &self.arms, Some(*best - tolerance), 0.1 * tolerance);
        let mut bound = bound.max(parents_bound);
        if bound >= *best - tolerance {
            *least = least.min(bound);
            return;
        }
        self.candidate.clear();
        let mut largest_loss = 0.0;
        for (i, (arm, original)) in self.arms.iter().zip(&problem.arms).enumerate() {
            let in_hull = self.hull.direction(i);
            let loss = arm.lambda * (1.0 - in_hull.norm());
            if loss > largest_loss {
                largest_loss = loss;
                node.split = i;
                node.split_at = in_hull;
            }
            self.candidate.push(original.nearest(in_hull, arm.centre));
        }
        let value = descend(problem, &mut self.candidate);
        if value < *best {
            *best = value;
            directions.copy_from_slice(&self.candidate);
            // A better answer can close the node that led to it.
            if self.hull.distance() >= *best - tolerance {
                let enough = Some(*best - tolerance);
                bound = bound.max(self.hull.approach(problem.prior, &self.arms, enough, 0.1 * tolerance));
            }
        }
        if bound >= *best - tolerance || largest_loss == 0.0 {
            *least = least.min(bound);
            return;
        }
        if problem.len() <= ARC_BOUND_ROBOTS_MAX {
            let enough = *best - tolerance;
            let arc = arc_bound(&mut self.hull, problem.prior, &mut self.arms, node.split, enough);
            bound = bound.max(arc);
            if bound >= enough {
                *least = least.min(bound);
                return;
            }
        }
        self.nodes.push(node);
        self.open.push(Open { bound, node: self.nodes.len() - 1 });
    }
}

/// Turns one robot after the other, and then pairs of them, to their closed-form optimum until
/// nothing moves; returns `|S|`, which never grows.
fn descend(problem: &Problem, directions: &mut [Vector]) -> f64 {
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
    value
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
    /// The two halves of the arc; a full circle is cut across `towards`.
    fn halves(&self, towards: Vector) -> [Self; 2] {
        let quarter = Vector::new(0.0, 1.0);
        if self.extent == Extent::Circle {
            let middle = towards.normalised().unwrap_or(self.centre);
            return [middle, -middle].map(|centre| Self::with_half_width(self.lambda, centre, quarter));
        }
        let half = |low: Vector, high: Vector| Self {
            centre: (low + high).normalised().unwrap_or(self.centre),
            low,
            high,
            extent: Extent::Narrow,
            ..*self
        };
        [half(self.low, self.centre), half(self.centre, self.high)]
    }
}
