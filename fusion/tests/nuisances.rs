//! A team that does not know exactly where it is: what the filter believes of its error, by treatment of the nuisances.
//!
//! A target with a nearly constant velocity, and robots on a ring of 15 m round it, which believe a wrong place.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on should panic")]

use nalgebra::{SMatrix, SVector, Vector2};
use rangehound_fusion::filter::Gaussian;
use rangehound_fusion::nuisance::Chain;
use rangehound_fusion::tracker::kalman::Kalman;
use rangehound_fusion::tracker::{Gate, Reading, Tracker};
use rangehound_shared::angle::wrapped_rad;
use rangehound_shared::draws::{Draws, Stream};
use rangehound_shared::measurement::{Kind, Pose};
use rangehound_shared::motion::MotionModel;
use rangehound_shared::motion::matrix::square_root;
use rangehound_shared::scenario::{NuisanceSpec, PoseCorrelation, Treatment};

const DT_S: f64 = 0.1;
const TICKS: u64 = 600;
const SETTLED_TICKS: u64 = 100;
const RING_M: f64 = 15.0;
const RANGE_STD_M: f64 = 0.3;

/// The settings that all robots have in common, and the share of the errors that each has.
#[derive(Clone)]
struct Team {
    robots: usize,
    spec: NuisanceSpec,
    /// Half of the team has a tenth of the errors, and half three times as much.
    is_mixed: bool,
    bearing_std_rad: Option<f64>,
}

#[derive(Debug, Default, Clone, Copy)]
struct Sums {
    squared_error_m2: f64,
    nees: f64,
    ticks: f64,
}

impl Sums {
    fn rmse_m(&self) -> f64 {
        (self.squared_error_m2 / self.ticks).sqrt()
    }

    /// Average of the normalised estimation errors squared, per degree of freedom.
    fn anees(&self) -> f64 {
        self.nees / self.ticks / 2.0
    }
}

fn motion() -> MotionModel {
    MotionModel::IntegratorChain { order: 2, noise_psd: 0.1 }
}

impl Team {
    fn new(robots: usize, spec: NuisanceSpec) -> Self {
        Self { robots, spec, is_mixed: false, bearing_std_rad: None }
    }

    fn spec_of(&self, robot: usize) -> NuisanceSpec {
        let factor = match self.is_mixed {
            false => 1.0,
            true if 2 * robot < self.robots => 0.1,
            true => 3.0,
        };
        NuisanceSpec {
            pose_std_m: self.spec.pose_std_m * factor,
            pose_drift_m: self.spec.pose_drift_m * factor,
            ..self.spec
        }
    }

    /// One run of the filter.
    fn run(&self, seed: u64, treatment: Treatment, sums: &mut Sums) {
        let normal = |draws: &mut Draws, tick: u64| {
            let mut drawn = [0.0; 8];
            draws.standard_normal(tick, &mut drawn);
            drawn
        };
        let specs: Vec<NuisanceSpec> = (0..self.robots).map(|robot| self.spec_of(robot)).collect();
        let transition = motion().transition::<4>(DT_S);
        let root = square_root(&transition.process_noise);
        let mut x = SVector::from([0.0, 0.0, 1.0, 0.5]);
        let deviations = SVector::from([2.0, 2.0, 1.0, 1.0]);
        let start = normal(&mut Draws::new(seed, Stream::PriorMean), 0);
        let prior = Gaussian {
            x: SVector::from_fn(|i, _| x[i] + deviations[i] * start[i]),
            p: SMatrix::from_diagonal(&deviations.component_mul(&deviations)),
        };
        let mut filter = Kalman::new(motion(), prior, Gate::new(None), Chain::of(specs.clone(), treatment));
        let mut target_noise = Draws::new(seed, Stream::TargetNoise);
        let mut range_noise: Vec<Draws> =
            (0..self.robots).map(|robot| Draws::new(seed, Stream::RangeNoise { robot })).collect();
        let mut error_noise: Vec<Draws> =
            (0..self.robots).map(|robot| Draws::new(seed, Stream::Nuisances { robot })).collect();
        let mut errors: Vec<[f64; 3]> = (0..self.robots)
            .map(|robot| {
                let drawn = normal(&mut error_noise[robot], 0);
                let spec = &specs[robot];
                [spec.pose_std_m * drawn[0], spec.pose_std_m * drawn[1], spec.heading_std_rad * drawn[2]]
            })
            .collect();
        for tick in 1..=TICKS {
            x = transition.phi * x + root * SVector::from_iterator(normal(&mut target_noise, tick).into_iter().take(4));
            let mut readings = Vec::new();
            for robot in 0..self.robots {
                let (spec, error) = (&specs[robot], &mut errors[robot]);
                let drawn = normal(&mut error_noise[robot], tick);
                let kept = match spec.correlation {
                    PoseCorrelation::White => 0.0,
                    PoseCorrelation::Time(time_s) => (-DT_S / time_s).exp(),
                    _ => 1.0,
                };
                let fresh = (1.0 - kept * kept).sqrt();
                let step_m = fresh * spec.pose_std_m + spec.pose_drift_m * DT_S.sqrt();
                for axis in 0..2 {
                    error[axis] = kept * error[axis] + step_m * drawn[axis];
                }
                error[2] = kept * error[2] + fresh * spec.heading_std_rad * drawn[2];
                let turn_rad = std::f64::consts::TAU * robot as f64 / self.robots as f64;
                let true_m = Vector2::new(x[0] + RING_M * turn_rad.cos(), x[1] + RING_M * turn_rad.sin());
                let variance_m2 = spec.position_variance_m2(tick as f64 * DT_S);
                let pose = Pose {
                    heading_rad: 0.3 + error[2],
                    covariance_m2: [variance_m2, 0.0, variance_m2],
                    heading_std_rad: spec.heading_std_rad,
                    ..Pose::at([true_m.x + error[0], true_m.y + error[1]])
                };
                let sight = Vector2::new(x[0], x[1]) - true_m;
                let noise = normal(&mut range_noise[robot], tick);
                let value = sight.norm() + RANGE_STD_M * noise[0];
                readings.push(Reading { robot, pose, value, std: RANGE_STD_M, ..Reading::default() });
                if let Some(std) = self.bearing_std_rad {
                    let value = wrapped_rad(sight.y.atan2(sight.x) - 0.3 + std * noise[1]);
                    readings.push(Reading { robot, kind: Kind::Bearing, pose, value, std, ..Reading::default() });
                }
            }
            filter.step(DT_S, &readings);
            if tick > SETTLED_TICKS {
                let error_m = Vector2::new(filter.state()[0] - x[0], filter.state()[1] - x[1]);
                let p = SMatrix::<f64, 4, 4>::from_column_slice(filter.covariance());
                let p = p.fixed_view::<2, 2>(0, 0).into_owned();
                sums.squared_error_m2 += error_m.norm_squared();
                sums.nees += error_m.dot(&(p.try_inverse().unwrap() * error_m));
                sums.ticks += 1.0;
            }
        }
    }

