//! Live runs: an observer that follows a run's logs, and nodes whose sensors, drives or planner are Python functions.
//!
//! The observer reads files and takes part in nothing: the run neither waits for it nor notices when it is killed.

use std::os::fd::OwnedFd;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use pyo3::prelude::*;
use pyo3::types::PyDict;
use rangehound::failure::Failure;
use rangehound::results::frame::{Frames, LoggedTick};
use rangehound::results::ros_bag::planar::{self, Controller};
use rangehound::run::node::{input_or_running, of_fusion, of_robot};
use rangehound::run::remote::Status;
use rangehound_fusion::planner::{Plan, Planner, Situation};
use rangehound_node::fusion::FusionError;
use rangehound_node::logs;
use rangehound_node::rendezvous::{Rendezvous, RendezvousError, Role};
use rangehound_node::robot::RobotError;
use rangehound_node::system::signal::Termination;
use rangehound_robot::drive::HOLD_TICKS;
use rangehound_robot::pose::{self, PoseSource};
use rangehound_robot::sensor::{self, Sensor};
use rangehound_shared::run_name::RunName;
use rangehound_shared::scenario::{Clock, RobotSpec, Scenario, Source, Timeout};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::inotify;

use crate::arrays::array;
use crate::callables::{Function, FunctionActuator, FunctionPose, FunctionSensor};
use crate::errors::{Raised, RunError, failed, input};
use crate::radio::RadioOnPort;
use crate::run::History;
use crate::situation;

/// How long an observer sleeps without a change of the logs: it then looks whether the run goes on.
const IDLE: Duration = Duration::from_millis(100);

/// A run without simulator, fusion and supervisor for this long has ended, whatever its state.
const NO_PROCESS_MAX: Duration = Duration::from_secs(3);

/// How long a node may take to end after it has been asked to.
const END_WAIT: Duration = Duration::from_secs(2);

/// How often a node's process acts on signals.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// Iterates over the ticks of a live run.
#[pyclass(module = "rangehound._native")]
pub(crate) struct Observer {
    run: Rendezvous,
    frames: Option<Frames>,
    changes: Option<OwnedFd>,
    next: Option<u64>,
    waits_for_truth: bool,
    /// True if no log has changed for a while: only then it asks whether the run goes on.
    is_quiet: bool,
    inhabited: Instant,
}

fn run_name(name: &str) -> PyResult<RunName> {
    name.parse().map_err(|error| input(format!("name: {error}")))
}

#[pymethods]
impl Observer {
    /// Waits for the run up to `timeout_s`, and starts with its newest tick, or with its first.
    #[new]
    pub(crate) fn new(
        py: Python<'_>,
        name: &str,
        from_start: bool,
        waits_for_truth: bool,
        timeout_s: f64,
    ) -> PyResult<Self> {
        let (name, began) = (run_name(name)?, Instant::now());
        let run = loop {
            if let Some(run) = Rendezvous::join_if_alive(&name).map_err(|error| failed(input_or_running(error)))? {
                break run.observe();
            }
            if began.elapsed().as_secs_f64() >= timeout_s {
                return Err(input(format!("no run {name} after {timeout_s} s: expected a run that has been started")));
            }
            py.check_signals()?;
            py.detach(|| std::thread::sleep(POLL_INTERVAL));
        };
        let next = from_start.then_some(0);
        Ok(Self { run, frames: None, changes: None, next, waits_for_truth, is_quiet: true, inhabited: Instant::now() })
    }

    /// Name of the run.
    #[getter]
    fn name(&self) -> String {
        self.run.name().to_string()
    }

    /// Its folder.
    #[getter]
    fn folder(&self) -> std::path::PathBuf {
        self.run.description().out_dir.clone()
    }

