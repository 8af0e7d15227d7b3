//! Branch and bound over intervals of the robots' curves.
//!
//! A node gives each robot an interval of its curve. Its bound is that of the convex hulls: at each multiplier `m` the sum of
//! the curves' supports bounds the cost. The best multiplier belongs to the best point of the sum of the hulls, which
//! simplicial decomposition finds. Where that point is no plan, the search splits the robot whose part of that point is
//! farthest from its curve.

use std::cell::Cell;
use std::cmp::Ordering;
use std::collections::BinaryHeap;

use super::follow;
use super::hull::{self, Vertex, Vertices};
use super::information::{Cost, Information};
use super::team::Team;

/// A plan is optimal if its cost is at most this share above the bound.
pub(super) const GAP_MAX: f64 = 1e-6;

/// Gap at which a node is closed; the rest of [`GAP_MAX`] is room for rounding.
const AIM: f64 = 0.5 * GAP_MAX;

/// Multipliers that are tried for one node.
const MULTIPLIERS_MAX: usize = 40;

/// A node is split when better multipliers could close no more than this part of the gap: its halves start with the same
/// vertices, so what is left is not lost.
const UNPROVEN_MAX: f64 = 0.25;

/// How far the cost of a vertex may be above the answer, in parts of the gap, for a descent from there to be worth its time.
const NEAR: f64 = 0.2;

/// Part of the bound's gap that the supports may leave.
pub(super) const SLACK: f64 = 0.02 * GAP_MAX;

/// A best point seldom needs more vertices.
const VERTICES: usize = 12;

/// Nodes whose memory is kept for the next search.
const KEPT_MAX: usize = 500;

/// An answer and its proof.
#[derive(Debug, Default)]
pub(super) struct Answer {
    /// Each robot's place on its curve.
    pub(super) at: Vec<f64>,
    /// Its cost.
    pub(super) cost: f64,
    /// No places cost less: the least bound of all closed nodes.
    pub(super) bound: f64,
    /// Nodes that were bounded.
    pub(super) nodes: u32,
}

/// Memory of a search, for the next one.
#[derive(Debug, Default)]
pub(super) struct Memory {
    open: BinaryHeap<Node>,
    closed: Vec<Node>,
    /// Vertices of closed nodes.
    spare: Vec<Vertex>,
    scratch: Scratch,
}

/// Memory for the bound of a node.
#[derive(Debug, Default)]
struct Scratch {
    vertices: Vertices,
    found: Vertex,
    at: Vec<f64>,
    near: Vec<Cell<f64>>,
}

#[derive(Debug, Default)]
struct Node {
    bound: f64,
    /// Each robot's interval.
    intervals: Vec<(f64, f64)>,
    /// The parts of the best point of its hulls.
    vertices: Vec<Vertex>,
    /// The robot to split, and where.
    split: (usize, f64),
}

impl PartialEq for Node {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}
impl Eq for Node {}
impl PartialOrd for Node {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Node {
    /// The least bound is the greatest: it comes first.
    fn cmp(&self, other: &Self) -> Ordering {
        other.bound.total_cmp(&self.bound)
    }
}

/// Finds places of least cost, from a first answer; bounds at most `nodes_max` nodes.
pub(super) fn search(team: &Team, start: Vec<f64>, nodes_max: u32, memory: &mut Memory) -> Answer {
    let mut at = start;
    let cost = team.criterion.cost(team.descend(&team.whole, &mut at));
    let mut root = memory.node();
    root.intervals.clone_from(&team.whole);
    let Scratch { vertices, found, .. } = &mut memory.scratch;
    place(team, &at, found);
    vertices.clear();
    vertices.push(found);
    let mut answer = Answer { at, cost, bound: f64::INFINITY, nodes: 0 };
    root.bound = 0.0;
    memory.store(root, |root, scratch| bound(team, root, scratch, &mut answer));
    while let Some(node) = memory.open.pop() {
        if node.bound >= answer.cost * (1.0 - AIM) || answer.nodes >= nodes_max {
            answer.bound = answer.bound.min(node.bound);
            memory.close(node);
            break;
        }
        for upper in [false, true] {
            let mut child = memory.node();
            let is_left = halve(team, &node, upper, &mut child.intervals);
            child.bound = node.bound;
            memory.scratch.vertices.copy(&node.vertices);
            memory.store(child, |child, scratch| is_left && bound(team, child, scratch, &mut answer));
        }
        memory.close(node);
    }
    memory.close_all();
    // Rounding may put a bound above its answer.
    answer.bound = answer.bound.min(answer.cost);
    answer
}

impl Memory {
    /// A closed node, or a new one.
    fn node(&mut self) -> Node {
        let new = || Node { vertices: Vec::with_capacity(VERTICES), ..Node::default() };
        self.closed.pop().unwrap_or_else(new)
    }

