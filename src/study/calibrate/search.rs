//! Fits all models to the ranges alone: first a rough path, then path, noise and errors of each model.

use nalgebra::Vector4;

use super::model::{Measured, Model, Problem, Reading};
use super::smoother::{FitParameters, Solution, optimise, update_sigmas};
use crate::statistics::{Z_95, median};

/// The fit of one model.
#[derive(Debug, Clone)]
pub struct Fit {
    /// The model.
    pub model: Model,
    /// Its estimate.
    pub estimate: FitParameters,
    /// Its evidence, information and residuals.
    pub solution: Solution,
    /// Standard deviation of the logarithm of the manoeuvring noise.
    pub log_psd_std: f64,
}

impl Fit {
    /// The manoeuvring noise, m^2/s^3, if `time` successive residuals count as one independent residual.
    #[must_use]
    pub fn accel_psd(&self, time: f64) -> Measured {
        let value = self.estimate.accel_psd;
        Measured { value, half_width: Z_95 * value * self.log_psd_std * time.sqrt() }
    }
}

/// A path from the ranges alone: at each knot the position on which most of the nearby ranges agree.
fn rough_path(problem: &Problem, go_on: &dyn Fn() -> bool) -> Vec<Vector4<f64>> {
    let all = &problem.observations;
    let around = (2 * problem.sensors).clamp(6, 24);
    let mut path: Vec<Vector4<f64>> = Vec::with_capacity(problem.knots_s.len());
    let mut next = 0;
    for knot in 0..problem.knots_s.len() {
        if !go_on() {
            path.resize(problem.knots_s.len(), Vector4::zeros());
            return path;
        }
        while next < all.len() && all[next].knot < knot {
            next += 1;
        }
        let start = next.saturating_sub(around / 2).min(all.len().saturating_sub(around));
        let window: Vec<&Reading> =
            all[start..(start + around).min(all.len())].iter().map(|observation| &observation.reading).collect();
        let mut best = (f64::INFINITY, [0.0, 0.0]);
        let mut consider = |place: [f64; 2]| {
            let mut misses: Vec<f64> = window.iter().map(|reading| miss(reading, place)).collect();
            misses.sort_unstable_by(f64::total_cmp);
            let kept = (misses.len() * 4).div_ceil(5);
            let sum: f64 = misses[..kept].iter().sum();
            if sum < best.0 {
                best = (sum, place);
            }
        };
        if let Some(before) = path.last() {
            consider([before[0], before[1]]);
        }
        for (index, a) in window.iter().enumerate() {
            for b in &window[..index] {
                crossings(a, b).into_iter().flatten().for_each(&mut consider);
            }
        }
        path.push(Vector4::new(best.1[0], best.1[1], 0.0, 0.0));
    }
    path
}

fn miss(reading: &Reading, place: [f64; 2]) -> f64 {
    (reading.range_m - reading.distance_m(place)).abs()
}

/// The intersections of the circles of two sensors' ranges. If they do not intersect, a point on the line through their
/// centres.
fn crossings(a: &Reading, b: &Reading) -> [Option<[f64; 2]>; 2] {
    let (dx, dy) = (b.position_m[0] - a.position_m[0], b.position_m[1] - a.position_m[1]);
    let apart = dx.hypot(dy);
    if a.sensor == b.sensor || apart < 1e-9 {
        return [None, None];
    }
    let (a_m, b_m) = (a.level_range_m(), b.level_range_m());
    let along = (a_m.powi(2) - b_m.powi(2) + apart * apart) / (2.0 * apart);
    let across = (a_m.powi(2) - along * along).max(0.0).sqrt();
    let (ux, uy) = (dx / apart, dy / apart);
    let at = |side: f64| {
        Some([a.position_m[0] + along * ux - side * across * uy, a.position_m[1] + along * uy + side * across * ux])
    };
    [at(1.0), at(-1.0)]
}

