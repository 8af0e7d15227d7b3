//! Sensors of the target: the trait that a driver implements, and the ones that need no hardware. Each kind of measurement
//! has a file.

mod bearing;
mod range;
mod recorded;
mod simulated;

use rangehound_shared::measurement::Measurement;
use rangehound_shared::message::WorldEntry;
use rangehound_shared::scenario::{Scenario, Source};

pub use range::calibrated_m;
pub use recorded::RecordedSensor;
pub use simulated::SimulatedSensor;

use crate::pose::PoseSource;

/// A robot's sensor of the target: of its range, its bearing or both.
///
/// [`sense`](Self::sense) is on the control path: fusion waits for it. Read a slow sensor in its own thread, as
/// `SerialSensor` in `rangehound-node` does.
pub trait Sensor: std::fmt::Debug + Send {
    /// The sensor's view of the target at a tick.
    ///
    /// Returns the newest values and never waits for one. Returns each value once, because fusion treats each as a new
    /// measurement, and none that is too old for the motion of target and robot. Called once for each tick from 1 on;
    /// a repeated tick does not call it again. `entry` is this robot's entry of the world; a real sensor ignores its
    /// values.
    fn sense(&mut self, tick: u64, entry: &WorldEntry) -> Sensed;
}

/// A sensor's values, each with the standard deviation that fusion uses: of the noise that remains after calibration and
/// is independent from tick to tick.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sensed {
    /// The range and its standard deviation, m.
    pub range_m: Option<(f64, f64)>,
    /// The bearing, counter-clockwise from the robot's heading, and its standard deviation, rad.
    pub bearing_rad: Option<(f64, f64)>,
}

impl Sensed {
    /// A range with its standard deviation, m.
    #[must_use]
    pub fn range(range_m: f64, std_m: f64) -> Self {
        Self { range_m: Some((range_m, std_m)), bearing_rad: None }
    }
}

/// A robot's measurement at a tick. At tick 0 the sensor is not read: the estimate is the prior.
pub fn measure<S: Sensor + ?Sized, P: PoseSource + ?Sized>(
    sensor: &mut S,
    poses: &mut P,
    (tick, time_s): (u64, f64),
    entry: &WorldEntry,
) -> Measurement {
    let pose = poses.pose(time_s, entry);
    let Sensed { range_m, bearing_rad } = if tick > 0 { sensor.sense(tick, entry) } else { Sensed::default() };
    Measurement::new(pose, range_m).with_bearing(bearing_rad)
}

/// The sensor that a scenario gives a robot, by id; `None` if it has no such robot.
#[must_use]
pub fn of_scenario(scenario: &Scenario, robot: usize) -> Option<Box<dyn Sensor>> {
    Some(match scenario.source {
        Source::Simulated { .. } => Box::new(SimulatedSensor::new(scenario, robot)?),
        Source::Recorded { .. } => Box::new(RecordedSensor::new(scenario, robot)?),
    })
}
