//! Many runs of each variant, spread over threads, with common random numbers.
//!
//! Run `i` of every variant has the seed `first_seed + i`. Prior mean, target noise, noise of measurements and errors of poses
//! are functions of seed, tick and robot, so planners differ only in their headings.

use std::fmt;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use nalgebra::Vector2;
use rangehound_fusion::planner::PlannerError;
use rangehound_shared::scenario::{EXACT, OWN, Scenario, ScenarioError, ScenarioFile};

use super::certified_reference::{CertifiedReference, Distance};
use crate::files::input;
use crate::results::report::{position_covariance, position_error};
use crate::run::experiment::Given;
use crate::run::in_process::{Parts, Team};
use crate::statistics;

/// How often progress is shown.
const PROGRESS_INTERVAL: Duration = Duration::from_millis(50);

/// Most ticks of all runs together: their samples take two gigabytes.
const TICKS_MAX: u64 = 30_000_000;

/// From this index on there are no runs: the threads end.
const NONE_LEFT: u64 = u64::MAX / 2;

/// The subject of a comparison.
#[derive(Debug)]
pub struct Trials {
    /// The scenario; what varies and the seed are overridden.
    pub given: Given,
    /// The variants that are compared.
    pub variants: Vec<Variant>,
    /// Runs of each.
    pub runs: u64,
    /// Seed of run 0.
    pub first_seed: u64,
    /// Threads to run on.
    pub threads: usize,
}

/// One of the things compared: a planner, with other sensors, localisers or another treatment of nuisances if those vary too.
#[derive(Debug, Clone)]
pub struct Variant {
    /// Its name in tables and pictures.
    pub name: String,
    /// The planner by name; the scenario's own if none.
    pub planner: Option<String>,
    /// Parts in the place of the scenario's: then `planner` may be none.
    pub custom: Option<CustomParts>,
    /// The named sensor that all robots have; the scenario's own if none.
    pub sensor: Option<String>,
    /// The named localiser that all robots have, or [`EXACT`]; the scenario's own if none.
    pub localiser: Option<String>,
    /// The filter's treatment of nuisances; the scenario's own if none.
    pub nuisances: Option<String>,
}

/// Makes the parts of a run.
pub type MakeParts = dyn Fn(&Scenario) -> Result<Parts, PlannerError> + Send + Sync;

/// Planner, sensors or world that have no name in scenarios. Each run has its own, on the thread that steps the run.
#[derive(Clone)]
pub struct CustomParts(pub Arc<MakeParts>);

impl fmt::Debug for CustomParts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("CustomParts").finish_non_exhaustive()
    }
}

/// The treatments of nuisances by name: those of a scenario, and estimation.
pub const TREATMENTS: [&str; 4] = ["ignored", "inflated", "schmidt", "estimated"];

/// The variations beside the planner: names of sensors, localisers and treatments of nuisances. An empty list does not vary.
#[derive(Debug, Clone, Copy, Default)]
pub struct Varied<'a> {
    /// Sensors of the scenario, or [`OWN`].
    pub sensors: &'a [String],
    /// Localisers of the scenario, [`EXACT`] or [`OWN`].
    pub localisers: &'a [String],
    /// [`TREATMENTS`].
    pub nuisances: &'a [String],
}

impl Varied<'_> {
    /// True if there is anything but planners to compare.
    #[must_use]
    pub fn is_given(&self) -> bool {
        [self.sensors, self.localisers, self.nuisances].iter().any(|names| !names.is_empty())
    }
}

impl Variant {
    /// All combinations. A name has what varies, or the planner if nothing does.
    #[must_use]
    pub fn all(planners: &[String], varied: Varied<'_>) -> Vec<Self> {
        let or_own = |names: &[String]| -> Vec<Option<String>> {
            if names.is_empty() { vec![None] } else { names.iter().cloned().map(Some).collect() }
        };
        let [sensors, localisers, nuisances] = [varied.sensors, varied.localisers, varied.nuisances].map(or_own);
        let varies = sensors.len() * localisers.len() * nuisances.len() > 1;
        let named = |name: &Option<String>| name.clone().filter(|name| name != OWN);
        let mut variants = Vec::new();
        for planner in planners {
            for sensor in &sensors {
                for localiser in &localisers {
                    for treatment in &nuisances {
                        let of_planner = (planners.len() > 1 || !varies).then_some(planner.as_str());
                        let parts = [of_planner, sensor.as_deref(), localiser.as_deref(), treatment.as_deref()];
                        variants.push(Self {
                            name: parts.into_iter().flatten().collect::<Vec<_>>().join(" "),
                            planner: Some(planner.clone()),
                            custom: None,
                            sensor: named(sensor),
                            localiser: named(localiser),
                            nuisances: treatment.clone(),
                        });
                    }
                }
            }
        }
        variants
    }

