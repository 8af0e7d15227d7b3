//! Anchors under a ceiling measure slant ranges. A filter that knows their height is consistent, also straight beneath
//! an anchor, where a range has almost no information about the position in the plane.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on should panic")]

use nalgebra::{SMatrix, SVector, Vector2};
use rangehound_fusion::filter::Gaussian;
use rangehound_fusion::nuisance::Chain;
use rangehound_fusion::tracker::imm::Imm;
use rangehound_fusion::tracker::kalman::Kalman;
use rangehound_fusion::tracker::{Gate, Reading, Tracker};
use rangehound_shared::draws::{Draws, Stream};
use rangehound_shared::measurement::Pose;
use rangehound_shared::motion::MotionModel;
use rangehound_shared::motion::matrix::square_root;
use rangehound_shared::scenario::{NuisanceSpec, Treatment};

const DT_S: f64 = 0.1;
const STD_M: f64 = 0.1;
const NOISE_PSD: f64 = 0.05;
const HEIGHT_M: f64 = 4.0;
const ANCHORS_M: [[f64; 2]; 4] = [[0.0, 0.0], [10.0, 0.0], [10.0, 8.0], [0.0, 8.0]];

/// Consistency of a filter, summed over simulated walks.
#[derive(Debug, Default, Clone, Copy)]
struct Consistency {
    nees: f64,
    nis: f64,
    ticks: f64,
    ranges: f64,
    squared_error_m2: f64,
    squared_end_error_m2: f64,
}

impl Consistency {
    fn anees(&self) -> f64 {
        self.nees / (2.0 * self.ticks)
    }

    fn nis_mean(&self) -> f64 {
        self.nis / self.ranges
    }

    fn rmse_m(&self) -> f64 {
        (self.squared_error_m2 / self.ticks).sqrt()
    }
}

fn motion() -> MotionModel {
    MotionModel::IntegratorChain { order: 2, noise_psd: NOISE_PSD }
}

/// A target that moves as the model says, with a range from each of these anchors at each tick. Adds the figures of the
/// ticks from `settled` on.
fn walk(
    tracker: &mut dyn Tracker,
    seed: u64,
    start: [f64; 4],
    anchors_m: &[[f64; 2]],
    assumed_height_m: f64,
    settled: u64,
    sum: &mut Consistency,
) {
    let transition = motion().transition::<4>(DT_S);
    let root = square_root(&transition.process_noise);
    let mut x = SVector::from(start);
    let [mut moves, mut noises] = [0, 1].map(|robot| Draws::new(seed, Stream::RangeNoise { robot }));
    for tick in 1..=300 {
        let mut drawn = [0.0; 4];
        moves.standard_normal(tick, &mut drawn);
        x = transition.phi * x + root * SVector::from(drawn);
        let target_m = Vector2::new(x[0], x[1]);
        let mut noise = [0.0; 4];
        noises.standard_normal(tick, &mut noise);
        let readings: Vec<Reading> = anchors_m
            .iter()
            .enumerate()
            .map(|(robot, anchor_m)| {
                let pose = Pose { height_m: assumed_height_m, ..Pose::at(*anchor_m) };
                let value = (target_m - pose.position_m()).norm().hypot(HEIGHT_M) + STD_M * noise[robot];
                Reading { robot, pose, value, std: STD_M, ..Reading::default() }
            })
            .collect();
        let fit = tracker.step(if tick == 1 { 0.0 } else { DT_S }, &readings);
        if tick < settled {
            continue;
        }
        let error_m = Vector2::new(tracker.state()[0], tracker.state()[1]) - target_m;
        let p = SMatrix::<f64, 4, 4>::from_column_slice(tracker.covariance()).fixed_view::<2, 2>(0, 0).into_owned();
        sum.nees += error_m.dot(&(p.try_inverse().unwrap() * error_m));
        sum.nis += fit.nis_all;
        sum.ticks += 1.0;
        sum.ranges += f64::from(fit.tested);
        sum.squared_error_m2 += error_m.norm_squared();
        sum.squared_end_error_m2 = error_m.norm_squared();
    }
}

/// Sensors without nuisances.
fn exact() -> Chain {
    Chain::of(vec![NuisanceSpec::default(); ANCHORS_M.len()], Treatment::Schmidt)
}

/// A filter that starts from the truth with an error of the stated covariance.
fn kalman(seed: u64, start: [f64; 4], variance_m2: f64) -> Kalman<4> {
    let mut drawn = [0.0; 4];
    Draws::new(seed, Stream::PriorMean).standard_normal(0, &mut drawn);
    let variances = SVector::from([variance_m2, variance_m2, 0.1, 0.1]);
    let x = SVector::from_fn(|i, _| start[i] + variances[i].sqrt() * drawn[i]);
    let prior = Gaussian { x, p: SMatrix::from_diagonal(&variances) };
    Kalman::new(motion(), prior, Gate::new(None), exact())
}

fn over_seeds(seeds: u64, mut one: impl FnMut(u64, &mut Consistency)) -> Consistency {
    let mut sum = Consistency::default();
    (1..=seeds).for_each(|seed| one(seed, &mut sum));
    sum
}

