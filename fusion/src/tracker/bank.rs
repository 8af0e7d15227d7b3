//! The tracker for no prior: a bank of extended Kalman filters, a Gaussian sum.
//!
//! A range puts the target on a circle. Where an estimate is so wide that the circle bends within it,
//! the likelihood `p(z|X)` is no Gaussian of the position but a sum of Gaussians along the circle, and
//! the product of both is a bank of narrower estimates: the hypotheses. The start from nothing is the
//! widest estimate; one after a long gap, or with a single sensor in reach, differs in degree alone.
//! The ranges weigh the hypotheses, each range being an outlier with some probability; the unlikely
//! are dropped and those that meet are merged, until one is left: an extended Kalman filter with a
//! gate. What no range tells apart, such as the mirror images beside two fixed sensors, stays a bank.

use std::f64::consts::TAU;

use nalgebra::{Cholesky, Matrix2, SMatrix, SVector, Vector2};
use rangehound_shared::motion::{MotionModel, Transition};
use serde::{Deserialize, Serialize};

use super::{Fit, Gate, Reading, Tracker};
use crate::filter::{Estimate, Innovation, RangeInformation};

/// Most hypotheses at a time, a bound on memory and time: two full circles.
const HYPOTHESES_MAX: usize = 128;

/// Most hypotheses on one circle. With 64 the circle bends by 3e-4 of its radius within one of them.
const CIRCLE_MAX: usize = 64;

/// A hypothesis is split where the circle bends by more than this within its standard deviation, in
/// standard deviations of the range. Below, the second-order terms stand in for the bend.
const BEND_MAX: f64 = 1.0;

/// The same bend within a new hypothesis: below [`BEND_MAX`], or it would be split again at once.
const BEND_SPLIT: f64 = 0.5;

/// Spacing of the hypotheses on a circle, in their standard deviations: their sum has a ripple of
/// `2 exp(-2 pi^2 / spacing^2)`, 1.4 %.
const SPACING: f64 = 2.0;

/// Share of the ranges taken to be outliers: that of radio ranges without a line of sight.
const OUTLIER_SHARE: f64 = 0.05;

/// Spread of an outlier beyond that of the hypothesis, in standard deviations of the range. One
/// outlier then costs the right hypothesis a factor of 400, not its life.
const OUTLIER_SPREAD: f64 = 50.0;

/// An update less than `exp` of this likelier than an outlier leaves a copy without it: about 1.8
/// standard deviations off, or a hypothesis so wide that one outlier would move it far.
const BRANCH_LOG_RATIO: f64 = 4.5;

/// Hypotheses of a lower log weight are dropped: two outliers, 12, and some bad luck.
const LOG_WEIGHT_MIN: f64 = -16.0;

/// Hypotheses within this squared Mahalanobis distance are merged: the sum of both has one peak.
const MERGE_SQUARE: f64 = 1.0;

/// The target's velocity at the start is what its noise drives up in this time, s: a manoeuvre's
/// length. A tenfold change of it changes no recording's error by more than 2 %.
const START_S: f64 = 10.0;

/// Least variance of velocity, (m/s)^2, and further derivatives at the start: a walk.
const START_VARIANCE_MIN: f64 = 1.0;

/// Standard deviation of the position before the start's range, in lengths of it: no information.
const START_SPREAD: f64 = 1e3;

/// Standard deviation of the state before the first range, and of the position, m, above which a
/// hypothesis is as good as none.
const UNKNOWN_STD: f64 = 1e6;

/// Least standard deviation of a range, m: keeps its information finite.
const RANGE_STD_MIN_M: f64 = 1e-6;

/// Least ratio of radial to tangential variance on a circle: far above the rounding of a determinant.
const ASPECT_MIN: f64 = 1e-8;

/// Relative inflation of the variances in each step: above their rounding and of no other effect.
const ROUNDING: f64 = 1e-12;

/// Weight of a range in the account of rejections after each later range: a memory of ten ranges.
const REJECTION_DECAY: f64 = 0.9;

/// Rejected share of the ranges, of those remembered, from which on the estimate may be locked out:
/// the mirror image of the target beside two of three sensors makes the third reject.
const REJECTED_SHARE: f64 = 0.3;

/// Rejections that must be remembered as well: two outliers in a row are no lock-out.
const REJECTED_MIN: f64 = 2.0;

/// Successive ranges from places within this share of the range are taken to be of one sensor. Such a
/// run counts once: by itself a bad sensor cannot show a lock-out.
const SAME_SENSOR_SHARE: f64 = 0.05;

