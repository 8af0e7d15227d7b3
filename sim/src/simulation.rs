//! The simulated world: the target moves by its model, the robots by their drives.

use nalgebra::{SMatrix, SVector};
use rangehound_shared::angle::wrapped_rad;
use rangehound_shared::draws::{Draws, Stream};
use rangehound_shared::measurement::{Kind, Pose};
use rangehound_shared::message::{Drive, Origin, WorldEntry};
use rangehound_shared::motion::matrix::square_root;
use rangehound_shared::scenario::bounds::TICKS_MAX;
use rangehound_shared::scenario::{RobotSpec, Scenario, SensorSpec};
use rangehound_shared::sealed::{self, SealError};

use crate::errors::{ErrorModel, Errors};
use crate::world::{World, are_valid};

/// Another motion of the target than by its scenario's model.
pub trait TargetMotion: std::fmt::Debug + Send {
    /// Replaces the true state at `tick` by that of the next. `noise` has a standard normal number for each state, drawn from
    /// (seed, tick) only.
    fn advance(&mut self, tick: u64, state: &mut [f64], noise: &[f64]);
}

/// A target with a state of dimension `N`, and the robots.
///
/// The target moves by `x(k+1) = Phi x(k) + w(k)`, `w(k) ~ N(0, G Qd G^T)` (Eq. 1), drawn from (seed,
/// k) only; the robots move by Eqs. 14 and 15. A robot's own pose is the true one plus its errors. A real
/// target is not simulated: only sensors of their own can measure it.
#[derive(Debug)]
pub struct Simulation<const N: usize> {
    tick: u64,
    dt_s: f64,
    phi: SMatrix<f64, N, N>,
    noise_root: SMatrix<f64, N, N>,
    noise: Draws,
    target: SVector<f64, N>,
    has_real_target: bool,
    /// `None`: by the scenario's model.
    motion: Option<Box<dyn TargetMotion>>,
    robots: Vec<Robot>,
    /// True poses.
    poses: Vec<Pose>,
    errors: Vec<Errors>,
    entries: Vec<WorldEntry>,
}

/// The constants of a robot.
#[derive(Debug, Clone)]
struct Robot {
    speed_limit_mps: f64,
    sensor: SensorSpec,
    error_model: ErrorModel,
}

impl<const N: usize> Simulation<N> {
    /// The world at tick 0.
    #[must_use]
    pub fn new(scenario: &Scenario, target_start: &[f64]) -> Self {
        let transition = scenario.motion.transition::<N>(scenario.dt_s);
        let mut robots: Vec<Robot> = scenario
            .robots
            .iter()
            .enumerate()
            .map(|(id, spec)| {
                let RobotSpec { speed_mps, sensor, nuisances, .. } = *spec;
                let error_model = ErrorModel::new(&nuisances, scenario.dt_s, scenario.seed, id);
                Robot { speed_limit_mps: speed_mps, sensor, error_model }
            })
            .collect();
        let mut simulation = Self {
            tick: 0,
            dt_s: scenario.dt_s,
            phi: transition.phi,
            noise_root: square_root(&transition.process_noise),
            noise: Draws::new(scenario.seed, Stream::TargetNoise),
            target: SVector::from_fn(|i, _| target_start.get(i).copied().unwrap_or(0.0)),
            has_real_target: scenario.has_real_target,
            motion: None,
            poses: scenario.robots.iter().map(|robot| Pose::at(robot.start_m)).collect(),
            errors: robots.iter_mut().map(|robot| robot.error_model.start()).collect(),
            robots,
            entries: vec![WorldEntry::default(); scenario.robots.len()],
        };
        simulation.observe();
        simulation
    }

    /// The same world with another motion of the target.
    #[must_use]
    pub fn moved_by(self, motion: Box<dyn TargetMotion>) -> Self {
        Self { motion: Some(motion), ..self }
    }

    /// Fills in what localisers say and what sensors can measure. At tick 0 they measure nothing.
    fn observe(&mut self) {
        let Self { tick, target, has_real_target, robots, poses, errors, entries, .. } = self;
        for (((entry, robot), pose), errors) in entries.iter_mut().zip(robots).zip(poses).zip(errors) {
            let (x_m, y_m) = (target[0] - pose.x_m, target[1] - pose.y_m);
            let distance_m = x_m.hypot(y_m);
            let SensorSpec { range, bearing_std_rad, field_of_view_rad, .. } = robot.sensor;
            let bearing_rad = match field_of_view_rad.is_some() || bearing_std_rad.is_some() {
                true => wrapped_rad(y_m.atan2(x_m) - pose.heading_rad),
                false => 0.0,
            };
            let is_seen = !*has_real_target
                && *tick > 0
                && distance_m <= robot.sensor.reach_m()
                && bearing_rad.abs() <= 0.5 * robot.sensor.view_rad();
            *entry = WorldEntry { pose: errors.believed(*pose), ..WorldEntry::default() };
            if is_seen && range.is_some() {
                entry.kinds |= Kind::Range.bit();
                entry.range_m = distance_m + errors.bias_m;
            }
            if is_seen && bearing_std_rad.is_some() {
                entry.kinds |= Kind::Bearing.bit();
                entry.bearing_rad = bearing_rad;
            }
            entry.origin = Origin::Simulated.to_bits();
        }
    }
}

