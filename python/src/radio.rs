//! A radio on a serial port as a robot's range sensor.

use std::path::PathBuf;
use std::time::Duration;

use pyo3::prelude::*;
use rangehound::failure::Failure;
use rangehound_node::serial::{Radio, SerialSensor};
use rangehound_shared::radio::Format;
use rangehound_shared::scenario::{Calibration, Scenario, bounds};

/// The attributes of `rangehound.Radio`.
#[derive(Debug, FromPyObject)]
pub(crate) struct RadioOnPort {
    port: PathBuf,
    format: String,
    anchor: Option<String>,
    tag: Option<String>,
    bias_m: f64,
    scale: f64,
    max_age_s: Option<f64>,
}

impl RadioOnPort {
    /// Opens the port as the sensor of a robot of this scenario.
    pub(crate) fn open(self, scenario: &Scenario, id: usize) -> Result<SerialSensor, Failure> {
        let Self { port, format, anchor, tag, bias_m, scale, max_age_s } = self;
        let format = format
            .parse::<Format>()
            .map_err(|error| Failure::input(format!("radio: format is {format:?}: {error}")))?;
        if !bounds::BIAS_M.contains(&bias_m) || !bounds::SCALE.contains(&scale) {
            let (biases_m, scales) = (bounds::BIAS_M, bounds::SCALE);
            let message = format!("radio: bias_m is {bias_m}, scale is {scale}: expected {biases_m:?} m, {scales:?}");
            return Err(Failure::input(message));
        }
        let max_age_s = max_age_s.unwrap_or(scenario.dt_s);
        let max_age = Duration::try_from_secs_f64(max_age_s)
            .map_err(|error| Failure::input(format!("radio: max_age_s is {max_age_s}: {error}: expected seconds")))?;
        let reported = scenario.robots.get(id).and_then(|robot| robot.reported.range);
        let std_m = reported.ok_or_else(|| Failure::input(format!("robot {id} has no ranges in the scenario")))?.std_m;
        SerialSensor::open(&port, Radio { format, anchor, tag }, Calibration { bias_m, scale }, std_m, max_age)
            .map_err(|error| Failure::input(format!("radio: {}: {error}", port.display())))
    }
}
