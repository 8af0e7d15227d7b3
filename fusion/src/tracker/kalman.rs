//! The tracker for a Gaussian prior: one extended Kalman filter.

use nalgebra::{Matrix2, Vector2};
use rangehound_shared::matrix::Matrix;
use rangehound_shared::motion::{MotionModel, Transition};
use rangehound_shared::robot_set::RobotSet;
use rangehound_shared::sealed::{self, SealError};

use super::{Fit, Gate, Reading, Tracker};
use crate::filter::{Estimate, RangeInformation};

/// One extended Kalman filter with a gate.
#[derive(Debug, Clone)]
pub struct Kalman<const N: usize> {
    motion: MotionModel,
    gate: Gate,
    estimate: Estimate<N>,
    /// The transition of the last step: most runs have one step length for all ticks.
    transition: (f64, Transition<N>),
}

impl<const N: usize> Kalman<N> {
    /// A filter that starts from N(mean, covariance).
    #[must_use]
    pub fn new(motion: MotionModel, mean: &[f64], covariance: &Matrix, gate: Gate) -> Self {
        let x = nalgebra::SVector::from_fn(|i, _| mean.get(i).copied().unwrap_or(0.0));
        let transition = (0.0, motion.transition(0.0));
        Self { motion, gate, estimate: Estimate { x, p: covariance.to_static() }, transition }
    }
}

impl<const N: usize> Tracker for Kalman<N> {
    fn step(&mut self, dt_s: f64, readings: &[Reading]) -> Fit {
        if self.transition.0 != dt_s {
            self.transition = (dt_s, self.motion.transition(dt_s));
        }
        let predicted = self.estimate.predict(&self.transition.1);
        let position_covariance = predicted.position_covariance();
        let mut information = RangeInformation::default();
        let mut failed = RobotSet::default();
        for reading in readings {
            let range = predicted.innovation(reading.position_m, reading.range_m, reading.range_std_m);
            if !self.gate.passes(range.normalised_square(&position_covariance)) {
                failed.set(reading.robot, true);
            } else if !reading.distrusted {
                information.add(&range);
            }
        }
        let (estimate, nis) = if information.count > 0 { predicted.update(&information) } else { (predicted, 0.0) };
        self.estimate = estimate;
        Fit { nis, fused: information.count, rejected: readings.len() as u32 - information.count, failed }
    }

    fn state(&self) -> &[f64] {
        self.estimate.x.as_slice()
    }

    fn covariance(&self) -> &[f64] {
        self.estimate.p.as_slice()
    }

    fn save(&self, bytes: &mut Vec<u8>) -> Result<(), SealError> {
        sealed::encode_into(&self.estimate, bytes)
    }

    fn restore(&mut self, bytes: &[u8]) -> Result<(), SealError> {
        self.estimate = sealed::decode(bytes)?;
        Ok(())
    }

    fn predicted_position(&self, dt_s: f64) -> (Vector2<f64>, Matrix2<f64>) {
        let predicted = if self.transition.0 == dt_s {
            self.estimate.predict(&self.transition.1)
        } else {
            self.estimate.predict(&self.motion.transition(dt_s))
        };
        (predicted.position(), predicted.position_covariance())
    }
}
