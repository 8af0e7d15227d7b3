//! The measurements of a robot, and the errors that stay: of its sensor and of its own pose.

use std::f64::consts::TAU;

use serde::{Deserialize, Serialize};

use super::bounds;

/// The name that `compare` uses for what the scenario itself gives each robot, beside named sensors and localisers.
pub const OWN: &str = "own";

/// The name that `compare` uses for localisers without errors.
pub const EXACT: &str = "exact";

/// The measurements of a robot, and their noise.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SensorSpec {
    /// Noise of its ranges; `None` if it measures none.
    pub range: Option<RangeNoise>,
    /// Standard deviation of its bearings, rad; `None` if it measures none.
    pub bearing_std_rad: Option<f64>,
    /// It measures nothing of a target farther away, m; `None` without a limit.
    pub max_range_m: Option<f64>,
    /// It measures nothing outside this angle, which is centred on its heading, rad; `None` if it sees all around.
    pub field_of_view_rad: Option<f64>,
}

/// Noise of a range: its standard deviation is `std_m + std_per_m d` at distance `d`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RangeNoise {
    /// At distance 0, m.
    pub std_m: f64,
    /// Growth with the distance.
    pub std_per_m: f64,
}

/// Systematic error of a range sensor: `measured = (1 + scale) true + bias_m`.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Calibration {
    /// Bias, m.
    pub bias_m: f64,
    /// Relative error that grows with the distance.
    pub scale: f64,
}

/// Standard deviations of a robot's nuisances: errors that are not the target's, and that stay for a while.
///
/// The position's error `e` follows `e_k+1 = f e_k + w_k` on each axis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct NuisanceSpec {
    /// Standard deviation of each coordinate of the position, m; at the start, if it drifts.
    pub pose_std_m: f64,
    /// Drift of each coordinate, m per square root of a second.
    pub pose_drift_m: f64,
    /// Standard deviation of the heading, rad.
    pub heading_std_rad: f64,
    /// How long the errors of position and heading stay.
    pub correlation: PoseCorrelation,
    /// Standard deviation of the bias of its ranges, m.
    pub bias_std_m: f64,
    /// Time after which the bias is another, s; `None` if it is constant.
    pub bias_correlation_s: Option<f64>,
}

/// How long the error of a robot's pose stays.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub enum PoseCorrelation {
    /// Not stated. The filter infers it from the covariances that the robot reports: a growing one is a drift, a shrinking
    /// one a correction.
    #[default]
    Inferred,
    /// Each pose has an error of its own: `f = 0`.
    White,
    /// A Gauss-Markov process with this time, s: `f = exp(-dt / time)`.
    Time(f64),
    /// A sum of independent steps, as of odometry: `f = 1`.
    Drift,
}

/// The filter's treatment of nuisances.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Treatment {
    /// Nothing: poses count as exact.
    Ignored,
    /// They widen the variance of each measurement, as if they were independent from one to the next.
    Inflated,
    /// The Schmidt filter: it follows how far the target's error depends on them, and does not estimate them.
    Schmidt,
    /// Some of them are estimated with the target, the rest as by Schmidt.
    Estimated {
        /// The biases of the ranges.
        bias: bool,
        /// The errors of the poses.
        pose: bool,
    },
}

impl SensorSpec {
    /// Ranges of constant noise, of targets at any distance in any direction.
    #[must_use]
    pub fn range(std_m: f64) -> Self {
        let range = Some(RangeNoise { std_m, std_per_m: 0.0 });
        Self { range, bearing_std_rad: None, max_range_m: None, field_of_view_rad: None }
    }

    /// The standard deviation of its ranges if it measures ranges of constant noise and nothing else, m.
    #[must_use]
    pub fn constant_range_std_m(&self) -> Option<f64> {
        let Self { range, bearing_std_rad, max_range_m, field_of_view_rad } = *self;
        let is_unlimited = max_range_m.is_none() && field_of_view_rad.is_none_or(|angle_rad| angle_rad >= TAU);
        let range = range.filter(|range| range.std_per_m == 0.0 && bearing_std_rad.is_none() && is_unlimited)?;
        Some(range.std_m)
    }

    /// Distance up to which it measures, m; infinite without a limit.
    #[must_use]
    pub fn reach_m(&self) -> f64 {
        self.max_range_m.unwrap_or(f64::INFINITY)
    }

    /// Angle in which it measures, rad; a full turn if it sees all around.
    #[must_use]
    pub fn view_rad(&self) -> f64 {
        self.field_of_view_rad.unwrap_or(TAU)
    }

    /// True if it measures something, and its numbers are within their bounds.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        let Self { range, bearing_std_rad, max_range_m, field_of_view_rad } = *self;
        (range.is_some() || bearing_std_rad.is_some())
            && range.is_none_or(|range| {
                bounds::STD_M.contains(&range.std_m) && bounds::STD_PER_M.contains(&range.std_per_m)
            })
            && bearing_std_rad.is_none_or(|std_rad| bounds::BEARING_STD_RAD.contains(&std_rad))
            && max_range_m.is_none_or(|limit_m| bounds::MAX_RANGE_M.contains(&limit_m))
            && field_of_view_rad.is_none_or(|angle_rad| bounds::FIELD_OF_VIEW_RAD.contains(&angle_rad))
    }
}

impl RangeNoise {
    /// The standard deviation at a distance, m.
    #[must_use]
    pub fn std_at_m(&self, distance_m: f64) -> f64 {
        self.std_m + self.std_per_m * distance_m.max(0.0)
    }
}

impl Default for NuisanceSpec {
    /// Exact poses and unbiased ranges.
    fn default() -> Self {
        Self {
            pose_std_m: 0.0,
            pose_drift_m: 0.0,
            heading_std_rad: 0.0,
            correlation: PoseCorrelation::Inferred,
            bias_std_m: 0.0,
            bias_correlation_s: None,
        }
    }
}

impl NuisanceSpec {
    /// Variance of each coordinate of the position this long after the start, m^2.
    #[must_use]
    pub fn position_variance_m2(&self, elapsed_s: f64) -> f64 {
        self.pose_std_m * self.pose_std_m + self.pose_drift_m * self.pose_drift_m * elapsed_s.max(0.0)
    }

    /// True if its numbers are within their bounds.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        let stds = [self.pose_std_m, self.pose_drift_m, self.bias_std_m];
        let time_s = match self.correlation {
            PoseCorrelation::Time(time_s) => Some(time_s),
            _ => None,
        };
        stds.iter().all(|std| bounds::NUISANCE_STD_M.contains(std))
            && bounds::HEADING_STD_RAD.contains(&self.heading_std_rad)
            && [time_s, self.bias_correlation_s].iter().flatten().all(|time_s| bounds::CORRELATION_S.contains(time_s))
    }
}
