//! The sensor of a recording, pure.

use rangehound_shared::message::{RangeKind, WorldEntry};
use rangehound_shared::scenario::{Calibration, Scenario};

use super::{RangeSensor, calibrated_m};

/// A recorded range with bias and scale removed.
#[derive(Debug, Clone)]
pub struct RecordedSensor {
    std_m: f64,
    calibration: Calibration,
}

impl RecordedSensor {
    /// The sensor of a robot, by id; `None` if the scenario has no such robot.
    #[must_use]
    pub fn new(scenario: &Scenario, robot: usize) -> Option<Self> {
        let spec = scenario.robots.get(robot)?;
        Some(Self { std_m: spec.reported_std_m, calibration: spec.calibration })
    }
}

impl RangeSensor for RecordedSensor {
    fn std_m(&self) -> f64 {
        self.std_m
    }

    fn measure(&mut self, _tick: u64, entry: &WorldEntry) -> Option<f64> {
        let is_measured = RangeKind::from_bits(entry.range_kind)? == RangeKind::Measured;
        is_measured.then(|| calibrated_m(entry.range_m, self.calibration)).filter(|range_m| range_m.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recorded_range_is_calibrated_and_gets_no_noise() {
        let mut sensor = RecordedSensor { std_m: 1.0, calibration: Calibration { bias_m: 0.5, scale: 0.25 } };
        let entry = WorldEntry { range_m: 10.0, range_kind: RangeKind::Measured.to_bits(), ..WorldEntry::default() };
        assert_eq!(sensor.measure(3, &entry), Some(7.6));
        assert_eq!(sensor.measure(3, &WorldEntry { range_m: 0.2, ..entry }), Some(0.0));
        assert_eq!(sensor.measure(3, &WorldEntry { range_kind: RangeKind::Absent.to_bits(), ..entry }), None);
        assert_eq!(sensor.measure(3, &WorldEntry { range_kind: RangeKind::True.to_bits(), ..entry }), None);
    }
}
