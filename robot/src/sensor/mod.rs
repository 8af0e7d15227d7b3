//! Range sensors: the trait that a driver implements, and the two that need no hardware.

mod recorded;
mod simulated;

use rangehound_shared::message::WorldEntry;
use rangehound_shared::scenario::{Calibration, Scenario, Source};

pub use recorded::RecordedSensor;
pub use simulated::SimulatedSensor;

/// A robot's range sensor.
///
/// [`measure`](Self::measure) is on the control path: fusion waits for the range while it works. A sensor
/// that is slow is read in a thread of its own, as `SerialSensor` in `rangehound-node` does.
pub trait RangeSensor {
    /// Standard deviation of the range measured last, or of the next if there was none, m. Fusion takes it for what
    /// is left after calibration, independent from tick to tick.
    fn std_m(&self) -> f64;

    /// The range at a tick, calibrated, m; `None` if there is none.
    ///
    /// Gives the newest range at hand and never waits for one. Each range is given once, as fusion takes each for a
    /// new measurement, and none that is older than the motion of target and robot allows. Asked once for each tick
    /// from 1 on; a repeat of the tick is answered without the sensor. `entry` is what the simulator or recording
    /// shows this robot: a real sensor has no use for its range.
    fn measure(&mut self, tick: u64, entry: &WorldEntry) -> Option<f64>;
}

/// A robot's report of a tick: the sensor's range, if there is one, and its standard deviation, m. At tick 0 the prior
/// holds, and the sensor is not read.
pub fn measure<S: RangeSensor + ?Sized>(sensor: &mut S, tick: u64, entry: &WorldEntry) -> (Option<f64>, f64) {
    let range_m = if tick > 0 { sensor.measure(tick, entry) } else { None };
    (range_m, sensor.std_m())
}

/// The true range behind a measured one, m: [`Calibration`] solved for it. One shorter than the bias is of a
/// target at the sensor.
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
