//! The estimate over time: prediction to each tick, gate, update.
//!
//! | tracker | for |
//! |---|---|
//! | [`kalman`] | a Gaussian prior: the paper's extended Kalman filter |
//! | [`bank`] | a Gaussian prior and one or two robots, whose ranges leave mirror images |
//! | [`imm`] | no prior, as for recordings: a calm and a manoeuvring model side by side, each with a [`bank`] of such filters that starts without a prior |

pub mod bank;
pub mod imm;
pub mod kalman;

use nalgebra::SVector;
use rangehound_shared::ROBOTS_MAX;
use rangehound_shared::measurement::{Kind, Pose};
use rangehound_shared::record::{FusionDecision, GateResult};
use rangehound_shared::robot_set::RobotSet;
use rangehound_shared::scenario::{Prior, Scenario, Source, defaults};
use rangehound_shared::sealed::SealError;
use rangehound_shared::with_state_dim;
use serde::{Deserialize, Serialize};

use crate::belief::Belief;
use crate::filter::Gaussian;
use crate::nuisance::Chain;

/// One calibrated range or bearing, with the pose from which it was measured.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Reading {
    /// The robot that measured it.
    pub robot: usize,
    /// Its kind.
    pub kind: Kind,
    /// Pose of the robot, as it knows it.
    pub pose: Pose,
    /// The range, m, or the bearing from the robot's heading, rad.
    pub value: f64,
    /// Standard deviation of the measurement, m or rad.
    pub std: f64,
    /// Growth of a range's standard deviation with the distance.
    pub std_per_m: f64,
    /// True if it is tested against the gate and not fused.
    pub distrusted: bool,
}

/// How a tick's measurements agreed with the estimate.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Fit {
    /// Normalised innovation squared of the joint update.
    pub nis: f64,
    /// Measurements fused: the NIS's degrees of freedom.
    pub fused: u32,
    /// Normalised innovation squared of all of the tick's measurements, fused or not.
    pub nis_all: f64,
    /// Measurements in [`Self::nis_all`], its degrees of freedom: all that were predicted.
    pub tested: u32,
    /// Measurements not fused: they failed the gate, or their sensors are distrusted.
    pub rejected: u32,
    /// Robots whose measurements of each [`Kind`] failed the gate, or the default gate if there is none.
    pub failed: [RobotSet; Kind::COUNT],
}

/// An estimate of the target that is updated with measurements. A tracker does no I/O, has no clock, and allocates nothing
/// after its construction.
pub trait Tracker: std::fmt::Debug + Send {
    /// Predicts over `dt_s` seconds, then updates with the readings, taken in order.
    fn step(&mut self, dt_s: f64, readings: &[Reading]) -> Fit;

    /// How the last step used each of its readings, in their order.
    fn judged(&self) -> &[GateResult];

    /// Multiplies the estimate's covariance by this factor, because the target may be lost. Trackers that recover by
    /// themselves ignore it.
    fn widen(&mut self, factor: f64);

    /// The state, position first.
    fn state(&self) -> &[f64];

    /// The covariance, n x n; symmetric, so its order of storage does not matter.
    fn covariance(&self) -> &[f64];

    /// Appends the state from which [`Self::restore`] continues, to the bit.
    ///
    /// # Errors
    /// If the state cannot be encoded.
    fn save(&self, bytes: &mut Vec<u8>) -> Result<(), SealError>;

    /// Continues from the state that a tracker of the same scenario saved.
    ///
    /// # Errors
    /// If the bytes are not such a state.
    fn restore(&mut self, bytes: &[u8]) -> Result<(), SealError>;

    /// Predicts over `dt_s` seconds (k+1|k), for the planner.
    fn predict_into(&self, dt_s: f64, belief: &mut Belief);
}

/// Buffers for a tracker's results on a tick's readings, so that no step allocates.
fn judged_room() -> Vec<GateResult> {
    Vec::with_capacity(Kind::COUNT * ROBOTS_MAX)
}

/// How a reading is used that passed the gate or failed it.
fn use_of(reading: &Reading, passed: bool) -> FusionDecision {
    match (reading.distrusted, passed) {
        (true, _) => FusionDecision::Distrusted,
        (false, true) => FusionDecision::Fused,
        (false, false) => FusionDecision::Rejected,
    }
}

/// Fewest robots with ranges, or with anything else, for which a prior is enough: fewer leave mirror images, which one
/// Gaussian cannot hold.
const KALMAN_ROBOTS_MIN: usize = 3;

/// The tracker that a scenario asks for.
#[must_use]
pub fn for_scenario(scenario: &Scenario) -> Box<dyn Tracker> {
    let motion = scenario.filter_motion.clone();
    let gate = Gate::new(scenario.gate_sigma);
    let chain = Chain::new(scenario);
    with_state_dim!(motion.state_dim(), N => match &scenario.prior {
        Prior::Gaussian { mean, covariance } => {
            let x = SVector::from_fn(|i, _| mean.get(i).copied().unwrap_or(0.0));
            let prior = Gaussian { x, p: covariance.to_static() };
            match scenario.source {
                // A recording with a known start is tracked like other recordings, but from this estimate.
                Source::Recorded(_) => Box::new(imm::Imm::<N>::new(&motion, gate, chain).starting_from(prior)),
                Source::Simulated { .. } if scenario.robots.len() < KALMAN_ROBOTS_MIN => {
                    Box::new(bank::Bank::<N>::new(motion, gate, chain).finely().starting_from(prior))
                }
                Source::Simulated { .. } => Box::new(kalman::Kalman::<N>::new(motion, prior, gate, chain)),
            }
        }
        Prior::FromRanges => Box::new(imm::Imm::<N>::new(&motion, gate, chain)),
    })
}

/// Chi-square gate with one degree of freedom on a single range.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gate {
    threshold: f64,
    /// Threshold for a robot's failures: the gate's, or the default gate's if all ranges are fused.
    failure_threshold: f64,
}

impl Gate {
    /// A gate that passes ranges whose innovations are within `sigma` standard deviations; `None` passes all.
    #[must_use]
    pub fn new(sigma: Option<f64>) -> Self {
        let square = |sigma: f64| sigma * sigma;
        Self {
            threshold: sigma.map_or(f64::INFINITY, square),
            failure_threshold: square(sigma.unwrap_or(defaults::RECORDED_GATE_SIGMA)),
        }
    }

    /// True if it passes everything.
    #[must_use]
    pub fn is_open(self) -> bool {
        self.threshold == f64::INFINITY
    }

    /// True if a range with this normalised innovation squared is to be fused.
    #[must_use]
    pub fn passes(self, normalised_square: f64) -> bool {
        normalised_square <= self.threshold
    }

    /// True if a range with this normalised innovation squared counts as a failure of its robot.
    #[must_use]
    pub fn fails(self, normalised_square: f64) -> bool {
        normalised_square > self.failure_threshold || normalised_square.is_nan()
    }
}
