//! Which model is believed, and what the data cannot tell.

use super::model::{Model, Problem, Reading, Sharing};
use super::search::Fit;
use super::smoother::FREEDOM;

/// Two-sided 95 % of a normal distribution.
const QUANTILE: f64 = 1.96;

/// Fewest ranges that are worth a calibration.
const READINGS_MIN: usize = 60;

/// A value with the half width of its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Measured {
    /// The value.
    pub value: f64,
    /// Half width of the interval.
    pub half_width: f64,
}

/// What was found for one sensor; `None` is what could not be told.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct SensorErrors {
    /// Bias, m.
    pub bias_m: Option<Measured>,
    /// Scale error.
    pub scale: Option<Measured>,
    /// Standard deviation of a range, m.
    pub range_std_m: Option<Measured>,
    /// Number of ranges that were used.
    pub ranges: usize,
}

/// The findings.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Findings {
    /// For each sensor in the recording's order.
    pub sensors: Vec<SensorErrors>,
    /// Spectral density of the acceleration, m^2/s^3.
    pub accel_psd: Option<f64>,
    /// What the data cannot tell, and why.
    pub untold: Vec<String>,
}

impl Findings {
    /// Findings of data that tell nothing.
    #[must_use]
    pub fn nothing(counts: &[usize], why: &str) -> Self {
        let none = |&ranges: &usize| SensorErrors { bias_m: None, scale: None, range_std_m: None, ranges };
        Self { sensors: counts.iter().map(none).collect(), accel_psd: None, untold: vec![why.to_owned()] }
    }
}

/// Why the ranges alone cannot tell, before anything is fitted.
#[must_use]
pub fn obstacle(readings: &[Reading], sensors: usize) -> Option<String> {
    if readings.len() < READINGS_MIN {
        return Some(format!(
            "bias, scale and noise: {} ranges are too few; {READINGS_MIN} are needed at least",
            readings.len()
        ));
    }
    if sensors < 3 {
        return Some(format!(
            "bias, scale and noise: {sensors} sensors leave the target's mirror image open and no range to check; \
             three are needed, or --truth"
        ));
    }
    let spread = line_spread(readings.iter().map(|reading| reading.position_m));
    (spread.1 <= 1e-3 * spread.0).then(|| {
        "bias, scale and noise: the sensors stand on one line, so the target's mirror image is open; give --truth"
            .to_owned()
    })
}

/// Standard deviations of points along and across their main direction.
fn line_spread(points: impl Iterator<Item = [f64; 2]> + Clone) -> (f64, f64) {
    let count = points.clone().count().max(1) as f64;
    let sum = points.clone().fold([0.0, 0.0], |sum, p| [sum[0] + p[0], sum[1] + p[1]]);
    let mean = [sum[0] / count, sum[1] / count];
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for p in points {
        let (x, y) = (p[0] - mean[0], p[1] - mean[1]);
        (xx, xy, yy) = (xx + x * x / count, xy + x * y / count, yy + y * y / count);
    }
    let (middle, half) = (0.5 * (xx + yy), (0.25 * (xx - yy).powi(2) + xy * xy).sqrt());
    ((middle + half).max(0.0).sqrt(), (middle - half).max(0.0).sqrt())
}

/// How many successive residuals of a sensor tell as much as one: their correlation time, in ranges.
#[must_use]
pub fn correlation(by_sensor: &[Vec<f64>]) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for left in by_sensor.iter().filter(|left| left.len() >= 20) {
        let n = left.len();
        let mean = left.iter().sum::<f64>() / n as f64;
        let variance: f64 = left.iter().map(|r| (r - mean).powi(2)).sum();
        let mut time = 1.0;
        for lag in 1..=(n / 4).min(500) {
            let together: f64 = left[lag..].iter().zip(left).map(|(a, b)| (a - mean) * (b - mean)).sum();
            let rho = together / variance.max(f64::MIN_POSITIVE);
            if rho < 2.0 / (n as f64).sqrt() {
                break;
            }
            time += 2.0 * rho;
        }
        sum += time * n as f64;
        count += n as f64;
    }
    if count > 0.0 { (sum / count).max(1.0) } else { 1.0 }
}

/// Residuals by sensor, in order of time.
fn by_sensor(problem: &Problem, fit: &Fit) -> Vec<Vec<f64>> {
    let mut all = vec![Vec::new(); problem.sensors];
    for (observation, left) in problem.observations.iter().zip(&fit.solution.residuals_m) {
        all[observation.reading.sensor].push(*left);
    }
    all
}

