//! Branch and bound over intervals of the robots' curves.
//!
//! A node gives each robot an interval of its curve. Its bound is that of the convex hulls: at each multiplier `m` the sum of
//! the curves' supports bounds the cost. The best multiplier belongs to the best point of the sum of the hulls, which
//! simplicial decomposition finds. Where that point is no plan, the robot is split whose part of it is farthest from its curve.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use smallvec::SmallVec;

use super::hull::{self, Shares};
use super::information::{Cost, Information};
use super::team::Team;
use crate::vector::Vector;

/// A plan is optimal if its cost is at most this share above the bound.
pub(super) const GAP_MAX: f64 = 1e-6;

/// Part of the gap up to which a node is to be closed: what is left is room for rounding.
const AIM: f64 = 0.5 * GAP_MAX;

/// Multipliers that are tried for one node.
const MULTIPLIERS_MAX: usize = 40;

/// Part of the bound's gap that the supports may leave.
const SLACK: f64 = 0.02 * GAP_MAX;

/// An answer and its proof.
#[derive(Debug, Default)]
pub(super) struct Answer {
    /// Each robot's place on its curve.
    pub(super) at: Vec<f64>,
    /// Its cost.
    pub(super) cost: f64,
    /// No places cost less.
    pub(super) bound: f64,
    /// Nodes that were bounded.
    pub(super) nodes: u32,
}

/// One robot's interval in each.
type Intervals = Vec<(f64, f64)>;

