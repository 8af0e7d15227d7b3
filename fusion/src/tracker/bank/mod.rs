//! The tracker without a prior: a bank of extended Kalman filters, a Gaussian sum.
//!
//! A range puts the target on a circle. If an estimate is so wide that the circle bends within it, the likelihood
//! `p(z|X)` is not a Gaussian of the position but a sum of Gaussians along the circle. The product of the two is a bank
//! of narrower estimates: the hypotheses. The start is the widest estimate; an estimate after a long gap, or with a
//! single sensor in reach, differs only in degree. The ranges weight the hypotheses; each range is an outlier with some
//! probability. Unlikely hypotheses are dropped and close ones are merged, until one is left: an extended Kalman filter
//! with a gate. The bank keeps hypotheses that the ranges cannot distinguish, such as the mirror images beside two
//! fixed sensors.

mod circle;
mod rejections;
mod sight;

use std::borrow::Cow;
use std::f64::consts::TAU;

use nalgebra::{Cholesky, SMatrix, SVector, Vector2};
use rangehound_shared::motion::{MotionModel, Transition};
use rangehound_shared::record::{Judged, RangeUse};
use serde::{Deserialize, Serialize};

use super::{Fit, Gate, Reading, judged_room, use_of};
use crate::filter::{Gaussian, Innovation, RangeInformation};
use circle::{CIRCLE_MAX, Circle};
use rejections::Rejections;
use sight::Sight;

/// Most hypotheses at a time, a bound on memory and time: two full circles.
const HYPOTHESES_MAX: usize = 128;

/// A hypothesis is split if the circle bends by more than this within its standard deviation, in standard deviations of
/// the range. Below, the second-order terms account for the bend.
const BEND_MAX: f64 = 1.0;

/// If an update is less than `exp` of this more likely than an outlier, a copy of the hypothesis without the update is
/// kept. That is the case for a range about 1.8 standard deviations off, or for a hypothesis so wide that one outlier
/// would move it far.
const BRANCH_LOG_RATIO: f64 = 4.5;

/// Hypotheses of a lower log weight are dropped. Two outliers cost 12; the rest is margin.
const LOG_WEIGHT_MIN: f64 = -16.0;

/// Hypotheses within this squared Mahalanobis distance are merged: the sum of both has one peak.
const MERGE_SQUARE: f64 = 1.0;

/// The variance of the target's velocity at the start is what its process noise adds in this time, s: the length of a
/// manoeuvre. A tenfold change of it changes no recording's error by more than 2 %.
const START_S: f64 = 10.0;

/// Least variance of velocity, (m/s)^2, and further derivatives at the start: walking speed.
const START_VARIANCE_MIN: f64 = 1.0;

/// Standard deviation of the position before the start's range, in multiples of that range: no information.
const START_SPREAD: f64 = 1e3;

/// Standard deviation of the state before the first range. Hypotheses with a wider position, m, are dropped.
const UNKNOWN_STD: f64 = 1e6;

/// Least standard deviation of a range, m: keeps its information finite.
const RANGE_STD_MIN_M: f64 = 1e-6;

/// Relative inflation of the variances in each step. It exceeds their rounding and has no other effect.
const ROUNDING: f64 = 1e-12;

/// Weight of a new start beside an estimate that may be locked out: small, so that the ranges decide.
const RESTART_WEIGHT: f64 = 1e-4;

/// A bank of extended Kalman filters that starts without a prior.
#[derive(Debug, Clone)]
pub struct Bank<const N: usize> {
    motion: MotionModel,
    gate: Gate,
    /// The transition of the last step.
    transition: (f64, Transition<N>),
    /// Sorted by falling weight, except merged ones. The weights sum to one. Empty without an estimate.
    hypotheses: Vec<Hypothesis<N>>,
    /// Mean and covariance of the sum: the estimate with the least mean square error.
    estimate: Gaussian<N>,
    rejections: Rejections,
    /// `ln p(z)` of the last step's ranges given all before.
    log_likelihood: f64,
    /// How the last step used its readings, in their order.
    judged: Vec<Judged>,
}

/// One Gaussian of the sum.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Hypothesis<const N: usize> {
    pub(super) log_weight: f64,
    pub(super) estimate: Gaussian<N>,
}

/// State for [`Bank::restore`]: borrowed for writing, owned after reading.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct SavedBank<'a, const N: usize> {
    hypotheses: Cow<'a, [Hypothesis<N>]>,
    estimate: Gaussian<N>,
    rejections: Rejections,
    log_likelihood: f64,
}

