//! The planner's input.

use rangehound_shared::motion::MotionModel;
use rangehound_shared::scenario::Clearance;

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
    /// A step of the horizon, s: how long the robots move before they measure. The planner chooses its
    /// horizon.
    pub step_s: f64,
}

/// A robot as a planner sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TeamMember {
    /// Where it is, m.
    pub position_m: Vector,
    /// Its speed limit, m/s.
    pub max_speed_mps: f64,
    /// Its sensor.
    pub sensor: Sensor,
    /// True if its measurements will be fused. Otherwise it is sent to where they would add most, and is not counted.
    pub is_fused: bool,
}

/// A robot's sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Sensor {
    /// The distance to the target.
    Range {
        /// Standard deviation, m.
        std_m: f64,
    },
}

impl Default for Situation {
    /// No robots, and a target at rest.
    fn default() -> Self {
        Self {
            belief: Belief::default(),
            motion: MotionModel::IntegratorChain { order: 1, noise_psd: 0.0 },
            team: Vec::new(),
            clearance: Clearance::default(),
            step_s: 0.0,
        }
    }
}

impl TeamMember {
    /// A robot that measures ranges of this standard deviation, all to be fused.
    #[must_use]
    pub fn ranging(position_m: Vector, max_speed_mps: f64, range_std_m: f64) -> Self {
        Self { position_m, max_speed_mps, sensor: Sensor::Range { std_m: range_std_m }, is_fused: true }
    }
}
