//! Estimates the target's complete path and the sensors' errors together: robust Gauss-Newton steps on a
//! block-tridiagonal matrix with a border.

use nalgebra::{Cholesky, DMatrix, DVector, Matrix4, Vector4};

use super::model::{Model, Problem};

/// Degrees of freedom of the ranges' Student distribution: heavy tails, so that an outlier counts little.
pub const FREEDOM: f64 = 4.0;

const STEPS_MAX: usize = 30;

/// Weight of a residual in the least squares, given the residual as a multiple of the noise's scale.
#[must_use]
pub fn student_weight(ratio: f64) -> f64 {
    (FREEDOM + 1.0) / (FREEDOM + ratio * ratio)
}

/// The parameters of a fit: the path, and the errors and noise of the sensors.
#[derive(Debug, Clone)]
pub struct FitParameters {
    /// `[x y vx vy]` at each knot.
    pub states: Vec<Vector4<f64>>,
    /// Biases, then scale errors, as the model numbers them.
    pub errors: Vec<f64>,
    /// Scale of each sensor's noise, m.
    pub sigmas_m: Vec<f64>,
    /// Spectral density of the acceleration, m^2/s^3.
    pub accel_psd: f64,
}

/// The results of a solution beside the estimate.
#[derive(Debug, Clone)]
pub struct Solution {
    /// Negative logarithm of the evidence (Laplace), up to a constant of the data.
    pub neg_log_evidence: f64,
    /// The same for fixed errors, at their estimate and without their prior.
    pub misfit: f64,
    /// The information of the data about the errors, without their prior: an inverse covariance.
    pub information: DMatrix<f64>,
    /// Residual of each range, m.
    pub residuals_m: Vec<f64>,
    /// Variance of each predicted range, from the uncertainty of path and errors, m^2.
    pub path_variances_m2: Vec<f64>,
}

struct Normal {
    diagonal: Vec<Matrix4<f64>>,
    upper: Vec<Matrix4<f64>>,
    border: Vec<Vec<Vector4<f64>>>,
    corner: DMatrix<f64>,
    rhs: Vec<Vector4<f64>>,
    errors_rhs: DVector<f64>,
}

/// Residual, distance, direction and scale error of one observation.
fn residual(problem: &Problem, model: Model, estimate: &FitParameters, index: usize) -> (f64, f64, [f64; 2], f64) {
    let observation = &problem.observations[index];
    let sensor = observation.reading.sensor;
    let state = &estimate.states[observation.knot];
    let dx = state[0] + observation.after_s * state[2] - observation.reading.position_m[0];
    let dy = state[1] + observation.after_s * state[3] - observation.reading.position_m[1];
    let distance = dx.hypot(dy).hypot(observation.reading.height_m).max(1e-6 * problem.span_m);
    let bias = model.bias_index(sensor).map_or(0.0, |at| estimate.errors[at]);
    let scale = model.scale_index(sensor, problem.sensors).map_or(0.0, |at| estimate.errors[at]);
    let residual_m = observation.reading.range_m - bias - (1.0 + scale) * distance;
    (residual_m, distance, [dx / distance, dy / distance], scale)
}

/// Derivative of a range with respect to the state at its knot.
fn slope_of([ux, uy]: [f64; 2], scale: f64, after_s: f64) -> Vector4<f64> {
    let (gx, gy) = ((1.0 + scale) * ux, (1.0 + scale) * uy);
    Vector4::new(gx, gy, gx * after_s, gy * after_s)
}

/// Sums in order: `Vector4::dot` sums in pairs, which would change the last digits of the figures.
fn dot(a: &Vector4<f64>, b: &Vector4<f64>) -> f64 {
    a.component_mul(b).sum()
}

fn motion_error(before: &Vector4<f64>, after: &Vector4<f64>, dt: f64) -> Vector4<f64> {
    after - before - Vector4::new(dt * before[2], dt * before[3], 0.0, 0.0)
}

/// The entries of an axis' inverse process noise: position, cross, velocity.
fn motion_weight(dt: f64, psd: f64) -> (f64, f64, f64) {
    (12.0 / (psd * dt * dt * dt), -6.0 / (psd * dt * dt), 4.0 / (psd * dt))
}

