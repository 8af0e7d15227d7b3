//! Runs as arrays: simulated, tracked from a recording, or loaded from a run folder. All of them are made from the records
//! that fusion and the simulator write of each tick.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use pyo3::prelude::*;
use pyo3::types::PyDict;
use rangehound::results::frame::{Frames, LoggedTick};
use rangehound::results::report::{ReportBuilder, read_nodes};
use rangehound::run::folder::read_description;
use rangehound::run::in_process::{Parts, Team};
use rangehound::study::compare::certified_reference::{CertifiedReference, Distance};
use rangehound_fusion::planner::PlannerError;
use rangehound_shared::measurement::Kind;
use rangehound_shared::message::Command;
use rangehound_shared::record::{FusionRecord, Heard, RobotRecord, WorldRecord};
use rangehound_shared::scenario::{self as shared, Source};
use rangehound_sim::world_moved_by;

use crate::arrays::array;
use crate::callables::{FunctionSensor, FunctionTarget};
use crate::errors::{Raised, failed, input, read_truth};
use crate::scenario::Scenario;
use crate::situation;

/// How long ticks are stepped before Python can act on signals and show progress.
const TURN: Duration = Duration::from_millis(40);

/// Ticks for which a simulated run has its memory at once.
const TICKS_AT_ONCE: usize = 100_000;

/// Ticks that are loaded before Python can act on signals and show progress.
const LOADED_AT_ONCE: u64 = 2_000;

/// Ticks between two looks at the time.
const TURN_TICKS: u64 = 32;

/// The arrays of a run, a row for each tick.
#[derive(Debug, Default)]
pub(crate) struct History {
    state_dim: usize,
    truth_dim: usize,
    robots: usize,
    tick: Vec<u64>,
    time_s: Vec<f64>,
    state: Vec<f64>,
    covariance: Vec<f64>,
    truth: Vec<f64>,
    nis: Vec<f64>,
    counts: [Vec<u64>; 3],
    planned: [Vec<f64>; 3],
    times_ns: [Vec<u64>; 2],
    position_m: Vec<f64>,
    believed_m: Vec<f64>,
    believed_covariance_m2: Vec<f64>,
    /// Height, heading and its standard deviation.
    believed: [Vec<f64>; 3],
    measured: [Vec<f64>; 4],
    used: [Vec<i8>; Kind::COUNT],
    commands: [Vec<f64>; 2],
    distances: [Vec<f64>; 2],
}

impl History {
    pub(crate) fn of(scenario: &shared::Scenario) -> Self {
        let truth_dim = WorldRecord::of(scenario).truth.len();
        Self { state_dim: scenario.motion.state_dim(), truth_dim, robots: scenario.robots.len(), ..Self::default() }
    }

    /// The same with memory for this many ticks, so that arrays need not move as they grow.
    fn with_room_for(mut self, ticks: u64) -> Self {
        let ticks = usize::try_from(ticks).unwrap_or(usize::MAX).min(TICKS_AT_ONCE);
        let (n, m) = (self.state_dim, self.robots);
        self.state.reserve(ticks * n);
        self.covariance.reserve(ticks * n * n);
        self.truth.reserve(ticks * self.truth_dim);
        [&mut self.position_m, &mut self.believed_m].into_iter().for_each(|column| column.reserve(2 * m * ticks));
        self.believed_covariance_m2.reserve(4 * m * ticks);
        let columns = self.measured.iter_mut().chain(&mut self.commands).chain(&mut self.believed);
        columns.for_each(|column| column.reserve(m * ticks));
        self
    }

