//! Range sensors: the trait that a driver implements, and the two that need no hardware.

mod recorded;
mod simulated;

use rangehound_shared::message::WorldEntry;
use rangehound_shared::scenario::{Calibration, Scenario, Source};

pub use recorded::RecordedSensor;
pub use simulated::SimulatedSensor;

/// A robot's range sensor.
///
/// [`measure`](Self::measure) is on the control path: fusion waits for the range. Read a slow sensor in its own thread, as
/// `SerialSensor` in `rangehound-node` does.
pub trait RangeSensor {
    /// Standard deviation, m, of the last measured range, or of the next one if there was none. Fusion uses it as the noise
    /// that remains after calibration, independent from tick to tick.
    fn std_m(&self) -> f64;

    /// The range at a tick, calibrated, m; `None` if there is none.
    ///
    /// Returns the newest available range and never waits for one. Returns each range once, because fusion treats each as a
    /// new measurement, and none that is too old for the motion of target and robot. Called once for each tick from 1 on;
    /// a repeated tick does not call it again. `entry` is this robot's entry of the world; a real sensor ignores its
    /// range.
    fn measure(&mut self, tick: u64, entry: &WorldEntry) -> Option<f64>;
}

/// A robot's range at a tick, if there is one, and its standard deviation, m. At tick 0 the sensor is not read: the
/// estimate is the prior.
pub fn measure<S: RangeSensor + ?Sized>(sensor: &mut S, tick: u64, entry: &WorldEntry) -> (Option<f64>, f64) {
    let range_m = if tick > 0 { sensor.measure(tick, entry) } else { None };
    (range_m, sensor.std_m())
}

/// The true range of a measured one, m: [`Calibration`] solved for it; 0 if the measured range is shorter than the bias.
#[must_use]
pub fn calibrated_m(measured_m: f64, calibration: Calibration) -> f64 {
    ((measured_m - calibration.bias_m) / (1.0 + calibration.scale)).max(0.0)
}

/// The sensor that a scenario gives a robot.
#[derive(Debug, Clone)]
#[allow(clippy::large_enum_variant, reason = "one for each robot, and nearly always the large one")]
pub enum Sensor {
    /// The sensor of a simulated target.
    Simulated(SimulatedSensor),
    /// The sensor of a recording.
    Recorded(RecordedSensor),
}

impl Sensor {
    /// The sensor of a robot, by id; `None` if the scenario has no such robot.
    #[must_use]
    pub fn new(scenario: &Scenario, robot: usize) -> Option<Self> {
        Some(match scenario.source {
            Source::Simulated { .. } => Self::Simulated(SimulatedSensor::new(scenario, robot)?),
            Source::Recorded { .. } => Self::Recorded(RecordedSensor::new(scenario, robot)?),
        })
    }
}

impl RangeSensor for Sensor {
    fn std_m(&self) -> f64 {
        match self {
            Self::Simulated(sensor) => sensor.std_m(),
            Self::Recorded(sensor) => sensor.std_m(),
        }
    }

    fn measure(&mut self, tick: u64, entry: &WorldEntry) -> Option<f64> {
        match self {
            Self::Simulated(sensor) => sensor.measure(tick, entry),
            Self::Recorded(sensor) => sensor.measure(tick, entry),
        }
    }
}