/// Weight of a new start beside an estimate that may be locked out: small, the ranges are to decide.
const RESTART_WEIGHT: f64 = 1e-4;

/// A bank of extended Kalman filters that starts from the ranges alone.
#[derive(Debug, Clone)]
pub struct Bank<const N: usize> {
    motion: MotionModel,
    gate: Gate,
    /// The transition of the last step.
    transition: (f64, Transition<N>),
    /// By falling weight, but for merged ones; the weights sum to one. Empty: nothing is known.
    hypotheses: Vec<Hypothesis<N>>,
    /// Mean and covariance of the sum: of all estimates the one of the least mean square error.
    estimate: Estimate<N>,
    rejections: Rejections,
}

/// One Gaussian of the sum.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Hypothesis<const N: usize> {
    log_weight: f64,
    estimate: Estimate<N>,
}

/// The account of rejected ranges, with exponential forgetting.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
struct Rejections {
    ranges: f64,
    rejected: f64,
    /// Where the last range that counted was measured from, m.
    position_m: Vector2<f64>,
}

/// A range as a hypothesis sees it, to second order.
struct Sight {
    innovation: Innovation,
    /// How far the circle bends within the hypothesis's standard deviation, `e_t^T P_11 e_t / (2 d)`, m.
    bend_m: f64,
    /// `S`, m^2.
    variance_m2: f64,
    /// `nu^2 / S`.
    normalised_square: f64,
    /// `ln` of the probability density that the range is an outlier of this value, 1/m.
    log_outlier: f64,
}

/// Gaussians along the circle of a range that sum up to its likelihood.
struct Circle {
    count: usize,
    radius_m: f64,
    radial_variance_m2: f64,
    tangential_variance_m2: f64,
    /// From one centre to the next, m.
    arc_m: f64,
}

impl<const N: usize> Bank<N> {
    /// A bank that knows nothing of the target.
    #[must_use]
    pub fn new(motion: MotionModel, gate: Gate) -> Self {
        let transition = (0.0, motion.transition(0.0));
        let hypotheses = Vec::with_capacity(HYPOTHESES_MAX);
        Self { motion, gate, transition, hypotheses, estimate: unknown(), rejections: Rejections::default() }
    }

    fn predict(&mut self, dt_s: f64) {
        if self.transition.0 != dt_s {
            self.transition = (dt_s, self.motion.transition(dt_s));
        }
        let transition = &self.transition.1;
        self.hypotheses.retain_mut(|hypothesis| {
            hypothesis.estimate = hypothesis.estimate.predict(transition);
            let spread_m2 = hypothesis.estimate.position_covariance().trace();
            make_sound(&mut hypothesis.estimate) && spread_m2 < UNKNOWN_STD * UNKNOWN_STD
        });
    }

    /// Weighs all hypotheses by a range and updates, branches or splits them.
    fn fuse(&mut self, reading: &Reading, fit: &mut Fit) {
        if self.hypotheses.is_empty() {
            self.start(reading, 1.0);
            fit.fused += 1;
            return;
        }
        let mut nis = None;
        let mut passed_weight = 0.0;
        for index in 0..self.hypotheses.len() {
            let Hypothesis { log_weight, estimate } = self.hypotheses[index];
            let sight = Sight::of(&estimate, reading);
            if self.gate.passes(sight.normalised_square) {
                nis = nis.or(Some(sight.normalised_square));
                passed_weight += log_weight.exp();
                self.apply(index, reading, &sight);
            } else {
                self.hypotheses[index].log_weight += sight.log_outlier;
            }
        }
        self.reduce();
        let passed = passed_weight > 0.5;
        if passed {
            fit.fused += 1;
            fit.nis += nis.unwrap_or_default();
        } else {
            fit.rejected += 1;
        }
        self.rejections.add(reading, !passed);
        if self.rejections.show_lock_out() {
            self.start(reading, RESTART_WEIGHT);
        }
    }

