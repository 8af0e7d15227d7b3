//! The best point of the convex hull of a few points of information.

use rangehound_shared::scenario::Criterion;
use smallvec::SmallVec;

use super::information::{Cost, Information};

/// Moves of share between two vertices in one call.
const MOVES_MAX: usize = 30;

/// Steps of a line search.
const STEPS_MAX: usize = 30;

/// Vertices that have a share are few: the cost falls along T, so the best point is on a face.
pub(super) type Vertices = SmallVec<[Vertex; 4]>;

/// What the team tells from places of its curves, and its share of the best point.
#[derive(Debug, Clone)]
pub(super) struct Vertex {
    /// Each robot's place.
    pub(super) at: SmallVec<[f64; 10]>,
    /// What each robot adds from there.
    pub(super) parts: SmallVec<[Information; 10]>,
    /// What is known then.
    pub(super) total: Information,
    /// Part of it in the best point; all parts add up to 1.
    pub(super) share: f64,
}

/// Finds the best point of the hull, from the shares that the vertices have; those that are left without one are removed.
///
/// Each move is along the edge from the held vertex that is worst in the direction of the cost's fall to the best one.
pub(super) fn improve(criterion: Criterion, vertices: &mut Vertices) -> Information {
    let sum = |vertices: &Vertices| vertices.iter().fold(Information::default(), |sum, v| sum + v.total * v.share);
    let mut best = sum(vertices);
    for _ in 0..MOVES_MAX {
        let m = criterion.multiplier(best);
        let (mut to, mut from) = ((f64::NEG_INFINITY, 0), (f64::INFINITY, 0));
        for (k, vertex) in vertices.iter().enumerate() {
            let along = vertex.total.along(m);
            if along > to.0 {
                to = (along, k);
            }
            if along < from.0 && vertex.share > 0.0 {
                from = (along, k);
            }
        }
        if to.0 - from.0 <= 1e-11 * best.t {
            break;
        }
        let step = vertices[to.1].total - vertices[from.1].total;
        let moved = line_search(criterion, best, step, vertices[from.1].share);
        vertices[to.1].share += moved;
        vertices[from.1].share -= moved;
        best = sum(vertices);
    }
    vertices.retain(|vertex| vertex.share > 0.0);
    best
}

/// How far the cost falls along a step, at most `most`: the cost is convex, so its slope changes sign once.
fn line_search(criterion: Criterion, from: Information, step: Information, most: f64) -> f64 {
    let fall = |share: f64| step.along(criterion.multiplier(from + step * share));
    let (mut low, mut high) = (0.0, most);
    let (mut low_fall, mut high_fall) = (fall(0.0), fall(most));
    if high_fall >= 0.0 {
        return most;
    }
    // Regula falsi, with the weight of an end halved that stays (Illinois).
    let (mut stays, mut last) = (0, 0.0);
    for _ in 0..STEPS_MAX {
        let middle = (low * high_fall - high * low_fall) / (high_fall - low_fall);
        if !(middle > low && middle < high) {
            break;
        }
        last = middle;
        let middle_fall = fall(middle);
        if middle_fall > 0.0 {
            (low, low_fall) = (middle, middle_fall);
            high_fall *= if stays > 0 { 0.5 } else { 1.0 };
            stays = 1;
        } else {
            (high, high_fall) = (middle, middle_fall);
            low_fall *= if stays < 0 { 0.5 } else { 1.0 };
            stays = -1;
        }
        if high - low <= 1e-7 * most || middle_fall == 0.0 {
            break;
        }
    }
    last
}
