//! The best answer of a search so far.

use crate::vector::Vector;

/// Nodes whose bounds are closer than this to the best answer are not examined. It is relative to `T - |S|`, so it is a
/// relative error of the trace too.
pub(super) const TRACE: f64 = 1e-8;

/// The quantity that a search minimises. Its values and bounds are in this measure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Measure {
    /// `|S|`.
    Length,
    /// `|S| - T`, computed without the difference, so without its rounding.
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
    /// From this bound on, a node cannot improve the answer by more than the tolerance.
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
