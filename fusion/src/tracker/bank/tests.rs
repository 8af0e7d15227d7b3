//! The bank on simulated ranges, and through hostile ones.

use proptest::prelude::*;

use rangehound_shared::measurement::Pose;
use rangehound_shared::scenario::{NuisanceSpec, PoseCorrelation, Treatment};

use super::*;

const STD_M: f64 = 0.2;
const SQUARE: [[f64; 2]; 4] = [[0.0, 0.0], [20.0, 0.0], [20.0, 20.0], [0.0, 20.0]];

/// The nuisances of a team that has none.
fn exact(robots: usize) -> Chain {
    Chain::of(vec![NuisanceSpec::default(); robots], Treatment::Schmidt)
}

fn bank() -> Bank<4> {
    Bank::new(MotionModel::IntegratorChain { order: 2, noise_psd: 0.2 }, Gate::new(Some(4.0)), exact(8))
}

fn range_from(position_m: Vector2<f64>, range_m: f64, std_m: f64) -> Reading {
    let pose = Pose::at([position_m.x, position_m.y]);
    Reading { pose, value: range_m, std: std_m, ..Reading::default() }
}

/// Feeds a bank with single ranges that have a noise of 1.7 sigma at most.
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
        self.rejected += self.bank.step(dt_s, &[range_from(position_m, range_m, STD_M)]).rejected;
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
    assert_eq!((run.bank.estimate().x, run.bank.estimate().p[(0, 0)]), (SVector::zeros(), 1e12));
    let (error_m, std_m) = run.square(3, [16.0, 3.0], 0.0);
    assert!(error_m < 0.4 && std_m < 0.6, "{error_m} {std_m}");
    assert!(run.bank.hypotheses.len() == 1 && run.rejected < 4);
}

#[test]
fn the_range_of_a_distrusted_robot_is_tested_and_moves_nothing() {
    let mut run = Run::new();
    run.square(3, [16.0, 3.0], 0.0);
    for (error_m, fails) in [(0.0, false), (3.0, true)] {
        let (mut tested, mut untouched) = (run.bank.clone(), run.bank.clone());
        let range_m = 16.0_f64.hypot(3.0) + error_m;
        let reading = Reading { robot: 7, value: range_m, std: STD_M, distrusted: true, ..Reading::default() };
        let fit = tested.step(0.1, &[reading]);
        assert_eq!((fit.fused, fit.rejected, fit.failed[0].contains(7)), (0, 1, fails));
        untouched.step(0.1, &[]);
        assert_eq!((tested.hypotheses, tested.estimate), (untouched.hypotheses, untouched.estimate));
    }
    let fit = bank().step(0.1, &[Reading { value: 5.0, std: STD_M, distrusted: true, ..Reading::default() }]);
    assert_eq!((fit.fused, fit.failed[0].is_empty()), (0, true), "without a hypothesis nothing fails");
}

#[test]
fn two_fixed_sensors_leave_both_mirror_images() {
    let mut run = Run::new();
    for k in 0..600 {
        let (error_m, std_m) = run.range(0.1, SQUARE[k % 2], [8.0, 6.0], 0.0);
        assert!(error_m < 3.0 * std_m, "{k}: {error_m} {std_m}");
    }
    let sides = |sign: f64| run.bank.hypotheses.iter().any(|h| (h.estimate.target.x[1] * sign - 6.0).abs() < 1.0);
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
fn it_recovers_from_a_lock_out_after_a_jump() {
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
        1 => survives(Bank::<2>::new(motion, Gate::new(Some(4.0)), exact(1)), steps),
        2 => survives(Bank::<4>::new(motion, Gate::new(None), exact(1)), steps),
        _ => survives(Bank::<6>::new(motion, Gate::new(Some(3.0)), exact(1)), steps),
    }
}

