//! The planner's input.

use std::f64::consts::TAU;

use nalgebra::Matrix2;
use rangehound_shared::motion::MotionModel;
use rangehound_shared::scenario::{Clearance, Criterion};

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
    /// What the planner is to make small.
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
    pub sensor: Sensor,
    /// True if its measurements will be fused. Otherwise it is sent to where they would add most, and is not counted.
    pub is_fused: bool,
}

/// What a robot measures of the target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sensor {
    /// Noise of its ranges; `None` if it measures none.
    pub range: Option<RangeNoise>,
    /// Standard deviation of its bearings, rad; `None` if it measures none.
    pub bearing_std_rad: Option<f64>,
    /// It measures nothing of a target farther away, m.
    pub max_range_m: f64,
    /// It measures nothing outside this angle, which is centred on its heading, rad.
    pub field_of_view_rad: f64,
}

/// Noise of a range: its standard deviation is `std_m + std_per_m d` at distance `d`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RangeNoise {
    /// At distance 0, m.
    pub std_m: f64,
    /// Growth with the distance.
    pub std_per_m: f64,
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

impl Sensor {
    /// Ranges of constant noise, of targets at any distance in any direction.
    #[must_use]
    pub fn range(std_m: f64) -> Self {
        let range = Some(RangeNoise { std_m, std_per_m: 0.0 });
        Self { range, bearing_std_rad: None, max_range_m: f64::INFINITY, field_of_view_rad: TAU }
    }

    /// The standard deviation of its ranges if it measures ranges of constant noise and nothing else, m.
    #[must_use]
    pub fn constant_range_std_m(&self) -> Option<f64> {
        let Self { range, bearing_std_rad, max_range_m, field_of_view_rad } = *self;
        let is_unlimited = max_range_m == f64::INFINITY && field_of_view_rad >= TAU;
        let range = range.filter(|range| range.std_per_m == 0.0 && bearing_std_rad.is_none() && is_unlimited)?;
        Some(range.std_m)
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
            sensor: Sensor::range(range_std_m),
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
