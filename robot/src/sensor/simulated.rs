//! The sensor of a simulated target, pure.

use rangehound_shared::message::{Origin, WorldEntry};
use rangehound_shared::scenario::Scenario;

use super::bearing::SimulatedBearing;
use super::range::SimulatedRange;
use super::{Sensed, Sensor};

/// The true values with Gaussian noise, a function of (seed, robot, tick).
#[derive(Debug, Clone)]
pub struct SimulatedSensor {
    range: Option<SimulatedRange>,
    bearing: Option<SimulatedBearing>,
}

impl SimulatedSensor {
    /// The sensor of a robot, by id; `None` if the scenario has no such robot.
    #[must_use]
    pub fn new(scenario: &Scenario, robot: usize) -> Option<Self> {
        let (spec, seed) = (scenario.robots.get(robot)?, scenario.seed);
        let range = SimulatedRange::new(spec, seed, robot);
        Some(Self { range, bearing: SimulatedBearing::new(spec, seed, robot) })
    }
}

impl Sensor for SimulatedSensor {
    fn sense(&mut self, tick: u64, entry: &WorldEntry) -> Sensed {
        let (true_m, true_rad) = entry.of(Origin::Simulated);
        Sensed {
            range_m: self.range.as_mut().zip(true_m).and_then(|(range, true_m)| range.sense(tick, true_m)),
            bearing_rad: self.bearing.as_mut().zip(true_rad).map(|(bearing, true_rad)| bearing.sense(tick, true_rad)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rangehound_shared::angle::wrapped_rad;
    use rangehound_shared::scenario::ScenarioFile;

    fn of(text: &str, robot: usize) -> SimulatedSensor {
        let file = ScenarioFile::parse(text, "test").unwrap();
        SimulatedSensor::new(&Scenario::from_file(&file, "test").unwrap(), robot).unwrap()
    }

    fn entry(kinds: u64) -> WorldEntry {
        WorldEntry { range_m: 10.0, bearing_rad: 3.1, kinds, ..WorldEntry::default() }
    }

    #[test]
    fn noise_is_the_same_for_a_repeated_tick_and_differs_between_robots() {
        let (mut a, mut again, mut other) = (of("", 1), of("", 1), of("", 2));
        let ranges: Vec<_> = (1..50).map(|tick| a.sense(tick, &entry(1))).collect();
        let repeated: Vec<_> = (1..50).map(|tick| again.sense(tick, &entry(1))).collect();
        assert_eq!(ranges, repeated);
        assert_eq!(a.sense(7, &entry(1)), ranges[6], "out of order too");
        assert_ne!(other.sense(7, &entry(1)), ranges[6]);
    }

    #[test]
    fn the_filter_can_assume_another_noise_than_the_true_one() {
        let sensed = |text: &str| of(text, 0).sense(1, &entry(1)).range_m.unwrap();
        let (range_m, reported_std_m) = sensed("[filter]\nrange_std_m = 0.25\n");
        assert_eq!((range_m, reported_std_m), (sensed("").0, 0.25));
    }

    #[test]
    fn only_true_values_are_measured() {
        let mut sensor = of("", 0);
        assert_eq!(sensor.sense(3, &entry(0)), Sensed::default());
        let recorded = WorldEntry { origin: Origin::Recorded.to_bits(), ..entry(3) };
        assert_eq!(sensor.sense(3, &recorded), Sensed::default());
        assert_eq!(sensor.sense(3, &WorldEntry { origin: 99, ..entry(3) }), Sensed::default());
        assert_eq!(sensor.sense(3, &entry(3)).bearing_rad, None, "it has no bearings");
    }

    #[test]
    fn both_noises_have_their_standard_deviations_and_a_bearing_is_within_one_turn() {
        let text =
            "[robots]\nsensor = \"s\"\n[sensor.s]\nrange_std_m = 0.3\nrange_std_per_m = 0.05\nbearing_std_rad = 0.1";
        let mut sensor = of(text, 0);
        let (mut range, mut bearing, ticks) = (0.0, 0.0, 20_000);
        for tick in 1..=ticks {
            let Sensed { range_m, bearing_rad } = sensor.sense(tick, &entry(3));
            let ((range_m, std_m), (bearing_rad, std_rad)) = (range_m.unwrap(), bearing_rad.unwrap());
            assert!((std_m - (0.3 + 0.05 * range_m)).abs() < 1e-12 && std_rad == 0.1);
            assert!(bearing_rad.abs() <= std::f64::consts::PI);
            range += (range_m - 10.0).powi(2);
            bearing += wrapped_rad(bearing_rad - 3.1).powi(2);
        }
        // Five standard deviations of a sample variance.
        assert!((range / ticks as f64 / 0.64 - 1.0).abs() < 0.05 && (bearing / ticks as f64 / 0.01 - 1.0).abs() < 0.05);
    }
}
