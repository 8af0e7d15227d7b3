//! The fusion centre's filter, tick by tick.

use std::sync::{Mutex, MutexGuard, PoisonError};

use numpy::PyArrayDyn;
use pyo3::prelude::*;
use rangehound_fusion::Centre;
use rangehound_fusion::planner::hull_certificate;
use rangehound_shared::measurement::{Kind, Measurement, Pose};
use rangehound_shared::scenario::{self as shared, Source};

use crate::arrays::{Numbers, array, each};
use crate::errors::input;
use crate::plan::Plan;
use crate::scenario::Scenario;

/// The filter of a scenario, between ticks.
#[pyclass(subclass, module = "rangehound._native")]
pub(crate) struct Filter {
    /// A lock, because a planner is for one thread at a time.
    centre: Mutex<Centre>,
    scenario: shared::Scenario,
    /// Where each robot was last.
    poses: Vec<Pose>,
    reports: Vec<Option<Measurement>>,
}

impl Filter {
    fn centre(&self) -> MutexGuard<'_, Centre> {
        self.centre.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn tick_after(&self) -> u64 {
        self.centre().next_tick()
    }
}

#[pymethods]
impl Filter {
    #[new]
    fn new(scenario: &Scenario) -> PyResult<Self> {
        let scenario = scenario.checked.clone();
        let filter = Self {
            centre: Mutex::new(Centre::new(&scenario).map_err(input)?),
            poses: scenario.robots.iter().map(|robot| Pose::at(robot.start_m)).collect(),
            reports: vec![None; scenario.robots.len()],
            scenario,
        };
        // Tick 0: the estimate is the prior.
        let reports = filter.poses.iter().map(|pose| Some(Measurement::new(*pose, None))).collect::<Vec<_>>();
        filter.centre().update(0.0, &reports).map_err(input)?;
        Ok(filter)
    }