fn cost(problem: &Problem, model: Model, estimate: &FitParameters, prior_stds: &[f64]) -> f64 {
    let mut sum = 0.0;
    for (index, observation) in problem.observations.iter().enumerate() {
        let sigma = estimate.sigmas_m[observation.reading.sensor];
        let ratio = residual(problem, model, estimate, index).0 / sigma;
        sum += 0.5 * (FREEDOM + 1.0) * (ratio * ratio / FREEDOM).ln_1p() + sigma.ln();
    }
    for k in 1..problem.knots_s.len() {
        let dt = problem.knots_s[k] - problem.knots_s[k - 1];
        let e = motion_error(&estimate.states[k - 1], &estimate.states[k], dt);
        let (p, c, v) = motion_weight(dt, estimate.accel_psd);
        for axis in 0..2 {
            let (a, b) = (e[axis], e[axis + 2]);
            sum += 0.5 * (p * a * a + 2.0 * c * a * b + v * b * b);
        }
        sum += (estimate.accel_psd * dt * dt).ln() * 2.0;
    }
    sum + prior_cost(&estimate.errors, prior_stds)
}

/// Negative logarithm of the errors' prior, up to a constant of each.
pub fn prior_cost(errors: &[f64], prior_stds: &[f64]) -> f64 {
    errors.iter().zip(prior_stds).map(|(error, std)| 0.5 * (error / std).powi(2) + std.ln()).sum()
}

fn normal(problem: &Problem, model: Model, estimate: &FitParameters, prior_stds: &[f64]) -> Normal {
    let (knots, errors) = (problem.knots_s.len(), estimate.errors.len());
    let mut n = Normal {
        diagonal: vec![Matrix4::zeros(); knots],
        upper: vec![Matrix4::zeros(); knots.saturating_sub(1)],
        border: vec![vec![Vector4::zeros(); errors]; knots],
        corner: DMatrix::zeros(errors, errors),
        rhs: vec![Vector4::zeros(); knots],
        errors_rhs: DVector::zeros(errors),
    };
    for k in 1..knots {
        let dt = problem.knots_s[k] - problem.knots_s[k - 1];
        let e = motion_error(&estimate.states[k - 1], &estimate.states[k], dt);
        let (p, c, v) = motion_weight(dt, estimate.accel_psd);
        for a in 0..2 {
            let b = a + 2;
            let (wp, wv) = (p * e[a] + c * e[b], c * e[a] + v * e[b]);
            n.rhs[k][a] -= wp;
            n.rhs[k][b] -= wv;
            n.rhs[k - 1][a] += wp;
            n.rhs[k - 1][b] += dt * wp + wv;
            let d = &mut n.diagonal[k];
            d[(a, a)] += p;
            d[(a, b)] += c;
            d[(b, a)] += c;
            d[(b, b)] += v;
            let d = &mut n.diagonal[k - 1];
            d[(a, a)] += p;
            d[(a, b)] += dt * p + c;
            d[(b, a)] += dt * p + c;
            d[(b, b)] += dt * dt * p + 2.0 * dt * c + v;
            let u = &mut n.upper[k - 1];
            u[(a, a)] -= p;
            u[(a, b)] -= c;
            u[(b, a)] -= dt * p + c;
            u[(b, b)] -= dt * c + v;
        }
    }
    // A very weak prior, so that no direction is completely free.
    let tiny = Matrix4::from_diagonal_element(1e-8 / (problem.span_m * problem.span_m));
    n.diagonal.iter_mut().for_each(|diagonal| *diagonal += tiny);
    for (index, observation) in problem.observations.iter().enumerate() {
        let (residual_m, distance, unit, scale) = residual(problem, model, estimate, index);
        let sensor = observation.reading.sensor;
        let sigma = estimate.sigmas_m[sensor];
        let weight = student_weight(residual_m / sigma) / (sigma * sigma);
        let slope = slope_of(unit, scale, observation.after_s);
        let weighted = slope * weight;
        let k = observation.knot;
        let slots = [(model.bias_index(sensor), 1.0), (model.scale_index(sensor, problem.sensors), distance)];
        n.rhs[k] += weighted * residual_m;
        n.diagonal[k] += weighted * slope.transpose();
        for (at, by) in slots {
            let Some(at) = at else { continue };
            n.errors_rhs[at] += weight * by * residual_m;
            n.border[k][at] += weighted * by;
            for (other, other_by) in slots {
                if let Some(other) = other {
                    n.corner[(at, other)] += weight * by * other_by;
                }
            }
        }
    }
    for (at, std) in prior_stds.iter().enumerate() {
        n.corner[(at, at)] += 1.0 / (std * std);
        n.errors_rhs[at] -= estimate.errors[at] / (std * std);
    }
    n
}