/// Judges the fits: the best one whose errors are all told, or why there is none.
#[must_use]
pub fn judge(problem: &Problem, fits: &[Fit]) -> (Findings, Option<Fit>) {
    let counts: Vec<usize> = (0..problem.sensors)
        .map(|sensor| problem.observations.iter().filter(|o| o.reading.sensor == sensor).count())
        .collect();
    let Some(best) = fits.first() else {
        return (Findings::nothing(&counts, "bias, scale and noise: no model fits these ranges"), None);
    };
    let noise_m = best.estimate.sigmas_m.iter().sum::<f64>() / problem.sensors.max(1) as f64;
    let extent = line_spread(best.estimate.states.iter().map(|state| [state[0], state[1]]));
    if extent.0 < noise_m.max(0.01 * problem.span_m) {
        let why = "bias and scale: the target stands still, so they cannot be told from its position; let it move \
                   through the scene, or give --truth";
        let mut findings = Findings::nothing(&counts, why);
        // Whatever the bias, the spread of the ranges about it is the noise.
        set_noise(&mut findings, best, problem, 1.0);
        return (findings, None);
    }
    let time = correlation(&by_sensor(problem, best));
    let mut untold = Vec::new();
    // Correlated residuals say less than their number: the evidence counts for that much less.
    let score = |fit: &Fit| {
        let errors = fit.estimate.errors.len() as f64;
        fit.solution.unlikelihood / time + 0.5 * errors * (problem.observations.len() as f64 / time).max(2.0).ln()
    };
    let mut ranked: Vec<&Fit> = fits.iter().collect();
    ranked.sort_by(|a, b| score(a).total_cmp(&score(b)));
    for fit in ranked {
        let told = open_quantities(problem, fit, time);
        if !told.is_empty() {
            untold.extend(told.into_iter().filter(|line| !untold.contains(line)).collect::<Vec<_>>());
            continue;
        }
        let mut findings = Findings::nothing(&counts, "");
        findings.untold = untold;
        let half = |at: usize| QUANTILE * (time * fit.solution.covariance[at][at]).sqrt();
        for sensor in 0..problem.sensors {
            let measured =
                |at: Option<usize>| at.map(|at| Measured { value: fit.estimate.errors[at], half_width: half(at) });
            findings.sensors[sensor].bias_m = measured(fit.model.bias_index(sensor));
            findings.sensors[sensor].scale = measured(fit.model.scale_index(sensor, problem.sensors));
        }
        set_noise(&mut findings, fit, problem, time);
        findings.accel_psd = Some(fit.estimate.accel_psd);
        if fit.model == (Model { bias: Sharing::Absent, scale: Sharing::Absent }) {
            findings.untold.push("bias and scale: none that the ranges would show".to_owned());
        }
        return (findings, Some(fit.clone()));
    }
    (Findings::nothing(&counts, "bias and scale: their intervals are too wide to be of use"), None)
}

/// The standard deviation, of the Student scale and the path's share taken together.
fn set_noise(findings: &mut Findings, fit: &Fit, problem: &Problem, time: f64) {
    for (sensor, errors) in findings.sensors.iter_mut().enumerate() {
        let sum: f64 = problem
            .observations
            .iter()
            .zip(fit.solution.residuals_m.iter().zip(&fit.solution.path_variances_m2))
            .filter(|(observation, _)| observation.reading.sensor == sensor)
            .map(|(_, (left, added))| (left * left + added).min(9.0 * FREEDOM * fit.estimate.sigmas_m[sensor].powi(2)))
            .sum();
        if errors.ranges >= 10 {
            let std_m = (sum / errors.ranges as f64).sqrt();
            let half_width = QUANTILE * std_m * (time / (2.0 * errors.ranges as f64)).sqrt() * 1.5;
            errors.range_std_m = Some(Measured { value: std_m, half_width });
        }
    }
}

