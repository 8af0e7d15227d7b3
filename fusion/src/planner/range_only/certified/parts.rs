//! Nodes of the search: each keeps every robot to a part of its arc.

use std::cmp::Ordering;

use super::bound::Hull;
use crate::planner::range_only::arm::{Arm, Extent};
use crate::vector::Vector;

/// The nodes of the search tree, and the arcs of one of them.
#[derive(Debug, Clone, Default)]
pub(super) struct Parts {
    nodes: Vec<Node>,
    /// The arcs of the root. Of several equal arms that are free, each has an arc of a full turn. All of these begin at
    /// the same direction, so that cuts can keep the arms in order.
    root_arms: Vec<Arm>,
    /// The arcs of the node that was restored last.
    pub(super) arms: Vec<Arm>,
    /// The arms' numbers, sorted so that equal arms are neighbours, and the position of each arm in that order.
    order: Vec<usize>,
    place: Vec<usize>,
    path: Vec<Cut>,
}

/// A node: the part of its parent on one side of a direction within one arm's arc.
#[derive(Debug, Clone, Copy)]
pub(super) struct Node {
    pub(super) parent: usize,
    pub(super) cut: Cut,
    /// Where this node is cut.
    pub(super) next: (usize, Vector),
}

/// Keeps one arm to the part of its arc before or after a direction. Permuting equal arms changes nothing, so the search
/// sorts them by direction. A cut therefore also keeps the equal arms earlier in the order before the direction, or the
/// later ones after it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cut {
    pub(super) arm: usize,
    pub(super) at: Vector,
    pub(super) side: Side,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Side {
    Before,
    After,
}

impl Parts {
    pub(super) fn with_capacity(nodes: usize) -> Self {
        Self { nodes: Vec::with_capacity(nodes), ..Self::default() }
    }

    /// A tree whose root has these arcs.
    pub(super) fn begin(&mut self, arms: &[Arm]) {
        self.nodes.clear();
        self.put_in_order(arms);
        self.arms.clear();
        self.arms.extend_from_slice(&self.root_arms);
    }

    /// Adds a node; returns its number.
    pub(super) fn add(&mut self, node: Node) -> usize {
        self.nodes.push(node);
        self.nodes.len() - 1
    }

    /// Where a node is cut.
    pub(super) fn next(&self, node: usize) -> (usize, Vector) {
        self.nodes[node].next
    }

    /// Sorts the arms so that equal ones are neighbours.
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
        self.root_arms.clear();
        self.root_arms.extend_from_slice(arms);
        for (place, &arm) in self.order.iter().enumerate() {
            self.place[arm] = place;
            let neighbours = [place.wrapping_sub(1), place + 1];
            let is_alike = |other: usize| self.order.get(other).is_some_and(|&other| arms[other] == arms[arm]);
            if arms[arm].extent == Extent::Circle && neighbours.into_iter().any(is_alike) {
                self.root_arms[arm].extent = Extent::Wide;
            }
        }
    }

    /// Restores the arcs of a node, with one more cut applied.
    pub(super) fn restrict(&mut self, node: usize, cut: Cut) {
        self.path.clear();
        self.path.push(cut);
        let mut at = node;
        while at != 0 {
            self.path.push(self.nodes[at].cut);
            at = self.nodes[at].parent;
        }
        self.arms.copy_from_slice(&self.root_arms);
        while let Some(Cut { arm, at, side }) = self.path.pop() {
            let alike = |other: usize| self.root_arms[other] == self.root_arms[arm];
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

    /// Where to cut an arm whose share in the hulls' nearest point is `towards`. Equal arms are cut at the same direction.
    pub(super) fn middle(&self, arm: usize, towards: Vector) -> Vector {
        let is_alone = self.run_of(self.place[arm]).len() == 1;
        self.arms[arm].middle(if is_alone { towards } else { Vector::default() })
    }

    /// Positions in the order of the arms that equal this one and have the same arc in this node.
    fn run_of(&self, place: usize) -> std::ops::Range<usize> {
        let arm = &self.arms[self.order[place]];
        let alike = |other: &&usize| self.arms[**other] == *arm;
        let start = place - self.order[..place].iter().rev().take_while(alike).count();
        start..place + self.order[place..].iter().take_while(alike).count()
    }

    /// Divides the hulls' nearest point among the arms. Equal arms have equal shares in it. The same sum also results if some
    /// of them stand at one end of their arc, some at the other, and one or two between. Only these one or two leave their
    /// arcs.
    pub(super) fn share_out(&self, hull: &Hull, in_hull: &mut Vec<Vector>) {
        in_hull.clear();
        in_hull.extend((0..self.arms.len()).map(|i| hull.direction(i)));
        let mut place = 0;
        while place < self.order.len() {
            let run = self.run_of(place);
            place = run.end;
            let first = self.order[run.start];
            if run.len() > 1 && in_hull[first].norm_squared() < 1.0 - 1e-12 {
                let arm = self.arms[first];
                let mut corners = hull.corners_of(first);
                // Sorted along the arc, as the arms are.
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
                    in_hull[self.order[slot]] = sum;
                }
            }
        }
    }
}

