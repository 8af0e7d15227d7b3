//! The sensor of a simulated target, pure.

use rangehound_shared::draws::{Draws, Stream};
use rangehound_shared::message::{RangeKind, WorldEntry};
use rangehound_shared::scenario::Scenario;

use super::RangeSensor;

/// The true range with Gaussian noise, a function of (seed, robot, tick).
#[derive(Debug, Clone)]
pub struct SimulatedSensor {
    std_m: f64,
    reported_std_m: f64,
    noise: Draws,
}

impl SimulatedSensor {
    /// The sensor of a robot, by id; `None` if the scenario has no such robot.
    #[must_use]
    pub fn new(scenario: &Scenario, robot: usize) -> Option<Self> {
        let spec = scenario.robots.get(robot)?;
        let (std_m, reported_std_m) = (spec.range_std_m, spec.reported_std_m);
        Some(Self { std_m, reported_std_m, noise: Draws::new(scenario.seed, Stream::RangeNoise { robot }) })
    }
}

impl RangeSensor for SimulatedSensor {
    #[allow(clippy::misnamed_getters, reason = "the filter is given another noise than the sensor has")]
    fn std_m(&self) -> f64 {
        self.reported_std_m
    }

    fn measure(&mut self, tick: u64, entry: &WorldEntry) -> Option<f64> {
        if RangeKind::from_bits(entry.range_kind)? != RangeKind::True {
            return None;
        }
        let mut noise = [0.0];
        self.noise.standard_normal(tick, &mut noise);
        Some(entry.range_m + self.std_m * noise[0]).filter(|range_m| range_m.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rangehound_shared::scenario::ScenarioFile;

    fn sensor(robot: usize) -> SimulatedSensor {
        let scenario = Scenario::from_file(&ScenarioFile::default(), "test").unwrap();
        SimulatedSensor::new(&scenario, robot).unwrap()
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
    fn the_filter_can_assume_another_noise_than_the_true_one() {
        let measured = |text: &str| {
            let file = ScenarioFile::parse(text, "test").unwrap();
            let mut sensor = SimulatedSensor::new(&Scenario::from_file(&file, "test").unwrap(), 0).unwrap();
            (sensor.measure(1, &entry(RangeKind::True)), sensor.std_m())
        };
        let (range, reported_std_m) = measured("[filter]\nrange_std_m = 0.25\n");
        assert_eq!((range, reported_std_m), (measured("").0, 0.25));
    }

    #[test]
    fn only_a_true_range_is_measured() {
        let mut sensor = sensor(0);
        assert_eq!(sensor.measure(3, &entry(RangeKind::Absent)), None);
        assert_eq!(sensor.measure(3, &entry(RangeKind::Measured)), None);
        assert_eq!(sensor.measure(3, &WorldEntry { range_kind: 99, ..entry(RangeKind::True) }), None);
    }
}