    /// The facts of the run that its messages lack: the length of a time step, s; whether its clock is lock step, whether it is a
    /// recording, and whether the state goes on with the velocity after the position; what ROS's stamps add to its times, ns, and
    /// the limits of the controller by default; and for each robot its speed limit, m/s, and the standard deviations that the filter
    /// assumes for its range at distance 0, m, and its bearing, rad: NaN for what it does not measure.
    fn describe<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let scenario = self.scenario();
        let of_each =
            |of: fn(&RobotSpec) -> f64| array(py, scenario.robots.iter().map(of).collect(), &[scenario.robots.len()]);
        let Controller { max_speed_mps, max_turn_rate_radps, heading_gain_per_s } = Controller::of_team(scenario);
        let dict = PyDict::new(py);
        dict.set_item("dt_s", scenario.dt_s)?;
        dict.set_item("is_lockstep", scenario.clock == Clock::Lockstep)?;
        dict.set_item("is_recording", matches!(scenario.source, Source::Recorded(_)))?;
        dict.set_item("has_velocity", planar::has_velocity(scenario))?;
        dict.set_item("stamp_offset_ns", planar::stamp_offset_ns(scenario))?;
        dict.set_item("controller", (max_speed_mps, max_turn_rate_radps, heading_gain_per_s))?;
        dict.set_item("max_speeds_mps", of_each(|robot| robot.speed_mps)?)?;
        dict.set_item("range_stds_m", of_each(|robot| robot.reported.range.map_or(f64::NAN, |range| range.std_m))?)?;
        dict.set_item("bearing_stds_rad", of_each(|robot| robot.reported.bearing_std_rad.unwrap_or(f64::NAN))?)?;
        Ok(dict)
    }

    /// The nodes and their states, as JSON with the keys of `rangehound status --json`.
    fn status(&self) -> PyResult<String> {
        serde_json::to_string(&Status::of(&self.run)).map_err(failed)
    }

    /// True once the run has ended, or its processes are gone.
    pub(crate) fn is_over(&mut self) -> bool {
        let roster = self.run.roster();
        if [Role::Sim, Role::Fusion, Role::Supervisor].into_iter().any(|role| roster.is_held(role)) {
            self.inhabited = Instant::now();
            // Fusion writes its last tick after the simulator has ended the run.
            return self.run.is_finished() && !roster.is_held(Role::Fusion);
        }
        self.run.is_finished() || self.inhabited.elapsed() >= NO_PROCESS_MAX
    }

    fn __iter__(this: PyRef<'_, Self>) -> PyRef<'_, Self> {
        this
    }

    /// The arrays of the next tick, of one row each; none at the end of the run.
    fn __next__<'py>(&mut self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyDict>>> {
        let history = self.wait(py, |scenario, logged| {
            let mut history = History::of(scenario);
            history.add(logged);
            history
        })?;
        history.map(|history| history.into_dict(py)).transpose()
    }
}

