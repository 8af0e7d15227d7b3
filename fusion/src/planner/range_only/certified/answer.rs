//! The best answer of a search so far.

use crate::vector::Vector;

/// Nodes closer than this to the best answer are not looked into, relative to `T - |S|`, which makes it an error of the trace.
pub(super) const TRACE: f64 = 1e-8;

/// What is made as small as can be; values and bounds of a search are in it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Measure {
    /// `|S|`.
    Length,
    /// `|S| - T`, less the least information: the same, but not as a difference.
    Information,
}

/// The best answer so far, and what has been proven.
pub(super) struct Answer<'a> {
    pub(super) best: f64,
    pub(super) directions: &'a mut [Vector],
    /// Least bound of the nodes that were set aside.
    pub(super) least: f64,
    pub(super) tolerance: f64,
    pub(super) measure: Measure,
}

impl Answer<'_> {
    /// A bound from which on a node holds nothing worth looking for.
    pub(super) fn enough(&self) -> f64 {
        self.best - self.tolerance
    }

    pub(super) fn set_aside(&mut self, bound: f64) {
        self.least = self.least.min(bound);
    }

    /// Takes an answer if it is better.
    pub(super) fn offer(&mut self, value: f64, directions: &[Vector]) -> bool {
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
