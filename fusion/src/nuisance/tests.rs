//! The O(M) forms against the full matrices, and extremes.

use nalgebra::{DMatrix, DVector};
use proptest::prelude::*;
use rangehound_shared::measurement::Pose;
use rangehound_shared::motion::MotionModel;
use rangehound_shared::scenario::{NuisanceSpec, PoseCorrelation};

use super::*;

/// A robot of a test: its pose's standard deviation, that of its bias, and the sensors that measure at a tick.
#[derive(Debug, Clone)]
struct Robot {
    at: (f64, f64),
    correlation: PoseCorrelation,
    pose_std_m: f64,
    heading_std_rad: f64,
    bias_std_m: f64,
    range: Option<f64>,
    bearing: Option<f64>,
}

fn robots() -> impl Strategy<Value = Vec<Robot>> {
    let correlation = prop_oneof![
        Just(PoseCorrelation::White),
        (0.1..50.0_f64).prop_map(PoseCorrelation::Time),
        Just(PoseCorrelation::Drift),
        Just(PoseCorrelation::Inferred),
    ];
    let of = (
        (-20.0..20.0_f64, -20.0..20.0_f64),
        correlation,
        0.1..2.0_f64,
        0.001..0.1_f64,
        0.0..0.5_f64,
        proptest::option::of(-1.0..1.0_f64),
        proptest::option::of(-0.1..0.1_f64),
    );
    let robot = of.prop_map(|(at, correlation, pose_std_m, heading_std_rad, bias_std_m, range, bearing)| Robot {
        at,
        correlation,
        pose_std_m,
        heading_std_rad,
        bias_std_m,
        range,
        bearing,
    });
    proptest::collection::vec(robot, 1..6)
}

fn chain(robots: &[Robot], treatment: Treatment) -> Chain {
    let spec = |robot: &Robot| NuisanceSpec {
        pose_std_m: robot.pose_std_m,
        heading_std_rad: robot.heading_std_rad,
        bias_std_m: robot.bias_std_m,
        correlation: robot.correlation,
        ..NuisanceSpec::default()
    };
    Chain::of(robots.iter().map(spec).collect(), treatment)
}

/// The readings of a tick, for a target at the origin.
fn readings(robots: &[Robot], tick: u32) -> Vec<Reading> {
    let mut readings = Vec::new();
    for (id, robot) in robots.iter().enumerate() {
        // Drifting robots are less certain with time, and they move.
        let growth = if robot.correlation == PoseCorrelation::Drift { 1.0 + 0.1 * f64::from(tick) } else { 1.0 };
        let variance_m2 = robot.pose_std_m * robot.pose_std_m * growth;
        let (x_m, y_m) = (robot.at.0 + f64::from(tick), robot.at.1);
        let pose = Pose {
            covariance_m2: [variance_m2, 0.3 * variance_m2, 0.5 * variance_m2],
            heading_rad: 0.4,
            heading_std_rad: robot.heading_std_rad,
            ..Pose::at([x_m, y_m])
        };
        let common = Reading { robot: id, pose, ..Reading::default() };
        if let Some(error_m) = robot.range {
            readings.push(Reading { value: x_m.hypot(y_m) + error_m, std: 0.3, ..common });
        }
        if let Some(error_rad) = robot.bearing {
            let value = (-y_m).atan2(-x_m) - 0.4 + error_rad;
            readings.push(Reading { kind: Kind::Bearing, value, std: 0.05, ..common });
        }
    }
    readings
}

/// One step of an estimate, as a tracker does it. Returns the normalised innovation squared.
fn step(estimate: &mut Estimate<4>, chain: &mut Chain, readings: &[Reading]) -> f64 {
    let transition = MotionModel::IntegratorChain { order: 2, noise_psd: 1.0 }.transition(0.1);
    estimate.predict(&transition);
    chain.advance(0.1);
    let mut heard = None;
    for reading in readings {
        if heard.replace(reading.robot) != Some(reading.robot)
            && let Some(change) = chain.hear(reading.robot, &reading.pose)
        {
            estimate.follow(chain);
            estimate.change(reading.robot, &change);
        }
    }
    let rows: Vec<Row> = readings.iter().map(|reading| estimate.row(reading, chain)).collect();
    estimate.update(rows.iter(), chain, &mut Vec::new())
}

