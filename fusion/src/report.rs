//! What fusion takes from a robot's message.

use crate::planner::Vector;

/// What one robot said at a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Report {
    /// Where it is, m.
    pub position_m: Vector,
    /// Its range and the range's standard deviation, m; `None` if its sensor had none.
    pub range_m: Option<(f64, f64)>,
}