fn survives<const N: usize>(mut bank: Bank<N>, steps: &[(f64, f64, f64, f64, f64)]) -> Result<(), TestCaseError> {
    for &(dt_s, x, y, range_m, range_std_m) in steps {
        // Some sensors are exactly at the estimated position.
        let position_m = if x > 0.6e8 { bank.estimate.position() } else { Vector2::new(x, y) };
        bank.step(dt_s, &[range_from(position_m, range_m, range_std_m)]);
        prop_assert!(bank.estimate().x.iter().all(|value| value.is_finite()));
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

/// A camera with ranges: after a gap in which the target may have gone anywhere, one range and one bearing locate it.
#[test]
fn one_range_and_one_bearing_locate_the_target_after_a_long_gap() {
    let motion = MotionModel::IntegratorChain { order: 2, noise_psd: 0.5 };
    let mut bank = Bank::<4>::new(motion, Gate::new(Some(4.0)), exact(2));
    let sees = |robot: usize, at: [f64; 2], target: [f64; 2]| {
        let (x, y) = (target[0] - at[0], target[1] - at[1]);
        let range = Reading { robot, pose: Pose::at(at), value: x.hypot(y), std: 0.09, ..Reading::default() };
        [range, Reading { kind: Kind::Bearing, value: y.atan2(x), std: 0.006, ..range }]
    };
    for _ in 0..40 {
        bank.advance(0.25, &sees(0, [0.0, 0.0], [2.0, 1.0]));
    }
    assert!((bank.estimate().position() - Vector2::new(2.0, 1.0)).norm() < 0.05);
    bank.advance(77.0, &sees(1, [5.0, 3.0], [3.5, 3.5]));
    let error_m = (bank.estimate().position() - Vector2::new(3.5, 3.5)).norm();
    assert!(error_m < 0.1, "{error_m}");
}

/// A range alone leaves a circle and a bearing alone a ray. The other one, from another place, cuts it to a point or two.
#[test]
fn a_range_and_a_bearing_start_an_estimate_in_either_order() {
    let target = Vector2::new(12.0, 5.0);
    let ranging = |error_m: f64| Reading {
        robot: 0,
        pose: Pose::at([0.0, 0.0]),
        value: target.norm() + error_m,
        std: 0.1,
        ..Reading::default()
    };
    let camera = |error_rad: f64| {
        let pose = Pose::at([10.0, -8.0]);
        let sight = target - pose.position_m();
        let value = sight.y.atan2(sight.x) + error_rad;
        Reading { robot: 1, kind: Kind::Bearing, pose, value, std: 0.02, ..Reading::default() }
    };
    for first in [Kind::Range, Kind::Bearing] {
        let motion = MotionModel::IntegratorChain { order: 2, noise_psd: 0.2 };
        let mut bank = Bank::<4>::new(motion, Gate::new(Some(4.0)), exact(2));
        let mut readings = [ranging(0.05), camera(-0.01)];
        if first == Kind::Bearing {
            readings.reverse();
        }
        bank.advance(0.0, &readings[..1]);
        assert!(bank.hypotheses.len() > 10, "{first:?}: {}", bank.hypotheses.len());
        let std_m = bank.estimate().position_covariance().trace().sqrt();
        assert!(std_m > 3.0, "{first:?} alone leaves the place open: {std_m}");
        bank.advance(0.1, &readings[1..]);
        for k in 0..20 {
            let error = (f64::from(k) * 2.399).sin();
            bank.advance(0.1, &[ranging(0.1 * error), camera(-0.02 * error)]);
        }
        let error_m = (bank.estimate().position() - target).norm();
        assert!(error_m < 0.5 && bank.hypotheses.len() < 4, "{first:?}: {error_m} {}", bank.hypotheses.len());
    }
}

/// Robots that believe a wrong place, new at each measurement or the same all the time, start a consistent estimate.
#[test]
fn uncertain_robots_start_a_consistent_estimate() {
    use rand::SeedableRng;
    const POSE_STD_M: f64 = 0.5;
    for correlation in [PoseCorrelation::White, PoseCorrelation::Time(30.0)] {
        let spec = NuisanceSpec { pose_std_m: POSE_STD_M, correlation, ..NuisanceSpec::default() };
        let (runs, mut nees) = (300, 0.0);
        for seed in 0..runs {
            let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
            // The sum of twelve uniform numbers is nearly normal.
            let mut normal = || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
            let motion = MotionModel::IntegratorChain { order: 2, noise_psd: 0.2 };
            let chain = Chain::of(vec![spec; 4], Treatment::Schmidt);
            let mut bank = Bank::<4>::new(motion, Gate::new(Some(4.0)), chain);
            let target = Vector2::new(10.0 + 2.0 * normal(), 10.0 + 2.0 * normal());
            let persistent = [(); 4].map(|()| Vector2::new(POSE_STD_M * normal(), POSE_STD_M * normal()));
            for k in 0..20_usize {
                let robot = k % 4;
                let fresh = Vector2::new(POSE_STD_M * normal(), POSE_STD_M * normal());
                let error = if correlation == PoseCorrelation::White { fresh } else { persistent[robot] };
                let believed = Vector2::from(SQUARE[robot]) + error;
                let range_m = (target - Vector2::from(SQUARE[robot])).norm() + STD_M * normal();
                let variance_m2 = POSE_STD_M * POSE_STD_M;
                let pose = Pose { covariance_m2: [variance_m2, 0.0, variance_m2], ..Pose::at(believed.into()) };
                let reading = Reading { robot, pose, value: range_m, std: STD_M, ..Reading::default() };
                bank.advance(0.05, &[reading]);
            }
            let error_m = bank.estimate().position() - target;
            let covariance_m2 = bank.estimate().position_covariance();
            nees += error_m.dot(&(covariance_m2.try_inverse().unwrap() * error_m));
        }
        let anees = nees / runs as f64 / 2.0;
        assert!((0.7..1.3).contains(&anees), "{correlation:?}: {anees}");
    }
}

/// Two bearings from different places cross; one alone leaves a ray.
#[test]
fn two_bearings_start_an_estimate_where_they_cross() {
    let mut bank =
        Bank::<4>::new(MotionModel::IntegratorChain { order: 2, noise_psd: 0.2 }, Gate::new(Some(4.0)), exact(2));
    let target = Vector2::new(12.0, 5.0);
    let sees = |robot: usize, at: [f64; 2], error_rad: f64| {
        let sight = target - Vector2::from(at);
        let value = sight.y.atan2(sight.x) + error_rad;
        Reading { robot, kind: Kind::Bearing, pose: Pose::at(at), value, std: 0.02, ..Reading::default() }
    };
    bank.advance(0.0, &[sees(0, [0.0, 0.0], 0.005)]);
    assert!(bank.hypotheses.len() > 10);
    for k in 0..20 {
        let error_rad = 0.02 * (f64::from(k) * 2.399).sin();
        bank.advance(0.1, &[sees(0, [0.0, 0.0], error_rad), sees(1, [10.0, -8.0], -error_rad)]);
    }
    let error_m = (bank.estimate().position() - target).norm();
    assert!(error_m < 0.5 && bank.hypotheses.len() < 4, "{error_m} {}", bank.hypotheses.len());
}

/// A bearing across the cut of the circle, a target on the robot, and a target at a metre with a one-degree camera.
#[test]
fn near_targets_and_bearings_across_half_a_turn_are_followed() {
    let motion = MotionModel::IntegratorChain { order: 2, noise_psd: 0.05 };
    let mut bank = Bank::<4>::new(motion, Gate::new(Some(4.0)), exact(2));
    let std = 1.0_f64.to_radians();
    for k in 0..600 {
        // The target passes over the first robot, and west of the second one.
        let target = Vector2::new(-1.0, 3.0 - 0.01 * f64::from(k));
        let readings = [[-1.0, 0.0], [0.0, 0.0]].map(|at| {
            let sight = target - Vector2::from(at);
            let value = sight.y.atan2(sight.x) + 1.5 * std * (f64::from(k) * 2.399).sin();
            let robot = usize::from(at[0] == 0.0);
            Reading { robot, kind: Kind::Bearing, pose: Pose::at(at), value, std, ..Reading::default() }
        });
        bank.advance(0.1, &readings);
        let (error_m, std_m) =
            ((bank.estimate().position() - target).norm(), bank.estimate().position_covariance().trace().sqrt());
        assert!(k < 50 || error_m < 0.3 + 3.0 * std_m, "{k}: {error_m} {std_m}");
        assert!(k < 50 || std_m < 1.0, "{k}: {std_m}");
    }
}
