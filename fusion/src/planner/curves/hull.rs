//! The best point of the convex hull of a few points of information.

use rangehound_shared::scenario::Criterion;
use smallvec::SmallVec;

use super::information::{Cost, Information};

/// A point of the hull's faces has three vertices at most: the cost falls along T, so the best is not inside.
pub(super) const VERTICES_MAX: usize = 3;

/// Halvings of a line search.
const HALVINGS: usize = 50;

/// Vertices and their shares of the best point.
pub(super) type Shares = SmallVec<[(usize, f64); VERTICES_MAX + 1]>;

/// Improves the best point of the hull once a vertex is added to it; vertices without a share drop out.
///
/// Each round minimises along one of the directions that move share between two vertices.
pub(super) fn improve(criterion: Criterion, points: &[Information], shares: &mut Shares, rounds: usize) -> Information {
    let sum = |shares: &Shares| {
        shares.iter().fold(Information::default(), |sum, (vertex, share)| sum + points[*vertex] * *share)
    };
    let mut best = sum(shares);
    for _ in 0..rounds {
        let m = criterion.multiplier(best);
        let along = |(vertex, _): &(usize, f64)| points[*vertex].along(m);
        let held = |shares: &Shares| {
            shares
                .iter()
                .enumerate()
                .filter(|(_, share)| share.1 > 0.0)
                .map(|(k, _)| k)
                .collect::<SmallVec<[usize; 4]>>()
        };
        let Some(to) = (0..shares.len()).max_by(|a, b| along(&shares[*a]).total_cmp(&along(&shares[*b]))) else {
            break;
        };
        let Some(from) = held(shares).into_iter().min_by(|a, b| along(&shares[*a]).total_cmp(&along(&shares[*b])))
        else {
            break;
        };
        if from == to || along(&shares[to]) - along(&shares[from]) <= 1e-13 * best.t {
            break;
        }
        let step = points[shares[to].0] - points[shares[from].0];
        // The cost is convex along the step: its slope changes sign once.
        let slope_is_down = |share: f64| {
            let at = best + step * share;
            step.along(criterion.multiplier(at)) > 0.0
        };
        let most = shares[from].1;
        let (mut low, mut high) = (0.0, most);
        if slope_is_down(most) {
            low = most;
        } else {
            for _ in 0..HALVINGS {
                let middle = 0.5 * (low + high);
                *if slope_is_down(middle) { &mut low } else { &mut high } = middle;
            }
        }
        shares[from].1 = if low == most { 0.0 } else { most - low };
        shares[to].1 += low;
        best = sum(shares);
    }
    shares.retain(|(_, share)| *share > 0.0);
    best
}
