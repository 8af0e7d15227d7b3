//! Plausibility of messages: of the numbers in each, and of a robot's motion since its last accepted report.

use rangehound_shared::measurement::{Kind, Measurement, Pose};
use rangehound_shared::message::{Header, Range, Refusal};
use rangehound_shared::scenario::{Scenario, Source, bounds};

use crate::centre::Centre;
use crate::vector::Vector;

/// A range more than this many standard deviations below zero is not noise of a close target.
const NEGATIVE_SIGMA_MAX: f64 = 10.0;

/// Largest magnitude of coordinates and ranges, m: the filter's arithmetic stays far within its bounds.
const DISTANCE_MAX_M: f64 = 1e12;

/// A bearing is given within one turn, with room for another convention of its sign.
const BEARING_MAX_RAD: f64 = 2.0 * std::f64::consts::TAU;

/// Standard deviations of a robot's own position by which a jump may be an error of its localiser.
const JUMP_SIGMA: f64 = 8.0;

/// Rounding of positions, relative to their coordinates and to the distance moved.
const JUMP_ROUNDING: f64 = 1e-9;

/// Limits on the messages of a run.
#[derive(Debug)]
pub(super) struct Validation {
    dt_s: f64,
    /// The most that each robot moves in a tick, m; `None` for recordings, whose sensors have no speed limit.
    steps_m: Option<Vec<f64>>,
}

impl Validation {
    pub(super) fn new(scenario: &Scenario) -> Self {
        let simulated = matches!(scenario.source, Source::Simulated { .. });
        let steps_m = scenario.robots.iter().map(|robot| robot.speed_mps * scenario.dt_s);
        Self { dt_s: scenario.dt_s, steps_m: simulated.then(|| steps_m.collect()) }
    }

    /// The time of a tick, s, if all steps are of equal length; `None` for recordings.
    pub(super) fn time_s(&self, tick: u64) -> Option<f64> {
        self.steps_m.as_ref().map(|_| tick as f64 * self.dt_s)
    }

    /// The measurement of a message.
    ///
    /// # Errors
    /// [`Refusal::Malformed`] if no robot of this run can have sent these numbers.
    pub(super) fn measurement(&self, centre: &Centre, header: &Header, range: &Range) -> Result<Measurement, Refusal> {
        let Measurement { pose, kinds, .. } = range.measurement;
        let near = |value: f64| value.abs() <= DISTANCE_MAX_M;
        let is_range = |(range_m, std_m): (f64, f64)| {
            near(range_m) && bounds::STD_M.contains(&std_m) && range_m >= -NEGATIVE_SIGMA_MAX * std_m
        };
        let is_bearing = |(bearing_rad, std_rad): (f64, f64)| {
            bearing_rad.abs() <= BEARING_MAX_RAD && bounds::BEARING_STD_RAD.contains(&std_rad)
        };
        let measured = range.measurement.range();
        let bearing = range.measurement.bearing();
        let is_valid = kinds >> Kind::COUNT == 0
            && pose.numbers().into_iter().all(near)
            && is_covariance(pose)
            && measured.is_none_or(is_range)
            && bearing.is_none_or(is_bearing);
        let is_timely = match self.time_s(header.tick) {
            Some(time_s) => header.valid_at_s == time_s,
            // The times of a recording never go back.
            None => {
                let earliest_s = if header.tick < centre.next_tick() { f64::MIN } else { centre.time_s() };
                header.valid_at_s.is_finite() && (header.valid_at_s >= earliest_s || centre.next_tick() == 0)
            }
        };
        if is_valid && is_timely {
            Ok(Measurement::new(pose, measured).with_bearing(bearing))
        } else {
            Err(Refusal::Malformed)
        }
    }

    /// True if a robot can have moved from one pose to another between two ticks, as far as it knows them.
    pub(super) fn can_reach(&self, id: usize, from: (u64, Pose), to: (u64, Pose)) -> bool {
        let Some(steps_m) = &self.steps_m else { return true };
        let reach_m = steps_m[id] * from.0.abs_diff(to.0) as f64;
        let [start_m, end_m] = [from.1, to.1].map(Vector::from);
        let rounding_m = JUMP_ROUNDING * (1.0 + start_m.norm() + end_m.norm() + reach_m);
        let variance_m2 = |pose: Pose| pose.position_covariance_m2().trace();
        let error_m = JUMP_SIGMA * (variance_m2(from.1) + variance_m2(to.1)).sqrt();
        (end_m - start_m).norm() <= reach_m + error_m + rounding_m
    }
}

/// True if the position's covariance is one, and the heading's standard deviation too.
fn is_covariance(pose: Pose) -> bool {
    let [xx_m2, xy_m2, yy_m2] = pose.covariance_m2;
    let largest_m2 = DISTANCE_MAX_M;
    xx_m2 >= 0.0
        && yy_m2 >= 0.0
        && xx_m2.max(yy_m2) <= largest_m2
        && xy_m2 * xy_m2 <= xx_m2 * yy_m2 * (1.0 + 1e-9)
        && bounds::HEADING_STD_RAD.contains(&pose.heading_std_rad)
}
