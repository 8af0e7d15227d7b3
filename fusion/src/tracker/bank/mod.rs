//! The tracker without a prior: a bank of extended Kalman filters, a Gaussian sum.
//!
//! A range puts the target on a circle, a bearing on a ray. If an estimate is so wide that the circle bends within it, the likelihood
//! `p(z|X)` is not a Gaussian of the position but a sum of Gaussians along the circle, and likewise along the ray. The product of the two is a bank
//! of narrower estimates: the hypotheses. The start is the widest estimate; an estimate after a long gap, or with a
//! single sensor in reach, differs only in degree. The ranges weight the hypotheses; each range is an outlier with some
//! probability. Unlikely hypotheses are dropped and close ones are merged, until one is left: an extended Kalman filter
//! with a gate. The bank keeps hypotheses that the ranges cannot distinguish, such as the mirror images beside two
//! fixed sensors.

mod circle;
mod ray;
mod rejections;
mod sight;

use std::borrow::Cow;
use std::f64::consts::TAU;

use nalgebra::{Cholesky, SMatrix, SVector, Vector2};
use rangehound_shared::angle::wrapped_rad;
use rangehound_shared::measurement::Kind;
use rangehound_shared::motion::{MotionModel, Transition};
use rangehound_shared::record::{FusionDecision, GateResult};
use rangehound_shared::sealed::{self, SealError};
use serde::{Deserialize, Serialize};

use super::{Fit, Gate, Reading, Tracker, judged_room, use_of};
use crate::belief::Belief;
use crate::filter::{Gaussian, Information, Innovation};
use crate::nuisance::{Chain, Estimate, Known, Whitened};
use circle::{CIRCLE_MAX, Circle};
use ray::Ray;
use rejections::Rejections;
use sight::Sight;

/// Most hypotheses at a time, a bound on memory and time: two full circles.
const HYPOTHESES_MAX: usize = 128;

/// A hypothesis is split if the circle bends by more than this within its standard deviation, in standard deviations of
/// the range. Below, the second-order terms account for the bend.
const BEND_MAX: f64 = 1.0;

/// The same for a long run of one or two robots, where many ranges from about one place would make a coarser bank too sure
/// of itself. A recording has outliers, and needs the room for them instead.
const BEND_MAX_FINE: f64 = 0.3;

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

/// Reach of a bearing before the start, m, in the place of a range.
const START_BEARING_M: f64 = 1e3;

/// A ray is split up to this many standard deviations of the hypothesis from it.
const RAY_SIGMA: f64 = 4.0;

/// Standard deviation of the state before the first range. Hypotheses with a wider position, m, are dropped.
const UNKNOWN_STD: f64 = 1e6;

/// Least standard deviation of a measurement, m or rad: keeps its information finite.
const STD_MIN: f64 = 1e-6;

/// Relative inflation of the variances in each step. It exceeds their rounding and has no other effect.
const ROUNDING: f64 = 1e-12;

/// Share of the measurements taken to be outliers: that of radio ranges without a line of sight. Without a gate the user
/// knows that there are none, and only a numerical floor is left.
const OUTLIER_SHARE: f64 = 0.05;
const NO_OUTLIER_SHARE: f64 = 1e-9;

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
    judged: Vec<GateResult>,
    chain: Chain,
    outlier_share: f64,
    bend_max: f64,
    scratch: Vec<Whitened<N>>,
}

/// One Gaussian of the sum.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Hypothesis<const N: usize> {
    pub(super) log_weight: f64,
    pub(super) estimate: Estimate<N>,
}

/// One Gaussian of a measurement's likelihood over the plane.
struct Piece {
    centre_m: Vector2<f64>,
    /// Direction from the sensor.
    along: Vector2<f64>,
    along_variance_m2: f64,
    across_variance_m2: f64,
    /// Integral of the likelihood over it, per unit of the measurement.
    integral: f64,
}

/// The Gaussians of a measurement's likelihood.
enum Pieces {
    Circle(Circle),
    Ray(Ray),
}