    /// Multiplies a hypothesis by `p(z|X) + p(outlier)`, as far as either term weighs anything.
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
        let (mut updated, _) = estimate.update(&information);
        let hypothesis = &mut self.hypotheses[index];
        hypothesis.log_weight += log_likelihood.max(sight.log_outlier);
        if make_sound(&mut updated) {
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
            // Both ways round from the side of the estimate.
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
            let (mut child, _) = estimate.update(&information);
            if let Some(root) = Cholesky::new(covariance)
                && make_sound(&mut child)
            {
                let square = offset_m.dot(&root.solve(&offset_m));
                let log_likelihood = circle.arc_m.ln() - 0.5 * (square + root.ln_determinant()) - TAU.ln();
                self.hypotheses.push(Hypothesis { log_weight: log_weight + log_likelihood, estimate: child });
            }
        }
    }

    /// Makes the weights sum to one, drops the unlikely, merges the near.
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

    /// Merges into a hypothesis the lighter ones near it.
    fn merge_into(&mut self, heavy: usize) {
        let Estimate { x, p } = self.hypotheses[heavy].estimate;
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

impl<const N: usize> Tracker for Bank<N> {
    fn step(&mut self, dt_s: f64, readings: &[Reading]) -> Fit {
        self.predict(dt_s);
        let mut fit = Fit::default();
        for reading in readings {
            let range_std_m = reading.range_std_m.max(RANGE_STD_MIN_M);
            self.fuse(&Reading { range_std_m, ..*reading }, &mut fit);
        }
        self.estimate = match &self.hypotheses[..] {
            [] => unknown(),
            [only] => only.estimate,
            several => mixture(several),
        };
        fit
    }

    fn state(&self) -> &[f64] {
        self.estimate.x.as_slice()
    }

    fn covariance(&self) -> &[f64] {
        self.estimate.p.as_slice()
    }

    fn predicted_position(&self, dt_s: f64) -> (Vector2<f64>, Matrix2<f64>) {
        // The model is linear: mean and covariance of the sum predict like those of one Gaussian.
        let predicted = if self.transition.0 == dt_s {
            self.estimate.predict(&self.transition.1)
        } else {
            self.estimate.predict(&self.motion.transition(dt_s))
        };
        (predicted.position(), predicted.position_covariance())
    }
}

impl Sight {
    /// With the second-order terms of `d(X)`: mean `d + bend`, variance `2 bend^2`.
    fn of<const N: usize>(estimate: &Estimate<N>, reading: &Reading) -> Self {
        let Reading { position_m, range_m, range_std_m } = *reading;
        let mut innovation = estimate.innovation(position_m, range_m, range_std_m);
        let covariance = estimate.position_covariance();
        let e = innovation.line_of_sight;
        let across_m2 = (covariance.trace() - e.dot(&(covariance * e))).max(0.0);
        let distance_m = (estimate.position() - position_m).norm().min(range_m);
        // A distance changes by no more than the position does.
        let bend_m = (across_m2 / (2.0 * distance_m)).min(across_m2.sqrt());
        innovation.innovation_m -= bend_m;
        innovation.noise_variance_m2 += 2.0 * bend_m * bend_m;
        let variance_m2 = innovation.variance_m2(&covariance);
        let normalised_square = innovation.normalised_square(&covariance);
        // A range well within a wide estimate has the density r / across, less than 1 / sqrt(S).
        let spread_m = OUTLIER_SPREAD * range_std_m + (TAU * variance_m2).sqrt() + across_m2 / range_m.max(range_std_m);
        let log_outlier = (OUTLIER_SHARE / spread_m).ln();
        Self { innovation, bend_m, variance_m2, normalised_square, log_outlier }
    }
}

impl Circle {
    fn of(reading: &Reading) -> Self {
        let Reading { range_m, range_std_m, .. } = *reading;
        let variance_m2 = range_std_m * range_std_m;
        if range_m < range_std_m {
            // Smaller than its own noise: one Gaussian about the sensor.
            let variance_m2 = variance_m2 + 0.5 * range_m * range_m;
            let (radial_variance_m2, tangential_variance_m2) = (variance_m2, variance_m2);
            let arc_m = TAU * range_std_m;
            return Self { count: 1, radius_m: 0.0, radial_variance_m2, tangential_variance_m2, arc_m };
        }
        let spacing_m = SPACING * (2.0 * range_m * range_std_m * BEND_SPLIT).sqrt();
        let count = ((TAU * range_m / spacing_m).ceil() as usize).clamp(1, CIRCLE_MAX);
        let arc_m = TAU * range_m / count as f64;
        let tangential_variance_m2 = (arc_m / SPACING) * (arc_m / SPACING);
        let bend_m = tangential_variance_m2 / (2.0 * range_m);
        let radial_variance_m2 = (variance_m2 + bend_m * bend_m).max(ASPECT_MIN * tangential_variance_m2);
        Self { count, radius_m: range_m, radial_variance_m2, tangential_variance_m2, arc_m }
    }
}

impl Rejections {
    fn add(&mut self, reading: &Reading, rejected: bool) {
        let moved_m = (reading.position_m - self.position_m).norm();
        if self.ranges > 0.0 && moved_m <= SAME_SENSOR_SHARE * reading.range_m {
            return;
        }
        self.position_m = reading.position_m;
        self.ranges = REJECTION_DECAY * self.ranges + 1.0;
        self.rejected = REJECTION_DECAY * self.rejected + f64::from(u8::from(rejected));
    }

    fn show_lock_out(&self) -> bool {
        self.rejected > REJECTED_MIN.max(REJECTED_SHARE * self.ranges)
    }
}

fn unknown<const N: usize>() -> Estimate<N> {
    Estimate { x: SVector::zeros(), p: SMatrix::identity() * (UNKNOWN_STD * UNKNOWN_STD) }
}

/// Lifts the covariance clear of rounding. False if it is not positive definite or not all is finite.
fn make_sound<const N: usize>(estimate: &mut Estimate<N>) -> bool {
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
fn mixture<const N: usize>(hypotheses: &[Hypothesis<N>]) -> Estimate<N> {
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
    Estimate { x, p }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const STD_M: f64 = 0.2;
    const SQUARE: [[f64; 2]; 4] = [[0.0, 0.0], [20.0, 0.0], [20.0, 20.0], [0.0, 20.0]];

    fn bank() -> Bank<4> {
        Bank::new(MotionModel::IntegratorChain { order: 2, noise_psd: 0.2 }, Gate::new(Some(4.0)))
    }

    /// Steps through one range each 0.1 s, of the sensors in turn, with a noise of 1.7 sigma at most.
    struct Run {
        bank: Bank<4>,
        count: u32,
        rejected: u32,
    }

    impl Run {
        fn new() -> Self {
            Self { bank: bank(), count: 0, rejected: 0 }
        }

        /// Returns the position error and its standard deviation, m.
        fn range(&mut self, dt_s: f64, sensor: [f64; 2], target: [f64; 2], error_m: f64) -> (f64, f64) {
            self.count += 1;
            let noise_m = STD_M * 1.7 * (f64::from(self.count) * 2.399).sin();
            let (position_m, target) = (Vector2::from(sensor), Vector2::from(target));
            let range_m = (target - position_m).norm() + noise_m + error_m;
            self.rejected += self.bank.step(dt_s, &[Reading { position_m, range_m, range_std_m: STD_M }]).rejected;
            let estimate = &self.bank.estimate;
            ((estimate.position() - target).norm(), estimate.position_covariance().trace().sqrt())
        }

        /// `seconds` of ranges from the square's corners to a still target, each tenth `outlier_m` too long.
        fn square(&mut self, seconds: usize, target: [f64; 2], outlier_m: f64) -> (f64, f64) {
            let mut last = (0.0, 0.0);
            for k in 0..seconds * 10 {
                let outlier_m = if k % 10 == 0 { outlier_m } else { 0.0 };
                last = self.range(0.1, SQUARE[k % 4], target, outlier_m);
            }
            last
        }
    }

    #[test]
    fn it_starts_from_the_ranges_of_fixed_sensors_alone() {
        let mut run = Run::new();
        assert_eq!((run.bank.state(), run.bank.covariance()[0]), (&[0.0; 4][..], 1e12));
        let (error_m, std_m) = run.square(3, [16.0, 3.0], 0.0);
        assert!(error_m < 0.4 && std_m < 0.6, "{error_m} {std_m}");
        assert!(run.bank.hypotheses.len() == 1 && run.rejected < 4);
    }

    #[test]
    fn two_fixed_sensors_leave_both_mirror_images() {
        let mut run = Run::new();
        for k in 0..600 {
            let (error_m, std_m) = run.range(0.1, SQUARE[k % 2], [8.0, 6.0], 0.0);
            assert!(error_m < 3.0 * std_m, "{k}: {error_m} {std_m}");
        }
        let sides = |sign: f64| run.bank.hypotheses.iter().any(|h| (h.estimate.x[1] * sign - 6.0).abs() < 1.0);
        assert!(sides(1.0) && sides(-1.0));
    }

    #[test]
    fn two_moving_sensors_resolve_the_mirror_image() {
        let mut run = Run::new();
        let mut last = (0.0, 0.0);
        for k in 0..600 {
            let t = f64::from(k) * 0.1;
            let (sin, cos) = (0.3 * t).sin_cos();
            let sensor = if k % 2 == 0 { [5.0 * cos, 5.0 * sin] } else { [10.0, -0.4 * t] };
            last = run.range(0.1, sensor, [4.0 + 0.2 * t, 9.0], 0.0);
        }
        assert!(last.0 < 0.5 && last.1 < 1.0, "{last:?}");
    }

    #[test]
    fn outliers_are_rejected_the_very_first_range_included() {
        let mut run = Run::new();
        let (error_m, std_m) = run.square(30, [16.0, 3.0], 8.0);
        assert!(error_m < 0.4 && std_m < 0.6, "{error_m} {std_m}");
        assert!((25..40).contains(&run.rejected), "{}", run.rejected);
    }

    #[test]
    fn it_leaves_the_lock_out_after_a_jump() {
        let mut run = Run::new();
        run.square(10, [16.0, 3.0], 0.0);
        let (error_m, std_m) = run.square(4, [-40.0, 70.0], 0.0);
        assert!(error_m < 1.0 && std_m < 2.0, "{error_m} {std_m}");
    }

    #[test]
    fn one_bad_sensor_is_no_lock_out() {
        let mut run = Run::new();
        run.square(5, [16.0, 3.0], 0.0);
        for _ in 0..30 {
            let (error_m, std_m) = run.range(0.01, SQUARE[0], [16.0, 3.0], 15.0);
            assert!(error_m < 0.6 && std_m < 1.0, "{error_m} {std_m}");
        }
    }

    #[test]
    fn it_recovers_after_a_long_gap() {
        let mut run = Run::new();
        run.square(10, [16.0, 3.0], 0.0);
        run.range(97.0, SQUARE[2], [5.0, 12.0], 0.0);
        let (error_m, std_m) = run.square(3, [5.0, 12.0], 0.0);
        assert!(error_m < 0.4 && std_m < 0.6, "{error_m} {std_m}");
    }

    fn hostile(order: usize, steps: &[(f64, f64, f64, f64, f64)]) -> Result<(), TestCaseError> {
        let motion = MotionModel::IntegratorChain { order, noise_psd: 0.2 };
        match order {
            1 => survives(Bank::<2>::new(motion, Gate::new(Some(4.0))), steps),
            2 => survives(Bank::<4>::new(motion, Gate::new(None)), steps),
            _ => survives(Bank::<6>::new(motion, Gate::new(Some(3.0))), steps),
        }
    }

    fn survives<const N: usize>(mut bank: Bank<N>, steps: &[(f64, f64, f64, f64, f64)]) -> Result<(), TestCaseError> {
        for &(dt_s, x, y, range_m, range_std_m) in steps {
            // Every fifth or so stands right on the estimate.
            let position_m = if x > 0.6e8 { bank.estimate.position() } else { Vector2::new(x, y) };
            bank.step(dt_s, &[Reading { position_m, range_m, range_std_m }]);
            prop_assert!(bank.state().iter().all(|value| value.is_finite()));
            prop_assert_eq!(bank.estimate.p, bank.estimate.p.transpose());
            prop_assert!(Cholesky::new(bank.estimate.p).is_some(), "{}", bank.estimate.p);
            prop_assert!(bank.hypotheses.capacity() == HYPOTHESES_MAX);
            let total: f64 = bank.hypotheses.iter().map(|h| h.log_weight.exp()).sum();
            prop_assert!((total - 1.0).abs() < 1e-4);
        }
        Ok(())
    }

    fn wild(low: i32, high: i32) -> impl Strategy<Value = f64> {
        prop_oneof![1 => Just(0.0), 8 => (f64::from(low)..f64::from(high)).prop_map(|e| 10.0_f64.powf(e))]
    }

    fn coordinate() -> impl Strategy<Value = f64> {
        prop_oneof![4 => -30.0..30.0_f64, 1 => -1e8..1e8_f64]
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 16, rng_seed: proptest::test_runner::RngSeed::Fixed(1), ..ProptestConfig::default() })]
        #[test]
        fn the_covariance_stays_positive_definite_through_anything(
            order in 1_usize..=3,
            steps in proptest::collection::vec((wild(-6, 6), coordinate(), coordinate(), wild(-4, 6), wild(-4, 5)), 1..24),
        ) {
            hostile(order, &steps)?;
        }
    }
}