struct Solved {
    step: Vec<Vector4<f64>>,
    errors_step: DVector<f64>,
    path_log_det: f64,
    errors_log_det: f64,
    inverse_pivots: Vec<Matrix4<f64>>,
    gains: Vec<Vec<Vector4<f64>>>,
    /// Inverse of the errors' covariance, and the covariance.
    schur: DMatrix<f64>,
    covariance: DMatrix<f64>,
}

fn solve(n: &Normal) -> Option<Solved> {
    let (knots, errors) = (n.diagonal.len(), n.corner.nrows());
    let mut path_log_det = 0.0;
    let mut inverse_pivots: Vec<Matrix4<f64>> = Vec::with_capacity(knots);
    // Column 0 is the right-hand side, the rest is the border.
    let mut columns: Vec<Vec<Vector4<f64>>> =
        (0..knots).map(|k| std::iter::once(n.rhs[k]).chain(n.border[k].iter().copied()).collect()).collect();
    for k in 0..knots {
        let mut pivot = n.diagonal[k];
        if k > 0 {
            let upper = &n.upper[k - 1];
            let carried = upper.transpose() * inverse_pivots[k - 1];
            pivot -= carried * upper;
            let (done, rest) = columns.split_at_mut(k);
            for (column, before) in rest[0].iter_mut().zip(&done[k - 1]) {
                *column -= carried * before;
            }
        }
        // Rounding makes the two triangles differ; the upper one is used.
        let factored = Cholesky::new(pivot.transpose())?;
        path_log_det += 2.0 * factored.l_dirty().diagonal().map(f64::ln).sum();
        inverse_pivots.push(factored.inverse().transpose());
    }
    for k in (0..knots).rev() {
        let (now, later) = columns.split_at_mut(k + 1);
        for (at, column) in now[k].iter_mut().enumerate() {
            if let Some(after) = later.first() {
                *column -= n.upper[k] * after[at];
            }
            *column = inverse_pivots[k] * *column;
        }
    }
    let mut schur = n.corner.clone();
    let mut right = n.errors_rhs.clone();
    for k in 0..knots {
        for a in 0..errors {
            right[a] -= dot(&n.border[k][a], &columns[k][0]);
            for b in 0..errors {
                schur[(a, b)] -= dot(&n.border[k][a], &columns[k][b + 1]);
            }
        }
    }
    let factored = Cholesky::new(schur.clone())?;
    let errors_log_det = 2.0 * factored.l_dirty().diagonal().map(f64::ln).sum();
    let (covariance, errors_step) = (factored.inverse(), factored.solve(&right));
    let step = columns
        .iter()
        .map(|columns| {
            let of_errors = columns[1..].iter().zip(errors_step.iter());
            of_errors.fold(columns[0], |step, (gain, by)| step - gain * *by)
        })
        .collect();
    let gains = columns.into_iter().map(|columns| columns[1..].to_vec()).collect();
    Some(Solved { step, errors_step, path_log_det, errors_log_det, inverse_pivots, gains, schur, covariance })
}

