//! The planner's input.

use nalgebra::Matrix2;
use rangehound_shared::motion::MotionModel;
use rangehound_shared::scenario::{Clearance, Criterion, SensorSpec};

use crate::belief::Belief;
use crate::vector::Vector;

/// Knowledge before a step: the target, the robots and their clearances.
#[derive(Debug, Clone, PartialEq)]
pub struct Situation {
    /// The target when the robots measure next, predicted: with none of those measurements.
    pub belief: Belief,
    /// The target's motion model, of the belief's dimension.
    pub motion: MotionModel,
    /// The robots that move and measure.
    pub team: Vec<TeamMember>,
    /// Clearances at the end of a step.
    pub clearance: Clearance,
    /// The criterion that the planner minimises.
    pub criterion: Criterion,
    /// A step of the horizon, s: how long the robots move before they measure. The planner chooses its
    /// horizon.
    pub step_s: f64,
}

/// A robot as a planner sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TeamMember {
    /// Where it is believed to be, m.
    pub position_m: Vector,
    /// Covariance of that, m^2; zero if it is known.
    pub position_covariance_m2: Matrix2<f64>,
    /// Standard deviation of its heading, rad: bearings are measured from it.
    pub heading_std_rad: f64,
    /// Its speed limit, m/s.
    pub max_speed_mps: f64,
    /// Its sensor.
    pub sensor: SensorSpec,
    /// True if its measurements will be fused. Otherwise it is sent to where they would add most, and is not counted.
    pub is_fused: bool,
}

impl Default for Situation {
    /// No robots, and a target at rest.
    fn default() -> Self {
        Self {
            belief: Belief::default(),
            motion: MotionModel::IntegratorChain { order: 1, noise_psd: 0.0 },
            team: Vec::new(),
            clearance: Clearance::default(),
            criterion: Criterion::default(),
            step_s: 0.0,
        }
    }
}

impl TeamMember {
    /// A robot that knows where it is and measures ranges of this standard deviation, all to be fused.
    #[must_use]
    pub fn ranging(position_m: Vector, max_speed_mps: f64, range_std_m: f64) -> Self {
        Self {
            position_m,
            position_covariance_m2: Matrix2::zeros(),
            heading_std_rad: 0.0,
            max_speed_mps,
            sensor: SensorSpec::range(range_std_m),
            is_fused: true,
        }
    }
}

impl Situation {
    /// True if all robots know where they are and measure ranges of constant noise alone: then each turns a vector of
    /// constant length, as in the paper.
    #[must_use]
    pub fn is_range_only(&self) -> bool {
        self.team.iter().all(|member| {
            member.sensor.constant_range_std_m().is_some() && member.position_covariance_m2 == Matrix2::zeros()
        })
    }
}
