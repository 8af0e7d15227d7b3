//! The simulated world: the target moves by its model, the robots by their drives.

use nalgebra::{SMatrix, SVector};
use rangehound_shared::draws::{Draws, Stream};
use rangehound_shared::measurement::Pose;
use rangehound_shared::message::{Drive, RangeKind, WorldEntry};
use rangehound_shared::motion::matrix::square_root;
use rangehound_shared::scenario::Scenario;
use rangehound_shared::scenario::bounds::TICKS_MAX;
use rangehound_shared::sealed::{self, SealError};

use crate::world::{World, are_valid};

/// A target with a state of dimension `N`, and the robots.
///
/// The target moves by `x(k+1) = Phi x(k) + w(k)`, `w(k) ~ N(0, G Qd G^T)` (Eq. 1), drawn from (seed,
/// k) only; the robots move by Eqs. 14 and 15.
#[derive(Debug, Clone)]
pub struct Simulation<const N: usize> {
    tick: u64,
    dt_s: f64,
    phi: SMatrix<f64, N, N>,
    noise_root: SMatrix<f64, N, N>,
    noise: Draws,
    target: SVector<f64, N>,
    speed_limits_mps: Vec<f64>,
    entries: Vec<WorldEntry>,
}

impl<const N: usize> Simulation<N> {
    /// The world at tick 0.
    #[must_use]
    pub fn new(scenario: &Scenario, target_start: &[f64]) -> Self {
        let transition = scenario.motion.transition::<N>(scenario.dt_s);
        let mut simulation = Self {
            tick: 0,
            dt_s: scenario.dt_s,
            phi: transition.phi,
            noise_root: square_root(&transition.process_noise),
            noise: Draws::new(scenario.seed, Stream::TargetNoise),
            target: SVector::from_fn(|i, _| target_start.get(i).copied().unwrap_or(0.0)),
            speed_limits_mps: scenario.robots.iter().map(|robot| robot.speed_mps).collect(),
            entries: scenario
                .robots
                .iter()
                .map(|robot| WorldEntry { pose: Pose::at(robot.start_m), ..WorldEntry::default() })
                .collect(),
        };
        simulation.look();
        simulation
    }

    /// Fills in the ranges that the sensors would measure. Tick 0 has no range.
    fn look(&mut self) {
        let kind = if self.tick == 0 { RangeKind::Absent } else { RangeKind::True };
        for entry in &mut self.entries {
            entry.range_kind = kind.to_bits();
            entry.range_m = match kind {
                RangeKind::Absent => 0.0,
                _ => (self.target[0] - entry.pose.x_m).hypot(self.target[1] - entry.pose.y_m),
            };
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

    fn truth(&self) -> &[f64] {
        self.target.as_slice()
    }

    fn advance(&mut self, drives: &[Option<Drive>]) {
        for ((entry, drive), limit_mps) in self.entries.iter_mut().zip(drives).zip(&self.speed_limits_mps) {
            let Some(drive) = drive else { continue };
            // A body cannot exceed its speed limit, whatever the command.
            let step_m = drive.speed_mps.clamp(0.0, *limit_mps) * self.dt_s;
            let (sin, cos) = drive.heading_rad.sin_cos();
            if step_m.is_finite() && sin.is_finite() {
                entry.pose.x_m += step_m * cos;
                entry.pose.y_m += step_m * sin;
            }
        }
        let mut normal = SVector::<f64, N>::zeros();
        self.noise.standard_normal(self.tick, normal.as_mut_slice());
        self.target = self.phi * self.target + self.noise_root * normal;
        self.tick += 1;
        self.look();
    }

    fn save(&self, bytes: &mut Vec<u8>) -> Result<(), SealError> {
        sealed::encode_into(&(self.tick, &self.target, &self.entries), bytes)
    }

    fn restore(&mut self, bytes: &[u8]) -> Result<(), SealError> {
        let (tick, target, entries): (u64, SVector<f64, N>, Vec<WorldEntry>) = sealed::decode(bytes)?;
        let places = entries.iter().flat_map(|entry| entry.pose.numbers().into_iter().chain([entry.range_m]));
        let is_valid = tick <= TICKS_MAX + 1 && are_valid(target.iter().copied().chain(places));
        if entries.len() != self.entries.len() || !is_valid {
            return Err(SealError::Malformed);
        }
        (self.tick, self.target, self.entries) = (tick, target, entries);
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
        let at = |i: usize| (world.entries()[i].pose.x_m, world.entries()[i].pose.y_m);
        assert_eq!(at(0), (16.0, 0.0));
        assert_eq!(at(1), (15.0, 0.0));
        assert!((at(2).1 - 1.0).abs() < 1e-12, "one step at the speed limit");
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
        assert!(b.entries().iter().all(|entry| entry.range_kind == RangeKind::True.to_bits()));
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
}
