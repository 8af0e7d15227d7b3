//! When rejected ranges show that the estimate is locked out.

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

use super::super::Reading;

/// Factor on the weight of earlier ranges with each new range: a memory of ten ranges.
const REJECTION_DECAY: f64 = 0.9;

/// Rejected share of the remembered ranges above which the estimate may be locked out. If the estimate is the mirror
/// image of the target beside two of three sensors, the ranges of the third are rejected.
const REJECTED_SHARE: f64 = 0.3;

/// Remembered rejections of a lock-out are more than this: two outliers in a row are no lock-out.
const REJECTED_MIN: f64 = 2.0;

/// Successive ranges from positions closer together than this share of the range are taken to be from one sensor. Such
/// a series counts once, so that a faulty sensor by itself cannot show a lock-out.
const SAME_SENSOR_SHARE: f64 = 0.05;

/// Counts of ranges and of rejected ones, with exponential forgetting.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Rejections {
    ranges: f64,
    rejected: f64,
    /// Position from which the last measurement that counted was taken, m.
    position_m: Vector2<f64>,
}

impl Rejections {
    /// Adds a reading of a target at this distance, m.
    pub(super) fn add(&mut self, reading: &Reading, distance_m: f64, rejected: bool) {
        let position_m = reading.pose.position_m();
        let moved_m = (position_m - self.position_m).norm();
        if self.ranges > 0.0 && moved_m <= SAME_SENSOR_SHARE * distance_m {
            return;
        }
        self.position_m = position_m;
        self.ranges = REJECTION_DECAY * self.ranges + 1.0;
        self.rejected = REJECTION_DECAY * self.rejected + f64::from(u8::from(rejected));
    }

    pub(super) fn show_lock_out(&self) -> bool {
        self.rejected > REJECTED_MIN.max(REJECTED_SHARE * self.ranges)
    }
}
