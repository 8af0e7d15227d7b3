//! Errors of each sensor against a known track, by robust regression.

use super::model::Measured;
use super::smoother::{FREEDOM, student_weight};
use super::verdict::{Findings, correlation};
use crate::statistics::{Z_95, median};

/// Distances and errors of one sensor, in order of time.
pub type Pairs = Vec<(f64, f64)>;

/// Finds each sensor's errors from (true distance, measured range minus true distance).
#[must_use]
pub fn regress(sensors: &[Pairs], names: &[String]) -> Findings {
    let counts: Vec<usize> = sensors.iter().map(Vec::len).collect();
    let mut findings = Findings::nothing(&counts, "");
    findings.undetermined.clear();
    for (sensor, pairs) in sensors.iter().enumerate() {
        if pairs.len() < 10 {
            findings.undetermined.push(format!(
                "the errors of sensor {}: only {} ranges lie within the time of the true track; 10 are needed",
                names[sensor],
                pairs.len()
            ));
            continue;
        }
        let (line, both) = fit(pairs, true);
        let time = correlation(&[both], f64::INFINITY);
        let half_scale = Z_95 * (line.variances[1] * time).sqrt();
        let half_bias = Z_95 * (line.variances[0] * time).sqrt();
        let errors = &mut findings.sensors[sensor];
        if half_bias > 2.0 * line.sigma && half_bias > line.values[0].abs() || !half_scale.is_finite() {
            let (level, _) = fit(pairs, false);
            let half_width = Z_95 * (level.variances[0] * time).sqrt();
            errors.bias_m = Some(Measured { value: level.values[0], half_width });
            findings.undetermined.push(format!(
                "the scale of sensor {}: its distances hardly change, so all of its error is taken as bias",
                names[sensor]
            ));
        } else {
            errors.bias_m = Some(Measured { value: line.values[0], half_width: half_bias });
            errors.scale = Some(Measured { value: line.values[1], half_width: half_scale });
        }
        let half_width = Z_95 * line.std_m * (time / (2.0 * pairs.len() as f64)).sqrt() * 1.5;
        errors.range_std_m = Some(Measured { value: line.std_m, half_width });
    }
    findings
}

struct Line {
    values: [f64; 2],
    variances: [f64; 2],
    sigma: f64,
    std_m: f64,
}

/// Fits a line, or a constant, to errors with Student noise; returns it with the residuals.
fn fit(pairs: &Pairs, sloped: bool) -> (Line, Vec<f64>) {
    let mut level: Vec<f64> = pairs.iter().map(|pair| pair.1).collect();
    let middle = median(&mut level).unwrap_or(0.0);
    let mut off: Vec<f64> = pairs.iter().map(|pair| (pair.1 - middle).abs()).collect();
    let mut sigma = (1.5 * median(&mut off).unwrap_or(1.0)).max(1e-9);
    let (mut a, mut b) = (middle, 0.0);
    let mut variances = [0.0, f64::INFINITY];
    for _ in 0..50 {
        let (mut s, mut sx, mut sy, mut sxx, mut sxy, mut square) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        for &(x, y) in pairs {
            let residual = y - a - b * x;
            let w = student_weight(residual / sigma);
            (s, sx, sy, sxx, sxy) = (s + w, sx + w * x, sy + w * y, sxx + w * x * x, sxy + w * x * y);
            square += w * residual * residual;
        }
        sigma = (square / pairs.len() as f64).sqrt().max(1e-9);
        let det = s * sxx - sx * sx;
        if sloped && det > 1e-9 * s * sxx {
            (a, b) = ((sxx * sy - sx * sxy) / det, (s * sxy - sx * sy) / det);
            variances = [sigma * sigma * sxx / det, sigma * sigma * s / det];
        } else {
            (a, b) = (sy / s, 0.0);
            variances = [sigma * sigma / s, f64::INFINITY];
        }
    }
    let residuals: Vec<f64> = pairs.iter().map(|&(x, y)| y - a - b * x).collect();
    let limit = 9.0 * FREEDOM * sigma * sigma;
    let std_m = (residuals.iter().map(|r| (r * r).min(limit)).sum::<f64>() / residuals.len() as f64).sqrt();
    (Line { values: [a, b], variances, sigma, std_m }, residuals)
}