fn prior() -> Gaussian<4> {
    Gaussian { x: SVector::from([0.3, -0.2, 0.1, 0.2]), p: SMatrix::<f64, 4, 4>::identity() * 2.0 }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

    /// Several ticks of the Schmidt filter in O(M) against the full matrices with gains of zero.
    #[test]
    fn the_schmidt_filter_equals_its_full_matrices(robots in robots(), ticks in 1_u32..6) {
        let mut fast_chain = chain(&robots, Treatment::Schmidt);
        let mut full_chain = chain(&robots, Treatment::Estimated { bias: false, pose: false });
        let mut fast = Estimate::new(prior(), &fast_chain);
        let mut full = Estimate::new(prior(), &full_chain);
        for tick in 0..ticks {
            let readings = readings(&robots, tick);
            let nis = step(&mut fast, &mut fast_chain, &readings);
            let full_nis = step(&mut full, &mut full_chain, &readings);
            prop_assert!((nis - full_nis).abs() < 1e-8 * (1.0 + full_nis), "{nis} {full_nis}");
            prop_assert!((fast.target.x - full.target.x).amax() < 1e-9, "{} {}", fast.target.x, full.target.x);
            prop_assert!((fast.target.p - full.target.p).amax() < 1e-9, "{} {}", fast.target.p, full.target.p);
        }
    }

    /// One joint update against the textbook's gain for the augmented state.
    #[test]
    fn the_joint_update_equals_the_textbook_kalman_gain(robots in robots()) {
        let readings = readings(&robots, 0);
        prop_assume!(!readings.is_empty());
        let mut chain = chain(&robots, Treatment::Estimated { bias: true, pose: true });
        let mut estimate = Estimate::new(prior(), &chain);
        estimate.predict(&MotionModel::IntegratorChain { order: 2, noise_psd: 1.0 }.transition(0.1));
        for reading in &readings {
            if let Some(change) = chain.hear(reading.robot, &reading.pose) {
                estimate.follow(&chain);
                estimate.change(reading.robot, &change);
            }
        }
        let rows: Vec<Row> = readings.iter().map(|reading| estimate.row(reading, &chain)).collect();
        let (m, size) = (rows.len(), 4 + NUISANCES * robots.len());
        let mut p = DMatrix::zeros(size, size);
        p.view_mut((0, 0), (4, 4)).copy_from(&estimate.target.p);
        for robot in 0..robots.len() {
            let at = 4 + NUISANCES * robot;
            p.view_mut((at, at), (4, 4)).copy_from(&chain.covariance(robot).matrix());
        }
        let (mut h, mut nu, mut r) = (DMatrix::zeros(m, size), DVector::zeros(m), DMatrix::zeros(m, m));
        for (i, row) in rows.iter().enumerate() {
            h[(i, 0)] = row.innovation.gradient.x;
            h[(i, 1)] = row.innovation.gradient.y;
            for k in 0..NUISANCES {
                h[(i, 4 + NUISANCES * row.robot + k)] = row.nuisance[k];
            }
            nu[i] = row.innovation.innovation;
            r[(i, i)] = row.innovation.noise_variance;
        }
        let s_inverse = (&h * &p * h.transpose() + r).try_inverse().unwrap();
        let gain = &p * h.transpose() * &s_inverse;
        let moved = &gain * &nu;
        let before = estimate.target.x;
        let nis = estimate.update(rows.iter(), &chain, &mut Vec::new());
        let after = (DMatrix::identity(size, size) - &gain * h) * &p;
        for i in 0..4 {
            prop_assert!((estimate.target.x[i] - before[i] - moved[i]).abs() < 1e-9);
            prop_assert!((estimate.target.p[(i, i)] - after[(i, i)]).abs() < 1e-9);
        }
        for robot in 0..robots.len() {
            for k in 0..NUISANCES {
                let mean = estimate.nuisances_of(robot)[k];
                prop_assert!((mean - moved[4 + NUISANCES * robot + k]).abs() < 1e-9);
            }
        }
        let textbook_nis = (nu.transpose() * s_inverse * &nu)[0];
        prop_assert!((nis - textbook_nis).abs() < 1e-8 * (1.0 + textbook_nis));
    }

    /// Vague and precise priors, precise and useless sensors, near and far, with certain and uncertain robots.
    #[test]
    fn the_covariance_stays_positive_definite_in_extremes(
        robots in robots(), log_variance in -6.0..8.0_f64, log_std in -3.0..3.0_f64, log_pose in -3.0..3.0_f64,
        near in proptest::bool::ANY,
    ) {
        let scale = 10.0_f64.powf(log_pose);
        let robots: Vec<Robot> = robots
            .into_iter()
            .map(|robot| Robot { pose_std_m: robot.pose_std_m * scale, ..robot })
            .collect();
        let mut chain = chain(&robots, Treatment::Schmidt);
        let p = SMatrix::<f64, 4, 4>::identity() * 10.0_f64.powf(log_variance);
        let mut estimate = Estimate::new(Gaussian { p, ..prior() }, &chain);
        for tick in 0..30 {
            let mut readings = readings(&robots, if near { 0 } else { tick });
            // The information of a measurement is at most eleven digits greater than that of the prior; floating point has
            // sixteen. The standard deviations below are a twentieth at least.
            let log_std = log_std.max(0.5 * (log_variance - 11.0) + 1.3);
            readings.iter_mut().for_each(|reading| reading.std *= 10.0_f64.powf(log_std));
            let nis = step(&mut estimate, &mut chain, &readings);
            prop_assert!(nis.is_finite() && nis >= 0.0);
            prop_assert!(estimate.target.p.cholesky().is_some(), "tick {tick}: {}", estimate.target.p);
            prop_assert!(estimate.target.x.iter().all(|value| value.is_finite()));
        }
    }
}