    /// Adds a tick. A value that no node has recorded is NaN, or zero if it is a count.
    pub(crate) fn add(&mut self, logged: LoggedTick<'_>) {
        let LoggedTick { tick, fusion, world } = logged;
        let n = self.state_dim;
        self.tick.push(tick);
        self.time_s.push(fusion.map(|record| record.time_s).or(world.map(|record| record.time_s)).unwrap_or(f64::NAN));
        let estimate = fusion.map(|record| &record.estimate);
        let number = |value: Option<f64>| value.unwrap_or(f64::NAN);
        match estimate {
            Some(estimate) => {
                self.state.extend_from_slice(&estimate.state[..n]);
                self.covariance.extend_from_slice(&estimate.covariance[..n * n]);
            }
            None => {
                self.state.resize(self.state.len() + n, f64::NAN);
                self.covariance.resize(self.covariance.len() + n * n, f64::NAN);
            }
        }
        match world {
            Some(world) => self.truth.extend_from_slice(&world.truth),
            None => self.truth.resize(self.truth.len() + self.truth_dim, f64::NAN),
        }
        self.nis.push(number(estimate.map(|estimate| estimate.nis)));
        let counts = estimate.map_or([0; 3], |estimate| [estimate.fused, estimate.rejected, estimate.missing]);
        self.counts.iter_mut().zip(counts).for_each(|(column, count)| column.push(count));
        let planned = estimate.map(|estimate| [estimate.objective, estimate.lower_bound, estimate.least_trace_m2]);
        let planned = planned.unwrap_or([f64::NAN; 3]);
        self.planned.iter_mut().zip(planned).for_each(|(column, value)| column.push(value));
        let times_ns = estimate.map_or([0; 2], |estimate| [estimate.stages.last_range_ns, estimate.stages.sent_ns]);
        self.times_ns.iter_mut().zip(times_ns).for_each(|(column, time_ns)| column.push(time_ns));
        for robot in 0..self.robots {
            let exchange = fusion.and_then(|record| record.exchanges.get(robot));
            let body = world.and_then(|record| record.robots.get(robot));
            self.add_robot(
                body,
                exchange.and_then(|exchange| exchange.heard),
                exchange.map(|exchange| exchange.command),
            );
        }
    }

    fn add_robot(&mut self, body: Option<&RobotRecord>, heard: Option<Heard>, command: Option<Command>) {
        let nowhere = [f64::NAN; 2];
        self.position_m.extend(body.map_or(nowhere, |body| [body.pose.x_m, body.pose.y_m]));
        let pose = heard.map(|heard| heard.measurement.pose);
        self.believed_m.extend(pose.map_or(nowhere, |pose| [pose.x_m, pose.y_m]));
        let [xx_m2, xy_m2, yy_m2] = pose.map_or([f64::NAN; 3], |pose| pose.covariance_m2);
        self.believed_covariance_m2.extend([xx_m2, xy_m2, xy_m2, yy_m2]);
        let other = pose.map_or([f64::NAN; 3], |pose| [pose.height_m, pose.heading_rad, pose.heading_std_rad]);
        self.believed.iter_mut().zip(other).for_each(|(column, value)| column.push(value));
        for (kind, used) in Kind::ALL.into_iter().zip(&mut self.used) {
            let (value, std) = heard.and_then(|heard| heard.measurement.of(kind)).unwrap_or((f64::NAN, f64::NAN));
            self.measured[2 * kind as usize].push(value);
            self.measured[2 * kind as usize + 1].push(std);
            let judged = heard.and_then(|heard| heard.judged[kind as usize]);
            used.push(judged.map_or(0, |judged| judged.used as i8 + 1));
        }
        let [headings, speeds] = &mut self.commands;
        headings.push(command.map_or(f64::NAN, |command| command.heading_rad));
        speeds.push(command.map_or(f64::NAN, |command| command.speed_mps));
    }

    fn add_distance(&mut self, distance: Distance) {
        let [gaps, excesses] = &mut self.distances;
        gaps.push(distance.gap);
        excesses.push(distance.trace_excess);
    }