#[test]
fn trilateration_from_anchors_four_metres_above_is_consistent() {
    let start = [3.0, 3.0, 0.3, 0.1];
    let with = |assumed_m: f64| {
        over_seeds(40, |seed, sum| walk(&mut kalman(seed, start, 1.0), seed, start, &ANCHORS_M, assumed_m, 1, sum))
    };
    let elevated = with(HEIGHT_M);
    assert!((0.85..1.15).contains(&elevated.anees()) && (0.95..1.05).contains(&elevated.nis_mean()), "{elevated:?}");
    // The same anchors, assumed to be in the plane.
    let in_plane = with(0.0);
    assert!(in_plane.anees() > 10.0 && in_plane.rmse_m() > 3.0 * elevated.rmse_m(), "{in_plane:?}");
}

#[test]
fn the_first_ranges_determine_the_position_beneath_the_anchors() {
    let start = [3.0, 3.0, 0.3, 0.1];
    let sum = over_seeds(20, |seed, sum| {
        let mut imm = Imm::<4>::new(&motion(), Gate::new(Some(4.0)), exact());
        walk(&mut imm, seed, start, &ANCHORS_M, HEIGHT_M, 20, sum);
    });
    // The calm model beside the true one makes it a little too sure.
    assert!((0.7..1.5).contains(&sum.anees()) && sum.rmse_m() < 0.25, "{sum:?}");
}

/// At rest straight beneath the only anchor: its ranges show that the target is near, and no more.
#[test]
fn a_target_straight_beneath_an_anchor_is_not_known_better_than_that() {
    let start = [0.0, 0.0, 0.0, 0.0];
    for seed in 1..=20 {
        let mut sum = Consistency::default();
        let mut imm = Imm::<4>::new(&motion(), Gate::new(Some(4.0)), exact());
        walk(&mut imm, seed, start, &ANCHORS_M[..1], HEIGHT_M, 1, &mut Consistency::default());
        let mut early = Imm::<4>::new(&motion(), Gate::new(Some(4.0)), exact());
        let pose = Pose { height_m: HEIGHT_M, ..Pose::default() };
        let readings = [Reading { pose, value: HEIGHT_M, std: STD_M, ..Reading::default() }];
        early.step(0.0, &readings);
        // A range as long as the height: the place is the foot, give or take sqrt(2 h sigma).
        let spread_m = early.covariance()[0].sqrt();
        assert!((0.4..1.0).contains(&spread_m) && early.state()[..2].iter().all(|x| x.abs() < 1e-9), "{spread_m}");
        // One that is shorter than the height is noise.
        for range_m in [HEIGHT_M - STD_M, HEIGHT_M - 4.0 * STD_M, 0.1] {
            let mut short = Imm::<4>::new(&motion(), Gate::new(Some(4.0)), exact());
            short.step(0.0, &[Reading { value: range_m, ..readings[0] }]);
            let short_m = short.covariance()[0].sqrt();
            assert!(short_m > 0.1 && short_m < spread_m, "{range_m}: {short_m}");
        }
        // From there with all anchors: they determine the position.
        let mut all = Imm::<4>::new(&motion(), Gate::new(Some(4.0)), exact());
        walk(&mut all, seed, start, &ANCHORS_M, HEIGHT_M, 250, &mut sum);
        assert!(sum.rmse_m() < 0.4, "{seed}: {sum:?}");
    }
}

#[test]
fn a_target_that_starts_beneath_an_anchor_is_followed_consistently() {
    let start = [0.0, 0.0, 0.3, 0.2];
    let sum =
        over_seeds(40, |seed, sum| walk(&mut kalman(seed, start, 1.0), seed, start, &ANCHORS_M, HEIGHT_M, 1, sum));
    assert!((0.85..1.2).contains(&sum.anees()) && (0.9..1.1).contains(&sum.nis_mean()), "{sum:?}");
    let from_ranges = over_seeds(20, |seed, sum| {
        let mut imm = Imm::<4>::new(&motion(), Gate::new(Some(4.0)), exact());
        walk(&mut imm, seed, start, &ANCHORS_M, HEIGHT_M, 20, sum);
    });
    assert!((0.7..1.6).contains(&from_ranges.anees()) && from_ranges.rmse_m() < 0.3, "{from_ranges:?}");
}

/// Straight beneath the anchor the distance has no slope: the range is predicted and tested, and has no information
/// about the plane.
#[test]
fn the_information_of_a_range_falls_to_nothing_straight_beneath_the_anchor() {
    let informs = |away_m: f64| {
        let mean = [away_m, 0.0, 0.0, 0.0];
        let prior = Gaussian { x: SVector::from(mean), p: SMatrix::identity() * 0.01 };
        let mut kalman = Kalman::<4>::new(motion(), prior, Gate::new(None), exact());
        let range_m = away_m.hypot(HEIGHT_M);
        let pose = Pose { height_m: HEIGHT_M, ..Pose::default() };
        let reading = Reading { pose, value: range_m, std: STD_M, ..Reading::default() };
        kalman.step(0.0, &[reading]);
        kalman.covariance()[0].recip() - 100.0
    };
    // The most, far away, is 1 / sigma^2.
    let elevated = [0.0, 0.4, 2.0, 40.0].map(informs);
    assert!(
        elevated[0].abs() < 1e-6 && elevated.is_sorted() && (0.9..1.0).contains(&(elevated[1] / 0.99)),
        "{elevated:?}"
    );
    assert!((elevated[3] / 100.0 - 1.0).abs() < 0.02, "{elevated:?}");
}