    /// One tick: predicts over a time step, then fuses what is given.
    ///
    /// `ranges_m`, m, and `bearings_rad`, rad, are (M,), NaN where a robot has none; `positions_m` (M, 2) stay until they are given
    /// again. Without standard deviations those of the scenario hold. Bearings count from `headings_rad`.
    /// `position_covariances_m2` is (M, 2, 2). `time_s` is for the filter of a recording alone.
    #[pyo3(signature = (
        ranges_m=None, *, positions_m=None, range_stds_m=None, bearings_rad=None, bearing_stds_rad=None, headings_rad=None,
        position_covariances_m2=None, time_s=None
    ))]
    #[allow(clippy::too_many_arguments, reason = "keywords of Python")]
    fn step(
        &mut self,
        ranges_m: Option<&Bound<'_, PyAny>>,
        positions_m: Option<&Bound<'_, PyAny>>,
        range_stds_m: Option<&Bound<'_, PyAny>>,
        bearings_rad: Option<&Bound<'_, PyAny>>,
        bearing_stds_rad: Option<&Bound<'_, PyAny>>,
        headings_rad: Option<&Bound<'_, PyAny>>,
        position_covariances_m2: Option<&Bound<'_, PyAny>>,
        time_s: Option<f64>,
    ) -> PyResult<()> {
        let robots = self.poses.len();
        if time_s.is_some() && matches!(self.scenario.source, Source::Simulated { .. }) {
            return Err(input("time_s is given: expected none, because the scenario's steps all last dt_s"));
        }
        let ranges = each(ranges_m, "ranges_m", robots)?;
        let range_stds = each(range_stds_m, "range_stds_m", robots)?;
        let bearings = each(bearings_rad, "bearings_rad", robots)?;
        let bearing_stds = each(bearing_stds_rad, "bearing_stds_rad", robots)?;
        let headings = each(headings_rad, "headings_rad", robots)?;
        let positions = positions_m
            .map(|value| Numbers::of(value, "positions_m")?.shaped("positions_m", &[robots, 2]))
            .transpose()?;
        let covariances = position_covariances_m2
            .map(|value| {
                Numbers::of(value, "position_covariances_m2")?.shaped("position_covariances_m2", &[robots, 2, 2])
            })
            .transpose()?;
        // All is checked before anything is stored.
        let mut poses = self.poses.clone();
        for (robot, pose) in poses.iter_mut().enumerate() {
            if let Some(positions) = &positions {
                (pose.x_m, pose.y_m) = (positions[2 * robot], positions[2 * robot + 1]);
            }
            if let Some(headings) = &headings {
                pose.heading_rad = headings[robot];
            }
            if let Some(values) = &covariances {
                pose.covariance_m2 = [values[4 * robot], values[4 * robot + 1], values[4 * robot + 3]];
            }
            if !pose.numbers().iter().all(|number| number.is_finite()) {
                return Err(input(format!(
                    "the pose of robot {robot} has NaN or infinite numbers: expected finite ones"
                )));
            }
            let reported = self.scenario.robots[robot].reported;
            let range = value("ranges_m", robot, &ranges, &range_stds, |range_m| {
                reported.range.map(|range| range.std_at_m(range_m))
            })?;
            let bearing = value("bearings_rad", robot, &bearings, &bearing_stds, |_| reported.bearing_std_rad)?;
            self.reports[robot] = Some(Measurement::new(*pose, range).with_bearing(bearing));
        }
        let now_s = time_s.unwrap_or(self.tick_after() as f64 * self.scenario.dt_s);
        self.centre().update(now_s, &self.reports).map_err(input)?;
        self.poses = poses;
        Ok(())
    }

    /// The best headings for the next measurements, by the scenario's planner.
    fn plan(&self) -> PyResult<Plan> {
        if matches!(self.scenario.source, Source::Recorded(_)) {
            return Err(input(
                "the filter is one of a recording: expected a simulated scenario, whose robots are steered",
            ));
        }
        let mut centre = self.centre();
        let began = std::time::Instant::now();
        centre.plan();
        let plan_us = began.elapsed().as_secs_f64() * 1e6;
        let (situation, plan) = (centre.situation(), centre.last_plan());
        let certificate = plan.certificate.unwrap_or_else(|| hull_certificate(situation, plan));
        Ok(Plan::of_parts(self.scenario.planner.name(), plan, certificate, plan_us))
    }

    /// The last tick.
    #[getter]
    fn tick(&self) -> u64 {
        self.tick_after().saturating_sub(1)
    }

    /// Time of the last tick, s.
    #[getter]
    fn time_s(&self) -> f64 {
        self.centre().time_s()
    }

    /// The state, (n,), position first.
    #[getter]
    fn state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let centre = self.centre();
        let state = centre.state();
        array(py, state.to_vec(), &[state.len()])
    }

    /// Its covariance, (n, n).
    #[getter]
    fn covariance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let centre = self.centre();
        let n = centre.state().len();
        array(py, centre.covariance().to_vec(), &[n, n])
    }

    /// Normalised innovation squared of the last update.
    #[getter]
    fn nis(&self) -> f64 {
        self.centre().estimate().nis
    }

    /// Measurements fused by the last update.
    #[getter]
    fn fused(&self) -> u64 {
        self.centre().estimate().fused
    }

    /// Measurements rejected by the last update.
    #[getter]
    fn rejected(&self) -> u64 {
        self.centre().estimate().rejected
    }

    /// Robots whose ranges are distrusted.
    #[getter]
    fn distrusted(&self) -> Vec<usize> {
        let ranges = self.centre().distrusted()[Kind::Range as usize];
        (0..self.poses.len()).filter(|robot| ranges.contains(*robot)).collect()
    }

    /// Hash over the bits of all estimates so far.
    #[getter]
    fn digest(&self) -> String {
        let [low, high] = self.centre().estimate().digest;
        format!("{high:016x}{low:016x}")
    }
}

/// A robot's value of a kind with its standard deviation; NaN is none.
fn value(
    name: &str,
    robot: usize,
    values: &Option<Vec<f64>>,
    stds: &Option<Vec<f64>>,
    own_std: impl Fn(f64) -> Option<f64>,
) -> PyResult<Option<(f64, f64)>> {
    let Some(value) = values.as_ref().map(|values| values[robot]).filter(|value| !value.is_nan()) else {
        return Ok(None);
    };
    let std = match stds {
        Some(stds) => stds[robot],
        None => own_std(value).ok_or_else(|| {
            input(format!("{name} has a value of robot {robot}, which measures none in the scenario: expected its standard deviation too"))
        })?,
    };
    if !value.is_finite() || !std.is_finite() || std <= 0.0 {
        return Err(input(format!(
            "{name} has {value} with standard deviation {std} for robot {robot}: expected a finite value and a positive deviation"
        )));
    }
    Ok(Some((value, std)))
}