    fn apply(&self, file: &mut ScenarioFile) {
        if let Some(planner) = &self.planner {
            file.planner.get_or_insert_default().name = Some(planner.clone());
        }
        if let Some(sensor) = &self.sensor {
            match &mut file.robot {
                Some(robots) => robots.iter_mut().for_each(|robot| {
                    (robot.sensor, robot.range_std_m) = (Some(sensor.clone()), None);
                }),
                None => {
                    let robots = file.robots.get_or_insert_default();
                    (robots.sensor, robots.range_std_m) = (Some(sensor.clone()), None);
                }
            }
        }
        if let Some(localiser) = &self.localiser {
            let localiser = Some(localiser.clone()).filter(|name| name != EXACT);
            match &mut file.robot {
                Some(robots) => robots.iter_mut().for_each(|robot| robot.localiser.clone_from(&localiser)),
                None => file.robots.get_or_insert_default().localiser = localiser,
            }
        }
        if let Some(treatment) = &self.nuisances {
            let filter = file.filter.get_or_insert_default();
            let estimates = treatment == "estimated";
            filter.nuisances = (!estimates).then(|| treatment.clone());
            filter.estimate = estimates.then(|| vec!["bias".to_owned(), "pose".to_owned()]);
        }
    }
}

/// One run of one variant.
#[derive(Debug, Clone, Default)]
pub struct Trial {
    /// Ticks 1 to the last; fewer than requested if the estimate diverged beyond all bounds.
    pub samples: Vec<Sample>,
    /// Sum of the normalised innovations squared.
    pub nis: f64,
    /// Ranges fused: degrees of freedom of `nis`.
    pub fused: u64,
    /// True if the estimate diverged beyond all bounds.
    pub out_of_bounds: bool,
}

/// One tick of a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Trace of the position covariance, m^2.
    pub trace_m2: f64,
    /// Its largest eigenvalue, m^2.
    pub max_eigenvalue_m2: f64,
    /// Squared position error, m^2.
    pub squared_error_m2: f64,
    /// The same over its covariance, two degrees of freedom; NaN if the covariance is singular.
    pub nees: f64,
    /// How far the plan is from the certified lower bound, see [`Distance::gap`].
    pub gap: f64,
    /// The planned position trace above the least that the bound allows, relative to the latter.
    pub trace_excess: f64,
    /// False if the bound is not proven to be the optimum, within what the planner states as its gap.
    pub certified: bool,
    /// Planning time, ns.
    pub planning_ns: u64,
}

impl Trials {
    /// Checks the extent of the comparison, before anything is computed; `ticks` are those of a run.
    ///
    /// # Errors
    /// One line that begins with the name of the wrong value.
    pub fn check_extent(&self, ticks: u64) -> Result<(), String> {
        let Self { runs, first_seed, .. } = self;
        if *runs == 0 || self.count().saturating_mul(ticks) > TICKS_MAX {
            let expected = format!("at least one run and at most {TICKS_MAX} ticks of all runs of all planners");
            return Err(format!("runs is {runs}: expected {expected}"));
        }
        if first_seed.checked_add(*runs).is_none() {
            return Err(format!(
                "seed is {first_seed}: expected at most {}, because each of {runs} runs has the next seed",
                u64::MAX - runs
            ));
        }
        Ok(())
    }

    /// The scenario of one run.
    ///
    /// # Errors
    /// [`ScenarioError`] for the first fault.
    pub fn scenario(&self, variant: &Variant, run: u64) -> Result<Scenario, ScenarioError> {
        let Given { file, file_name, folder, flags, .. } = &self.given;
        let mut file = file.clone();
        file.seed = Some(self.first_seed.wrapping_add(run));
        variant.apply(&mut file);
        input::scenario(&file, file_name, folder).map_err(|error| error.by_flag(flags))
    }

