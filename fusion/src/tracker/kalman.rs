//! The tracker for a Gaussian prior: one extended Kalman filter.

use rangehound_shared::ROBOTS_MAX;
use rangehound_shared::motion::matrix::Matrix;
use rangehound_shared::motion::{MotionModel, Transition};
use rangehound_shared::record::{Judged, RangeUse};
use rangehound_shared::robot_set::RobotSet;
use rangehound_shared::sealed::{self, SealError};

use super::{Fit, Gate, Reading, Tracker, judged_room, use_of};
use crate::belief::Belief;
use crate::filter::{Gaussian, Innovation, RangeInformation};

/// One extended Kalman filter with a gate.
#[derive(Debug, Clone)]
pub struct Kalman<const N: usize> {
    motion: MotionModel,
    gate: Gate,
    estimate: Gaussian<N>,
    /// The transition of the last step: most runs have one step length for all ticks.
    transition: (f64, Transition<N>),
    /// Innovations of the last step's readings, in their order.
    innovations: Vec<Innovation>,
    judged: Vec<Judged>,
}

impl<const N: usize> Kalman<N> {
    /// A filter that starts from N(mean, covariance).
    #[must_use]
    pub fn new(motion: MotionModel, mean: &[f64], covariance: &Matrix, gate: Gate) -> Self {
        let x = nalgebra::SVector::from_fn(|i, _| mean.get(i).copied().unwrap_or(0.0));
        let transition = (0.0, motion.transition(0.0));
        let estimate = Gaussian { x, p: covariance.to_static() };
        Self { motion, gate, estimate, transition, innovations: Vec::with_capacity(ROBOTS_MAX), judged: judged_room() }
    }
}

/// The innovation of a reading. For a sensor at another height than the target, second-order terms are added: straight
/// beneath it the first-order term of the distance is zero. In the plane the filter is the paper's.
fn innovation<const N: usize>(estimate: &Gaussian<N>, reading: &Reading) -> Innovation {
    let Reading { position_m, height_m, range_m, range_std_m, .. } = *reading;
    let mut range = estimate.slant_innovation(position_m, height_m, range_m, range_std_m);
    if height_m != 0.0 {
        let bend = estimate.bend(&range.line_of_sight, range_m - range.innovation_m);
        range.innovation_m -= bend.mean_m;
        range.noise_variance_m2 += bend.variance_m2;
    }
    range
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
        self.innovations.clear();
        self.judged.clear();
        for reading in readings {
            let range = innovation(&predicted, reading);
            let normalised_square = range.normalised_square(&position_covariance);
            let passed = self.gate.passes(normalised_square);
            let used = use_of(reading, passed);
            failed.set(reading.robot, self.gate.fails(normalised_square));
            if used == RangeUse::Fused {
                information.add(&range);
            }
            self.innovations.push(range);
            self.judged.push(Judged { used, normalised_square: Some(normalised_square) });
        }
        let tested = readings.len() as u32;
        let nis_all = if tested > 0 { predicted.nis(self.innovations.iter()) } else { 0.0 };
        let nis = match information.count {
            0 => 0.0,
            count if count == tested => nis_all,
            _ => {
                let ranges = self.innovations.iter().zip(&self.judged);
                predicted.nis(ranges.filter(|(_, judged)| judged.used == RangeUse::Fused).map(|(range, _)| range))
            }
        };
        self.estimate = if information.count > 0 { predicted.update(&information) } else { predicted };
        Fit { nis, fused: information.count, nis_all, tested, rejected: tested - information.count, failed }
    }

    fn judged(&self) -> &[Judged] {
        &self.judged
    }

    fn widen(&mut self, factor: f64) {
        self.estimate.p *= factor;
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

    fn predict_into(&self, dt_s: f64, belief: &mut Belief) {
        belief.assign(&if self.transition.0 == dt_s {
            self.estimate.predict(&self.transition.1)
        } else {
            self.estimate.predict(&self.motion.transition(dt_s))
        });
    }
}
