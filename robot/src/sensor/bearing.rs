//! Bearings of the target, simulated and recorded.

use rangehound_shared::angle::wrapped_rad;
use rangehound_shared::draws::{Draws, Stream};
use rangehound_shared::scenario::RobotSpec;

/// The true bearing with Gaussian noise, a function of (seed, robot, tick).
#[derive(Debug, Clone)]
pub(super) struct SimulatedBearing {
    std_rad: f64,
    reported_std_rad: f64,
    draws: Draws,
}

impl SimulatedBearing {
    /// Of a robot, by id; `None` if it measures no bearings.
    pub(super) fn new(spec: &RobotSpec, seed: u64, robot: usize) -> Option<Self> {
        let (std_rad, reported_std_rad) = spec.sensor.bearing_std_rad.zip(spec.reported.bearing_std_rad)?;
        Some(Self { std_rad, reported_std_rad, draws: Draws::new(seed, Stream::BearingNoise { robot }) })
    }

    /// A bearing and its standard deviation, rad.
    pub(super) fn sense(&mut self, tick: u64, true_rad: f64) -> (f64, f64) {
        let noise_rad = self.std_rad * self.draws.one_standard_normal(tick);
        (wrapped_rad(true_rad + noise_rad), self.reported_std_rad)
    }
}

/// Bearings of a recording, as they are there.
#[derive(Debug, Clone)]
pub(super) struct RecordedBearing {
    reported_std_rad: f64,
}

impl RecordedBearing {
    /// Of a robot; `None` if it measures no bearings.
    pub(super) fn new(spec: &RobotSpec) -> Option<Self> {
        Some(Self { reported_std_rad: spec.reported.bearing_std_rad? })
    }

    /// The bearing and its standard deviation, rad.
    pub(super) fn sense(&self, measured_rad: f64) -> (f64, f64) {
        (measured_rad, self.reported_std_rad)
    }
}
