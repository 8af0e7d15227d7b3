//! The sensor of a recording, pure.

use rangehound_shared::message::{Origin, WorldEntry};
use rangehound_shared::scenario::{RobotSpec, Scenario};

use super::bearing::RecordedBearing;
use super::range::RecordedRange;
use super::{Sensed, Sensor};

/// Recorded bearings, and ranges with bias and scale removed.
#[derive(Debug, Clone)]
pub struct RecordedSensor {
    range: Option<RecordedRange>,
    bearing: Option<RecordedBearing>,
}

impl RecordedSensor {
    /// The sensor of a robot, by id; `None` if the scenario has no such robot.
    #[must_use]
    pub fn new(scenario: &Scenario, robot: usize) -> Option<Self> {
        scenario.robots.get(robot).map(Self::of)
    }

    fn of(spec: &RobotSpec) -> Self {
        Self { range: RecordedRange::new(spec), bearing: RecordedBearing::new(spec) }
    }
}

impl Sensor for RecordedSensor {
    fn sense(&mut self, _tick: u64, entry: &WorldEntry) -> Sensed {
        let (range_m, bearing_rad) = entry.of(Origin::Recorded);
        Sensed {
            range_m: self.range.as_ref().zip(range_m).map(|(range, measured_m)| range.sense(measured_m)),
            bearing_rad: self
                .bearing
                .as_ref()
                .zip(bearing_rad)
                .map(|(bearing, measured_rad)| bearing.sense(measured_rad)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rangehound_shared::scenario::{Calibration, ScenarioFile, SensorSpec};

    #[test]
    fn a_recorded_range_is_calibrated_and_gets_no_noise() {
        let reported = SensorSpec { bearing_std_rad: Some(0.02), ..SensorSpec::range(1.0) };
        let calibration = Calibration { bias_m: 0.5, scale: 0.25 };
        let scenario = Scenario::from_file(&ScenarioFile::default(), "test").unwrap();
        let mut sensor = RecordedSensor::of(&RobotSpec { reported, calibration, ..scenario.robots[0].clone() });
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
