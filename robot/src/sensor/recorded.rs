//! The sensor of a recording, pure.

use rangehound_shared::message::{Origin, WorldEntry};
use rangehound_shared::scenario::{Calibration, Scenario, SensorSpec};

use super::{Sensed, Sensor, calibrated_m};

/// Recorded bearings, and ranges with bias and scale removed.
#[derive(Debug, Clone)]
pub struct RecordedSensor {
    reported: SensorSpec,
    calibration: Calibration,
}

impl RecordedSensor {
    /// The sensor of a robot, by id; `None` if the scenario has no such robot.
    #[must_use]
    pub fn new(scenario: &Scenario, robot: usize) -> Option<Self> {
        let spec = scenario.robots.get(robot)?;
        Some(Self { reported: spec.reported, calibration: spec.calibration })
    }
}

impl Sensor for RecordedSensor {
    fn sense(&mut self, _tick: u64, entry: &WorldEntry) -> Sensed {
        let (range_m, bearing_rad) = entry.of(Origin::Recorded);
        let range_m = range_m.map(|range_m| calibrated_m(range_m, self.calibration));
        let std_m = |range_m: f64| self.reported.range.map(|noise| (range_m, noise.std_at_m(range_m)));
        Sensed { range_m: range_m.and_then(std_m), bearing_rad: bearing_rad.zip(self.reported.bearing_std_rad) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recorded_range_is_calibrated_and_gets_no_noise() {
        let reported = SensorSpec { bearing_std_rad: Some(0.02), ..SensorSpec::range(1.0) };
        let mut sensor = RecordedSensor { reported, calibration: Calibration { bias_m: 0.5, scale: 0.25 } };
        let origin = Origin::Recorded.to_bits();
        let entry = WorldEntry { range_m: 10.0, bearing_rad: 0.4, kinds: 3, origin, ..WorldEntry::default() };
        let both = Sensed { range_m: Some((7.6, 1.0)), bearing_rad: Some((0.4, 0.02)) };
        assert_eq!(sensor.sense(3, &entry), both);
        let near = WorldEntry { range_m: 0.2, kinds: 1, ..entry };
        assert_eq!(sensor.sense(3, &near), Sensed::range(0.0, 1.0));
        assert_eq!(sensor.sense(3, &WorldEntry { kinds: 0, ..entry }), Sensed::default());
        assert_eq!(sensor.sense(3, &WorldEntry { origin: Origin::Simulated.to_bits(), ..entry }), Sensed::default());
    }
}
