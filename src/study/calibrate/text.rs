//! The findings as `calibration.toml`.

use std::fmt::Write as _;

use super::model::Measured;
use super::verdict::Findings;
use crate::files::calibration::VERSION;
use crate::statistics::median;

/// The file's text.
#[must_use]
pub(super) fn text(findings: &Findings, names: &[String]) -> String {
    let mut text =
        format!("# measured = (1 + scale) true + bias_m; +- is half of the 95 % interval\nversion = {VERSION}\n");
    let mut stds: Vec<f64> = findings.sensors.iter().filter_map(|s| s.range_std_m.map(|m| m.value)).collect();
    if let Some(std_m) = median(&mut stds) {
        let _ = writeln!(text, "range_std_m = {std_m:?}");
    }
    if let Some(Measured { value, half_width }) = findings.accel_psd {
        let _ = writeln!(text, "accel_psd = {value:?} # +- {half_width:.2e}");
    }
    for (name, errors) in names.iter().zip(&findings.sensors) {
        let _ = writeln!(text, "\n[[sensor]]\nid = {}", toml::Value::from(name.as_str()));
        let mut line = |key: &str, measured: Option<Measured>| {
            let _ = match measured {
                Some(Measured { value, half_width }) => writeln!(text, "{key} = {value:?} # +- {half_width:.2e}"),
                None => writeln!(text, "# {key}: not determined"),
            };
        };
        line("bias_m", errors.bias_m);
        line("scale", errors.scale);
        line("range_std_m", errors.range_std_m);
    }
    text
}
