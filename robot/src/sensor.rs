//! The range sensor, pure.

use rangehound_shared::draws::{Draws, Stream};
use rangehound_shared::message::{RangeKind, WorldEntry};
use rangehound_shared::scenario::{Calibration, Scenario};

/// One robot's range sensor.
#[derive(Debug, Clone)]
pub struct Sensor {
    std_m: f64,
    calibration: Calibration,
    noise: Draws,
}

impl Sensor {
    /// The sensor of a robot, by id; `None` if the scenario has no such robot.
    #[must_use]
    pub fn new(scenario: &Scenario, robot: usize) -> Option<Self> {
        let spec = scenario.robots.get(robot)?;
        let noise = Draws::new(scenario.seed, Stream::RangeNoise { robot });
        Some(Self { std_m: spec.range_std_m, calibration: spec.calibration, noise })
    }

    /// Standard deviation of its range, m.
    #[must_use]
    pub fn std_m(&self) -> f64 {
        self.std_m
    }

    /// The range at a tick, m: the true one with noise `n ~ N(0, sigma^2)` (Eq. 3) that depends on
    /// (seed, robot, tick) alone, or the recorded one with bias and scale removed; none that is no number.
    #[must_use]
    pub fn measure(&mut self, tick: u64, entry: &WorldEntry) -> Option<f64> {
        let range_m = match RangeKind::from_bits(entry.range_kind)? {
            RangeKind::Absent => None,
            RangeKind::True => {
                let mut noise = [0.0];
                self.noise.standard_normal(tick, &mut noise);
                Some(entry.range_m + self.std_m * noise[0])
            }
            // A range shorter than its bias is one of a target at the sensor.
            RangeKind::Measured => {
                Some(((entry.range_m - self.calibration.bias_m) / (1.0 + self.calibration.scale)).max(0.0))
            }
        };
        range_m.filter(|range_m| range_m.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rangehound_shared::scenario::ScenarioFile;
    use std::path::Path;

    fn sensor(robot: usize) -> Sensor {
        let scenario = Scenario::from_file(&ScenarioFile::default(), "test", Path::new(".")).unwrap();
        Sensor::new(&scenario, robot).unwrap()
    }

    fn entry(kind: RangeKind) -> WorldEntry {
        WorldEntry { range_m: 10.0, range_kind: kind.to_bits(), ..WorldEntry::default() }
    }

    #[test]
    fn noise_is_the_same_for_a_repeated_tick_and_differs_between_robots() {
        let (mut a, mut again, mut other) = (sensor(1), sensor(1), sensor(2));
        let ranges: Vec<_> = (1..50).map(|tick| a.measure(tick, &entry(RangeKind::True))).collect();
        let repeated: Vec<_> = (1..50).map(|tick| again.measure(tick, &entry(RangeKind::True))).collect();
        assert_eq!(ranges, repeated);
        assert_eq!(a.measure(7, &entry(RangeKind::True)), ranges[6], "out of order too");
        assert_ne!(other.measure(7, &entry(RangeKind::True)), ranges[6]);
    }

    #[test]
    fn a_recorded_range_is_calibrated_and_gets_no_noise() {
        let mut sensor = sensor(0);
        sensor.calibration = Calibration { bias_m: 0.5, scale: 0.25 };
        assert_eq!(sensor.measure(3, &entry(RangeKind::Measured)), Some(7.6));
        assert_eq!(sensor.measure(3, &entry(RangeKind::Absent)), None);
        assert_eq!(sensor.measure(3, &WorldEntry { range_kind: 99, ..entry(RangeKind::True) }), None);
    }
}
