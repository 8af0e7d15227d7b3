//! What fusion takes from a robot's message.

use rangehound_shared::record::Heard;
use serde::{Deserialize, Serialize};

use crate::planner::Vector;

/// What one robot said at a tick.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Where it is, m.
    pub position_m: Vector,
    /// Its range and the range's standard deviation, m; `None` if its sensor had none.
    pub range_m: Option<(f64, f64)>,
}

impl Report {
    /// As it is put down, with the first tick whose estimate knows of it.
    #[must_use]
    pub fn heard(&self, taken_at: u64) -> Heard {
        let Vector { x, y } = self.position_m;
        Heard { position_m: [x, y], range_m: self.range_m, taken_at }
    }
}

impl From<Heard> for Report {
    fn from(Heard { position_m, range_m, .. }: Heard) -> Self {
        let [x, y] = position_m;
        Self { position_m: Vector::new(x, y), range_m }
    }
}
