//! The tracker for a Gaussian prior: one extended Kalman filter.

use nalgebra::Matrix2;
use rangehound_shared::ROBOTS_MAX;
use rangehound_shared::measurement::Kind;
use rangehound_shared::motion::{MotionModel, Transition};
use rangehound_shared::record::{FusionDecision, GateResult};
use rangehound_shared::sealed::{self, SealError};

use super::{Fit, Gate, Reading, Tracker, judged_room, use_of};
use crate::belief::Belief;
use crate::filter::Gaussian;
use crate::nuisance::{Chain, Estimate, Known, Row, Whitened};

/// One extended Kalman filter with a gate.
#[derive(Debug, Clone)]
pub struct Kalman<const N: usize> {
    motion: MotionModel,
    gate: Gate,
    estimate: Estimate<N>,
    chain: Chain,
    /// The transition of the last step: most runs have one step length for all ticks.
    transition: (f64, Transition<N>),
    /// The last step's readings compared with their predictions, in their order.
    rows: Vec<Row>,
    judged: Vec<GateResult>,
    scratch: Vec<Whitened<N>>,
}

impl<const N: usize> Kalman<N> {
    /// A filter that starts from this estimate.
    #[must_use]
    pub fn new(motion: MotionModel, prior: Gaussian<N>, gate: Gate, chain: Chain) -> Self {
        let transition = (0.0, motion.transition(0.0));
        let estimate = Estimate::new(prior, &chain);
        let rows = Vec::with_capacity(Kind::COUNT * ROBOTS_MAX);
        Self { motion, gate, estimate, chain, transition, rows, judged: judged_room(), scratch: Vec::new() }
    }
}

/// A reading compared with its prediction. Second-order terms are added for a sensor at another height than the target,
/// because straight beneath it the first-order term of the distance is zero, and for a robot whose position is uncertain.
/// For others the filter is the paper's.
fn row_of<const N: usize>(estimate: &Estimate<N>, reading: &Reading, chain: &Chain) -> Row {
    let mut row = estimate.row(reading, chain);
    let is_bent = reading.pose.height_m != 0.0 || chain.covariance(reading.robot).position_m2 != Matrix2::zeros();
    if reading.kind == Kind::Range && is_bent {
        let sight_covariance = estimate.sight_covariance(reading.robot, chain);
        let innovation = &mut row.innovation;
        let distance_m = (reading.value - innovation.innovation).abs().max(f64::MIN_POSITIVE);
        let bend = Gaussian::<N>::second_order(&sight_covariance, &innovation.gradient, distance_m);
        innovation.innovation -= bend.mean_m;
        innovation.noise_variance += bend.variance_m2;
    }
    row
}

impl<const N: usize> Tracker for Kalman<N> {
    fn step(&mut self, dt_s: f64, readings: &[Reading]) -> Fit {
        let Self { motion, gate, estimate, chain, transition, rows, judged, scratch } = self;
        if transition.0 != dt_s {
            *transition = (dt_s, motion.transition(dt_s));
        }
        estimate.predict(&transition.1);
        chain.advance(dt_s);
        for (index, reading) in readings.iter().enumerate() {
            let is_first = index.checked_sub(1).is_none_or(|before| readings[before].robot != reading.robot);
            if is_first && let Some(change) = chain.hear(reading.robot, &reading.pose) {
                estimate.follow(chain);
                estimate.change(reading.robot, &change);
            }
        }
        let mut fit = Fit { tested: readings.len() as u32, ..Fit::default() };
        rows.clear();
        judged.clear();
        for reading in readings {
            let row = row_of(estimate, reading, chain);
            let nu = row.innovation.innovation;
            let normalised_square = nu * nu / estimate.variance(&row, chain);
            let used = use_of(reading, gate.passes(normalised_square));
            fit.failed[reading.kind as usize].set(reading.robot, gate.fails(normalised_square));
            fit.fused += u32::from(used == FusionDecision::Fused);
            rows.push(row);
            judged.push(GateResult { used, normalised_square: Some(normalised_square) });
        }
        fit.rejected = fit.tested - fit.fused;
        if fit.rejected > 0 {
            fit.nis_all = estimate.nis(rows.iter(), chain, scratch);
        }
        if fit.fused > 0 {
            let fused = rows.iter().zip(judged.iter()).filter(|(_, judged)| judged.used == FusionDecision::Fused);
            fit.nis = estimate.update(fused.map(|(row, _)| row), chain, scratch);
        }
        if fit.rejected == 0 {
            fit.nis_all = fit.nis;
        }
        fit
    }

    fn judged(&self) -> &[GateResult] {
        &self.judged
    }

    fn widen(&mut self, factor: f64) {
        self.estimate.widen(factor);
    }

    fn state(&self) -> &[f64] {
        self.estimate.target.x.as_slice()
    }

    fn covariance(&self) -> &[f64] {
        self.estimate.target.p.as_slice()
    }

    fn save(&self, bytes: &mut Vec<u8>) -> Result<(), SealError> {
        sealed::encode_into(&(&self.estimate, self.chain.saved()), bytes)
    }

    fn restore(&mut self, bytes: &[u8]) -> Result<(), SealError> {
        let (estimate, known): (Estimate<N>, Vec<Known>) = sealed::decode(bytes)?;
        if !estimate.is_of_team(self.chain.robots()) || !self.chain.restore(&known) {
            return Err(SealError::Malformed);
        }
        self.estimate = estimate;
        Ok(())
    }

    fn predict_into(&self, dt_s: f64, belief: &mut Belief) {
        belief.assign(&if self.transition.0 == dt_s {
            self.estimate.target.predict(&self.transition.1)
        } else {
            self.estimate.target.predict(&self.motion.transition(dt_s))
        });
    }
}
