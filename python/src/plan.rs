//! One step of a planner.

use std::cell::RefCell;

use numpy::PyArrayDyn;
use pyo3::prelude::*;
use rangehound::plan::line::{LineSolver, Solved};
use rangehound::plan::schema::{Number, Object, Pair, ProblemLine, RobotLine};
use rangehound_fusion::planner::{self, Certificate};
use rangehound_shared::scenario::{PlannerTable, defaults};

use crate::arrays::{Numbers, array, each};
use crate::errors::input;

/// The headings of one step, and the objective that they reach.
#[pyclass(frozen, module = "rangehound._native")]
#[derive(Debug)]
pub(crate) struct Plan {
    /// Name of the planner.
    #[pyo3(get)]
    pub(crate) planner: String,
    pub(crate) headings: Vec<f64>,
    pub(crate) speeds: Vec<f64>,
    /// The minimised quantity: `|S|`, 1/m^2, for ranges of constant noise; the criterion's value for other sensors.
    #[pyo3(get)]
    pub(crate) objective: f64,
    /// No headings reach less of it.
    #[pyo3(get)]
    pub(crate) lower_bound: f64,
    /// True if the bound is proven to be reached.
    #[pyo3(get)]
    pub(crate) certified: bool,
    /// Trace of the position covariance after the robots' next measurements, m^2.
    #[pyo3(get)]
    pub(crate) position_trace_m2: f64,
    /// No headings lead to a lesser trace, m^2.
    #[pyo3(get)]
    pub(crate) lower_bound_trace_m2: f64,
    /// Time of the planning alone, us.
    #[pyo3(get)]
    pub(crate) plan_us: f64,
}

impl Plan {
    fn of(solved: Solved<'_>) -> Self {
        let Solved { planner, plan, certificate, plan_us } = solved;
        Self::of_parts(planner, plan, certificate, plan_us)
    }

    pub(crate) fn of_parts(planner: &str, plan: &planner::Plan, certificate: Certificate, plan_us: f64) -> Self {
        Self {
            planner: planner.to_owned(),
            headings: plan.commands.iter().map(|command| command.heading_rad).collect(),
            speeds: plan.commands.iter().map(|command| command.speed_mps).collect(),
            objective: plan.predicted.objective,
            lower_bound: certificate.lower_bound,
            certified: certificate.is_optimal,
            position_trace_m2: plan.predicted.position_trace_m2,
            lower_bound_trace_m2: certificate.least_trace_m2,
            plan_us,
        }
    }
}

#[pymethods]
impl Plan {
    /// Heading of each robot, (M,), rad counter-clockwise from the x axis.
    #[getter]
    fn headings_rad<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        array(py, self.headings.clone(), &[self.headings.len()])
    }

    /// Speed of each robot, (M,), m/s.
    #[getter]
    fn speeds_mps<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        array(py, self.speeds.clone(), &[self.speeds.len()])
    }

    fn __repr__(&self) -> String {
        let Self { planner, headings, position_trace_m2, certified, .. } = self;
        format!(
            "Plan(planner={planner:?}, headings_rad={headings:?}, position_trace_m2={position_trace_m2}, certified={})",
            if *certified { "True" } else { "False" }
        )
    }
}

thread_local! {
    /// Solves for this thread; it keeps planners and memory, and no answer depends on earlier ones.
    static SOLVER: RefCell<Option<(u64, LineSolver)>> = const { RefCell::new(None) };
}

/// Solves a problem with the thread's solver of this seed.
fn solve(problem: &ProblemLine, seed: u64, tick: u64) -> PyResult<Plan> {
    SOLVER.with_borrow_mut(|kept| {
        let solver = match kept {
            Some((of_seed, solver)) if *of_seed == seed => solver,
            _ => {
                let solver = LineSolver::new(PlannerTable::default(), seed).map_err(input)?;
                &mut kept.insert((seed, solver)).1
            }
        };
        solver.solve(tick, problem).map(Plan::of).map_err(input)
    })
}

