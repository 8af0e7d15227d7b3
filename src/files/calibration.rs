//! `calibration.toml`, version 1: written by `calibrate`, read by `track --calibration`.

use std::path::Path;

use rangehound_shared::recording::SensorName;
use rangehound_shared::scenario::{RecordedSensorTable, RecordingTable};
use serde::Deserialize;

use crate::failure::{self, Failure};

/// Version of the format.
pub const VERSION: u64 = 1;

/// Largest file that is read, bytes.
const LEN_MAX: u64 = 1 << 20;

/// The contents of a file.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Calibration {
    /// Version of the format.
    pub version: u64,
    /// Standard deviation of a range of any other sensor, m.
    pub range_std_m: Option<f64>,
    /// Spectral density of the acceleration, m^2/s^3.
    pub accel_psd: Option<f64>,
    /// The sensors.
    #[serde(default)]
    pub sensor: Vec<SensorCalibration>,
}

/// One `[[sensor]]`.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorCalibration {
    /// Its id in the recording.
    pub id: String,
    /// Bias B in `measured = (1 + S) true + B`, m.
    pub bias_m: Option<f64>,
    /// Scale error S.
    pub scale: Option<f64>,
    /// Standard deviation of a range, m.
    pub range_std_m: Option<f64>,
}

/// Reads a file; unknown keys are refused.
///
/// # Errors
/// [`Failure::Input`].
pub fn read(path: &Path) -> Result<Calibration, Failure> {
    let refuse = |problem: String| {
        let expected = if problem.contains(": expected ") {
            ""
        } else {
            ": expected a calibration as `rangehound calibrate` writes it"
        };
        Failure::input(format!("cannot use {}: {problem}{expected}", path.display()))
    };
    let len = std::fs::metadata(path).map_err(|error| refuse(error.to_string()))?.len();
    if len > LEN_MAX {
        return Err(refuse(format!("it has {len} bytes, more than {LEN_MAX}")));
    }
    let text = std::fs::read_to_string(path).map_err(|error| refuse(error.to_string()))?;
    parse(&text).map_err(refuse)
}

/// Parses the text of a file.
///
/// # Errors
/// The first fault.
pub fn parse(text: &str) -> Result<Calibration, String> {
    let file: Calibration =
        toml::from_str(text).map_err(|error| error.message().replacen(", expected ", ": expected ", 1))?;
    if file.version != VERSION {
        return Err(format!("its version is {}, not {VERSION}", file.version));
    }
    for (index, sensor) in file.sensor.iter().enumerate() {
        if file.sensor[..index].iter().any(|before| before.id == sensor.id) {
            return Err(format!("sensor {:?} is in it twice", sensor.id));
        }
    }
    let all = file.sensor.iter().flat_map(|sensor| [sensor.bias_m, sensor.scale, sensor.range_std_m]);
    if all.chain([file.range_std_m, file.accel_psd]).flatten().any(|value| !value.is_finite()) {
        return Err("it has a value that is not finite".to_owned());
    }
    Ok(file)
}

/// Adds a calibration to the values of the command line, which take precedence. Reports sensors that only one of the two
/// has.
pub fn merge(file: &Calibration, known: &[String], table: &mut RecordingTable, psd: &mut Option<f64>) {
    let list = |names: Vec<&str>| names.join(", ");
    let surplus: Vec<&str> =
        file.sensor.iter().map(|s| s.id.as_str()).filter(|id| !known.iter().any(|k| k == id)).collect();
    if !surplus.is_empty() {
        failure::print_stderr(format_args!(
            "calibration: values for sensors that are not in this recording: {}",
            list(surplus)
        ));
    }
    let missing: Vec<&str> =
        known.iter().map(String::as_str).filter(|k| file.sensor.iter().all(|s| s.id != *k)).collect();
    if !missing.is_empty() {
        failure::print_stderr(format_args!("calibration: no values for sensors of this recording: {}", list(missing)));
    }
    let (std_given, bias_given, scale_given) = (table.range_std_m, table.bias_m, table.scale);
    table.range_std_m = std_given.or(file.range_std_m);
    *psd = psd.or(file.accel_psd);
    let sensors = table.sensor.get_or_insert_default();
    for calibrated in file.sensor.iter().filter(|sensor| known.contains(&sensor.id)) {
        let Some(sensor) = entry(sensors, &calibrated.id) else { continue };
        let unless = |given: Option<f64>, value: Option<f64>| if given.is_some() { None } else { value };
        sensor.range_std_m = sensor.range_std_m.or(unless(std_given, calibrated.range_std_m));
        sensor.bias_m = sensor.bias_m.or(unless(bias_given, calibrated.bias_m));
        sensor.scale = sensor.scale.or(unless(scale_given, calibrated.scale));
    }
}

/// The table's entry of a sensor; created if it is missing.
fn entry<'a>(sensors: &'a mut Vec<RecordedSensorTable>, name: &str) -> Option<&'a mut RecordedSensorTable> {
    let id: SensorName = name.parse().ok()?;
    let index = sensors.iter().position(|sensor| sensor.id == id).unwrap_or_else(|| {
        sensors.push(RecordedSensorTable::new(id));
        sensors.len() - 1
    });
    sensors.get_mut(index)
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = "version = 1\nrange_std_m = 0.2\naccel_psd = 0.5\n[[sensor]]\nid = \"7\"\nbias_m = 0.1\nscale = 0.02\nrange_std_m = 0.3\n";

    #[test]
    fn flags_win_over_the_file() {
        let file = parse(FILE).unwrap();
        let mut table = RecordingTable { bias_m: Some(0.4), ..RecordingTable::default() };
        let mut psd = Some(2.0);
        merge(&file, &["7".to_owned(), "8".to_owned()], &mut table, &mut psd);
        let sensor = &table.sensor.unwrap()[0];
        assert_eq!((sensor.bias_m, sensor.scale, sensor.range_std_m), (None, Some(0.02), Some(0.3)));
        assert_eq!((table.range_std_m, table.bias_m, psd), (Some(0.2), Some(0.4), Some(2.0)));
    }

    #[test]
    fn wrong_calibrations_are_refused() {
        for (from, to) in [("version = 1", "version = 2"), ("bias_m = 0.1", "bias = 0.1"), ("0.02", "nan")] {
            assert!(parse(&FILE.replace(from, to)).is_err(), "{to}");
        }
        assert!(parse(&format!("{FILE}[[sensor]]\nid = \"7\"\n")).unwrap_err().contains("twice"));
    }
}