/// State for [`Bank::restore`]: borrowed for writing, owned after reading.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct SavedBank<'a, const N: usize> {
    hypotheses: Cow<'a, [Hypothesis<N>]>,
    estimate: Gaussian<N>,
    rejections: Rejections,
    log_likelihood: f64,
    nuisances: Cow<'a, [Known]>,
}

impl<const N: usize> Bank<N> {
    /// The same bank, started from this estimate.
    #[must_use]
    pub(super) fn starting_from(mut self, estimate: Gaussian<N>) -> Self {
        self.hypotheses.clear();
        self.hypotheses.push(Hypothesis { log_weight: 0.0, estimate: Estimate::new(estimate, &self.chain) });
        self.estimate = estimate;
        self
    }

    /// The same bank with finer hypotheses.
    #[must_use]
    pub(super) fn finely(self) -> Self {
        Self { bend_max: BEND_MAX_FINE, ..self }
    }

    /// State from which [`Self::restore`] continues.
    pub(super) fn saved(&self) -> SavedBank<'_, N> {
        let Self { ref hypotheses, estimate, rejections, log_likelihood, .. } = *self;
        let nuisances = Cow::Borrowed(self.chain.saved());
        SavedBank { hypotheses: Cow::Borrowed(hypotheses), estimate, rejections, log_likelihood, nuisances }
    }

    /// Continues from the saved state of a bank of the same scenario.
    ///
    /// # Errors
    /// If it is not such a state.
    pub(super) fn restore(&mut self, restored: SavedBank<'_, N>) -> Result<(), SealError> {
        let SavedBank { hypotheses, estimate, rejections, log_likelihood, nuisances } = restored;
        let robots = self.chain.robots();
        if !hypotheses.iter().all(|hypothesis| hypothesis.estimate.is_of_team(robots))
            || !self.chain.restore(&nuisances)
        {
            return Err(SealError::Malformed);
        }
        // Reuses the memory, so that steps allocate nothing.
        self.hypotheses.clear();
        self.hypotheses.extend(hypotheses.iter().take(HYPOTHESES_MAX).cloned());
        self.estimate = estimate;
        self.rejections = rejections;
        self.log_likelihood = log_likelihood;
        Ok(())
    }

    /// A bank without an estimate.
    #[must_use]
    pub fn new(motion: MotionModel, gate: Gate, chain: Chain) -> Self {
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
            chain,
            outlier_share: if gate.is_open() { NO_OUTLIER_SHARE } else { OUTLIER_SHARE },
            bend_max: BEND_MAX,
            scratch: Vec::new(),
        }
    }

    /// Predicts over `dt_s` seconds, then updates with the readings, taken in order.
    pub fn advance(&mut self, dt_s: f64, readings: &[Reading]) -> Fit {
        self.predict(dt_s);
        self.log_likelihood = 0.0;
        self.judged.clear();
        let mut fit = Fit::default();
        let mut heard = None;
        for reading in readings {
            if heard != Some(reading.robot) {
                heard = Some(reading.robot);
                self.hear(reading);
            }
            let reading = Reading { std: reading.std.max(STD_MIN), ..*reading };
            if reading.distrusted {
                self.test(&reading, &mut fit);
            } else {
                self.fuse(&reading, &mut fit);
            }
        }
        self.estimate = match &self.hypotheses[..] {
            [] => unknown(),
            [only] => only.estimate.target,
            several => mixture(several),
        };
        fit
    }

    /// Records how a reading is used, with its normalised innovation squared for the heaviest hypothesis whose gate it
    /// passed, or else for the heaviest of all.
    fn judge(&mut self, reading: &Reading, passed: bool, normalised_square: Option<f64>, fit: &mut Fit) {
        let used = use_of(reading, passed);
        // Without a gate every range passes, but it may still count as a failure.
        let is_failure = normalised_square.is_some_and(|square| self.gate.fails(square));
        fit.failed[reading.kind as usize].set(reading.robot, !passed || is_failure);
        if used == FusionDecision::Fused {
            fit.fused += 1;
        } else {
            fit.rejected += 1;
        }
        if let Some(square) = normalised_square {
            fit.nis_all += square;
            fit.tested += 1;
        }
        self.judged.push(GateResult { used, normalised_square });
    }

    /// The hypothesis, if there is only one.
    pub(super) fn settled(&mut self) -> Option<&mut Estimate<N>> {
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
            hypothesis.estimate.predict(transition);
            let spread_m2 = hypothesis.estimate.target.position_covariance().trace();
            make_valid(&mut hypothesis.estimate.target) && spread_m2 < UNKNOWN_STD * UNKNOWN_STD
        });
        self.chain.advance(dt_s);
    }

    /// Takes the nuisances that a robot reports with its pose.
    fn hear(&mut self, reading: &Reading) {
        let Some(change) = self.chain.hear(reading.robot, &reading.pose) else { return };
        for hypothesis in &mut self.hypotheses {
            hypothesis.estimate.follow(&self.chain);
            hypothesis.estimate.change(reading.robot, &change);
        }
    }

    /// Tests a range against the gate. Without a hypothesis it passes.
    fn test(&mut self, reading: &Reading, fit: &mut Fit) {
        let (mut first, mut passing, mut passed_weight) = (None, None, 0.0);
        for hypothesis in &self.hypotheses {
            let square = Sight::of(&hypothesis.estimate, reading, &self.chain, self.outlier_share).normalised_square;
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
        let (mut first, mut passing, mut distance_m) = (None, None, None);
        let mut passed_weight = 0.0;
        for index in 0..self.hypotheses.len() {
            let Hypothesis { log_weight, estimate } = &self.hypotheses[index];
            let log_weight = *log_weight;
            let sight = Sight::of(estimate, reading, &self.chain, self.outlier_share);
            distance_m = distance_m.or(Some(sight.distance_m));
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
        let distance_m = match reading.kind {
            Kind::Range => reading.value,
            Kind::Bearing => distance_m.unwrap_or(0.0),
        };
        self.rejections.add(reading, distance_m, !passed);
        if self.rejections.show_lock_out() {
            self.start(reading, RESTART_WEIGHT);
        }
    }

    /// Multiplies a hypothesis by `p(z|X) + p(outlier)`; a negligible term is left out.
    fn apply(&mut self, index: usize, reading: &Reading, sight: &Sight) {
        let room = self.hypotheses.len() < HYPOTHESES_MAX;
        if sight.is_bent(reading, self.bend_max) {
            // Without room it only loses weight, as if the measurement were an outlier.
            self.split(index, reading, sight, sight.own_std, false);
            self.branch(index, reading, sight);
            return;
        }
        let log_likelihood = -0.5 * (sight.normalised_square + (TAU * sight.variance).ln());
        if room && log_likelihood < sight.log_outlier + BRANCH_LOG_RATIO {
            self.hypotheses.push(self.hypotheses[index].clone());
            self.branch(self.hypotheses.len() - 1, reading, sight);
        }
        let hypothesis = &mut self.hypotheses[index];
        hypothesis.log_weight += log_likelihood.max(sight.log_outlier);
        // Nearly all updates are valid, and without nuisances this copy allocates nothing.
        let mut updated = hypothesis.estimate.clone();
        updated.update(std::iter::once(&sight.row), &self.chain, &mut self.scratch);
        if make_valid(&mut updated.target) {
            hypothesis.estimate = updated;
        }
    }

    /// Multiplies a hypothesis by `p(outlier)`. An outlier tells a hypothesis nothing that is narrower than outliers are; a
    /// wider one is split or updated with the noise of an outlier.
    fn branch(&mut self, index: usize, reading: &Reading, sight: &Sight) {
        let before = self.hypotheses.len();
        if let Some(std) = sight.wide_outlier_std(reading) {
            self.split(index, reading, sight, std, false);
        }
        let (older, parts) = self.hypotheses.split_at_mut(before);
        let log_share = self.outlier_share.ln();
        parts.iter_mut().for_each(|part| part.log_weight += log_share);
        // Its parts are in its place.
        older[index].log_weight += if parts.is_empty() { sight.log_outlier } else { f64::NEG_INFINITY };
    }

    /// Adds hypotheses all around the circle of a range or along the ray of a bearing, of this total weight.
    fn start(&mut self, reading: &Reading, weight: f64) {
        self.rejections = Rejections::default();
        self.hypotheses.truncate(HYPOTHESES_MAX - CIRCLE_MAX - 1);
        let first = self.hypotheses.len();
        let from_rest = self.motion.transition::<N>(START_S).process_noise;
        let reach_m = match reading.kind {
            Kind::Range => reading.value.max(reading.std),
            Kind::Bearing => START_BEARING_M,
        };
        let spread_m = START_SPREAD * reach_m;
        let mut estimate = unknown();
        for i in 0..N {
            let derivative_variance = from_rest[(i, i)].max(START_VARIANCE_MIN);
            estimate.p[(i, i)] = if i < 2 { spread_m * spread_m } else { derivative_variance };
        }
        estimate.x[0] = reading.pose.x_m;
        estimate.x[1] = reading.pose.y_m;
        let estimate = Estimate::new(estimate, &self.chain);
        let sight = Sight::of(&estimate, reading, &self.chain, self.outlier_share);
        self.hypotheses.push(Hypothesis { log_weight: 0.0, estimate });
        self.split(first, reading, &sight, sight.own_std, true);
        self.hypotheses[first].log_weight = f64::NEG_INFINITY;
        let total = log_sum(&self.hypotheses[first..]);
        for hypothesis in &mut self.hypotheses[first..] {
            hypothesis.log_weight += weight.ln() - total;
        }
        self.reduce();
    }

    /// Adds the products of a hypothesis with the Gaussians of a measurement's likelihood over the plane,
    /// `p(z|X) = sum_k w_k N(X_1; c_k, C_k)`: updates with positions `c_k`, as far as there is room.
    /// `std` is the standard deviation of the measurement, m or rad.
    fn split(&mut self, index: usize, reading: &Reading, sight: &Sight, std: f64, is_start: bool) {
        let Hypothesis { log_weight, estimate } = self.hypotheses[index].clone();
        let from_sensor = estimate.target.position() - sight.row.sensor_m;
        let towards_rad = from_sensor.y.atan2(from_sensor.x);
        let pieces = Pieces::of(reading, sight, (std, self.bend_max), &estimate.target, is_start);
        for k in 0..pieces.count().min(HYPOTHESES_MAX - self.hypotheses.len()) {
            let piece = pieces.piece(sight.row.sensor_m, towards_rad, k);
            let across = Vector2::new(-piece.along.y, piece.along.x);
            let offset_m = piece.centre_m - estimate.target.position();
            let mut covariance = estimate.target.position_covariance();
            let mut information = Information::default();
            for (gradient, noise_variance) in
                [(piece.along, piece.along_variance_m2), (across, piece.across_variance_m2)]
            {
                let innovation = gradient.dot(&offset_m);
                information.add(&Innovation { gradient, innovation, noise_variance });
                covariance += gradient * gradient.transpose() * noise_variance;
            }
            let mut child = estimate.clone();
            child.update_with(&information);
            if let Some(root) = Cholesky::new(covariance)
                && make_valid(&mut child.target)
            {
                let square = offset_m.dot(&root.solve(&offset_m));
                let mut log_likelihood = piece.integral.ln() - 0.5 * (square + root.ln_determinant()) - TAU.ln();
                if is_start {
                    log_likelihood += pieces.per_area(k).ln();
                }
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
        let Gaussian { x, p } = self.hypotheses[heavy].estimate.target;
        let Some(root) = Cholesky::new(p) else { return };
        let mut light = heavy + 1;
        while light < self.hypotheses.len() {
            let apart = self.hypotheses[light].estimate.target.x - x;
            if apart.dot(&root.solve(&apart)) < MERGE_SQUARE {
                let lighter = self.hypotheses.remove(light);
                let heavier = &mut self.hypotheses[heavy];
                let pair = [heavier.clone(), lighter];
                heavier.log_weight = log_sum(&pair);
                merge(&mut heavier.estimate, &pair);
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
fn mixture<const N: usize>(hypotheses: &[Hypothesis<N>]) -> Gaussian<N> {
    let total = log_sum(hypotheses);
    mixture_of(|| hypotheses.iter().map(move |h| ((h.log_weight - total).exp(), &h.estimate.target)))
}

/// Mean and covariance of weighted Gaussians.
pub(super) fn mixture_of<'a, const N: usize, I: Iterator<Item = (f64, &'a Gaussian<N>)>>(
    weighted: impl Fn() -> I,
) -> Gaussian<N> {
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

/// Sets an estimate to the sum of two.
pub(super) fn merge<const N: usize>(into: &mut Estimate<N>, pair: &[Hypothesis<N>; 2]) {
    let total = log_sum(pair);
    let weights = [0, 1].map(|i| (pair[i].log_weight - total).exp());
    into.set_mixture(mixture(pair), &[(weights[0], &pair[0].estimate), (weights[1], &pair[1].estimate)]);
}

impl Pieces {
    fn of<const N: usize>(
        reading: &Reading,
        sight: &Sight,
        (std, bend_max): (f64, f64),
        target: &Gaussian<N>,
        is_start: bool,
    ) -> Self {
        match reading.kind {
            Kind::Range => Self::Circle(Circle::of(reading.value, std, reading.pose.height_m, bend_max)),
            Kind::Bearing => {
                let bearing_rad = wrapped_rad(reading.value + reading.pose.heading_rad);
                if is_start {
                    return Self::Ray(Ray::whole(bearing_rad, std));
                }
                let reach_m = RAY_SIGMA * target.position_covariance().trace().sqrt();
                let limits_m = (sight.distance_m - reach_m, sight.distance_m + reach_m);
                Self::Ray(Ray::of(bearing_rad, std, limits_m))
            }
        }
    }

    fn count(&self) -> usize {
        match self {
            Self::Circle(circle) => circle.count,
            Self::Ray(ray) => ray.count,
        }
    }

    fn piece(&self, sensor_m: Vector2<f64>, towards_rad: f64, index: usize) -> Piece {
        match self {
            Self::Circle(circle) => circle.piece(sensor_m, towards_rad, index),
            Self::Ray(ray) => ray.piece(sensor_m, index),
        }
    }

    fn per_area(&self, index: usize) -> f64 {
        match self {
            Self::Circle(_) => 1.0,
            Self::Ray(ray) => ray.per_area(index),
        }
    }
}

impl<const N: usize> Tracker for Bank<N> {
    fn step(&mut self, dt_s: f64, readings: &[Reading]) -> Fit {
        self.advance(dt_s, readings)
    }

    fn judged(&self) -> &[GateResult] {
        &self.judged
    }

    fn widen(&mut self, _factor: f64) {
        // It recovers by itself when rejections show a lock-out.
    }

    fn state(&self) -> &[f64] {
        self.estimate.x.as_slice()
    }

    fn covariance(&self) -> &[f64] {
        self.estimate.p.as_slice()
    }

    fn save(&self, bytes: &mut Vec<u8>) -> Result<(), SealError> {
        sealed::encode_into(&self.saved(), bytes)
    }

    fn restore(&mut self, bytes: &[u8]) -> Result<(), SealError> {
        Self::restore(self, sealed::decode(bytes)?)
    }

    fn predict_into(&self, dt_s: f64, belief: &mut Belief) {
        // The mean of mirror images is a place where the target is not: a plan needs the most likely one.
        let most_likely = self.hypotheses.iter().max_by(|a, b| a.log_weight.total_cmp(&b.log_weight));
        let estimate = most_likely.map_or(&self.estimate, |hypothesis| &hypothesis.estimate.target);
        belief.assign(&estimate.predict(&self.motion.transition(dt_s)));
    }
}

#[cfg(test)]
mod tests;