/// Plans one step of a team of M robots: the headings after which their next measurements are most informative.
///
/// With the predicted covariance P of the target's position and the line of sight e_i from where robot i measures, the
/// covariance after ranges is (P^-1 + sum_i e_i e_i^T / sigma_i^2)^-1. Its trace is least where |S|, the difference of the
/// eigenvalues of its inverse, is least.
///
/// `prior_position_covariance` is P, (2, 2), m^2; `target` the predicted position, (2,), m; `time_step_s` how long the robots
/// move. `positions` is (M, 2), m. Values of robots are (M,), or one number for all: `max_speed`, m/s; `range_std`, m, which
/// grows by `range_std_per_m` with the distance; `bearing_std_rad`; `max_range_m`; `field_of_view_rad`; `heading_std_rad`.
/// NaN means that a robot does not have it. `position_covariance` is (M, 2, 2), m^2. `stand_off_m`, `stand_off_sigma` and
/// `separation_m` keep distances. `planner` is a name ("certified" if it is missing), `criterion` "trace", "eigenvalue" or
/// "determinant". The random planner depends on `seed` and `tick`.
///
/// Raises `InputError` with the argument's name.
#[pyfunction]
#[pyo3(signature = (
    *, prior_position_covariance, target, time_step_s, positions, max_speed, range_std=None, range_std_per_m=None,
    bearing_std_rad=None, max_range_m=None, field_of_view_rad=None, position_covariance=None, heading_std_rad=None,
    stand_off_m=None, stand_off_sigma=None, separation_m=None, planner=None, criterion=None, seed=None, tick=0
))]
#[allow(clippy::too_many_arguments, reason = "keywords of Python: the keys of a line of `rangehound plan`")]
pub(crate) fn plan(
    prior_position_covariance: &Bound<'_, PyAny>,
    target: &Bound<'_, PyAny>,
    time_step_s: f64,
    positions: &Bound<'_, PyAny>,
    max_speed: &Bound<'_, PyAny>,
    range_std: Option<&Bound<'_, PyAny>>,
    range_std_per_m: Option<&Bound<'_, PyAny>>,
    bearing_std_rad: Option<&Bound<'_, PyAny>>,
    max_range_m: Option<&Bound<'_, PyAny>>,
    field_of_view_rad: Option<&Bound<'_, PyAny>>,
    position_covariance: Option<&Bound<'_, PyAny>>,
    heading_std_rad: Option<&Bound<'_, PyAny>>,
    stand_off_m: Option<f64>,
    stand_off_sigma: Option<f64>,
    separation_m: Option<f64>,
    planner: Option<String>,
    criterion: Option<String>,
    seed: Option<u64>,
    tick: u64,
) -> PyResult<Plan> {
    let covariance = Numbers::of(prior_position_covariance, "prior_position_covariance")?;
    let covariance = covariance.shaped("prior_position_covariance", &[2, 2])?;
    let target = Numbers::of(target, "target")?.shaped("target", &[2])?;
    let positions = Numbers::of(positions, "positions")?;
    let robots = positions.shape.first().copied().unwrap_or(0);
    let positions = positions.shaped("positions", &[robots, 2])?;
    let speeds = each(Some(max_speed), "max_speed", robots)?;
    // NaN: this robot does not have it.
    let range_std = each(range_std, "range_std", robots)?;
    let range_std_per_m = each(range_std_per_m, "range_std_per_m", robots)?;
    let bearing_std_rad = each(bearing_std_rad, "bearing_std_rad", robots)?;
    let max_range_m = each(max_range_m, "max_range_m", robots)?;
    let field_of_view_rad = each(field_of_view_rad, "field_of_view_rad", robots)?;
    let heading_std_rad = each(heading_std_rad, "heading_std_rad", robots)?;
    let covariances = position_covariance
        .map(|value| Numbers::of(value, "position_covariance")?.shaped("position_covariance", &[robots, 2, 2]))
        .transpose()?;
    let of = |values: &Option<Vec<f64>>, robot: usize| {
        values.as_ref().map(|values| values[robot]).filter(|value| !value.is_nan()).map(Number)
    };
    let team = (0..robots).map(|robot| {
        Object(RobotLine {
            position: Some(pair(&positions[2 * robot..])),
            max_speed: of(&speeds, robot),
            range_std: of(&range_std, robot),
            range_std_per_m: of(&range_std_per_m, robot),
            bearing_std_rad: of(&bearing_std_rad, robot),
            max_range_m: of(&max_range_m, robot),
            field_of_view_rad: of(&field_of_view_rad, robot),
            position_covariance: covariances.as_ref().map(|values| matrix(&values[4 * robot..])),
            heading_std_rad: of(&heading_std_rad, robot),
        })
    });
    let problem = ProblemLine {
        prior_position_covariance: Some(matrix(&covariance)),
        target: Some(pair(&target)),
        time_step_s: Some(Number(time_step_s)),
        robots: Some(team.collect()),
        stand_off_m: stand_off_m.map(Number),
        stand_off_sigma: stand_off_sigma.map(Number),
        separation_m: separation_m.map(Number),
        planner,
        criterion,
    };
    solve(&problem, seed.unwrap_or(defaults::SEED), tick)
}

fn pair(values: &[f64]) -> Pair<Number> {
    Pair([Number(values[0]), Number(values[1])])
}

fn matrix(values: &[f64]) -> Pair<Pair<Number>> {
    Pair([pair(values), pair(&values[2..])])
}