impl<const N: usize> World for Simulation<N> {
    fn time_s(&self) -> f64 {
        self.tick as f64 * self.dt_s
    }

    fn entries(&self) -> &[WorldEntry] {
        &self.entries
    }

    fn poses(&self) -> &[Pose] {
        &self.poses
    }

    fn truth(&self) -> &[f64] {
        if self.has_real_target { &[] } else { self.target.as_slice() }
    }

    fn advance(&mut self, drives: &[Option<Drive>]) {
        for ((pose, drive), robot) in self.poses.iter_mut().zip(drives).zip(&self.robots) {
            let Some(drive) = drive else { continue };
            // A body cannot exceed its speed limit, whatever the command.
            let step_m = drive.speed_mps.clamp(0.0, robot.speed_limit_mps) * self.dt_s;
            let (sin, cos) = drive.heading_rad.sin_cos();
            if step_m.is_finite() && sin.is_finite() {
                pose.x_m += step_m * cos;
                pose.y_m += step_m * sin;
                // A robot that stands still faces where it faced.
                if step_m > 0.0 {
                    pose.heading_rad = wrapped_rad(drive.heading_rad);
                }
            }
        }
        let mut normal = SVector::<f64, N>::zeros();
        self.noise.standard_normal(self.tick, normal.as_mut_slice());
        match &mut self.motion {
            Some(motion) => motion.advance(self.tick, self.target.as_mut_slice(), normal.as_slice()),
            None => self.target = self.phi * self.target + self.noise_root * normal,
        }
        self.tick += 1;
        for (errors, robot) in self.errors.iter_mut().zip(&mut self.robots) {
            robot.error_model.advance(self.tick, errors);
        }
        self.observe();
    }

    fn save(&self, bytes: &mut Vec<u8>) -> Result<(), SealError> {
        sealed::encode_into(&(self.tick, &self.target, &self.poses, &self.errors), bytes)
    }

