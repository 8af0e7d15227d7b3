//! Bounds on inputs: they keep all later products and quotients finite.

use std::ops::RangeInclusive;

/// A coordinate, m.
pub const COORDINATE: RangeInclusive<f64> = -1e8..=1e8;
/// An entry of a target's state.
pub const STATE: RangeInclusive<f64> = -1e8..=1e8;
/// Length of a time step, s.
pub const DT_S: RangeInclusive<f64> = 1e-4..=1e4;
/// A speed limit, m/s.
pub const SPEED_MPS: RangeInclusive<f64> = 0.0..=1e5;
/// Standard deviation of a range, m.
pub const STD_M: RangeInclusive<f64> = 1e-4..=1e5;
/// Growth of that with the distance.
pub const STD_PER_M: RangeInclusive<f64> = 0.0..=10.0;
/// Standard deviation of a bearing, rad.
pub const BEARING_STD_RAD: RangeInclusive<f64> = 1e-5..=3.2;
/// Standard deviation of a heading, rad.
pub const HEADING_STD_RAD: RangeInclusive<f64> = 0.0..=3.2;
/// Distance up to which a sensor measures, m.
pub const MAX_RANGE_M: RangeInclusive<f64> = 1e-3..=1e8;
/// Angle in which a sensor measures, rad.
pub const FIELD_OF_VIEW_RAD: RangeInclusive<f64> = 1e-3..=6.3;
/// Spectral density of a target's noise.
pub const NOISE_PSD: RangeInclusive<f64> = 0.0..=1e9;
/// A gate, in standard deviations of an innovation.
pub const GATE_SIGMA: RangeInclusive<f64> = 1.0..=1e6;
/// A variance.
pub const VARIANCE: RangeInclusive<f64> = 1e-9..=1e12;
/// Any entry of a matrix.
pub const MATRIX_ENTRY: RangeInclusive<f64> = -1e12..=1e12;
/// Least eigenvalue of a covariance, relative to its largest entry: below it, inverses are noise.
pub const RELATIVE_EIGENVALUE_MIN: f64 = 1e-13;
/// Silence after which a robot is left out, s.
pub const TIMEOUT_S: RangeInclusive<f64> = 1e-3..=1e6;
/// Bias of a range sensor, m.
pub const BIAS_M: RangeInclusive<f64> = -1e5..=1e5;
/// Scale error of a range sensor.
pub const SCALE: RangeInclusive<f64> = -0.9..=10.0;
/// A clearance, m or standard deviations.
pub const CLEARANCE: RangeInclusive<f64> = 0.0..=1e6;
/// Most time steps of a run.
pub const TICKS_MAX: u64 = 1_000_000_000;
/// Standard deviation of a known start, m.
pub const START_STD_M: RangeInclusive<f64> = 1e-3..=1e5;
/// Standard deviation of a nuisance: of a position or of a bias, m; a drift, m per square root of a second.
pub const NUISANCE_STD_M: RangeInclusive<f64> = 0.0..=1e5;
/// Time for which an error stays, s.
pub const CORRELATION_S: RangeInclusive<f64> = 1e-3..=1e9;
/// Most robots whose nuisances can be estimated: memory and time grow with the square.
pub const ESTIMATED_ROBOTS_MAX: usize = 32;