/// A range bias of one sensor of four: the Schmidt filter expects an error of its size for ever, and the joint one finds it.
#[test]
fn a_constant_bias_is_considered_or_found() {
    let corners = [(10.0, 0.0), (0.0, 10.0), (-10.0, 0.0), (0.0, -10.0)];
    let robots: Vec<Robot> = corners
        .iter()
        .map(|&at| Robot {
            at,
            correlation: PoseCorrelation::White,
            pose_std_m: 0.0,
            heading_std_rad: 0.0,
            bias_std_m: 0.5,
            range: Some(0.0),
            bearing: None,
        })
        .collect();
    let after = |treatment: Treatment| {
        let mut chain = chain(&robots, treatment);
        let mut estimate = Estimate::new(prior(), &chain);
        for tick in 0..400_u32 {
            let mut readings = readings(&robots, 0);
            for (id, reading) in readings.iter_mut().enumerate() {
                let bias_m = if id == 0 { 0.8 } else { 0.0 };
                reading.value += bias_m + 0.3 * (f64::from(tick * 4) + id as f64 * 1.7).sin();
            }
            // The sensors stand still, and the target circles between them.
            let turn_rad = f64::from(tick) * 0.05;
            let target_m = Vector2::new(3.0 * turn_rad.cos(), 3.0 * turn_rad.sin());
            for (reading, at) in readings.iter_mut().zip(corners) {
                let sensor_m = Vector2::new(at.0, at.1);
                reading.value += (target_m - sensor_m).norm() - sensor_m.norm();
                reading.pose = Pose::at([at.0, at.1]);
            }
            step(&mut estimate, &mut chain, &readings);
        }
        (estimate.target.position_covariance().trace().sqrt(), estimate.nuisances_of(0)[3])
    };
    let (ignored_std_m, _) = after(Treatment::Ignored);
    let (considered_std_m, none_m) = after(Treatment::Schmidt);
    let (joint_std_m, bias_m) = after(Treatment::Estimated { bias: true, pose: false });
    assert!(considered_std_m > 1.3 * ignored_std_m && none_m == 0.0, "{considered_std_m} {ignored_std_m}");
    assert!(joint_std_m < considered_std_m && (bias_m - 0.8).abs() < 0.2, "{joint_std_m} {bias_m}");
}

/// A correction by something new keeps `P' P^-1` of the error, and a growing covariance all of it.
#[test]
fn the_kept_part_of_an_error_follows_from_the_covariances() {
    let mut chain = Chain::of(vec![NuisanceSpec::default()], Treatment::Schmidt);
    let pose = |variance_m2: f64| Pose { covariance_m2: [variance_m2, 0.0, variance_m2], ..Pose::default() };
    assert_eq!(chain.hear(0, &Pose::default()), None);
    assert_eq!(chain.hear(0, &pose(1.0)).unwrap().matrix()[(0, 0)], 0.0, "nothing is known before");
    let grown = chain.hear(0, &pose(1.5)).unwrap();
    assert!((grown.matrix()[(0, 0)] - 1.0).abs() < 1e-12 && (grown.noise.position_m2[(0, 0)] - 0.5).abs() < 1e-12);
    let corrected = chain.hear(0, &pose(0.3)).unwrap();
    assert!((corrected.matrix()[(0, 0)] - 0.2).abs() < 1e-12, "{corrected:?}");
    // P' - P' P^-1 P P^-1 P'
    assert!((corrected.noise.position_m2[(1, 1)] - (0.3 - 0.09 / 1.5)).abs() < 1e-12, "{corrected:?}");
    let split = Pose { covariance_m2: [0.6, 0.0, 0.1], ..Pose::default() };
    let mixed = chain.hear(0, &split).unwrap();
    let noise = mixed.noise.position_m2;
    assert!(noise[(0, 0)] >= 0.0 && noise[(1, 1)] >= -1e-12 && noise.determinant() >= -1e-12, "{mixed:?}");
}