impl<const N: usize> Bank<N> {
    /// Starts from this estimate.
    pub(super) fn begin_with(&mut self, estimate: Gaussian<N>) {
        self.hypotheses.clear();
        self.hypotheses.push(Hypothesis { log_weight: 0.0, estimate });
        self.estimate = estimate;
    }

    /// State from which [`Self::restore`] continues.
    pub(super) fn saved(&self) -> SavedBank<'_, N> {
        let Self { ref hypotheses, estimate, rejections, log_likelihood, .. } = *self;
        SavedBank { hypotheses: Cow::Borrowed(hypotheses), estimate, rejections, log_likelihood }
    }

    /// Continues from the saved state of a bank of the same scenario.
    pub(super) fn restore(&mut self, restored: SavedBank<'_, N>) {
        let SavedBank { hypotheses, estimate, rejections, log_likelihood } = restored;
        // Reuses the memory, so that steps allocate nothing.
        self.hypotheses.clear();
        self.hypotheses.extend(hypotheses.iter().take(HYPOTHESES_MAX));
        self.estimate = estimate;
        self.rejections = rejections;
        self.log_likelihood = log_likelihood;
    }

    /// A bank without an estimate.
    #[must_use]
    pub fn new(motion: MotionModel, gate: Gate) -> Self {
        let transition = (0.0, motion.transition(0.0));
        let hypotheses = Vec::with_capacity(HYPOTHESES_MAX);
        Self {
            motion,
            gate,
            transition,
            hypotheses,
            estimate: unknown(),
            rejections: Rejections::default(),
            log_likelihood: 0.0,
            judged: judged_room(),
        }
    }

    /// Predicts over `dt_s` seconds, then updates with the readings, taken in order.
    pub fn step(&mut self, dt_s: f64, readings: &[Reading]) -> Fit {
        self.predict(dt_s);
        self.log_likelihood = 0.0;
        self.judged.clear();
        let mut fit = Fit::default();
        for reading in readings {
            let reading = Reading { range_std_m: reading.range_std_m.max(RANGE_STD_MIN_M), ..*reading };
            if reading.distrusted {
                self.test(&reading, &mut fit);
            } else {
                self.fuse(&reading, &mut fit);
            }
        }
        self.estimate = match &self.hypotheses[..] {
            [] => unknown(),
            [only] => only.estimate,
            several => mixture(several),
        };
        fit
    }

    /// How the last step used its readings, in their order.
    pub(super) fn judged(&self) -> &[Judged] {
        &self.judged
    }

    /// Records how a reading is used, with its normalised innovation squared for the heaviest hypothesis whose gate it
    /// passed, or else for the heaviest of all.
    fn judge(&mut self, reading: &Reading, passed: bool, normalised_square: Option<f64>, fit: &mut Fit) {
        let used = use_of(reading, passed);
        // Without a gate every range passes, but it may still count as a failure.
        let is_failure = normalised_square.is_some_and(|square| self.gate.fails(square));
        fit.failed.set(reading.robot, !passed || is_failure);
        if used == RangeUse::Fused {
            fit.fused += 1;
        } else {
            fit.rejected += 1;
        }
        if let Some(square) = normalised_square {
            fit.nis_all += square;
            fit.tested += 1;
        }
        self.judged.push(Judged { used, normalised_square });
    }

    /// The hypothesis, if there is only one.
    pub(super) fn settled(&mut self) -> Option<&mut Gaussian<N>> {
        match &mut self.hypotheses[..] {
            [only] => Some(&mut only.estimate),
            _ => None,
        }
    }

    /// Mean and covariance of the sum.
    pub(super) fn estimate(&self) -> &Gaussian<N> {
        &self.estimate
    }

    /// `ln p(z)` of the last step's ranges given all before, for the comparison of models.
    pub(super) fn log_likelihood(&self) -> f64 {
        self.log_likelihood
    }

    fn predict(&mut self, dt_s: f64) {
        if self.transition.0 != dt_s {
            self.transition = (dt_s, self.motion.transition(dt_s));
        }
        let transition = &self.transition.1;
        self.hypotheses.retain_mut(|hypothesis| {
            hypothesis.estimate = hypothesis.estimate.predict(transition);
            let spread_m2 = hypothesis.estimate.position_covariance().trace();
            make_valid(&mut hypothesis.estimate) && spread_m2 < UNKNOWN_STD * UNKNOWN_STD
        });
    }

    /// Tests a range against the gate. Without a hypothesis it passes.
    fn test(&mut self, reading: &Reading, fit: &mut Fit) {
        let (mut first, mut passing, mut passed_weight) = (None, None, 0.0);
        for hypothesis in &self.hypotheses {
            let square = Sight::of(&hypothesis.estimate, reading).normalised_square;
            first = first.or(Some(square));
            if self.gate.passes(square) {
                passing = passing.or(Some(square));
                passed_weight += hypothesis.log_weight.exp();
            }
        }
        let passed = self.hypotheses.is_empty() || passed_weight > 0.5;
        self.judge(reading, passed, if passed { passing } else { first }, fit);
    }

    /// Weights all hypotheses by a range, and updates, branches or splits them.
    fn fuse(&mut self, reading: &Reading, fit: &mut Fit) {
        if self.hypotheses.is_empty() {
            self.start(reading, 1.0);
            self.judge(reading, true, None, fit);
            return;
        }
        let (mut first, mut passing) = (None, None);
        let mut passed_weight = 0.0;
        for index in 0..self.hypotheses.len() {
            let Hypothesis { log_weight, estimate } = self.hypotheses[index];
            let sight = Sight::of(&estimate, reading);
            first = first.or(Some(sight.normalised_square));
            if self.gate.passes(sight.normalised_square) {
                passing = passing.or(Some(sight.normalised_square));
                passed_weight += log_weight.exp();
                self.apply(index, reading, &sight);
            } else {
                self.hypotheses[index].log_weight += sight.log_outlier;
            }
        }
        self.log_likelihood += log_sum(&self.hypotheses);
        self.reduce();
        let passed = passed_weight > 0.5;
        if passed {
            fit.nis += passing.unwrap_or_default();
        }
        self.judge(reading, passed, if passed { passing } else { first }, fit);
        self.rejections.add(reading, !passed);
        if self.rejections.show_lock_out() {
            self.start(reading, RESTART_WEIGHT);
        }
    }

    /// Multiplies a hypothesis by `p(z|X) + p(outlier)`; a negligible term is left out.
    fn apply(&mut self, index: usize, reading: &Reading, sight: &Sight) {
        let Hypothesis { log_weight, estimate } = self.hypotheses[index];
        let room = self.hypotheses.len() < HYPOTHESES_MAX;
        if room && sight.bend_m > BEND_MAX * reading.range_std_m {
            self.split(index, reading);
            self.hypotheses[index].log_weight += sight.log_outlier;
            return;
        }
        let log_likelihood = -0.5 * (sight.normalised_square + (TAU * sight.variance_m2).ln());
        if room && log_likelihood < sight.log_outlier + BRANCH_LOG_RATIO {
            self.hypotheses.push(Hypothesis { log_weight: log_weight + sight.log_outlier, estimate });
        }
        let mut information = RangeInformation::default();
        information.add(&sight.innovation);
        let mut updated = estimate.update(&information);
        let hypothesis = &mut self.hypotheses[index];
        hypothesis.log_weight += log_likelihood.max(sight.log_outlier);
        if make_valid(&mut updated) {
            hypothesis.estimate = updated;
        }
    }

    /// Adds hypotheses all around the circle of a range, of this total weight.
    fn start(&mut self, reading: &Reading, weight: f64) {
        self.rejections = Rejections::default();
        self.hypotheses.truncate(HYPOTHESES_MAX - CIRCLE_MAX - 1);
        let first = self.hypotheses.len();
        let from_rest = self.motion.transition::<N>(START_S).process_noise;
        let spread_m = START_SPREAD * reading.range_m.max(reading.range_std_m);
        let mut estimate = unknown();
        for i in 0..N {
            let derivative_variance = from_rest[(i, i)].max(START_VARIANCE_MIN);
            estimate.p[(i, i)] = if i < 2 { spread_m * spread_m } else { derivative_variance };
        }
        estimate.x[0] = reading.position_m.x;
        estimate.x[1] = reading.position_m.y;
        self.hypotheses.push(Hypothesis { log_weight: 0.0, estimate });
        self.split(first, reading);
        self.hypotheses[first].log_weight = f64::NEG_INFINITY;
        let total = log_sum(&self.hypotheses[first..]);
        for hypothesis in &mut self.hypotheses[first..] {
            hypothesis.log_weight += weight.ln() - total;
        }
        self.reduce();
    }

    /// Adds the products of a hypothesis with the Gaussians of a range's circle,
    /// `p(z|X) = arc sum_k N(X_1; c_k, C_k)`: updates with positions `c_k`, as far as there is room.
    fn split(&mut self, index: usize, reading: &Reading) {
        let Hypothesis { log_weight, estimate } = self.hypotheses[index];
        let circle = Circle::of(reading);
        let sight = estimate.position() - reading.position_m;
        let towards_rad = sight.y.atan2(sight.x);
        for k in 0..circle.count.min(HYPOTHESES_MAX - self.hypotheses.len()) {
            // Alternately both ways round, from the side of the estimate.
            let turn = if k % 2 == 0 { k / 2 } else { circle.count - k.div_ceil(2) };
            let (sin, cos) = (towards_rad + TAU * turn as f64 / circle.count as f64).sin_cos();
            let (radial, tangential) = (Vector2::new(cos, sin), Vector2::new(-sin, cos));
            let offset_m = reading.position_m + radial * circle.radius_m - estimate.position();
            let mut covariance = estimate.position_covariance();
            let mut information = RangeInformation::default();
            for (line_of_sight, noise_variance_m2) in
                [(radial, circle.radial_variance_m2), (tangential, circle.tangential_variance_m2)]
            {
                let innovation_m = line_of_sight.dot(&offset_m);
                information.add(&Innovation { line_of_sight, innovation_m, noise_variance_m2 });
                covariance += line_of_sight * line_of_sight.transpose() * noise_variance_m2;
            }
            let mut child = estimate.update(&information);
            if let Some(root) = Cholesky::new(covariance)
                && make_valid(&mut child)
            {
                let square = offset_m.dot(&root.solve(&offset_m));
                let log_likelihood = circle.arc_m.ln() - 0.5 * (square + root.ln_determinant()) - TAU.ln();
                self.hypotheses.push(Hypothesis { log_weight: log_weight + log_likelihood, estimate: child });
            }
        }
    }

    /// Normalises the weights, drops unlikely hypotheses, and merges close ones.
    fn reduce(&mut self) {
        if let [only] = &mut self.hypotheses[..] {
            only.log_weight = 0.0;
            return;
        }
        let total = log_sum(&self.hypotheses);
        self.hypotheses.retain_mut(|hypothesis| {
            hypothesis.log_weight -= total;
            hypothesis.log_weight > LOG_WEIGHT_MIN
        });
        self.hypotheses.sort_unstable_by(|a, b| b.log_weight.total_cmp(&a.log_weight));
        let mut heavy = 0;
        while heavy < self.hypotheses.len() {
            self.merge_into(heavy);
            heavy += 1;
        }
    }

    /// Merges lighter hypotheses into a close heavier one.
    fn merge_into(&mut self, heavy: usize) {
        let Gaussian { x, p } = self.hypotheses[heavy].estimate;
        let Some(root) = Cholesky::new(p) else { return };
        let mut light = heavy + 1;
        while light < self.hypotheses.len() {
            let apart = self.hypotheses[light].estimate.x - x;
            if apart.dot(&root.solve(&apart)) < MERGE_SQUARE {
                let pair = [self.hypotheses[heavy], self.hypotheses.remove(light)];
                self.hypotheses[heavy] = Hypothesis { log_weight: log_sum(&pair), estimate: mixture(&pair) };
            } else {
                light += 1;
            }
        }
    }
}