    /// Keeps a node open if `bound` finds that it may have a better answer.
    fn store(&mut self, mut node: Node, bound: impl FnOnce(&mut Node, &mut Scratch) -> bool) {
        if bound(&mut node, &mut self.scratch) {
            for vertex in self.scratch.vertices.iter() {
                let mut copy = self.spare.pop().unwrap_or_default();
                copy.copy(vertex);
                node.vertices.push(copy);
            }
            self.open.push(node);
        } else {
            self.close(node);
        }
    }

    fn close(&mut self, mut node: Node) {
        self.spare.append(&mut node.vertices);
        self.closed.push(node);
    }

    /// Ends a search. The memory of a large one is not kept.
    fn close_all(&mut self) {
        let mut left = std::mem::take(&mut self.open);
        left.drain().for_each(|node| self.close(node));
        self.open = left;
        let Self { open, closed, spare, .. } = self;
        closed.truncate(KEPT_MAX);
        spare.truncate(VERTICES * KEPT_MAX);
        open.shrink_to(KEPT_MAX);
        closed.shrink_to(KEPT_MAX);
        spare.shrink_to(VERTICES * KEPT_MAX);
    }
}

/// The intervals of one half of a node; false if alike robots leave none of it.
///
/// Robots that are alike and stand on one spot change places at no cost, so they are taken in the order of their parameters.
fn halve(team: &Team, node: &Node, upper: bool, intervals: &mut Vec<(f64, f64)>) -> bool {
    let (robot, cut) = node.split;
    let (end, start) = team.curves[robot].cut_at(cut);
    intervals.clone_from(&node.intervals);
    let peers = |i: &usize| team.group[*i] == team.group[robot] && team.is_fused[*i];
    if upper {
        intervals[robot].0 = start;
        for i in (robot + 1..intervals.len()).filter(peers) {
            intervals[i].0 = intervals[i].0.max(start);
        }
    } else {
        intervals[robot].1 = end;
        for i in (0..robot).filter(peers) {
            intervals[i].1 = intervals[i].1.min(end);
        }
    }
    intervals.iter().all(|(low, high)| low <= high)
}

/// Bounds a node and decides where to split it; false if it has no better answer. Starts from the best point of its parent's
/// hulls, whose vertices are at hand, and improves the answer on the way.
fn bound(team: &Team, node: &mut Node, scratch: &mut Scratch, answer: &mut Answer) -> bool {
    let Node { bound: least, intervals, .. } = node;
    let Scratch { vertices, found, at, near } = scratch;
    let criterion = team.criterion;
    answer.nodes += 1;
    for vertex in vertices.iter_mut() {
        for i in team.fused() {
            let at = vertex.at[i].clamp(intervals[i].0, intervals[i].1);
            if at != vertex.at[i] {
                let part = team.curves[i].information(at);
                vertex.total = vertex.total - vertex.parts[i] + part;
                (vertex.at[i], vertex.parts[i]) = (at, part);
            }
        }
    }
    let mut best = hull::improve(criterion, vertices);
    let mut bound = 0.0_f64;
    for _ in 0..MULTIPLIERS_MAX {
        let m = criterion.multiplier(best);
        // How far each support may be from its maximum.
        let slack = SLACK * best.along(m).abs() / team.curves.len() as f64;
        let last = &vertices[vertices.len() - 1];
        found.copy(last);
        found.share = 0.0;
        let (h, total) = team.supports(
            team.fused(),
            intervals,
            m,
            slack,
            |i| last.at[i],
            |i, support| {
                (found.at[i], found.parts[i]) = (support.at, support.information);
            },
        );
        found.total = total;
        bound = bound.max(criterion.bound(m, h));
        keep(team, &found.at, criterion.cost(found.total), answer);
        if bound >= answer.cost * (1.0 - AIM) {
            answer.bound = answer.bound.min(bound);
            return false;
        }
        // No better multiplier proves much more.
        let left = criterion.cost(best) - bound;
        if left <= UNPROVEN_MAX * (answer.cost - bound) || found.total.along(m) <= best.along(m) + slack {
            break;
        }
        vertices.push(found);
        best = hull::improve(criterion, vertices);
    }
    // The best vertex may lead to a better answer, if it is not far from one.
    let best_vertex = vertices.iter().min_by(|a, b| criterion.cost(a.total).total_cmp(&criterion.cost(b.total)));
    if let Some(vertex) = best_vertex
        && criterion.cost(vertex.total) - answer.cost < NEAR * (answer.cost - bound)
    {
        at.clone_from(&vertex.at);
        let total = team.descend(intervals, at);
        keep(team, at, criterion.cost(total), answer);
    }
    let (robot, cut) = split(team, intervals, vertices, best);
    let middle = vertices.iter().fold(Information::default(), |sum, vertex| sum + vertex.parts[robot] * vertex.share);
    if !narrow(team, intervals, robot, best - middle, answer, near) {
        return false;
    }
    let (low, high) = intervals[robot];
    let cut = if cut > low && cut < high { cut } else { 0.5 * (low + high) };
    *least = least.max(bound);
    node.split = (robot, cut);
    true
}

/// Leaves of a robot's interval what may have better answers, by multipliers that follow it; false if that is nothing.
fn narrow(
    team: &Team,
    intervals: &mut [(f64, f64)],
    robot: usize,
    rest: Information,
    answer: &mut Answer,
    near: &mut Vec<Cell<f64>>,
) -> bool {
    let aim = answer.cost * (1.0 - AIM);
    let left = follow::open_part(team, intervals, robot, rest, answer, aim, near);
    if left != Some(intervals[robot]) {
        answer.bound = answer.bound.min(aim);
    }
    intervals[robot] = left.unwrap_or_default();
    left.is_some()
}

/// Makes a vertex that of these places, with the whole share.
fn place(team: &Team, at: &[f64], vertex: &mut Vertex) {
    vertex.at.clear();
    vertex.at.extend_from_slice(at);
    vertex.parts.clear();
    vertex.parts.extend(at.iter().zip(&team.curves).map(|(at, curve)| curve.information(*at)));
    (vertex.total, vertex.share) = (team.total(at), 1.0);
}

fn keep(team: &Team, at: &[f64], cost: f64, answer: &mut Answer) {
    if cost < answer.cost {
        answer.cost = cost;
        for i in team.fused() {
            answer.at[i] = at[i];
        }
    }
}

/// The robot whose part of the best point is farthest from its curve, and the middle of the places that it is made of.
fn split(team: &Team, intervals: &[(f64, f64)], vertices: &Vertices, best: Information) -> (usize, f64) {
    let m = team.criterion.multiplier(best);
    let mut widest = (f64::NEG_INFINITY, 0, 0.0);
    for i in team.fused() {
        let (low, high) = intervals[i];
        let (mut first, mut last) = (f64::INFINITY, f64::NEG_INFINITY);
        let mut middle = Information::default();
        for vertex in vertices.iter() {
            middle += vertex.parts[i] * vertex.share;
            (first, last) = (first.min(vertex.at[i]), last.max(vertex.at[i]));
        }
        let spread = vertices.iter().map(|vertex| vertex.share * (vertex.parts[i] - middle).size(m)).sum::<f64>();
        // Between its places, but not so near to an end that the other half stays as it is.
        let margin = 0.05 * (high - low);
        let cut = (0.5 * (first + last)).clamp(low + margin, high - margin);
        if high > low && spread > widest.0 {
            widest = (spread, i, cut);
        }
    }
    (widest.1, widest.2)
}