    /// The arrays by name.
    pub(crate) fn into_dict(self, py: Python<'_>) -> PyResult<Bound<'_, PyDict>> {
        let dict = PyDict::new(py);
        let (ticks, n, m) = (self.tick.len(), self.state_dim, self.robots);
        dict.set_item("tick", array(py, self.tick, &[ticks])?)?;
        dict.set_item("time_s", array(py, self.time_s, &[ticks])?)?;
        dict.set_item("state", array(py, self.state, &[ticks, n])?)?;
        dict.set_item("covariance", array(py, self.covariance, &[ticks, n, n])?)?;
        dict.set_item("truth", array(py, self.truth, &[ticks, self.truth_dim])?)?;
        dict.set_item("nis", array(py, self.nis, &[ticks])?)?;
        for (name, column) in ["fused", "rejected", "missing"].into_iter().zip(self.counts) {
            dict.set_item(name, array(py, column, &[ticks])?)?;
        }
        for (name, column) in ["objective", "lower_bound", "least_trace_m2"].into_iter().zip(self.planned) {
            dict.set_item(name, array(py, column, &[ticks])?)?;
        }
        for (name, column) in ["last_range_ns", "sent_ns"].into_iter().zip(self.times_ns) {
            dict.set_item(name, array(py, column, &[ticks])?)?;
        }
        dict.set_item("robot_m", array(py, self.position_m, &[ticks, m, 2])?)?;
        dict.set_item("believed_m", array(py, self.believed_m, &[ticks, m, 2])?)?;
        dict.set_item("believed_covariance_m2", array(py, self.believed_covariance_m2, &[ticks, m, 2, 2])?)?;
        let names = ["believed_height_m", "believed_heading_rad", "believed_heading_std_rad"];
        for (name, column) in names.into_iter().zip(self.believed) {
            dict.set_item(name, array(py, column, &[ticks, m])?)?;
        }
        let names = ["range_m", "range_std_m", "bearing_rad", "bearing_std_rad"];
        for (name, column) in names.into_iter().zip(self.measured) {
            dict.set_item(name, array(py, column, &[ticks, m])?)?;
        }
        for (name, column) in ["range_used", "bearing_used"].into_iter().zip(self.used) {
            dict.set_item(name, array(py, column, &[ticks, m])?)?;
        }
        for (name, column) in ["heading_rad", "speed_mps"].into_iter().zip(self.commands) {
            dict.set_item(name, array(py, column, &[ticks, m])?)?;
        }
        for (name, column) in ["gap", "trace_excess"].into_iter().zip(self.distances) {
            if column.len() == ticks {
                dict.set_item(name, array(py, column, &[ticks])?)?;
            }
        }
        Ok(dict)
    }
}

/// A run in this process, stepped turn by turn.
struct Stepped<'a> {
    team: Team,
    ticks: u64,
    next: u64,
    fusion: FusionRecord,
    world: WorldRecord,
    history: History,
    report: ReportBuilder<'a>,
    reference: Option<CertifiedReference>,
    raised: Raised,
}

impl Stepped<'_> {
    /// Steps for a turn. False at the end of the run.
    fn turn(&mut self) -> anyhow::Result<bool> {
        let began = Instant::now();
        while self.next <= self.ticks {
            self.team.tick()?;
            if self.raised.is_set() {
                return Ok(false);
            }
            self.team.record_estimate(&mut self.fusion);
            self.team.record_world(&mut self.world);
            let logged = LoggedTick { tick: self.next, fusion: Some(&self.fusion), world: Some(&self.world) };
            self.history.add(logged);
            self.report.add(logged);
            if let Some(reference) = &mut self.reference {
                let centre = self.team.centre();
                self.history.add_distance(reference.measure(centre.situation(), centre.last_plan()));
            }
            self.team.advance();
            self.next += 1;
            if self.next.is_multiple_of(TURN_TICKS) && began.elapsed() > TURN {
                return Ok(true);
            }
        }
        Ok(false)
    }
}

/// The parts of a run that are functions; what is missing is the scenario's.
pub(crate) fn parts(
    scenario: &shared::Scenario,
    planner: Option<Py<PyAny>>,
    sensor: Option<Py<PyAny>>,
    target: Option<Py<PyAny>>,
    raised: &Raised,
) -> Result<Parts, PlannerError> {
    let planner = planner.map(|function| situation::planner(scenario.robots.len(), function, raised.clone()));
    let motion = target.map(|function| Box::new(FunctionTarget::new(function, raised.clone())));
    Ok(Parts {
        planner: planner.transpose()?,
        sensors: sensor.map_or_else(Vec::new, |function| FunctionSensor::of_team(scenario, function, raised)),
        world: motion.and_then(|motion| world_moved_by(scenario, motion)),
    })
}

