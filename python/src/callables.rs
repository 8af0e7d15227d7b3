//! Sensors and target models that are Python functions.

use std::fmt;
use std::sync::Arc;

use numpy::PyArray1;
use pyo3::prelude::*;
use rangehound_robot::drive::Actuator;
use rangehound_robot::pose::PoseSource;
use rangehound_robot::sensor::{Sensed, Sensor};
use rangehound_shared::measurement::{Kind, Pose};
use rangehound_shared::message::{Command, WorldEntry};
use rangehound_shared::scenario::{Scenario, SensorSpec};
use rangehound_sim::simulation::TargetMotion;

use crate::arrays::Numbers;
use crate::errors::{Raised, input};

/// A Python function that several threads may hold.
#[derive(Clone)]
pub(crate) struct Function(Arc<Py<PyAny>>);

impl fmt::Debug for Function {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Function")
    }
}

impl Function {
    /// The function, for any thread.
    pub(crate) fn new(function: Py<PyAny>) -> Self {
        Self(Arc::new(function))
    }
}

/// `f(robot, tick, range_m, bearing_rad)`: what a robot's sensor measures, given the truth.
#[derive(Debug)]
pub(crate) struct FunctionSensor {
    function: Function,
    robot: usize,
    /// The standard deviations for values that come without.
    reported: SensorSpec,
    raised: Raised,
}

impl FunctionSensor {
    /// The sensor of one robot of a scenario; `None` if it has no such robot.
    pub(crate) fn of_robot(scenario: &Scenario, robot: usize, function: Py<PyAny>, raised: &Raised) -> Option<Self> {
        let reported = scenario.robots.get(robot)?.reported;
        Some(Self { function: Function::new(function), robot, reported, raised: raised.clone() })
    }

    /// The sensors of all robots of a scenario.
    pub(crate) fn of_team(scenario: &Scenario, function: Py<PyAny>, raised: &Raised) -> Vec<Box<dyn Sensor>> {
        let function = Function::new(function);
        let sensor = |(robot, spec): (usize, &rangehound_shared::scenario::RobotSpec)| -> Box<dyn Sensor> {
            Box::new(Self { function: function.clone(), robot, reported: spec.reported, raised: raised.clone() })
        };
        scenario.robots.iter().enumerate().map(sensor).collect()
    }

    fn call(&self, tick: u64, entry: &WorldEntry) -> PyResult<Sensed> {
        let truth = |kind: Kind, value: f64| if entry.kinds & kind.bit() != 0 { value } else { f64::NAN };
        let seen = (truth(Kind::Range, entry.range_m), truth(Kind::Bearing, entry.bearing_rad));
        Python::attach(|py| {
            let answer = self.function.0.bind(py).call1((self.robot, tick, seen.0, seen.1))?;
            if answer.is_none() {
                return Ok(Sensed::default());
            }
            let what = || format!("the answer of the sensor of robot {} at tick {tick}", self.robot);
            let numbers = Numbers::of(&answer, &what())?.data;
            self.sensed(&numbers).ok_or_else(|| {
                input(format!(
                    "{} is {numbers:?}: expected None, range_m, (range_m, range_std_m) or (range_m, \
                    range_std_m, bearing_rad, bearing_std_rad), with NaN for what is not measured",
                    what()
                ))
            })
        })
    }

    /// The values of an answer; `None` if it is not one.
    fn sensed(&self, numbers: &[f64]) -> Option<Sensed> {
        let (range, bearing) = match *numbers {
            [range_m] => ((range_m, self.reported.range?.std_at_m(range_m)), None),
            [range_m, std_m] => ((range_m, std_m), None),
            [range_m, std_m, bearing_rad, std_rad] => ((range_m, std_m), Some((bearing_rad, std_rad))),
            _ => return None,
        };
        let measured = |(value, std): (f64, f64)| {
            let is_valid = value.is_nan() || value.is_finite() && std.is_finite() && std > 0.0;
            is_valid.then_some(Some((value, std)).filter(|(value, _)| !value.is_nan()))
        };
        if range.0 < 0.0 {
            return None;
        }
        Some(Sensed { range_m: measured(range)?, bearing_rad: bearing.map_or(Some(None), measured)? })
    }
}

impl Sensor for FunctionSensor {
    fn sense(&mut self, tick: u64, entry: &WorldEntry) -> Sensed {
        if self.raised.is_set() {
            return Sensed::default();
        }
        self.call(tick, entry).unwrap_or_else(|error| {
            self.raised.set(error);
            Sensed::default()
        })
    }
}

/// `f(tick, state, noise)`: the target's next true state.
#[derive(Debug)]
pub(crate) struct FunctionTarget {
    function: Function,
    raised: Raised,
}

impl FunctionTarget {
    pub(crate) fn new(function: Py<PyAny>, raised: Raised) -> Self {
        Self { function: Function::new(function), raised }
    }