    fn runs(&self, runs: u64, treatment: Treatment) -> Sums {
        let mut sums = Sums::default();
        (1..=runs).for_each(|seed| self.run(seed, treatment, &mut sums));
        sums
    }
}

/// The six pose errors of the table in docs/uncertain.md, each with its name.
fn rows(robots: usize) -> Vec<(String, Team)> {
    let of = |correlation, pose_std_m, pose_drift_m| NuisanceSpec {
        pose_std_m,
        pose_drift_m,
        correlation,
        ..NuisanceSpec::default()
    };
    let specs = [
        ("white 1 m", of(PoseCorrelation::White, 1.0, 0.0)),
        ("Markov 1 m, 30 s", of(PoseCorrelation::Time(30.0), 1.0, 0.0)),
        ("drift 0.1 m/sqrt s", of(PoseCorrelation::Drift, 0.1, 0.1)),
    ];
    [false, true]
        .into_iter()
        .flat_map(|is_mixed| {
            specs.map(|(name, spec)| {
                let name = format!("{name}{}", if is_mixed { ", half and half" } else { "" });
                (name, Team { is_mixed, ..Team::new(robots, spec) })
            })
        })
        .collect()
}

#[test]
fn the_schmidt_filter_is_consistent_for_every_kind_of_pose_error() {
    for robots in [4, 10] {
        for (name, team) in rows(robots) {
            let schmidt = team.runs(60, Treatment::Schmidt);
            // Sixty runs: the mean of a correlated error has a standard deviation of about 0.05.
            assert!((0.85..1.15).contains(&schmidt.anees()), "{robots} {name}: {schmidt:?} {}", schmidt.anees());
            let ignored = team.runs(5, Treatment::Ignored);
            assert!(ignored.anees() > 3.0, "{robots} {name}: {}", ignored.anees());
        }
    }
}

#[test]
fn uncertain_headings_and_bearings_are_consistent_too() {
    for correlation in [PoseCorrelation::White, PoseCorrelation::Time(30.0)] {
        let spec = NuisanceSpec { pose_std_m: 0.5, heading_std_rad: 0.05, correlation, ..NuisanceSpec::default() };
        let team = Team { bearing_std_rad: Some(0.02), ..Team::new(4, spec) };
        let schmidt = team.runs(60, Treatment::Schmidt);
        assert!((0.85..1.15).contains(&schmidt.anees()), "{correlation:?}: {}", schmidt.anees());
    }
}

/// The table of docs/uncertain.md: `cargo test --release -p rangehound-fusion --test nuisances -- --ignored --nocapture`.
#[test]
#[ignore = "minutes: prints RMSE and ANEES of 400 runs for each pose error and treatment"]
fn the_table_of_treatments() {
    let treatments = [
        ("ignored", Treatment::Ignored),
        ("inflated", Treatment::Inflated),
        ("Schmidt", Treatment::Schmidt),
        ("joint", Treatment::Estimated { bias: false, pose: true }),
    ];
    for robots in [4, 10] {
        for (name, team) in rows(robots) {
            let mut line = format!("{robots:2} robots, {name:35}");
            for (treatment_name, treatment) in treatments {
                let runs = if treatment_name == "joint" { 40 } else { 400 };
                let sums = team.runs(runs, treatment);
                line += &format!("  {treatment_name} {:.3} / {:.2}", sums.rmse_m(), sums.anees());
                if treatment == Treatment::Schmidt {
                    assert!((0.95..=1.05).contains(&sums.anees()), "{line}");
                }
            }
            println!("{line}");
        }
    }
}
