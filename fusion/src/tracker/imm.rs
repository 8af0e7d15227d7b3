//! The tracker of recordings: interacting multiple models, one calm and one manoeuvring.
//!
//! One process noise does not fit a target that drives straight most of the time and sometimes turns: a filter that
//! follows the turns is noisy on the straights. Two banks with different process noise run side by side. The likelihood
//! of the ranges gives the probability of each, and each step starts both from mixtures of their estimates (Blom &
//! Bar-Shalom, "The Interacting Multiple Model Algorithm", 1988).

use rangehound_shared::motion::MotionModel;
use rangehound_shared::record::GateResult;
use rangehound_shared::sealed::{self, SealError};

use super::bank::{Bank, Hypothesis, SavedBank, merge, mixture_of};
use super::{Fit, Gate, Reading, Tracker};
use crate::belief::Belief;
use crate::filter::Gaussian;
use crate::nuisance::Chain;

/// Process noise of the calm model as a share of the given one, which the manoeuvring model has. A smaller share makes
/// straights smoother, but biased ranges have more effect.
const CALM_SHARE: f64 = 0.3;

/// Mean time for which a target keeps to one model, s.
const DWELL_S: f64 = 20.0;

/// Least probability of a model, so that it can become probable again.
const PROBABILITY_MIN: f64 = 1e-6;

/// Two banks and the probability of each.
#[derive(Debug, Clone)]
pub struct Imm<const N: usize> {
    motion: MotionModel,
    modes: [Mode<N>; 2],
    estimate: Gaussian<N>,
}

#[derive(Debug, Clone)]
struct Mode<const N: usize> {
    probability: f64,
    bank: Bank<N>,
}

impl<const N: usize> Imm<N> {
    /// A tracker without a prior. `motion` has the process noise of the manoeuvring model.
    #[must_use]
    pub fn new(motion: &MotionModel, gate: Gate, chain: Chain) -> Self {
        let calm = match motion {
            MotionModel::IntegratorChain { order, noise_psd } => {
                MotionModel::IntegratorChain { order: *order, noise_psd: noise_psd * CALM_SHARE }
            }
            custom @ MotionModel::Custom { .. } => custom.clone(),
        };
        let modes = [(motion.clone(), chain.clone()), (calm, chain)]
            .map(|(motion, chain)| Mode { probability: 0.5, bank: Bank::new(motion, gate, chain) });
        let estimate = *modes[0].bank.estimate();
        Self { motion: motion.clone(), modes, estimate }
    }

    /// The same tracker, started from this estimate.
    #[must_use]
    pub fn starting_from(mut self, estimate: Gaussian<N>) -> Self {
        self.modes = self.modes.map(|mode| Mode { bank: mode.bank.starting_from(estimate), ..mode });
        self.estimate = estimate;
        self
    }

    /// Predicts the models' probabilities over a step, and mixes their estimates, weighted by the probabilities that
    /// the target changed from one model to the other. Estimates are mixed only if each bank has a single hypothesis.
    fn interact(&mut self, dt_s: f64) {
        let stay = 0.5 + 0.5 * (-2.0 * dt_s / DWELL_S).exp();
        let before = [self.modes[0].probability, self.modes[1].probability];
        let predicted = [0, 1].map(|j| stay * before[j] + (1.0 - stay) * before[1 - j]);
        let [a, b] = &mut self.modes;
        if let (Some(a), Some(b)) = (a.bank.settled(), b.bank.settled()) {
            let estimates = [a.clone(), b.clone()];
            for (j, into) in [a, b].into_iter().enumerate() {
                let came_by = |i: usize| if i == j { stay } else { 1.0 - stay };
                let mixed = [0, 1].map(|i| Hypothesis {
                    log_weight: (came_by(i) * before[i]).max(f64::MIN_POSITIVE).ln(),
                    estimate: estimates[i].clone(),
                });
                merge(into, &mixed);
            }
        }
        for (mode, probability) in self.modes.iter_mut().zip(predicted) {
            mode.probability = probability;
        }
    }

    /// Index of the more probable model.
    fn more_probable(&self) -> usize {
        usize::from(self.modes[0].probability < self.modes[1].probability)
    }

    /// Updates the models' probabilities with the likelihoods of the ranges.
    fn weigh(&mut self) {
        let best = self.modes.iter().map(|mode| mode.bank.log_likelihood()).fold(f64::MIN, f64::max);
        let weights = [0, 1].map(|j| self.modes[j].probability * (self.modes[j].bank.log_likelihood() - best).exp());
        let total: f64 = weights.iter().sum();
        for (mode, weight) in self.modes.iter_mut().zip(weights) {
            mode.probability = (weight / total).clamp(PROBABILITY_MIN, 1.0 - PROBABILITY_MIN);
        }
        let total: f64 = self.modes.iter().map(|mode| mode.probability).sum();
        let modes = &self.modes;
        self.estimate = mixture_of(|| modes.iter().map(move |mode| (mode.probability / total, mode.bank.estimate())));
    }
}

