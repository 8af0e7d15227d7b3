//! Ranges of the target, simulated and recorded.

use rangehound_shared::draws::{Draws, Stream};
use rangehound_shared::scenario::{Calibration, RangeNoise, RobotSpec};

/// The true distance with Gaussian noise, a function of (seed, robot, tick).
#[derive(Debug, Clone)]
pub(super) struct SimulatedRange {
    noise: RangeNoise,
    reported: RangeNoise,
    draws: Draws,
}

impl SimulatedRange {
    /// Of a robot, by id; `None` if it measures no ranges.
    pub(super) fn new(spec: &RobotSpec, seed: u64, robot: usize) -> Option<Self> {
        let (noise, reported) = spec.sensor.range.zip(spec.reported.range)?;
        Some(Self { noise, reported, draws: Draws::new(seed, Stream::RangeNoise { robot }) })
    }

    /// A range and its standard deviation, m; `None` if it would be infinite.
    pub(super) fn sense(&mut self, tick: u64, true_m: f64) -> Option<(f64, f64)> {
        let range_m = true_m + self.noise.std_at_m(true_m) * self.draws.one_standard_normal(tick);
        // A robot knows the distance only by what it has measured.
        Some((range_m, self.reported.std_at_m(range_m))).filter(|_| range_m.is_finite())
    }
}

/// Ranges of a recording, with bias and scale removed.
#[derive(Debug, Clone)]
pub(super) struct RecordedRange {
    reported: RangeNoise,
    calibration: Calibration,
}

impl RecordedRange {
    /// Of a robot; `None` if it measures no ranges.
    pub(super) fn new(spec: &RobotSpec) -> Option<Self> {
        Some(Self { reported: spec.reported.range?, calibration: spec.calibration })
    }

    /// The calibrated range and its standard deviation, m.
    pub(super) fn sense(&self, measured_m: f64) -> (f64, f64) {
        let range_m = calibrated_m(measured_m, self.calibration);
        (range_m, self.reported.std_at_m(range_m))
    }
}

/// The true range of a measured one, m: [`Calibration`] solved for it; 0 if the measured range is shorter than the bias.
#[must_use]
pub fn calibrated_m(measured_m: f64, calibration: Calibration) -> f64 {
    ((measured_m - calibration.bias_m) / (1.0 + calibration.scale)).max(0.0)
}