/// Improves an estimate until it converges; `None` if a matrix becomes singular, or once `go_on` says no.
pub fn optimise(
    problem: &Problem,
    model: Model,
    estimate: &mut FitParameters,
    go_on: &dyn Fn() -> bool,
) -> Option<Solution> {
    let prior_stds = model.prior_stds(problem.sensors, problem.span_m);
    let mut now = cost(problem, model, estimate, &prior_stds);
    for _ in 0..STEPS_MAX {
        if !go_on() {
            return None;
        }
        let solved = solve(&normal(problem, model, estimate, &prior_stds))?;
        let mut factor = 1.0;
        let mut better = None;
        for _ in 0..6 {
            let mut next = estimate.clone();
            for (state, step) in next.states.iter_mut().zip(&solved.step) {
                *state += step * factor;
            }
            next.errors.iter_mut().zip(solved.errors_step.iter()).for_each(|(error, step)| *error += factor * step);
            let then = cost(problem, model, &next, &prior_stds);
            if then < now {
                better = Some((next, then));
                break;
            }
            factor *= 0.4;
        }
        let Some((next, then)) = better else { break };
        *estimate = next;
        let gained = now - then;
        now = then;
        if gained < 1e-3 {
            break;
        }
    }
    let n = normal(problem, model, estimate, &prior_stds);
    let solved = solve(&n)?;
    let path = path_covariances(&n, &solved);
    let mut residuals_m = Vec::with_capacity(problem.observations.len());
    let mut path_variances_m2 = Vec::with_capacity(problem.observations.len());
    for (index, observation) in problem.observations.iter().enumerate() {
        let (residual_m, distance, unit, scale) = residual(problem, model, estimate, index);
        let slope = slope_of(unit, scale, observation.after_s);
        let mut variance = dot(&slope, &(path[observation.knot] * slope));
        let mut errors_slope: Vec<f64> = solved.gains[observation.knot].iter().map(|gain| -dot(gain, &slope)).collect();
        let sensor = observation.reading.sensor;
        if let Some(at) = model.bias_index(sensor) {
            errors_slope[at] += 1.0;
        }
        if let Some(at) = model.scale_index(sensor, problem.sensors) {
            errors_slope[at] += distance;
        }
        let errors_slope = DVector::from_vec(errors_slope);
        variance += errors_slope.dot(&(&solved.covariance * &errors_slope));
        residuals_m.push(residual_m);
        path_variances_m2.push(variance.max(0.0));
    }
    let priors = prior_stds.iter().map(|std| 1.0 / (std * std));
    let misfit = now - prior_cost(&estimate.errors, &prior_stds) + 0.5 * solved.path_log_det;
    Some(Solution {
        neg_log_evidence: now + 0.5 * (solved.path_log_det + solved.errors_log_det),
        misfit,
        information: solved.schur - DMatrix::from_diagonal(&DVector::from_iterator(prior_stds.len(), priors)),
        residuals_m,
        path_variances_m2,
    })
}

fn path_covariances(n: &Normal, solved: &Solved) -> Vec<Matrix4<f64>> {
    let mut all = solved.inverse_pivots.clone();
    for k in (0..all.len().saturating_sub(1)).rev() {
        let gain = solved.inverse_pivots[k] * n.upper[k];
        let added = gain * all[k + 1] * gain.transpose();
        all[k] += added;
    }
    all
}

/// Each sensor's noise from the residuals, as in the expectation-maximisation step of a Student distribution.
pub fn update_sigmas(problem: &Problem, solution: &Solution, sigmas_m: &mut [f64], least_m: f64) {
    let mut sums = vec![(0.0, 0.0); sigmas_m.len()];
    let residuals = solution.residuals_m.iter().zip(&solution.path_variances_m2);
    for (observation, (residual_m, added)) in problem.observations.iter().zip(residuals) {
        let sensor = observation.reading.sensor;
        let square = residual_m * residual_m + added;
        let weight = student_weight(square.sqrt() / sigmas_m[sensor]);
        sums[sensor].0 += weight * square;
        sums[sensor].1 += 1.0;
    }
    // Half of each variance is that of all sensors. Otherwise two sensors may be given no noise, and determine the
    // complete path alone.
    let all = sums.iter().fold((0.0, 0.0), |all, one| (all.0 + one.0, all.1 + one.1));
    let usual = all.0 / f64::max(all.1, 1.0);
    for (sigma, (sum, count)) in sigmas_m.iter_mut().zip(sums) {
        *sigma = ((sum + (count + 5.0) * usual) / (2.0 * count + 5.0)).sqrt().max(least_m);
    }
}
