//! What fusion takes from a robot's message.

use rangehound_shared::record::{Heard, Judged};
use serde::{Deserialize, Serialize};

use crate::planner::Vector;

/// What one robot said at a tick.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Where it is, m.
    pub position_m: Vector,
    /// Height of its sensor above the plane in which the target moves, m.
    pub height_m: f64,
    /// Its range and the range's standard deviation, m; `None` if its sensor had none.
    pub range_m: Option<(f64, f64)>,
}

impl Report {
    /// As it is put down, with the first tick whose estimate knows of it, and what was done with its range.
    #[must_use]
    pub fn heard(&self, taken_at: u64, judged: Option<Judged>) -> Heard {
        let Self { position_m: Vector { x, y }, height_m, range_m } = *self;
        Heard { position_m: [x, y], height_m, range_m, taken_at, judged }
    }
}

impl From<Heard> for Report {
    fn from(Heard { position_m: [x, y], height_m, range_m, .. }: Heard) -> Self {
        Self { position_m: Vector::new(x, y), height_m, range_m }
    }
}