impl<const N: usize> Tracker for Imm<N> {
    fn step(&mut self, dt_s: f64, readings: &[Reading]) -> Fit {
        self.interact(dt_s);
        let fits = [0, 1].map(|j| self.modes[j].bank.advance(dt_s, readings));
        self.weigh();
        fits[self.more_probable()]
    }

    fn judged(&self) -> &[GateResult] {
        self.modes[self.more_probable()].bank.judged()
    }

    fn widen(&mut self, _factor: f64) {
        // The banks recover by themselves when rejections show a lock-out.
    }

    fn state(&self) -> &[f64] {
        self.estimate.x.as_slice()
    }

    fn covariance(&self) -> &[f64] {
        self.estimate.p.as_slice()
    }

    fn save(&self, bytes: &mut Vec<u8>) -> Result<(), SealError> {
        let [a, b] = &self.modes;
        let modes = [(a.probability, a.bank.saved()), (b.probability, b.bank.saved())];
        sealed::encode_into(&(modes, &self.estimate), bytes)
    }

    fn restore(&mut self, bytes: &[u8]) -> Result<(), SealError> {
        let (modes, estimate): ([(f64, SavedBank<'_, N>); 2], Gaussian<N>) = sealed::decode(bytes)?;
        for (mode, (probability, bank)) in self.modes.iter_mut().zip(modes) {
            mode.probability = probability;
            mode.bank.restore(bank)?;
        }
        self.estimate = estimate;
        Ok(())
    }

    fn predict_into(&self, dt_s: f64, belief: &mut Belief) {
        belief.assign(&self.estimate.predict(&self.motion.transition(dt_s)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;
    use rangehound_shared::measurement::Pose;
    use rangehound_shared::scenario::{NuisanceSpec, Treatment};

    fn exact() -> Chain {
        Chain::of(vec![NuisanceSpec::default()], Treatment::Schmidt)
    }

    /// Ranges from four corners, ten a second, to a target that drives straight, then in circles.
    fn probabilities_of_the_calm_model() -> (f64, f64) {
        let motion = MotionModel::IntegratorChain { order: 2, noise_psd: 1.0 };
        let mut imm = Imm::<4>::new(&motion, Gate::new(Some(4.0)), exact());
        let (mut position, mut velocity) = (Vector2::new(5.0, 5.0), Vector2::new(0.5, 0.0));
        let mut on_the_straight = 0.0;
        for k in 0..1_200 {
            if k == 600 {
                on_the_straight = imm.modes[1].probability;
            }
            let turn_rad = if k < 600 { 0.0 } else { 0.15 };
            let (sin, cos) = f64::sin_cos(turn_rad);
            velocity = Vector2::new(cos * velocity.x - sin * velocity.y, sin * velocity.x + cos * velocity.y);
            if k == 600 {
                velocity *= 4.0;
            }
            position += velocity * 0.1;
            let corner = [(0.0, 0.0), (40.0, 0.0), (40.0, 40.0), (0.0, 40.0)][k % 4];
            let pose = Pose::at([corner.0, corner.1]);
            let value = (position - pose.position_m()).norm() + 0.03 * (k as f64 * 2.399).sin();
            imm.step(0.1, &[Reading { pose, value, std: 0.05, ..Reading::default() }]);
        }
        assert!((imm.estimate.position() - position).norm() < 0.3);
        (on_the_straight, imm.modes[1].probability)
    }

    #[test]
    fn the_ranges_distinguish_the_calm_from_the_turning_target() {
        let (straight, turning) = probabilities_of_the_calm_model();
        assert!(straight > 0.8 && turning < 0.2, "{straight} {turning}");
    }

    #[test]
    fn a_long_pause_and_steps_without_time_are_survived() {
        let motion = MotionModel::IntegratorChain { order: 2, noise_psd: 1.0 };
        let mut imm = Imm::<4>::new(&motion, Gate::new(Some(4.0)), exact());
        for dt_s in [0.0, 0.0, 1e6, 0.0, 1.0, 1e6, 0.1] {
            for x in [0.0, 10.0, 0.0] {
                let pose = Pose::at([x, 0.0]);
                imm.step(dt_s, &[Reading { pose, value: 7.0, std: 0.1, ..Reading::default() }]);
                assert!(imm.state().iter().chain(imm.covariance()).all(|value| value.is_finite()));
            }
        }
    }
}
