//! The messages of a run for ROS: the same numbers as in its ROS 2 bag.

use numpy::PyArrayDyn;
use pyo3::prelude::*;
use rangehound::results::ros_bag::diagnostics::TickDiagnostics;
use rangehound::results::ros_bag::markers::{Marker, RobotMarkers, markers};
use rangehound::results::ros_bag::planar::{Controller, Moving, PlanarPose};
use rangehound_shared::measurement::Pose;
use rangehound_shared::message::{Command, Estimate};

use crate::arrays::{Numbers, array};
use crate::errors::input;

/// A pose: x, y and z, m, yaw, rad, and the covariance over x, y, z, roll, pitch, yaw, (36,).
type Placing<'py> = (f64, f64, f64, f64, Bound<'py, PyArrayDyn<f64>>);

fn placing<'py>(py: Python<'py>, placed: &PlanarPose) -> PyResult<Placing<'py>> {
    let [x_m, y_m, z_m] = placed.position_m;
    Ok((x_m, y_m, z_m, placed.yaw_rad, array(py, placed.covariance().to_vec(), &[36])?))
}

/// The estimated target: its pose, which faces along its velocity; and its speed, m/s, with the covariance of its velocity in
/// its own frame, (36,).
#[pyfunction]
pub(crate) fn ros_target<'py>(
    py: Python<'py>,
    state: &Bound<'py, PyAny>,
    covariance: &Bound<'py, PyAny>,
    has_velocity: bool,
) -> PyResult<(Placing<'py>, f64, Bound<'py, PyArrayDyn<f64>>)> {
    let (state, mut estimate) = (Numbers::of(state, "state")?.data, Estimate::default());
    let n = state.len();
    let covariance = Numbers::of(covariance, "covariance")?.shaped("covariance", &[n, n])?;
    if n < 2 || n > estimate.state.len() || has_velocity && n < 4 {
        return Err(input(format!("state has {n} numbers: expected those of a run")));
    }
    estimate.state_dim = n as u64;
    estimate.state[..n].copy_from_slice(&state);
    estimate.covariance[..n * n].copy_from_slice(&covariance);
    let moving = Moving::target(&estimate, has_velocity);
    let twist = array(py, moving.covariance().to_vec(), &[36])?;
    Ok((placing(py, &PlanarPose::target(&estimate, has_velocity))?, moving.speed_mps, twist))
}

/// The pose of a robot as it reported it: position (3,), m, covariance of x and y (2, 2), m^2, heading and its standard
/// deviation, rad.
#[pyfunction]
pub(crate) fn ros_robot<'py>(
    py: Python<'py>,
    position_m: [f64; 3],
    covariance_m2: &Bound<'py, PyAny>,
    heading_rad: f64,
    heading_std_rad: f64,
) -> PyResult<Placing<'py>> {
    let covariance = Numbers::of(covariance_m2, "covariance_m2")?.shaped("covariance_m2", &[2, 2])?;
    let [x_m, y_m, height_m] = position_m;
    let covariance_m2 = [covariance[0], covariance[1], covariance[3]];
    placing(py, &PlanarPose::robot(&Pose { x_m, y_m, height_m, heading_rad, covariance_m2, heading_std_rad }))
}

/// A marker: namespace, id, type, whether it is shown, position, m, yaw, rad, scale, m, colour, and points, m.
type Drawn = (&'static str, usize, i32, bool, [f64; 2], f64, [f64; 3], [f32; 4], Vec<[f64; 2]>);

/// The markers of a tick for RViz: for an estimated position (2,), m, with its covariance (2, 2), m^2; and for each robot where it is, m, NaN
/// if it was not heard, its range, m, NaN without one, whether that was not fused, and heading, rad, and speed, m/s, of its command.
#[pyfunction]
pub(crate) fn ros_markers(
    position_m: [f64; 2],
    covariance_m2: [[f64; 2]; 2],
    robots: Vec<([f64; 2], f64, bool, f64, f64)>,
) -> Vec<Drawn> {
    let seen = |(place_m, range_m, is_rejected, heading_rad, speed_mps): ([f64; 2], f64, bool, f64, f64)| {
        let range = range_m.is_finite().then_some((range_m, is_rejected));
        let command = Command { heading_rad, speed_mps };
        place_m.iter().all(|x_m| x_m.is_finite()).then_some(RobotMarkers { place_m, command, range })
    };
    let robots: Vec<Option<RobotMarkers>> = robots.into_iter().map(seen).collect();
    let drawn = |marker: Marker| {
        let Marker { namespace, id, shape, is_shown, position_m, yaw_rad, scale_m, colour, points_m } = marker;
        (namespace, id, shape as i32, is_shown, position_m, yaw_rad, scale_m, colour, points_m)
    };
    markers(position_m, &covariance_m2.into(), &robots).into_iter().map(drawn).collect()
}

/// The diagnostics of a tick for ROS: level, name and message of the status, and its keys and values. `sent_ns` are the stamps of the last
/// measurement and of the headings, `rejected` is the number since the last status.
#[pyfunction]
#[pyo3(signature = (*, tick, ticks, fused, missing, rejected, silent, distrusted, sent_ns, trace_m2))]
#[allow(clippy::too_many_arguments, reason = "keywords of Python")]
pub(crate) fn ros_status(
    tick: u64,
    ticks: u64,
    fused: u64,
    missing: u64,
    rejected: u64,
    silent: Vec<usize>,
    distrusted: Vec<usize>,
    sent_ns: [u64; 2],
    trace_m2: f64,
) -> (u8, &'static str, &'static str, Vec<(&'static str, String)>) {
    let status =
        TickDiagnostics { tick, ticks, fused, missing, silent, distrusted, sent_ns, trace_m2 }.status(rejected);
    (status.level, status.name, status.message, status.values)
}

/// The controller of a robot that drives forwards and turns: forward speed, m/s, and turn rate, rad/s.
#[pyfunction]
pub(crate) fn ros_twist(
    heading_rad: f64,
    speed_mps: f64,
    yaw_rad: f64,
    max_speed_mps: f64,
    max_turn_rate_radps: f64,
    heading_gain_per_s: f64,
) -> [f64; 2] {
    let controller = Controller { max_speed_mps, max_turn_rate_radps, heading_gain_per_s };
    controller.twist(Command { heading_rad, speed_mps }, yaw_rad)
}
