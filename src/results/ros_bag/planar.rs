//! The numbers of a run that ROS receives: poses, velocities and twists in the plane, and stamps. The bag and the node of the Python package
//! write them.

use std::f64::consts::PI;

use rangehound_shared::measurement::Pose;
use rangehound_shared::message::{Command, Estimate};
use rangehound_shared::motion::MotionModel;
use rangehound_shared::scenario::{Scenario, Source};

/// Variance of an angle of which nothing is known: uniform over a turn, rad^2.
pub const ANY_ANGLE_RAD2: f64 = PI * PI / 3.0;

/// Variance of what is not estimated, in the square of its unit.
pub const UNKNOWN: f64 = 1e6;

/// Slowest target whose velocity has a direction, m^2/s^2.
const SLOWEST_M2PS2: f64 = 1e-12;

/// The first stamp of a run whose own times are no stamps, ns: ROS takes 0 for a stamp that is not set.
const FIRST_NS: i64 = 1_000_000_000;

/// Times that are stamps as they are, s: from the first to the last that a stamp can hold, less a run of a year.
const STAMPS_S: std::ops::Range<f64> = 1.0..2_147_483_647.0 - 32e6;

/// A time as a stamp, ns.
#[must_use]
pub fn stamp_ns(time_s: f64) -> i64 {
    let second = time_s.floor();
    (second as i64).saturating_mul(1_000_000_000).saturating_add(((time_s - second) * 1e9).round() as i64)
}

/// The offset from the times of a run to its stamps, ns.
#[must_use]
pub fn stamp_offset_ns(scenario: &Scenario) -> i64 {
    let start_s = match &scenario.source {
        Source::Simulated { .. } => 0.0,
        Source::Recorded(ranges) => ranges.start_s,
    };
    if STAMPS_S.contains(&start_s) { 0 } else { FIRST_NS.saturating_sub(stamp_ns(start_s)) }
}

/// True if the target's state goes on with its velocity after the position.
#[must_use]
pub fn has_velocity(scenario: &Scenario) -> bool {
    matches!(scenario.motion, MotionModel::IntegratorChain { order: 2.., .. })
}

/// A pose in the plane, or above it, with its covariance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlanarPose {
    /// Position; z is the height above the plane in which the target moves.
    pub position_m: [f64; 3],
    /// Rotation about the vertical.
    pub yaw_rad: f64,
    /// Over x, y, yaw.
    pub covariance: [[f64; 3]; 3],
}

impl PlanarPose {
    /// A robot's pose as it reported it.
    #[must_use]
    pub fn robot(pose: &Pose) -> Self {
        let Pose { x_m, y_m, height_m, heading_rad, covariance_m2: [xx, xy, yy], heading_std_rad } = *pose;
        let turn = (heading_std_rad * heading_std_rad).min(ANY_ANGLE_RAD2);
        let covariance = [[xx, xy, 0.0], [xy, yy, 0.0], [0.0, 0.0, turn]];
        Self { position_m: [x_m, y_m, height_m], yaw_rad: heading_rad, covariance }
    }

    /// The estimated pose of the target, which faces along its velocity `v`. With `J = (-vy, vx) / |v|^2` the variance of its yaw is `J P_v J^T`, and
    /// the covariance with its position `P_pv J^T`. Where that variance exceeds the one of any angle, the yaw is not known.
    #[must_use]
    pub fn target(estimate: &Estimate, has_velocity: bool) -> Self {
        let [x_m, y_m, ..] = estimate.state;
        let p = |row, column| covariance_at(estimate, row, column);
        let mut covariance = [[p(0, 0), p(0, 1), 0.0], [p(1, 0), p(1, 1), 0.0], [0.0, 0.0, ANY_ANGLE_RAD2]];
        let [vx_mps, vy_mps] = velocity_mps(estimate, has_velocity);
        let square = vx_mps * vx_mps + vy_mps * vy_mps;
        if square > SLOWEST_M2PS2 {
            let [jx, jy] = [-vy_mps / square, vx_mps / square];
            let turn = jx * (jx * p(2, 2) + 2.0 * jy * p(2, 3)) + jy * jy * p(3, 3);
            if turn < ANY_ANGLE_RAD2 {
                covariance[2][2] = turn;
                let with_turn = [0, 1].map(|axis| p(axis, 2) * jx + p(axis, 3) * jy);
                [covariance[0][2], covariance[1][2]] = with_turn;
                [covariance[2][0], covariance[2][1]] = with_turn;
            }
        }
        Self { position_m: [x_m, y_m, 0.0], yaw_rad: vy_mps.atan2(vx_mps), covariance }
    }

    /// Its covariance as ROS has it.
    #[must_use]
    pub fn covariance(&self) -> [f64; 36] {
        full(&self.covariance)
    }
}

/// The target's velocity in its own frame, whose x axis is the direction of the velocity. The turn rate is not estimated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moving {
    /// Speed.
    pub speed_mps: f64,
    /// Over the velocity along x and y, and the turn rate.
    covariance: [[f64; 3]; 3],
}

