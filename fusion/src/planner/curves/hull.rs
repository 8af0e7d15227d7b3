//! The best point of the convex hull of a few points of information.

use std::ops::{Deref, DerefMut};

use rangehound_shared::scenario::Criterion;

use super::information::{Cost, Information};

/// Moves of share between two vertices in one call.
const MOVES_MAX: usize = 30;

/// Steps of a line search.
const STEPS_MAX: usize = 30;

/// The information of the team from places of its curves, and its share of the best point.
#[derive(Debug, Default)]
pub(super) struct Vertex {
    /// Each robot's place.
    pub(super) at: Vec<f64>,
    /// The information that each robot adds from there.
    pub(super) parts: Vec<Information>,
    /// The information after that.
    pub(super) total: Information,
    /// Part of it in the best point; all parts add up to 1.
    pub(super) share: f64,
}

impl Vertex {
    /// Becomes a copy in the memory that it has.
    pub(super) fn copy(&mut self, other: &Self) {
        self.at.clone_from(&other.at);
        self.parts.clone_from(&other.parts);
        (self.total, self.share) = (other.total, other.share);
    }
}

/// Vertices that have a share are few: the cost falls along T, so the best point is on a face. Removed ones leave their memory
/// to later ones.
#[derive(Debug, Default)]
pub(super) struct Vertices {
    all: Vec<Vertex>,
    count: usize,
}

impl Vertices {
    /// Adds a vertex, which is a copy of another one.
    pub(super) fn push(&mut self, vertex: &Vertex) {
        if self.count == self.all.len() {
            self.all.push(Vertex::default());
        }
        self.all[self.count].copy(vertex);
        self.count += 1;
    }

    /// Becomes a copy in the memory that it has.
    pub(super) fn copy(&mut self, others: &[Vertex]) {
        self.clear();
        others.iter().for_each(|vertex| self.push(vertex));
    }

    pub(super) fn clear(&mut self) {
        self.count = 0;
    }

    /// Removes those without a share; the others keep their order.
    fn remove_idle(&mut self) {
        let mut kept = 0;
        for k in 0..self.count {
            if self.all[k].share > 0.0 {
                self.all.swap(kept, k);
                kept += 1;
            }
        }
        self.count = kept;
    }
}

impl Deref for Vertices {
    type Target = [Vertex];

    fn deref(&self) -> &[Vertex] {
        &self.all[..self.count]
    }
}

impl DerefMut for Vertices {
    fn deref_mut(&mut self) -> &mut [Vertex] {
        &mut self.all[..self.count]
    }
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
    vertices.remove_idle();
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