/// Runs a scenario in this process: its arrays, and its report as JSON.
#[pyfunction]
#[pyo3(signature = (
    scenario, *, planner=None, sensor=None, target=None, seed=None, ticks=None, gap=false, truth=None, progress=None
))]
#[allow(clippy::too_many_arguments, reason = "keywords of Python")]
pub(crate) fn simulate<'py>(
    py: Python<'py>,
    scenario: &Scenario,
    planner: Option<Py<PyAny>>,
    sensor: Option<Py<PyAny>>,
    target: Option<Py<PyAny>>,
    seed: Option<u64>,
    ticks: Option<u64>,
    gap: bool,
    truth: Option<PathBuf>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<(Bound<'py, PyDict>, String)> {
    let scenario = &scenario.with(py, seed, ticks)?;
    let truth = read_truth(py, truth)?;
    let is_recorded = matches!(scenario.source, Source::Recorded(_));
    let replaced = planner.is_some() || sensor.is_some() || target.is_some() || gap;
    if is_recorded && replaced {
        return Err(input(
            "planner, sensor, target or gap is given with a recording: expected a simulated scenario, because recorded \
             sensors are neither steered nor simulated",
        ));
    }
    let (raised, robots) = (Raised::default(), scenario.robots.len());
    let parts = parts(scenario, planner, sensor, target, &raised).map_err(input)?;
    let mut run = Stepped {
        team: Team::of_parts(scenario, Path::new(""), parts).map_err(failed)?,
        ticks: scenario.ticks,
        next: 0,
        fusion: FusionRecord::of(scenario),
        world: WorldRecord::of(scenario),
        history: History::of(scenario).with_room_for(scenario.ticks + 1),
        report: ReportBuilder::new(truth.as_ref()).map_err(failed)?,
        reference: gap.then(|| CertifiedReference::for_robots(robots)).transpose().map_err(input)?,
        raised: raised.clone(),
    };
    while py.detach(|| run.turn()).map_err(failed)? {
        py.check_signals()?;
        if let Some(progress) = &progress {
            progress.call1((run.next, run.ticks))?;
        }
    }
    raised.check()?;
    let report = run.report.finish(scenario, Vec::new());
    Ok((run.history.into_dict(py)?, serde_json::to_string(&report).map_err(failed)?))
}

/// Loads the logs of a run folder, of a run that has ended or that still runs: scenario, arrays, and the report as JSON.
#[pyfunction]
#[pyo3(signature = (folder, *, truth=None, progress=None))]
pub(crate) fn load<'py>(
    py: Python<'py>,
    folder: PathBuf,
    truth: Option<PathBuf>,
    progress: Option<Py<PyAny>>,
) -> PyResult<(Option<Scenario>, Bound<'py, PyDict>, String)> {
    let description = read_description(&folder).map_err(failed)?;
    let truth = read_truth(py, truth)?;
    let read = || -> anyhow::Result<_> {
        let (mut history, mut report) = (History::of(&description.scenario), ReportBuilder::new(truth.as_ref())?);
        let frames = Frames::open(&description)?;
        let count = frames.newest_tick()?.map_or(0, |newest| newest + 1);
        frames.for_each(|logged| {
            history.add(logged);
            report.add(logged);
            let done = logged.tick + 1;
            if done.is_multiple_of(LOADED_AT_ONCE) {
                Python::attach(|py| {
                    py.check_signals()?;
                    progress.as_ref().map_or(Ok(()), |progress| progress.call1(py, (done, count)).map(drop))
                })?;
            }
            Ok(())
        })?;
        Ok((history, report.finish(&description.scenario, read_nodes(&folder)?)))
    };
    let (history, report) = py.detach(read).map_err(failed)?;
    let scenario = Scenario::of_run(py, &folder)?;
    Ok((scenario, history.into_dict(py)?, serde_json::to_string(&report).map_err(failed)?))
}
