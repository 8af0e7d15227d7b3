//! The situation of a planner, and planners that are Python functions.

use numpy::PyArrayDyn;
use pyo3::prelude::*;
use pyo3::types::PyTuple;
use rangehound::study::compare::certified_reference::{CertifiedReference, Distance};
use rangehound_fusion::planner::{self as planners, Custom, Planner, PlannerError, hull_certificate};
use rangehound_fusion::planner::{Situation as Seen, TeamMember};
use rangehound_shared::message::Command;
use rangehound_shared::scenario::{PlannerSpec, PlannerTable, defaults};

use crate::arrays::{Numbers, array};
use crate::errors::{Raised, input};
use crate::plan::Plan;

/// The inputs of a planner before a step.
#[pyclass(frozen, module = "rangehound._native")]
pub(crate) struct Situation {
    tick: u64,
    seen: Seen,
}

type Array<'py> = PyResult<Bound<'py, PyArrayDyn<f64>>>;

impl Situation {
    /// A value of each robot, (M,).
    fn of_each<'py>(&self, py: Python<'py>, value: impl Fn(&TeamMember) -> f64) -> Array<'py> {
        array(py, self.seen.team.iter().map(value).collect(), &[self.seen.team.len()])
    }
}

#[pymethods]
impl Situation {
    /// The tick.
    #[getter]
    fn tick(&self) -> u64 {
        self.tick
    }

    /// Number of robots M that are planned for.
    #[getter]
    fn robots(&self) -> usize {
        self.seen.team.len()
    }

    /// How long the robots move before they measure, s.
    #[getter]
    fn step_s(&self) -> f64 {
        self.seen.step_s
    }

