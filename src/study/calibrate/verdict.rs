//! Selection and averaging of models, and what the data cannot determine.

use nalgebra::{Cholesky, DMatrix};

use super::model::{Measured, Model, Problem, Reading, Sharing};
use super::search::Fit;
use super::smoother::{FREEDOM, prior_cost, student_weight};
use crate::statistics::{Z_95, mean};

/// Fewest ranges for a calibration.
const READINGS_MIN: usize = 60;

/// The findings for one sensor; `None` where the data do not determine a value.
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
    pub accel_psd: Option<Measured>,
    /// The values that the data cannot determine, and why.
    pub undetermined: Vec<String>,
}

impl Findings {
    /// The findings if the data determine nothing.
    #[must_use]
    pub fn nothing(counts: &[usize], why: &str) -> Self {
        let none = |&ranges: &usize| SensorErrors { bias_m: None, scale: None, range_std_m: None, ranges };
        Self { sensors: counts.iter().map(none).collect(), accel_psd: None, undetermined: vec![why.to_owned()] }
    }
}

/// Why the ranges alone cannot determine anything, before any fit.
#[must_use]
pub(super) fn obstacle(readings: &[Reading], sensors: usize) -> Option<String> {
    if readings.len() < READINGS_MIN {
        return Some(format!(
            "bias, scale and noise: {} ranges are too few; {READINGS_MIN} are needed at least",
            readings.len()
        ));
    }
    if sensors < 3 {
        return Some(format!(
            "bias, scale and noise: with {sensors} sensors the target may also be at its mirror image; \
             use three sensors or more, or give --truth"
        ));
    }
    let spread = line_spread(readings.iter().map(|reading| reading.position_m));
    (spread.1 <= 1e-3 * spread.0).then(|| {
        "bias, scale and noise: the sensors stand on one line, so the target may also be at its mirror image; \
         give --truth"
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

/// The correlation time of the sensors' residuals, in ranges: this number of successive residuals counts as one
/// independent residual. The weight of a correlation falls exponentially with its lag, with the time constant `memory`
/// in ranges.
#[must_use]
pub(super) fn correlation(by_sensor: &[Vec<f64>], memory: f64) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for residuals in by_sensor.iter().filter(|residuals| residuals.len() >= 20) {
        let n = residuals.len();
        let mean = mean(residuals.iter().copied());
        let variance: f64 = residuals.iter().map(|r| (r - mean).powi(2)).sum();
        let mut time = 1.0;
        for lag in 1..=(n / 4).min(500) {
            let together: f64 = residuals[lag..].iter().zip(residuals).map(|(a, b)| (a - mean) * (b - mean)).sum();
            let rho = together / variance.max(f64::MIN_POSITIVE);
            if rho < 2.0 / (n as f64).sqrt() {
                break;
            }
            time += 2.0 * rho * (-(lag as f64) / memory).exp();
        }
        sum += time * n as f64;
        count += n as f64;
    }
    if count > 0.0 { (sum / count).max(1.0) } else { 1.0 }
}

/// Number of ranges of a sensor that a tracker remembers. It follows from the time constant of the steady Kalman filter
/// for nearly constant velocity, `sqrt(2) (R / Q)^(1/4)`, with R and Q the spectral densities of position noise and
/// acceleration.
fn memory(problem: &Problem, fit: &Fit) -> f64 {
    let duration_s = problem.knots_s.last().zip(problem.knots_s.first()).map_or(0.0, |(last, first)| last - first);
    let weight: f64 = problem.observations.iter().map(|o| fit.estimate.sigmas_m[o.reading.sensor].powi(-2)).sum();
    // A range has information about one axis of two.
    let time_s = std::f64::consts::SQRT_2 * (2.0 * duration_s / weight / fit.estimate.accel_psd).powf(0.25);
    time_s * problem.observations.len() as f64 / (problem.sensors as f64 * duration_s.max(1e-9))
}

/// Residuals by sensor, in order of time, times the weights of the fit, so that an outlier counts little.
fn by_sensor(problem: &Problem, fit: &Fit) -> Vec<Vec<f64>> {
    let mut all = vec![Vec::new(); problem.sensors];
    for (observation, residual) in problem.observations.iter().zip(&fit.solution.residuals_m) {
        let sensor = observation.reading.sensor;
        all[sensor].push(residual * student_weight(residual / fit.estimate.sigmas_m[sensor]));
    }
    all
}

/// Judges the fits. Of those whose errors are all determined, it averages the errors by evidence, and returns the
/// findings with the best fit. If there is none, the findings have the reason.
#[must_use]
pub(super) fn judge(problem: &Problem, fits: &[Fit]) -> (Findings, Option<Fit>) {
    let counts: Vec<usize> = (0..problem.sensors)
        .map(|sensor| problem.observations.iter().filter(|o| o.reading.sensor == sensor).count())
        .collect();
    let Some(best) = fits.first() else {
        return (
            Findings::nothing(
                &counts,
                "bias, scale and noise: no model fits these ranges; look at units and sensor positions",
            ),
            None,
        );
    };
    let noise_m = best.estimate.sigmas_m.iter().sum::<f64>() / problem.sensors.max(1) as f64;
    let extent = line_spread(best.estimate.states.iter().map(|state| [state[0], state[1]]));
    if extent.0 < noise_m.max(0.01 * problem.span_m) {
        let why = "bias and scale: the target stands still, so they cannot be distinguished from its position; let it move \
                   through the scene, or give --truth";
        let mut findings = Findings::nothing(&counts, why);
        // Whatever the bias is, the spread of the ranges about it is the noise.
        set_noise(&mut findings, best, problem, 1.0);
        return (findings, None);
    }
    let time = correlation(&by_sensor(problem, best), f64::INFINITY);
    let mut judged: Vec<GateResult<'_>> = fits.iter().filter_map(|fit| GateResult::new(problem, fit, time)).collect();
    judged.sort_by(|a, b| a.score.total_cmp(&b.score));
    let mut undetermined = Vec::new();
    judged.retain(|one| {
        let open = one.open(problem);
        let is_determined = open.is_empty();
        undetermined.extend(open);
        is_determined
    });
    let Some(first) = judged.first() else {
        return (
            Findings::nothing(
                &counts,
                "bias and scale: the intervals are too wide; record a longer track, or give --truth",
            ),
            None,
        );
    };
    let (fit, least) = (first.fit, first.score);
    judged.retain(|one| one.score < least - WEIGHT_MIN.ln());
    let mut findings = Findings::nothing(&counts, "");
    findings.undetermined = undetermined;
    for (sensor, errors) in findings.sensors.iter_mut().enumerate() {
        errors.bias_m = averaged(&judged, |model| model.bias_index(sensor));
        errors.scale = averaged(&judged, |model| model.scale_index(sensor, problem.sensors));
    }
    set_noise(&mut findings, fit, problem, time);
    // Correlated errors do not average out, but the tracker assumes independent errors. If the variances of noise and
    // manoeuvres are both increased by one factor, the tracker responds as fast, and its covariance matches its error.
    // The factor is for the core of the noise: outliers are not correlated.
    let (mut core, mut total) = (0.0, 0.0);
    for (errors, sigma_m) in findings.sensors.iter().zip(&fit.estimate.sigmas_m) {
        let Some(std_m) = errors.range_std_m else { continue };
        core += errors.ranges as f64 * sigma_m.powi(2).min(std_m.value.powi(2));
        total += errors.ranges as f64 * std_m.value.powi(2);
    }
    let correlated = (correlation(&by_sensor(problem, fit), memory(problem, fit)) * core
        / f64::max(total, f64::MIN_POSITIVE))
    .max(1.0);
    for std_m in findings.sensors.iter_mut().filter_map(|errors| errors.range_std_m.as_mut()) {
        *std_m = std_m.scaled(correlated.sqrt());
    }
    findings.accel_psd = Some(fit.accel_psd(time).scaled(correlated));
    if findings.sensors.iter().all(|errors| errors.bias_m.is_none() && errors.scale.is_none()) {
        findings.undetermined.push(
            "bias and scale: the ranges fit as well without them; longer recordings, more sensors or --truth may tell"
                .to_owned(),
        );
    }
    (findings, Some(fit.clone()))
}

/// Least weight of a model, relative to the most likely one, that still counts ("Occam's window", Madigan & Raftery 1994).
const WEIGHT_MIN: f64 = 0.05;

/// A fit with the information of its data: correlated residuals count less than their number.
struct GateResult<'a> {
    fit: &'a Fit,
    prior_stds: Vec<f64>,
    /// Negative logarithm of the evidence.
    score: f64,
    covariance: DMatrix<f64>,
}

impl<'a> GateResult<'a> {
    /// The evidence (Laplace) with the likelihood to the power of 1 / `time`.
    fn new(problem: &Problem, fit: &'a Fit, time: f64) -> Option<Self> {
        let prior_stds = fit.model.prior_stds(problem.sensors, problem.span_m);
        let mut precision = &fit.solution.information / time;
        prior_stds.iter().enumerate().for_each(|(at, std)| precision[(at, at)] += 1.0 / (std * std));
        let factored = Cholesky::new(precision)?;
        let half_log_det = factored.l_dirty().diagonal().map(f64::ln).sum();
        let score = fit.solution.misfit / time + prior_cost(&fit.estimate.errors, &prior_stds) + half_log_det;
        Some(Self { fit, prior_stds, score, covariance: factored.inverse() })
    }

    /// The errors that the data determine hardly better than the prior.
    fn open(&self, problem: &Problem) -> Vec<String> {
        let model = self.fit.model;
        let biases = model.scale_index(0, problem.sensors).unwrap_or(self.prior_stds.len());
        let is_open = |at: usize| self.covariance[(at, at)].sqrt() > 0.5 * self.prior_stds[at];
        let shared = |sharing| if sharing == Sharing::Each { "of each sensor" } else { "common to all" };
        let kinds = [("bias", model.bias, 0..biases), ("scale", model.scale, biases..self.prior_stds.len())];
        kinds
            .into_iter()
            .filter(|(_, _, slots)| slots.clone().any(is_open))
            .map(|(what, sharing, _)| format!("{what} {}: interval too wide", shared(sharing)))
            .collect()
    }
}

/// The mean of one error over models, weighted by their evidence, and its interval; `None` if no model has it.
fn averaged(judged: &[GateResult<'_>], index: impl Fn(Model) -> Option<usize>) -> Option<Measured> {
    judged.iter().find_map(|one| index(one.fit.model))?;
    let least = judged.first()?.score;
    // A model without the error has the value 0 with certainty.
    let estimates = judged.iter().map(|one| {
        let (value, variance) =
            index(one.fit.model).map_or((0.0, 0.0), |at| (one.fit.estimate.errors[at], one.covariance[(at, at)]));
        ((least - one.score).exp(), value, variance)
    });
    let total: f64 = estimates.clone().map(|(weight, ..)| weight).sum();
    let value = estimates.clone().map(|(weight, value, _)| weight * value).sum::<f64>() / total;
    let variance =
        estimates.map(|(weight, v, variance)| weight * (variance + (v - value).powi(2))).sum::<f64>() / total;
    Some(Measured { value, half_width: Z_95 * variance.sqrt() })
}

/// Sets each sensor's standard deviation from its residuals and the variances of the predicted ranges. The squares of
/// outliers are limited.
fn set_noise(findings: &mut Findings, fit: &Fit, problem: &Problem, time: f64) {
    for (sensor, errors) in findings.sensors.iter_mut().enumerate() {
        let sum: f64 = problem
            .observations
            .iter()
            .zip(fit.solution.residuals_m.iter().zip(&fit.solution.path_variances_m2))
            .filter(|(observation, _)| observation.reading.sensor == sensor)
            .map(|(_, (residual, added))| {
                (residual * residual + added).min(9.0 * FREEDOM * fit.estimate.sigmas_m[sensor].powi(2))
            })
            .sum();
        if errors.ranges >= 10 {
            let std_m = (sum / errors.ranges as f64).sqrt();
            let half_width = Z_95 * std_m * (time / (2.0 * errors.ranges as f64)).sqrt() * 1.5;
            errors.range_std_m = Some(Measured { value: std_m, half_width });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::search::search;
    use super::*;

    const ANCHORS_M: [[f64; 2]; 4] = [[0.0, 0.0], [10.0, 0.0], [10.0, 8.0], [0.0, 8.0]];

    /// Ranges to a target on a winding path, or to one at rest, with noise from a seed.
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
        judge(&problem, &search(&problem, |_| (), &|| true))
    }

    #[test]
    fn a_fit_that_is_not_wanted_any_more_ends_at_its_next_step() {
        let readings = simulated(9, [0.0; 4], 0.0, 0.05, true);
        let problem = Problem::new(&readings, 4);
        let knots = problem.knots_s.len();
        // While it looks for a rough path, and later, while it fits the first model.
        for steps in [knots / 2, knots + 5] {
            let left = std::cell::Cell::new(steps);
            let mut asked = 0;
            let fits = search(&problem, |_| asked += 1, &|| left.replace(left.get().saturating_sub(1)) > 0);
            assert!(fits.is_empty() && asked == Model::ALL.len() && left.get() == 0, "{} fits", fits.len());
        }
    }

    #[test]
    fn intervals_contain_the_true_biases() {
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
    fn manoeuvring_noise_has_an_interval_narrower_than_itself() {
        let (findings, _) = findings(&simulated(8, [0.0; 4], 0.0, 0.05, true));
        let psd = findings.accel_psd.unwrap();
        assert!(psd.half_width > 0.0 && psd.half_width < psd.value, "{psd:?}");
    }

    #[test]
    fn correlated_residuals_count_less_and_only_within_the_memory() {
        let steps: Vec<f64> = (0..1_000).map(|i| if (i / 20) % 2 == 0 { 1.0 } else { -1.0 }).collect();
        let alternating: Vec<f64> = (0..1_000).map(|i| if i % 2 == 0 { 1.0 } else { -1.0 }).collect();
        let (all, short) =
            (correlation(std::slice::from_ref(&steps), f64::INFINITY), correlation(std::slice::from_ref(&steps), 2.0));
        assert!(all > 5.0 && short > 1.5 && short < all, "{all} {short}");
        assert_eq!(correlation(&[alternating], f64::INFINITY), 1.0);
    }

    #[test]
    fn a_common_scale_error_is_found_as_one() {
        let (findings, _) = findings(&simulated(4, [0.0; 4], 0.06, 0.05, true));
        let scale = findings.sensors[0].scale.unwrap();
        assert!((scale.value - 0.06).abs() < 0.01 && findings.sensors[0].bias_m.is_none(), "{findings:?}");
    }

    #[test]
    fn valid_ranges_are_not_corrected() {
        let (findings, _) = findings(&simulated(5, [0.0; 4], 0.0, 0.05, true));
        assert!(
            findings.sensors.iter().all(|sensor| sensor.bias_m.is_none() && sensor.scale.is_none()),
            "{findings:?}"
        );
    }

    #[test]
    fn undetermined_errors_are_not_reported() {
        let (findings, fit) = findings(&simulated(6, [0.2; 4], 0.0, 0.05, false));
        assert!(fit.is_none() && findings.undetermined[0].contains("stands still"), "{findings:?}");
        let mut readings = simulated(7, [0.0; 4], 0.0, 0.05, true);
        assert_eq!(obstacle(&readings, 4), None);
        assert!(obstacle(&readings[..40], 4).unwrap().contains("too few"));
        readings.retain(|reading| reading.sensor < 2);
        assert!(obstacle(&readings, 2).unwrap().contains("mirror"));
    }
}