    fn restore(&mut self, bytes: &[u8]) -> Result<(), SealError> {
        let (tick, target, poses, errors): (u64, SVector<f64, N>, Vec<Pose>, Vec<Errors>) = sealed::decode(bytes)?;
        let numbers = poses.iter().flat_map(|pose| pose.numbers()).chain(errors.iter().flat_map(Errors::numbers));
        let is_valid = tick <= TICKS_MAX + 1 && are_valid(target.iter().copied().chain(numbers));
        if poses.len() != self.poses.len() || errors.len() != self.errors.len() || !is_valid {
            return Err(SealError::Malformed);
        }
        (self.tick, self.target, self.poses, self.errors) = (tick, target, poses, errors);
        self.observe();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rangehound_shared::scenario::ScenarioFile;

    fn paper() -> Scenario {
        Scenario::from_file(&ScenarioFile::default(), "test").unwrap()
    }

    fn drive(heading_rad: f64, speed_mps: f64) -> Option<Drive> {
        Some(Drive { heading_rad, speed_mps, ..Drive::default() })
    }

    #[test]
    fn robots_move_as_they_drive_and_no_faster_than_they_can() {
        let mut world = Simulation::<4>::new(&paper(), &[0.0, 0.0, -8.0, 4.0]);
        world.advance(&[drive(0.0, 10.0), None, drive(std::f64::consts::FRAC_PI_2, 1e9)]);
        let at = |world: &Simulation<4>, i: usize| (world.poses()[i].x_m, world.poses()[i].y_m);
        assert_eq!(at(&world, 0), (16.0, 0.0));
        assert_eq!(at(&world, 1), (15.0, 0.0));
        assert!((at(&world, 2).1 - 1.0).abs() < 1e-12, "one step at the speed limit");
        world.advance(&[drive(f64::NAN, 10.0), drive(0.0, f64::NAN), drive(0.0, -5.0)]);
        assert!(world.entries().iter().all(|entry| entry.is_valid()));
        assert_eq!(world.entries()[2].pose.x_m, 15.0, "nobody drives backwards");
    }

    #[test]
    fn the_target_does_not_depend_on_what_robots_do() {
        let (mut a, mut b) = (Simulation::<4>::new(&paper(), &[0.0; 4]), Simulation::<4>::new(&paper(), &[0.0; 4]));
        for _ in 0..50 {
            a.advance(&[None; 3]);
            b.advance(&[drive(1.0, 10.0); 3]);
        }
        assert_eq!(a.truth(), b.truth());
        assert_ne!(a.entries(), b.entries());
        assert!(b.entries().iter().all(|entry| entry.of(Origin::Simulated).0.is_some()));
    }

    /// A world of one robot with this sensor at (0, 0), and the target at rest at this place.
    fn seen(sensor: &str, target: [f64; 2]) -> (Option<f64>, Option<f64>) {
        let text = format!(
            "[target]\nnoise_psd = 0.0\nstart = [{}, {}, 0.0, 0.0]\n[robots]\ncount = 1\nstart_m = [0.0, 0.0]\n\
             sensor = \"s\"\n[sensor.s]\n{sensor}",
            target[0], target[1]
        );
        let scenario = Scenario::from_file(&ScenarioFile::parse(&text, "test").unwrap(), "test").unwrap();
        let mut world = Simulation::<4>::new(&scenario, &[target[0], target[1], 0.0, 0.0]);
        world.advance(&[None]);
        world.entries()[0].of(Origin::Simulated)
    }

    #[test]
    fn a_sensor_sees_what_is_within_its_reach_and_its_field_of_view() {
        let both = "range_std_m = 0.1\nbearing_std_rad = 0.01\nmax_range_m = 6.0\n";
        assert_eq!(seen(both, [3.0, 4.0]), (Some(5.0), Some(4.0_f64.atan2(3.0))));
        assert_eq!(seen(both, [30.0, 4.0]), (None, None));
        assert_eq!(seen("bearing_std_rad = 0.01\nfield_of_view_rad = 1.0", [10.0, 4.0]).0, None);
        assert!(seen("bearing_std_rad = 0.01\nfield_of_view_rad = 1.0", [10.0, 4.0]).1.is_some());
        assert_eq!(seen("range_std_m = 0.1\nfield_of_view_rad = 1.0", [10.0, 6.0]), (None, None));
    }

    #[test]
    fn robots_believe_a_wrong_place_and_measure_from_the_true_one() {
        let text = "[robots]\nlocaliser = \"odometry\"\n[localiser.odometry]\nstd_m = 1.0\ndrift_m = 0.5";
        let scenario = Scenario::from_file(&ScenarioFile::parse(text, "test").unwrap(), "test").unwrap();
        let mut world = Simulation::<4>::new(&scenario, &[0.0; 4]);
        (0..5).for_each(|_| world.advance(&[None; 3]));
        let (pose, entry) = (world.poses()[1], world.entries()[1]);
        assert_eq!((pose.x_m, pose.y_m), (15.0, 0.0));
        assert!((entry.pose.x_m - 15.0).abs() > 1e-3 && (entry.pose.x_m - 15.0).abs() < 10.0);
        let distance_m = (world.truth()[0] - 15.0).hypot(world.truth()[1]);
        assert_eq!(entry.of(Origin::Simulated), (Some(distance_m), None));
        let mut bytes = Vec::new();
        world.save(&mut bytes).unwrap();
        let mut other = Simulation::<4>::new(&scenario, &[0.0; 4]);
        other.restore(&bytes).unwrap();
        assert_eq!(other.entries(), world.entries());
    }

    #[test]
    fn a_target_of_another_motion_has_the_same_noise_for_the_same_seed() {
        #[derive(Debug)]
        struct Walk;
        impl TargetMotion for Walk {
            fn advance(&mut self, tick: u64, state: &mut [f64], noise: &[f64]) {
                state[0] = tick as f64;
                state[1] = noise[1];
            }
        }
        let mut worlds = [(); 2].map(|()| Simulation::<4>::new(&paper(), &[0.0; 4]).moved_by(Box::new(Walk)));
        worlds.iter_mut().for_each(|world| (0..4).for_each(|_| world.advance(&[None; 3])));
        assert_eq!(worlds[0].truth()[0], 3.0);
        assert!(worlds[0].truth()[1] != 0.0 && worlds[0].truth() == worlds[1].truth());
    }

    #[test]
    fn process_noise_has_the_models_covariance() {
        let scenario = paper();
        let covariance = scenario.motion.transition::<4>(scenario.dt_s).process_noise;
        let mut sum = SMatrix::<f64, 4, 4>::zeros();
        let mut world = Simulation::<4>::new(&scenario, &[0.0; 4]);
        let steps = 100_000;
        for _ in 0..steps {
            let before = world.target;
            world.advance(&[None; 3]);
            let noise = world.target - world.phi * before;
            sum += noise * noise.transpose();
        }
        let scale = covariance.diagonal().map(f64::sqrt);
        let error = (sum / f64::from(steps) - covariance).component_div(&(scale * scale.transpose()));
        // Five standard deviations of a sample covariance.
        assert!(error.amax() < 5.0 * (2.0 / f64::from(steps)).sqrt(), "{error}");
    }

    #[test]
    fn a_real_target_is_not_simulated() {
        let file = ScenarioFile::parse("[target]\nreal = true\n", "test").unwrap();
        let scenario = Scenario::from_file(&file, "test").unwrap();
        let mut world = Simulation::<4>::new(&scenario, &[0.0, 0.0, -8.0, 4.0]);
        world.advance(&[drive(0.0, 10.0), None, None]);
        assert!(world.truth().is_empty() && world.entries().iter().all(|entry| entry.kinds == 0));
        assert_eq!(world.poses()[0].x_m, 16.0, "robots move all the same");
    }
}