    /// Where the target is predicted to be when the robots measure next, (2,), m.
    #[getter]
    fn target_m<'py>(&self, py: Python<'py>) -> Array<'py> {
        let position_m = self.seen.belief.position_m();
        array(py, vec![position_m.x, position_m.y], &[2])
    }

    /// Covariance of that, (2, 2), m^2.
    #[getter]
    fn covariance_m2<'py>(&self, py: Python<'py>) -> Array<'py> {
        array(py, self.seen.belief.position_covariance_m2().as_slice().to_vec(), &[2, 2])
    }

    /// The predicted state, (n,), position first.
    #[getter]
    fn state<'py>(&self, py: Python<'py>) -> Array<'py> {
        let n = self.seen.motion.state_dim();
        array(py, self.seen.belief.mean.as_slice()[..n].to_vec(), &[n])
    }

    /// Covariance of the predicted state, (n, n).
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> Array<'py> {
        let n = self.seen.motion.state_dim();
        array(py, self.seen.belief.covariance.view((0, 0), (n, n)).iter().copied().collect(), &[n, n])
    }

    /// Position of each robot as it knows it, (M, 2), m.
    #[getter]
    fn positions_m<'py>(&self, py: Python<'py>) -> Array<'py> {
        let positions = self.seen.team.iter().flat_map(|member| [member.position_m.x, member.position_m.y]);
        array(py, positions.collect(), &[self.seen.team.len(), 2])
    }

    /// Covariance of each robot's position, (M, 2, 2), m^2.
    #[getter]
    fn position_covariances_m2<'py>(&self, py: Python<'py>) -> Array<'py> {
        let team = &self.seen.team;
        let values = team.iter().flat_map(|member| member.position_covariance_m2.iter().copied().collect::<Vec<_>>());
        array(py, values.collect(), &[team.len(), 2, 2])
    }

    /// Speed limit of each robot, (M,), m/s.
    #[getter]
    fn max_speeds_mps<'py>(&self, py: Python<'py>) -> Array<'py> {
        self.of_each(py, |member| member.max_speed_mps)
    }

    /// Standard deviation of each robot's range at distance 0, (M,), m; NaN without ranges.
    #[getter]
    fn range_stds_m<'py>(&self, py: Python<'py>) -> Array<'py> {
        self.of_each(py, |member| member.sensor.range.map_or(f64::NAN, |range| range.std_m))
    }

    /// Standard deviation of each robot's bearing, (M,), rad; NaN without bearings.
    #[getter]
    fn bearing_stds_rad<'py>(&self, py: Python<'py>) -> Array<'py> {
        self.of_each(py, |member| member.sensor.bearing_std_rad.unwrap_or(f64::NAN))
    }

    /// The plan of a built-in planner for this situation.
    #[pyo3(signature = (planner="certified", *, seed=None))]
    fn plan(&self, planner: &str, seed: Option<u64>) -> PyResult<Plan> {
        let table = PlannerTable { name: Some(planner.to_owned()), ..PlannerTable::default() };
        let spec = PlannerSpec::from_table(&table, "the call of plan").map_err(input)?;
        let mut planner =
            planners::for_team(spec, self.seen.team.len(), seed.unwrap_or(defaults::SEED)).map_err(input)?;
        let mut plan = planners::Plan::default();
        let began = std::time::Instant::now();
        planner.plan(self.tick, &self.seen, &mut plan);
        let plan_us = began.elapsed().as_secs_f64() * 1e6;
        let certificate = plan.certificate.unwrap_or_else(|| hull_certificate(&self.seen, &plan));
        Ok(Plan::of_parts(spec.name(), &plan, certificate, plan_us))
    }

    /// Evaluates headings (M,), rad, and speeds (M,), m/s: `(objective, position trace in m^2, gap to the certified
    /// optimum)`.
    #[pyo3(signature = (headings_rad, speeds_mps=None))]
    fn evaluate(
        &self,
        headings_rad: &Bound<'_, PyAny>,
        speeds_mps: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<(f64, f64, f64)> {
        let mut commands = vec![Command::default(); self.seen.team.len()];
        fill(&self.seen, &mut commands, headings_rad, speeds_mps)
            .map_err(|problem| problem.into_error("headings_rad"))?;
        let robots = commands.len();
        let mut planner = Custom::new(robots, move |_, _, chosen| chosen.copy_from_slice(&commands)).map_err(input)?;
        let mut plan = planners::Plan::default();
        planner.plan(self.tick, &self.seen, &mut plan);
        let Distance { gap, .. } = CertifiedReference::for_robots(robots).map_err(input)?.measure(&self.seen, &plan);
        Ok((plan.predicted.objective, plan.predicted.position_trace_m2, gap))
    }

    /// The same as `evaluate`: its former name. Headings (M,), rad; speeds (M,), m/s.
    #[pyo3(signature = (headings_rad, speeds_mps=None))]
    fn worth(
        &self,
        headings_rad: &Bound<'_, PyAny>,
        speeds_mps: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<(f64, f64, f64)> {
        self.evaluate(headings_rad, speeds_mps)
    }

    fn __repr__(&self) -> String {
        let target = self.seen.belief.position_m();
        format!("Situation(tick={}, target_m=[{}, {}], robots={})", self.tick, target.x, target.y, self.seen.team.len())
    }
}

/// A planner that is a Python function. Its first exception is stored in `raised`; from then on the robots hold their course.
pub(crate) fn planner(robots: usize, function: Py<PyAny>, raised: Raised) -> Result<Box<dyn Planner>, PlannerError> {
    let mut course = vec![Command::default(); robots];
    let choose = move |tick: u64, situation: &Seen, commands: &mut [Command]| {
        if !raised.is_set() {
            match Python::attach(|py| call(py, &function, tick, situation, commands)) {
                Ok(()) => {
                    course.clear();
                    course.extend_from_slice(commands);
                    return;
                }
                Err(error) => raised.set(error),
            }
        }
        commands.iter_mut().zip(&course).for_each(|(command, held)| *command = *held);
    };
    Ok(Box::new(Custom::new(robots, choose)?))
}

fn call(py: Python<'_>, function: &Py<PyAny>, tick: u64, seen: &Seen, commands: &mut [Command]) -> PyResult<()> {
    let answer = function.bind(py).call1((Situation { tick, seen: seen.clone() },))?;
    let filled = if let Ok(plan) = answer.cast::<Plan>() {
        let plan = plan.get();
        put(seen, commands, &plan.headings, Some(&plan.speeds))
    } else if let Ok(pair) = answer.cast::<PyTuple>()
        && pair.len() == 2
        && pair.get_item(0)?.extract::<f64>().is_err()
    {
        fill(seen, commands, &pair.get_item(0)?, Some(&pair.get_item(1)?))
    } else {
        fill(seen, commands, &answer, None)
    };
    filled.map_err(|problem| {
        problem.into_error(&format!("the answer of the planner {} at tick {tick}", name_of(function.bind(py))))
    })
}

/// A function's name for people.
pub(crate) fn name_of(function: &Bound<'_, PyAny>) -> String {
    let name = function.getattr("__name__").or_else(|_| function.get_type().getattr("__name__"));
    name.and_then(|name| name.extract()).unwrap_or_else(|_| "planner".to_owned())
}

/// The fault of headings.
pub(crate) enum Wrong {
    Raised(PyErr),
    Is(String),
}

impl Wrong {
    fn into_error(self, what: &str) -> PyErr {
        match self {
            Self::Raised(error) => error,
            Self::Is(problem) => input(format!("{what} {problem}")),
        }
    }
}

/// Fills in the commands of these headings and speeds; without speeds the robots go as fast as they can.
fn fill(
    seen: &Seen,
    commands: &mut [Command],
    headings: &Bound<'_, PyAny>,
    speeds: Option<&Bound<'_, PyAny>>,
) -> Result<(), Wrong> {
    let headings = Numbers::of(headings, "headings").map_err(Wrong::Raised)?;
    let speeds = match speeds {
        Some(speeds) => {
            let speeds = Numbers::of(speeds, "speeds").map_err(Wrong::Raised)?;
            Some(speeds.for_each("speeds", seen.team.len()).map_err(Wrong::Raised)?)
        }
        None => None,
    };
    put(seen, commands, &headings.data, speeds.as_deref())
}

fn put(seen: &Seen, commands: &mut [Command], headings: &[f64], speeds: Option<&[f64]>) -> Result<(), Wrong> {
    let robots = commands.len();
    let expected = || format!("expected {robots} finite headings, rad, one for each robot");
    if headings.len() != robots {
        return Err(Wrong::Is(format!("has {} headings: {}", headings.len(), expected())));
    }
    for (robot, (command, member)) in commands.iter_mut().zip(&seen.team).enumerate() {
        let speed_mps = speeds.map_or(member.max_speed_mps, |speeds| speeds[robot]);
        *command = Command { heading_rad: headings[robot], speed_mps };
        if !(command.heading_rad.is_finite() && speed_mps.is_finite()) {
            return Err(Wrong::Is(format!(
                "has {} rad, {speed_mps} m/s for robot {robot}: {}",
                command.heading_rad,
                expected()
            )));
        }
    }
    Ok(())
}