    /// Runs of all variants together.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.runs.saturating_mul(self.variants.len() as u64)
    }

    /// Runs them all: for each variant its trials in order of runs, independent of the threads. `on_progress` receives the
    /// number of runs done, several times a second; its error ends all runs at once.
    ///
    /// # Errors
    /// If a run cannot be set up or a thread cannot be started; also that of `on_progress`.
    pub fn run(&self, mut on_progress: impl FnMut(u64) -> anyhow::Result<()>) -> anyhow::Result<Vec<Vec<Trial>>> {
        let (next, done) = (AtomicU64::new(0), AtomicU64::new(0));
        let mut indexed = std::thread::scope(|scope| {
            let start = |_| std::thread::Builder::new().spawn_scoped(scope, || self.work(&next, &done));
            let workers: std::io::Result<Vec<_>> = (0..self.threads).map(start).collect();
            let workers = workers.inspect_err(|_| next.store(NONE_LEFT, Ordering::Relaxed)).map_err(|error| {
                anyhow::anyhow!("cannot start {} threads: {error}: choose fewer with --threads", self.threads)
            })?;
            while workers.iter().any(|worker| !worker.is_finished()) {
                on_progress(done.load(Ordering::Relaxed)).inspect_err(|_| next.store(NONE_LEFT, Ordering::Relaxed))?;
                std::thread::sleep(PROGRESS_INTERVAL);
            }
            let mut indexed = Vec::with_capacity(self.count() as usize);
            for worker in workers {
                indexed.extend(
                    worker
                        .join()
                        .map_err(|_| anyhow::anyhow!("a thread of the comparison panicked: please report this"))??,
                );
            }
            Ok::<_, anyhow::Error>(indexed)
        })?;
        indexed.sort_unstable_by_key(|(index, _)| *index);
        let mut trials: Vec<Vec<Trial>> = self.variants.iter().map(|_| Vec::new()).collect();
        for (index, trial) in indexed {
            trials[(index % self.variants.len() as u64) as usize].push(trial);
        }
        Ok(trials)
    }

    /// A thread's share. All variants of a run come before the next run, so that a busy moment of the
    /// machine affects all of them alike, and the remaining time can be estimated from the finished runs.
    fn work(&self, next: &AtomicU64, done: &AtomicU64) -> anyhow::Result<Vec<(u64, Trial)>> {
        let mut trials = Vec::new();
        loop {
            let index = next.fetch_add(1, Ordering::Relaxed);
            if index >= self.count() {
                return Ok(trials);
            }
            let variants = self.variants.len() as u64;
            let variant = &self.variants[(index % variants) as usize];
            let trial = self
                .scenario(variant, index / variants)
                .map_err(anyhow::Error::from)
                .and_then(|scenario| Trial::run(&scenario, variant, || next.load(Ordering::Relaxed) >= NONE_LEFT))
                // The other threads need not continue.
                .inspect_err(|_| next.store(NONE_LEFT, Ordering::Relaxed))?;
            trials.push((index, trial));
            done.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl Trial {
    /// Runs a scenario to its end, or until `is_stopped`.
    fn run(scenario: &Scenario, variant: &Variant, is_stopped: impl Fn() -> bool) -> anyhow::Result<Self> {
        let parts = variant.custom.as_ref().map(|CustomParts(make)| make(scenario)).transpose()?;
        let mut team = Team::of_parts(scenario, Path::new(""), parts.unwrap_or_default())?;
        let reference = &mut CertifiedReference::for_robots(scenario.robots.len())?;
        let mut trial = Self { samples: Vec::with_capacity(scenario.ticks as usize), ..Self::default() };
        for tick in 0..=scenario.ticks {
            if is_stopped() {
                break;
            }
            if team.tick().is_err() {
                trial.out_of_bounds = true;
                break;
            }
            if tick > 0 {
                trial.add(&team, reference);
            }
            team.advance();
        }
        Ok(trial)
    }

    fn add(&mut self, team: &Team, reference: &mut CertifiedReference) {
        let estimate = team.centre().estimate();
        let &[x_m, y_m, ..] = team.world().truth() else { return };
        self.nis += estimate.nis;
        self.fused += estimate.fused;
        let p = position_covariance(&estimate);
        let (squared_error_m2, nees) = position_error(&estimate, Vector2::new(x_m, y_m));
        let Distance { gap, trace_excess, certified } =
            reference.measure(team.centre().situation(), team.centre().last_plan());
        self.samples.push(Sample {
            trace_m2: p.trace(),
            max_eigenvalue_m2: 0.5 * p.trace() + (0.5 * (p[(0, 0)] - p[(1, 1)])).hypot(p[(0, 1)]),
            squared_error_m2,
            nees: nees.unwrap_or(f64::NAN),
            gap,
            trace_excess,
            certified,
            planning_ns: team.planning_ns(),
        });
    }

    /// True if the mean position error of the last ticks is above a limit, or there is no estimate.
    #[must_use]
    pub fn has_diverged(&self, last_ticks: usize, limit_m: f64) -> bool {
        let last = &self.samples[self.samples.len().saturating_sub(last_ticks)..];
        self.out_of_bounds || statistics::mean(last.iter().map(|sample| sample.squared_error_m2.sqrt())) > limit_m
    }
}