fn unknown<const N: usize>() -> Gaussian<N> {
    Gaussian { x: SVector::zeros(), p: SMatrix::identity() * (UNKNOWN_STD * UNKNOWN_STD) }
}

/// Inflates the covariance against rounding. False if it is not positive definite, or if a value is not finite.
fn make_valid<const N: usize>(estimate: &mut Gaussian<N>) -> bool {
    inflate(&mut estimate.p);
    let finite = estimate.x.iter().chain(estimate.p.iter()).all(|value| value.is_finite());
    finite && Cholesky::new(estimate.p).is_some()
}

fn inflate<const N: usize>(p: &mut SMatrix<f64, N, N>) {
    for i in 0..N {
        p[(i, i)] *= 1.0 + ROUNDING;
    }
}

/// `ln sum w`.
fn log_sum<const N: usize>(hypotheses: &[Hypothesis<N>]) -> f64 {
    let max = hypotheses.iter().map(|hypothesis| hypothesis.log_weight).fold(f64::MIN, f64::max);
    max + hypotheses.iter().map(|hypothesis| (hypothesis.log_weight - max).exp()).sum::<f64>().ln()
}

/// Mean and covariance of a Gaussian sum.
pub(super) fn mixture<const N: usize>(hypotheses: &[Hypothesis<N>]) -> Gaussian<N> {
    let total = log_sum(hypotheses);
    let weighted = || hypotheses.iter().map(|h| ((h.log_weight - total).exp(), &h.estimate));
    let mut x = SVector::zeros();
    for (weight, estimate) in weighted() {
        x += estimate.x * weight;
    }
    let mut p = SMatrix::zeros();
    for (weight, estimate) in weighted() {
        let apart = estimate.x - x;
        p += (estimate.p + apart * apart.transpose()) * weight;
    }
    p = (p + p.transpose()) * 0.5;
    inflate(&mut p);
    Gaussian { x, p }
}

#[cfg(test)]
mod tests;