impl Moving {
    /// That of an estimate.
    #[must_use]
    pub fn target(estimate: &Estimate, has_velocity: bool) -> Self {
        let mut covariance = [[UNKNOWN, 0.0, 0.0], [0.0, UNKNOWN, 0.0], [0.0, 0.0, UNKNOWN]];
        let [vx_mps, vy_mps] = velocity_mps(estimate, has_velocity);
        if has_velocity {
            let (sin, cos) = vy_mps.atan2(vx_mps).sin_cos();
            let p = |row, column| covariance_at(estimate, row, column);
            let [xx, xy, yy] = [p(2, 2), p(2, 3), p(3, 3)];
            let along = cos * cos * xx + 2.0 * sin * cos * xy + sin * sin * yy;
            let across = sin * sin * xx - 2.0 * sin * cos * xy + cos * cos * yy;
            let both = (cos * cos - sin * sin) * xy + sin * cos * (yy - xx);
            (covariance[0], covariance[1]) = ([along, both, 0.0], [both, across, 0.0]);
        }
        Self { speed_mps: vx_mps.hypot(vy_mps), covariance }
    }

    /// Its covariance as ROS has it.
    #[must_use]
    pub fn covariance(&self) -> [f64; 36] {
        full(&self.covariance)
    }
}

/// The controller of a robot that drives forwards and turns. With its yaw `psi`, a commanded heading `theta` and speed `s`:
/// `e = theta - psi` in (-pi, pi], `w = clamp(k e, -w_max, w_max)`, `v = min(s, v_max) max(0, cos e)`.
///
/// A robot that faces away from its heading turns on the spot, and drives once the error is below 90 degrees. With a constant heading and
/// without the limit the error decays as `e(t) = e(0) exp(-k t)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Controller {
    /// Greatest forward speed `v_max`.
    pub max_speed_mps: f64,
    /// Greatest turn rate `w_max`.
    pub max_turn_rate_radps: f64,
    /// Turn rate for each rad of error `k`.
    pub heading_gain_per_s: f64,
}

impl Controller {
    /// The limits by default: the speed of the team's fastest robot, which commands do not exceed.
    #[must_use]
    pub fn of_team(scenario: &Scenario) -> Self {
        let max_speed_mps = scenario.robots.iter().map(|robot| robot.speed_mps).fold(0.0, f64::max);
        Self { max_speed_mps, max_turn_rate_radps: 2.0, heading_gain_per_s: 3.0 }
    }

    /// Forward speed, m/s, and turn rate, rad/s; zero to stop, or if a value is no number.
    #[must_use]
    pub fn twist(&self, command: Command, yaw_rad: f64) -> [f64; 2] {
        let Command { heading_rad, speed_mps } = command;
        if ![heading_rad, speed_mps, yaw_rad].iter().all(|value| value.is_finite()) || speed_mps <= 0.0 {
            return [0.0; 2];
        }
        let error_rad = wrapped(heading_rad - yaw_rad);
        let turn_radps = self.heading_gain_per_s * error_rad;
        let turn_radps = turn_radps.max(-self.max_turn_rate_radps).min(self.max_turn_rate_radps);
        [speed_mps.min(self.max_speed_mps) * error_rad.cos().max(0.0), turn_radps]
    }
}

/// The angle within (-pi, pi].
fn wrapped(angle_rad: f64) -> f64 {
    let turned_rad = angle_rad.rem_euclid(2.0 * PI);
    if turned_rad > PI { turned_rad - 2.0 * PI } else { turned_rad }
}

/// The estimated velocity; zero for models without one.
fn velocity_mps(estimate: &Estimate, has_velocity: bool) -> [f64; 2] {
    let [_, _, vx_mps, vy_mps, ..] = estimate.state;
    if has_velocity { [vx_mps, vy_mps] } else { [0.0; 2] }
}

fn covariance_at(estimate: &Estimate, row: usize, column: usize) -> f64 {
    let n = estimate.state_dim as usize;
    if row < n && column < n { estimate.covariance.get(row * n + column).copied().unwrap_or(0.0) } else { 0.0 }
}

/// The covariance of ROS, row by row over x, y, z, roll, pitch, yaw, from one over x, y, yaw.
fn full(planar: &[[f64; 3]; 3]) -> [f64; 36] {
    const PLACES: [usize; 3] = [0, 1, 5];
    let mut full = [0.0; 36];
    for (row, numbers) in PLACES.into_iter().zip(planar) {
        for (column, number) in PLACES.into_iter().zip(numbers) {
            full[6 * row + column] = *number;
        }
    }
    full
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stamp_is_the_time_to_the_nanosecond() {
        let times = [(0.3, 300_000_000), (0.999_999_999_9, 1_000_000_000), (-0.25, -250_000_000)];
        for (time_s, expected_ns) in times {
            assert_eq!(stamp_ns(time_s), expected_ns);
        }
        assert_eq!(stamp_ns(1_700_000_000.25), 1_700_000_000_250_000_000);
    }

    #[test]
    fn a_robot_that_faces_away_turns_on_the_spot_the_shorter_way() {
        let robot = Controller { max_speed_mps: 2.0, max_turn_rate_radps: 1.5, heading_gain_per_s: 3.0 };
        let twist = |heading_rad, speed_mps, yaw_rad| robot.twist(Command { heading_rad, speed_mps }, yaw_rad);
        assert_eq!(twist(0.0, 9.0, 0.0), [2.0, 0.0]);
        assert_eq!(twist(PI, 1.0, 0.1), [0.0, 1.5]);
        assert!(twist(3.0, 1.0, -3.0)[1] < 0.0);
        for stop in [(1.0, 0.0, 0.0), (f64::NAN, 1.0, 0.0), (0.0, 1.0, f64::INFINITY)] {
            assert_eq!(twist(stop.0, stop.1, stop.2), [0.0; 2]);
        }
        assert_eq!([wrapped(-PI), wrapped(PI), wrapped(0.0)], [PI, PI, 0.0]);
    }
}