impl Observer {
    /// The result of `take` for the next tick, once it is logged; `None` at the end of the run.
    pub(crate) fn wait<T>(
        &mut self,
        py: Python<'_>,
        take: impl Fn(&Scenario, LoggedTick<'_>) -> T,
    ) -> PyResult<Option<T>> {
        loop {
            if let Some(taken) = self.look(false, &take).map_err(failed)? {
                return Ok(Some(taken));
            }
            if self.is_quiet && self.is_over() {
                // The tick that was logged just before the end.
                return self.look(true, &take).map_err(failed);
            }
            py.check_signals()?;
            py.detach(|| self.sleep());
        }
    }

    /// The scenario of the run.
    pub(crate) fn scenario(&self) -> &Scenario {
        &self.run.description().scenario
    }

    /// The newest tick in fusion's log.
    pub(crate) fn newest_tick(&self) -> Option<u64> {
        self.frames.as_ref()?.newest_estimate().ok()?
    }

    /// The result of `take` for the next tick, if it is logged.
    pub(crate) fn look<T>(
        &mut self,
        is_over: bool,
        take: impl Fn(&Scenario, LoggedTick<'_>) -> T,
    ) -> anyhow::Result<Option<T>> {
        let description = self.run.description();
        let frames = match &mut self.frames {
            Some(frames) => frames,
            None => match Frames::open(description) {
                Ok(frames) => self.frames.insert(frames),
                // The nodes have not made their logs yet.
                Err(_) => return Ok(None),
            },
        };
        let Some(newest) = frames.newest_estimate()? else { return Ok(None) };
        let next = *self.next.get_or_insert(newest);
        for tick in next..=newest {
            let logged = frames.logged(tick)?;
            // After a kill the record of a tick may be missing: its successor writes it, or the run goes on without it.
            if logged.fusion.is_none() && tick < newest {
                continue;
            }
            if logged.fusion.is_none()
                || self.waits_for_truth && logged.world.is_none() && tick + 1 >= newest && !is_over
            {
                return Ok(None);
            }
            self.next = Some(tick + 1);
            return Ok(Some(take(&description.scenario, logged)));
        }
        Ok(None)
    }

    /// Sleeps until a log changes, or for a while.
    fn sleep(&mut self) {
        if self.changes.is_none() && self.frames.is_some() {
            self.changes = watch(&self.run.description().out_dir, self.waits_for_truth);
            // Ticks that were written before are read first.
            return;
        }
        let Some(changes) = &self.changes else { return std::thread::sleep(POLL_INTERVAL) };
        let timeout = Timespec { tv_sec: 0, tv_nsec: IDLE.as_nanos() as i64 };
        self.is_quiet = poll(&mut [PollFd::new(changes, PollFlags::IN)], Some(&timeout)).is_ok_and(|ready| ready == 0);
        if !self.is_quiet {
            self.inhabited = Instant::now();
        }
        // The events say only that something was written.
        let mut events = [0; 4096];
        while rustix::io::read(changes, &mut events).is_ok_and(|read| read == events.len()) {}
    }
}

/// Tells of writes to the logs of a run; `None` on a file system that does not.
fn watch(folder: &std::path::Path, also_truth: bool) -> Option<OwnedFd> {
    let changes = inotify::init(inotify::CreateFlags::CLOEXEC | inotify::CreateFlags::NONBLOCK).ok()?;
    let worlds = also_truth.then(|| logs::worlds_path(folder));
    for log in [logs::estimates_path(folder)].iter().chain(&worlds) {
        inotify::add_watch(&changes, log, inotify::WatchFlags::MODIFY).ok()?;
    }
    Some(changes)
}

/// One node in a process: iceoryx2 is set up for one run, once.
static IS_A_NODE: AtomicBool = AtomicBool::new(false);

/// The error if this process has been a node before.
fn refuse_second_node(has_been: bool) -> Result<(), Failure> {
    let refusal = || Failure::input("this process has been a node before: start a new process for each node");
    (!has_been).then_some(()).ok_or_else(refusal)
}

/// Claims this process for a node that is about to join the bus.
fn claim_process() -> Result<(), Failure> {
    refuse_second_node(IS_A_NODE.swap(true, Ordering::Relaxed))
}

/// A node that has been refused its role has not joined the bus.
fn release_process(error: &RendezvousError) {
    if matches!(error, RendezvousError::RoleTaken { .. }) {
        IS_A_NODE.store(false, Ordering::Relaxed);
    }
}

/// Runs a node in a thread of its own until the run ends. An exception of one of its functions, or of a signal, ends it.
fn run_node(
    py: Python<'_>,
    (name, role): (&str, Role),
    raised: &Raised,
    asked_of: &Asked,
    node: impl FnOnce(&Rendezvous, &Termination) -> Result<(), Failure> + Send + 'static,
) -> PyResult<()> {
    let name = run_name(name)?;
    refuse_second_node(IS_A_NODE.load(Ordering::Relaxed)).map_err(failed)?;
    let (termination, joined) = (Termination::by_request(), Arc::new(OnceLock::new()));
    let (of_node, joined_by_node) = (termination.clone(), Arc::clone(&joined));
    let work = move || {
        let rendezvous = Rendezvous::join(&name, &of_node, || ()).map_err(input_or_running)?;
        node(joined_by_node.get_or_init(|| rendezvous), &of_node)
    };
    let worker = std::thread::Builder::new().name("node".to_owned()).spawn(work);
    let worker = worker.map_err(|error| failed(anyhow::Error::from(error)))?;
    let (mut ended, mut asked) = (Ok(()), None);
    while !worker.is_finished() {
        py.detach(|| std::thread::sleep(POLL_INTERVAL));
        if let Err(error) = py.check_signals() {
            ended = Err(error);
        }
        if let Some(error) = asked_of.overdue() {
            raised.set(error);
        }
        if ended.is_err() || raised.is_set() {
            termination.request();
            if asked.get_or_insert_with(Instant::now).elapsed() > END_WAIT {
                // A function does not return. Its thread ends with the process; the run must not wait for that. In a thread, because
                // whoever takes a role is named after it.
                py.detach(|| {
                    std::thread::scope(|scope| scope.spawn(|| joined.get().map(|run| run.abandon(role))).join().ok())
                });
                ended?;
                return raised.check();
            }
        }
    }
    let outcome = py.detach(|| worker.join());
    ended?;
    raised.check()?;
    outcome.map_err(|_| failed(anyhow::anyhow!("the node panicked: please report this")))?.map_err(failed)
}

/// Runs a robot of a live run.
#[pyfunction]
#[pyo3(signature = (name, id, *, radio=None, measure=None, pose=None, carry_out=None))]
pub(crate) fn run_robot(
    py: Python<'_>,
    name: &str,
    id: usize,
    radio: Option<RadioOnPort>,
    measure: Option<Py<PyAny>>,
    pose: Option<Py<PyAny>>,
    carry_out: Option<Py<PyAny>>,
) -> PyResult<()> {
    let raised = Raised::default();
    let of_node = raised.clone();
    run_node(py, (name, Role::Robot(id)), &raised, &Asked::default(), move |rendezvous, termination| {
        let scenario = &rendezvous.description().scenario;
        let no_such = || Failure::input(format!("id is {id}: expected 0 to {}", scenario.robots.len() - 1));
        let mut sensor: Box<dyn Sensor> = match (measure, radio) {
            (Some(f), _) => Box::new(FunctionSensor::of_robot(scenario, id, f, &of_node).ok_or_else(no_such)?),
            (None, Some(radio)) => Box::new(radio.open(scenario, id)?),
            (None, None) => sensor::of_scenario(scenario, id).ok_or_else(no_such)?,
        };
        let mut poses: Box<dyn PoseSource> = match pose {
            Some(f) => Box::new(FunctionPose::new(f, of_node.clone())),
            None => pose::of_scenario(scenario, id).ok_or_else(no_such)?,
        };
        let mut actuator = FunctionActuator { function: carry_out.map(Function::new), raised: of_node };
        let parts = (sensor.as_mut(), poses.as_mut(), &mut actuator);
        claim_process()?;
        rangehound_node::robot::run_with(rendezvous, id, parts, termination).map_err(|error| {
            if let RobotError::Rendezvous(refused) = &error {
                release_process(refused);
            }
            of_robot(rendezvous, error)
        })
    })
}

/// Runs the fusion of a live run with a planner that is a function, or with the scenario's.
#[pyfunction]
#[pyo3(signature = (name, *, planner=None))]
pub(crate) fn run_fusion(py: Python<'_>, name: &str, planner: Option<Py<PyAny>>) -> PyResult<()> {
    let (raised, asked) = (Raised::default(), Asked::default());
    let (of_node, asked_of_node) = (raised.clone(), asked.clone());
    run_node(py, (name, Role::Fusion), &raised, &asked, move |rendezvous, termination| {
        let scenario = &rendezvous.description().scenario;
        let planner = match planner {
            Some(function) => {
                let inner = situation::planner(scenario.robots.len(), function, of_node.clone());
                let limit = time_limit(scenario);
                let inner = inner.map_err(Failure::input)?;
                Some(Box::new(Watched { inner, limit, asked: asked_of_node, raised: of_node }) as Box<dyn Planner>)
            }
            None => None,
        };
        claim_process()?;
        rangehound_node::fusion::run_with(rendezvous, planner, termination).map_err(|error| {
            if let FusionError::Rendezvous(refused) = &error {
                release_process(refused);
            }
            of_fusion(rendezvous, error)
        })
    })
}

/// How long a planner may take: in real time until the robots stop, in lock step until they would be left out.
fn time_limit(scenario: &Scenario) -> Duration {
    match (scenario.clock, scenario.timeout) {
        (Clock::Realtime, _) => Duration::from_secs_f64(HOLD_TICKS as f64 * scenario.dt_s),
        (Clock::Lockstep, Timeout::After(timeout)) => timeout,
        (Clock::Lockstep, Timeout::Forever) => Duration::MAX,
    }
}

/// The tick that a planner is asked for, since when, and how long it may take.
#[derive(Debug, Clone, Default)]
struct Asked(Arc<Mutex<Option<(u64, Instant, Duration)>>>);

impl Asked {
    fn set(&self, asked: Option<(u64, Instant, Duration)>) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = asked;
    }

    /// The error of a planner that takes too long.
    fn overdue(&self) -> Option<PyErr> {
        let (tick, since, limit) = (*self.0.lock().unwrap_or_else(PoisonError::into_inner))?;
        let (taken_s, limit_s) = (since.elapsed().as_secs_f64(), limit.as_secs_f64());
        let error = format!("the planner has taken {taken_s:.2} s at tick {tick}: expected at most {limit_s} s");
        (since.elapsed() > limit).then(|| RunError::new_err(error))
    }
}

/// A planner whose time is limited.
#[derive(Debug)]
struct Watched {
    inner: Box<dyn Planner>,
    limit: Duration,
    asked: Asked,
    raised: Raised,
}

impl Planner for Watched {
    fn name(&self) -> &'static str {
        self.inner.name()
    }

    fn plan(&mut self, tick: u64, situation: &Situation, plan: &mut Plan) {
        self.asked.set(Some((tick, Instant::now(), self.limit)));
        self.inner.plan(tick, situation, plan);
        if let Some(error) = self.asked.overdue() {
            self.raised.set(error);
        }
        self.asked.set(None);
    }
}
