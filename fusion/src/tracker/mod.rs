//! The estimate over time: prediction to each tick, gate, update.
//!
//! | tracker | for |
//! |---|---|
//! | [`kalman`] | a Gaussian prior: the paper's extended Kalman filter |
//! | [`imm`] | no prior, as for recordings: a calm and a manoeuvring model side by side, each with a [`bank`] of such filters that starts from the ranges alone |

pub mod bank;
pub mod imm;
pub mod kalman;

use nalgebra::{SVector, Vector2};
use rangehound_shared::ROBOTS_MAX;
use rangehound_shared::record::{Judged, RangeUse};
use rangehound_shared::robot_set::RobotSet;
use rangehound_shared::scenario::{Prior, Scenario, Source, defaults};
use rangehound_shared::sealed::SealError;
use rangehound_shared::with_state_dim;
use serde::{Deserialize, Serialize};

use crate::belief::Belief;
use crate::filter::Gaussian;

/// One range, as fused: calibrated, with the place it was measured from.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Reading {
    /// Whose it is.
    pub robot: usize,
    /// Where the robot was, m.
    pub position_m: Vector2<f64>,
    /// Height of its sensor above the plane in which the target moves, m.
    pub height_m: f64,
    /// What it measured, m.
    pub range_m: f64,
    /// Standard deviation of the measurement, m.
    pub range_std_m: f64,
    /// True if it is only to be tested against the gate, not to be fused.
    pub distrusted: bool,
}

/// How a tick's ranges agreed with the estimate.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Fit {
    /// Normalised innovation squared of the joint update.
    pub nis: f64,
    /// Ranges fused: the NIS's degrees of freedom.
    pub fused: u32,
    /// Normalised innovation squared of all ranges, fused or not: of the tick's ranges jointly.
    pub nis_all: f64,
    /// Ranges in it, its degrees of freedom: all that anything predicted.
    pub tested: u32,
    /// Ranges not fused: they failed the gate, or were only to be tested.
    pub rejected: u32,
    /// Robots whose range speaks against them: it failed the gate, or would have failed the default one where there is none.
    pub failed: RobotSet,
}

/// An estimate of the target that follows its ranges. Does no I/O, knows no clock, and after its
/// construction allocates nothing.
pub trait Tracker: std::fmt::Debug + Send {
    /// Predicts over `dt_s` seconds, then updates with the readings, taken in order.
    fn step(&mut self, dt_s: f64, readings: &[Reading]) -> Fit;

    /// What the last step did with each of its readings, in their order.
    fn judged(&self) -> &[Judged];

    /// Takes the estimate to be this many times less certain, in variance: it may be lost. Trackers that find the target
    /// again by themselves leave it at that.
    fn widen(&mut self, factor: f64);

    /// The state, position first.
    fn state(&self) -> &[f64];

    /// The covariance, n x n; symmetric, so its order of storage does not matter.
    fn covariance(&self) -> &[f64];

    /// Appends what [`Self::restore`] needs to go on from here, to the bit.
    ///
    /// # Errors
    /// If it cannot be encoded.
    fn save(&self, bytes: &mut Vec<u8>) -> Result<(), SealError>;

    /// Goes on from what a tracker of the same scenario saved.
    ///
    /// # Errors
    /// If the bytes are not such.
    fn restore(&mut self, bytes: &[u8]) -> Result<(), SealError>;

    /// Predicts over `dt_s` seconds (k+1|k), for the planner.
    fn predict_into(&self, dt_s: f64, belief: &mut Belief);
}

/// Buffers for a tracker's results on a tick's readings, so that no step allocates.
fn judged_room() -> Vec<Judged> {
    Vec::with_capacity(ROBOTS_MAX)
}

/// What becomes of a reading that passed the gate or failed it.
fn use_of(reading: &Reading, passed: bool) -> RangeUse {
    match (reading.distrusted, passed) {
        (true, _) => RangeUse::Distrusted,
        (false, true) => RangeUse::Fused,
        (false, false) => RangeUse::Rejected,
    }
}

/// The tracker that a scenario asks for.
#[must_use]
pub fn for_scenario(scenario: &Scenario) -> Box<dyn Tracker> {
    let motion = scenario.filter_motion.clone();
    let gate = Gate::new(scenario.gate_sigma);
    with_state_dim!(motion.state_dim(), N => match &scenario.prior {
        // A recording whose start is known is tracked as others are, once they have found the target.
        Prior::Gaussian { mean, covariance } if matches!(scenario.source, Source::Recorded(_)) => {
            let x = SVector::from_fn(|i, _| mean.get(i).copied().unwrap_or(0.0));
            Box::new(imm::Imm::<N>::new(&motion, gate).starting_from(Gaussian { x, p: covariance.to_static() }))
        }
        Prior::Gaussian { mean, covariance } => {
            Box::new(kalman::Kalman::<N>::new(motion, mean, covariance, gate))
        }
        Prior::FromRanges => Box::new(imm::Imm::<N>::new(&motion, gate)),
    })
}

/// Chi-square gate with one degree of freedom on a single range.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gate {
    threshold: f64,
    /// What counts as a failure when a robot is judged: the gate, or the default one where all ranges are fused.
    failure_threshold: f64,
}

impl Gate {
    /// Passes a range whose innovation is within `sigma` of its standard deviations; `None` passes all.
    #[must_use]
    pub fn new(sigma: Option<f64>) -> Self {
        let square = |sigma: f64| sigma * sigma;
        Self {
            threshold: sigma.map_or(f64::INFINITY, square),
            failure_threshold: square(sigma.unwrap_or(defaults::RECORDED_GATE_SIGMA)),
        }
    }

    /// True if a range with this normalised innovation squared is to be fused.
    #[must_use]
    pub fn passes(self, normalised_square: f64) -> bool {
        normalised_square <= self.threshold
    }

    /// True if a range with this normalised innovation squared speaks against its robot.
    #[must_use]
    pub fn fails(self, normalised_square: f64) -> bool {
        normalised_square > self.failure_threshold || normalised_square.is_nan()
    }
}