    fn call(&self, tick: u64, state: &mut [f64], noise: &[f64]) -> PyResult<()> {
        Python::attach(|py| {
            let (before, noise) = (PyArray1::from_slice(py, state), PyArray1::from_slice(py, noise));
            let answer = self.function.0.bind(py).call1((tick, before, noise))?;
            let what = format!("the answer of the target at tick {tick}");
            let next = Numbers::of(&answer, &what)?.shaped(&what, &[state.len()])?;
            if !next.iter().all(|value| value.is_finite()) {
                return Err(input(format!("{what} is {next:?}: expected a finite state")));
            }
            state.copy_from_slice(&next);
            Ok(())
        })
    }
}

impl TargetMotion for FunctionTarget {
    fn advance(&mut self, tick: u64, state: &mut [f64], noise: &[f64]) {
        if self.raised.is_set() {
            return;
        }
        if let Err(error) = self.call(tick, state, noise) {
            self.raised.set(error);
        }
    }
}

/// `f(time_s, x_m, y_m, heading_rad)`: where a robot says that it is; the arguments are what the world's localiser says.
#[derive(Debug)]
pub(crate) struct FunctionPose {
    function: Function,
    raised: Raised,
}

impl FunctionPose {
    pub(crate) fn new(function: Py<PyAny>, raised: Raised) -> Self {
        Self { function: Function::new(function), raised }
    }

    fn call(&self, time_s: f64, pose: Pose) -> PyResult<Pose> {
        Python::attach(|py| {
            let answer = self.function.0.bind(py).call1((time_s, pose.x_m, pose.y_m, pose.heading_rad))?;
            let numbers = Numbers::of(&answer, "the answer of the localiser")?.data;
            posed(&numbers, pose).ok_or_else(|| {
                input(format!(
                    "the answer of the localiser is {numbers:?}: expected (x_m, y_m), and heading_rad, std_m and \
                     heading_std_rad if they are known, or (x_m, y_m, heading_rad, xx_m2, xy_m2, yy_m2, heading_std_rad), all finite"
                ))
            })
        })
    }
}

/// The pose of a localiser's answer; `pose` has what the answer lacks. `None` if it is not one.
fn posed(numbers: &[f64], pose: Pose) -> Option<Pose> {
    let of = |i: usize, absent: f64| numbers.get(i).copied().unwrap_or(absent);
    let (covariance_m2, heading_std_rad) = match *numbers {
        [_, _, _, xx_m2, xy_m2, yy_m2, heading_std_rad] => ([xx_m2, xy_m2, yy_m2], heading_std_rad),
        [_, _] | [_, _, _] | [_, _, _, _] | [_, _, _, _, _] => {
            let std_m = Some(of(3, 0.0)).filter(|std_m| *std_m >= 0.0)?;
            ([std_m * std_m, 0.0, std_m * std_m], of(4, 0.0))
        }
        _ => return None,
    };
    let [xx_m2, xy_m2, yy_m2] = covariance_m2;
    let is_covariance = xx_m2 >= 0.0 && yy_m2 >= 0.0 && xy_m2 * xy_m2 <= xx_m2 * yy_m2 * (1.0 + 1e-9);
    let is_valid = numbers.iter().all(|number| number.is_finite()) && is_covariance && heading_std_rad >= 0.0;
    let (x_m, y_m, heading_rad) = (of(0, pose.x_m), of(1, pose.y_m), of(2, pose.heading_rad));
    is_valid.then_some(Pose { x_m, y_m, heading_rad, covariance_m2, heading_std_rad, ..pose })
}

impl PoseSource for FunctionPose {
    fn pose(&mut self, time_s: f64, entry: &WorldEntry) -> Pose {
        if self.raised.is_set() {
            return entry.pose;
        }
        self.call(time_s, entry.pose).unwrap_or_else(|error| {
            self.raised.set(error);
            entry.pose
        })
    }
}

/// `f(heading_rad, speed_mps)`: carries a command out. The answer is what was driven; `None` means as commanded.
#[derive(Debug)]
pub(crate) struct FunctionActuator {
    /// `None`: the simulator moves the robot.
    pub(crate) function: Option<Function>,
    pub(crate) raised: Raised,
}

impl FunctionActuator {
    fn call(&self, function: &Function, command: Command) -> PyResult<Command> {
        Python::attach(|py| {
            let answer = function.0.bind(py).call1((command.heading_rad, command.speed_mps))?;
            if answer.is_none() {
                return Ok(command);
            }
            let what = "the answer of carry_out";
            let driven = Numbers::of(&answer, what)?.shaped(what, &[2])?;
            Ok(Command { heading_rad: driven[0], speed_mps: driven[1] })
        })
    }
}

impl Actuator for FunctionActuator {
    fn carry_out(&mut self, command: Command) -> Command {
        let Some(function) = &self.function else { return command };
        // The last command, to stop, is carried out even after an exception.
        self.call(function, command).unwrap_or_else(|error| {
            self.raised.set(error);
            Command::default()
        })
    }
}