impl Arm {
    /// Where to cut the arc: in the middle. A full circle is cut across `towards`, so that `towards` is the middle of one
    /// half. If `towards` is zero, it is cut at its centre and opposite.
    fn middle(&self, towards: Vector) -> Vector {
        match (self.extent, towards.normalised()) {
            (Extent::Circle, Some(towards)) => towards.rotated_by(Vector::new(0.0, 1.0)),
            _ => self.centre,
        }
    }

    /// The part of the arc before or after a direction in it.
    fn part(&self, at: Vector, side: Side) -> Self {
        let (low, high) = match (self.extent, side) {
            // A circle begins and ends opposite the cut.
            (Extent::Circle, Side::Before) => (-at, at),
            (Extent::Circle, Side::After) => (at, -at),
            (_, Side::Before) => (self.low, at),
            (_, Side::After) => (at, self.high),
        };
        // Counter-clockwise from `low` to `high`, this is at most half a turn if `high` is to the left of `low`.
        let is_narrow = self.extent != Extent::Wide || low.cross(high) >= 0.0;
        // The middle is perpendicular to the chord and parallel to the sum of the ends. The longer of the two is used: the
        // other suffers from cancellation.
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
    use crate::planner::range_only::Problem;
    use proptest::prelude::*;
    use std::f64::consts::{PI, TAU};

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(3_000))]

        /// Wherever it is cut, a configuration with equal robots in order is in one of the two parts.
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
            let mut parts = Parts::default();
            parts.begin(&problem.arms);
            // Equal robots, sorted by their directions along the arc.
            let mut shares: Vec<f64> = places[..problem.len()].to_vec();
            let order = parts.order.clone();
            for run in order.chunk_by(|&i, &j| problem.arms[i] == problem.arms[j]) {
                let mut sorted: Vec<f64> = run.iter().map(|&i| shares[i]).collect();
                sorted.sort_by(f64::total_cmp);
                run.iter().zip(sorted).for_each(|(&i, share)| shares[i] = share);
            }
            let configuration: Vec<Vector> = (0..problem.len())
                .map(|i| parts.root_arms[i].low.rotated_by(Vector::from_angle((shares[i] * widths[i]).min(TAU - 1e-9))))
                .collect();
            let is_in = |arm: &Arm, u: Vector| (arm.nearest(u, u) - u).norm() < 1e-9;
            let nowhere = Cut { arm: 0, at: Vector::default(), side: Side::Before };
            let mut parent = parts.add(Node { parent: 0, cut: nowhere, next: (0, Vector::default()) });
            for (which, towards) in cuts {
                let arm = which.index(problem.len());
                let at = parts.middle(arm, Vector::from_angle(towards));
                let before = parts.arms[arm].part(at, Side::Before);
                let side = if is_in(&before, configuration[arm]) { Side::Before } else { Side::After };
                let cut = Cut { arm, at, side };
                parts.restrict(parent, cut);
                for (arm, u) in parts.arms.iter().zip(&configuration) {
                    prop_assert!(is_in(arm, *u), "{arm:?} {u:?}");
                }
                parent = parts.add(Node { parent, cut, next: (0, Vector::default()) });
            }
        }
    }
}