#[derive(Debug)]
struct Node {
    bound: f64,
    intervals: Intervals,
    /// Where the relaxation had its robots, to start from.
    at: Vec<f64>,
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
pub(super) fn search(team: &Team, start: Vec<f64>, nodes_max: u32) -> Answer {
    let mut start = start;
    let cost = team.criterion.cost(team.descend(&team.whole(), &mut start));
    let mut answer = Answer { at: start, cost, ..Answer::default() };
    let at = answer.at.clone();
    let Some(root) = bounded(team, team.whole(), at, &mut answer) else { return answer };
    let mut open = BinaryHeap::from([root]);
    while let Some(node) = open.pop() {
        if node.bound >= answer.cost * (1.0 - AIM) || answer.nodes >= nodes_max {
            answer.bound = node.bound.min(answer.cost);
            return answer;
        }
        for upper in [false, true] {
            if let Some(child) = half(team, &node, upper)
                && let Some(mut child) = bounded(team, child, node.at.clone(), &mut answer)
            {
                child.bound = child.bound.max(node.bound);
                open.push(child);
            }
        }
        answer.bound = answer.cost * (1.0 - AIM);
    }
    answer
}

/// One half of a node; `None` if alike robots leave none of it.
///
/// Robots that are alike and stand on one spot change places at no cost, so they are taken in the order of their parameters.
fn half(team: &Team, node: &Node, upper: bool) -> Option<Intervals> {
    let (robot, cut) = node.split;
    let mut intervals = node.intervals.clone();
    let peers = |i: &usize| team.group[*i] == team.group[robot] && team.is_fused[*i];
    if upper {
        intervals[robot].0 = cut;
        for i in (robot + 1..intervals.len()).filter(peers) {
            intervals[i].0 = intervals[i].0.max(cut);
        }
    } else {
        intervals[robot].1 = cut;
        for i in (0..robot).filter(peers) {
            intervals[i].1 = intervals[i].1.min(cut);
        }
    }
    intervals.iter().all(|(low, high)| low <= high).then_some(intervals)
}

/// A vertex of the relaxation: what the team tells from the supports of one multiplier.
#[derive(Debug)]
struct Vertex {
    at: SmallVec<[f64; 16]>,
    told: SmallVec<[Information; 16]>,
}

/// A node with its bound and where to split it; `None` if it has no better answer. Improves the answer on the way.
fn bounded(team: &Team, intervals: Intervals, mut at: Vec<f64>, answer: &mut Answer) -> Option<Node> {
    let criterion = team.criterion;
    answer.nodes += 1;
    for (at, (low, high)) in at.iter_mut().zip(&intervals) {
        *at = at.clamp(*low, *high);
    }
    let mut best = team.total(&at);
    let mut points = vec![best];
    let mut vertices = vec![vertex(team, &at)];
    let mut shares: Shares = SmallVec::from_slice(&[(0, 1.0)]);
    let mut bound = 0.0_f64;
    for _ in 0..MULTIPLIERS_MAX {
        let m = criterion.multiplier(best);
        // No more than all else that is uncertain about the bound.
        let slack = SLACK * best.along(m).abs() / team.curves.len() as f64;
        let (mut h, mut total) = (team.prior.along(m), team.prior);
        let mut found =
            Vertex { at: SmallVec::from_slice(&at), told: SmallVec::from_elem(Information::default(), at.len()) };
        for i in team.fused() {
            let support = team.curves[i].support(intervals[i], m, slack);
            h += support.bound;
            total += support.information;
            (found.at[i], found.told[i]) = (support.at, support.information);
        }
        bound = bound.max(criterion.bound(m, h));
        keep(team, &found.at, criterion.cost(total), answer);
        if bound >= answer.cost * (1.0 - AIM) {
            answer.bound = bound.min(answer.cost);
            return None;
        }
        // What better multipliers could still prove.
        let left = criterion.cost(best) - bound;
        if left <= 0.1 * (answer.cost - bound) || total.along(m) <= best.along(m) + slack {
            break;
        }
        points.push(total);
        vertices.push(found);
        shares.push((points.len() - 1, 0.0));
        best = hull::improve(criterion, &points, &mut shares, 30);
    }
    // A vertex of the relaxation may lead to a better answer, if it is not far from one.
    for (vertex, _) in &shares {
        at.copy_from_slice(&vertices[*vertex].at);
        if criterion.cost(points[*vertex]) - answer.cost < answer.cost - bound {
            let total = team.descend(&intervals, &mut at);
            keep(team, &at, criterion.cost(total), answer);
        }
    }
    let split = split(team, &intervals, &vertices, &shares, criterion.multiplier(best), &answer.at);
    Some(Node { bound, intervals, at, split })
}

fn vertex(team: &Team, at: &[f64]) -> Vertex {
    let told = at.iter().zip(&team.curves).map(|(at, curve)| curve.information(*at));
    Vertex { at: SmallVec::from_slice(at), told: told.collect() }
}

fn keep(team: &Team, at: &[f64], cost: f64, answer: &mut Answer) {
    if cost < answer.cost {
        answer.cost = cost;
        for i in team.fused() {
            answer.at[i] = at[i];
        }
    }
}

/// The robot whose part of the relaxation is farthest from its curve, and the middle of the places that it is made of.
fn split(
    team: &Team,
    intervals: &[(f64, f64)],
    vertices: &[Vertex],
    shares: &Shares,
    m: Vector,
    known: &[f64],
) -> (usize, f64) {
    let mut best = (f64::NEG_INFINITY, 0, 0.0);
    for i in team.fused() {
        let (low, high) = intervals[i];
        let told = |k: usize| vertices[k].told[i];
        let (mut first, mut last) = (f64::INFINITY, f64::NEG_INFINITY);
        let mut middle = Information::default();
        for (k, share) in shares {
            middle += told(*k) * *share;
            (first, last) = (first.min(vertices[*k].at[i]), last.max(vertices[*k].at[i]));
        }
        let spread = shares.iter().map(|(k, share)| share * (told(*k) - middle).size(m)).sum::<f64>();
        // Between its places, but not so near to an end that the other half stays as it is.
        let margin = 0.05 * (high - low);
        let mut cut = (0.5 * (first + last)).clamp(low + margin, high - margin);
        let away: f64 = std::env::var("RH_AWAY").map_or(0.15, |v| v.parse().unwrap());
        if (cut - known[i]).abs() < away * (high - low) {
            let side = if known[i] - low > high - known[i] { -1.0 } else { 1.0 };
            cut = (known[i] + side * away * (high - low)).clamp(low + margin, high - margin);
        }
        if high > low && spread > best.0 {
            best = (spread, i, cut);
        }
    }
    (best.1, best.2)
}