/// Fits one model, starting from an estimate: path, errors and the sensors' noise first. Then the manoeuvring noise
/// changes in steps as long as the evidence improves, and at last goes to the vertex of a parabola.
fn fit(problem: &Problem, model: Model, mut estimate: FitParameters, go_on: &dyn Fn() -> bool) -> Option<Fit> {
    let errors = model.prior_stds(problem.sensors, problem.span_m).len();
    estimate.errors = vec![0.0; errors];
    let least_m = 1e-5 * problem.span_m;
    let with_noise = |mut estimate: FitParameters, turns: usize| -> Option<(FitParameters, Solution)> {
        let mut solution = optimise(problem, model, &mut estimate, go_on)?;
        for _ in 0..turns {
            update_sigmas(problem, &solution, &mut estimate.sigmas_m, least_m);
            solution = optimise(problem, model, &mut estimate, go_on)?;
        }
        Some((estimate, solution))
    };
    let (mut estimate, mut solution) = with_noise(estimate, 8)?;
    for factor in [8.0_f64, 2.0] {
        for direction in [factor, 1.0 / factor] {
            for _ in 0..8 {
                let mut tried = estimate.clone();
                tried.accel_psd *= direction;
                let Some((tried, found)) = with_noise(tried, 4) else { break };
                if found.neg_log_evidence >= solution.neg_log_evidence - 0.1 {
                    break;
                }
                (estimate, solution) = (tried, found);
            }
        }
    }
    (estimate, solution) = with_noise(estimate, 5)?;
    // The evidence as a parabola over the logarithm of the manoeuvring noise.
    let mut beside = [0.0; 2];
    for (neg_log_evidence, by) in beside.iter_mut().zip([1.0, -1.0]) {
        let mut tried = estimate.clone();
        tried.accel_psd *= f64::exp(by * LOG_PSD_STEP);
        *neg_log_evidence = optimise(problem, model, &mut tried, go_on)?.neg_log_evidence;
    }
    let [above, below] = beside;
    let curvature = (above + below - 2.0 * solution.neg_log_evidence) / LOG_PSD_STEP.powi(2);
    if curvature > 0.0 {
        let step = (below - above) / (2.0 * LOG_PSD_STEP * curvature);
        estimate.accel_psd *= step.clamp(-1.0, 1.0).exp();
        solution = optimise(problem, model, &mut estimate, go_on)?;
    }
    Some(Fit { model, estimate, solution, log_psd_std: curvature.max(0.0).sqrt().recip() })
}

/// Step of the logarithm of the manoeuvring noise that shows the evidence's curvature.
const LOG_PSD_STEP: f64 = 0.5;

/// An initial estimate from a path.
fn start(problem: &Problem, states: Vec<Vector4<f64>>) -> FitParameters {
    let mut misses: Vec<f64> = problem
        .observations
        .iter()
        .map(|observation| {
            let state = states[observation.knot];
            miss(&observation.reading, [state[0], state[1]])
        })
        .collect();
    let sigma = (2.0 * median(&mut misses).unwrap_or(1.0)).max(1e-4 * problem.span_m);
    let mut gaps: Vec<f64> = problem.knots_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let dt = median(&mut gaps).unwrap_or(1.0).max(1e-6);
    // The target crosses its scene within some 200 knots, and can change its velocity within 50.
    let accel_psd = (problem.span_m / (200.0 * dt)).powi(2) / (50.0 * dt);
    FitParameters { states, errors: Vec::new(), sigmas_m: vec![sigma; problem.sensors], accel_psd }
}

/// All models that can be fitted, the one with the most evidence first; `show` receives the number of finished models.
/// Once `go_on` says no, it ends after one step.
pub fn search(problem: &Problem, mut show: impl FnMut(usize), go_on: &dyn Fn() -> bool) -> Vec<Fit> {
    let mut start = start(problem, rough_path(problem, go_on));
    let mut fits: Vec<Fit> = Vec::new();
    for (done, model) in Model::ALL.into_iter().enumerate() {
        if let Some(fit) = fit(problem, model, start.clone(), go_on) {
            start = fit.estimate.clone();
            fits.push(fit);
        }
        show(done + 1);
    }
    fits.sort_by(|a, b| a.solution.neg_log_evidence.total_cmp(&b.solution.neg_log_evidence));
    fits
}

/// The manoeuvring noise that fits corrected ranges, with the known track as the first estimate of the path.
#[must_use]
pub fn manoeuvring(problem: &Problem, states: Vec<Vector4<f64>>, go_on: &dyn Fn() -> bool) -> Option<Measured> {
    let start = start(problem, states);
    let model = Model { bias: super::model::Sharing::Absent, scale: super::model::Sharing::Absent };
    fit(problem, model, start, go_on).map(|fit| fit.accel_psd(1.0))
}