/// Errors of a model that its data leave open: intervals as wide as the value and wider than the noise, or hardly
/// narrower than what was taken for granted.
fn open_quantities(problem: &Problem, fit: &Fit, time: f64) -> Vec<String> {
    let prior = fit.model.prior_stds(problem.sensors, problem.span_m);
    let noise_m = fit.estimate.sigmas_m.iter().copied().fold(0.0, f64::max);
    let biases = fit.model.scale_index(0, problem.sensors).unwrap_or(prior.len());
    let is_open = |at: usize| {
        let std = fit.solution.covariance[at][at].sqrt();
        let useful = if at < biases { noise_m } else { 2.0 * noise_m / problem.span_m };
        let half_width = QUANTILE * std * time.sqrt();
        std > 0.5 * prior[at] || (half_width > useful && half_width > fit.estimate.errors[at].abs())
    };
    let mut told = Vec::new();
    let shared = |sharing| if sharing == Sharing::Each { "of each sensor" } else { "common to all" };
    if (0..biases).any(is_open) {
        told.push(format!("bias {}, beside scale {:?}: interval too wide", shared(fit.model.bias), fit.model.scale));
    }
    if (biases..prior.len()).any(is_open) {
        told.push(format!("scale {}, beside bias {:?}: interval too wide", shared(fit.model.scale), fit.model.bias));
    }
    told
}

#[cfg(test)]
mod tests {
    use super::super::search::search;
    use super::*;

    const ANCHORS_M: [[f64; 2]; 4] = [[0.0, 0.0], [10.0, 0.0], [10.0, 8.0], [0.0, 8.0]];

    /// Ranges to a target on a winding path, or one that stands still, with noise of a seed.
    fn simulated(seed: u64, biases_m: [f64; 4], scale: f64, std_m: f64, moves: bool) -> Vec<Reading> {
        let mut state = seed;
        let mut uniform = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        (0..1_200)
            .map(|index| {
                let (time_s, sensor) = (0.05 * f64::from(index), index as usize % 4);
                let t = if moves { time_s } else { 0.0 };
                let (x, y) = (5.0 + 3.5 * (0.31 * t).sin(), 4.0 + 2.8 * (0.47 * t).cos());
                let position_m = ANCHORS_M[sensor];
                let distance = (x - position_m[0]).hypot(y - position_m[1]);
                let normal = (0..12).map(|_| uniform()).sum::<f64>() - 6.0;
                let range_m = (1.0 + scale) * distance + biases_m[sensor] + std_m * normal;
                Reading { time_s, sensor, position_m, height_m: 0.0, range_m }
            })
            .collect()
    }

    fn findings(readings: &[Reading]) -> (Findings, Option<Fit>) {
        let problem = Problem::new(readings, 4);
        judge(&problem, &search(&problem, |_| ()))
    }

    #[test]
    fn intervals_hold_the_biases_that_were_put_in() {
        let biases_m = [0.1, 0.3, -0.2, 0.5];
        let (mut inside, mut all) = (0, 0);
        for seed in 1..=3 {
            let (findings, fit) = findings(&simulated(seed, biases_m, 0.0, 0.05, true));
            assert_eq!(fit.unwrap().model, Model { bias: Sharing::Each, scale: Sharing::Absent });
            for (sensor, bias_m) in findings.sensors.iter().zip(biases_m) {
                let found = sensor.bias_m.unwrap();
                assert!((found.value - bias_m).abs() < 0.05, "{found:?} for {bias_m}");
                inside += usize::from((found.value - bias_m).abs() <= found.half_width);
                all += 1;
                assert!((0.04..0.065).contains(&sensor.range_std_m.unwrap().value), "{sensor:?}");
            }
        }
        assert!(inside * 10 >= all * 7, "{inside} of {all}");
    }

    #[test]
    fn a_scale_error_of_all_is_found_as_one() {
        let (findings, _) = findings(&simulated(4, [0.0; 4], 0.06, 0.05, true));
        let scale = findings.sensors[0].scale.unwrap();
        assert!((scale.value - 0.06).abs() < 0.01 && findings.sensors[0].bias_m.is_none(), "{findings:?}");
    }

    #[test]
    fn sound_ranges_are_left_alone() {
        let (findings, _) = findings(&simulated(5, [0.0; 4], 0.0, 0.05, true));
        assert!(
            findings.sensors.iter().all(|sensor| sensor.bias_m.is_none() && sensor.scale.is_none()),
            "{findings:?}"
        );
    }

    #[test]
    fn what_cannot_be_told_is_not() {
        let (findings, fit) = findings(&simulated(6, [0.2; 4], 0.0, 0.05, false));
        assert!(fit.is_none() && findings.untold[0].contains("stands still"), "{findings:?}");
        let mut readings = simulated(7, [0.0; 4], 0.0, 0.05, true);
        assert_eq!(obstacle(&readings, 4), None);
        assert!(obstacle(&readings[..40], 4).unwrap().contains("too few"));
        readings.retain(|reading| reading.sensor < 2);
        assert!(obstacle(&readings, 2).unwrap().contains("mirror"));
    }
}
