//! Many runs of each variant, spread over threads, with common random numbers.
//!
//! Run `i` of every variant has the seed `first_seed + i`. Prior mean, target noise, noise of measurements and errors of poses
//! are functions of seed, tick and robot, so planners differ only in their headings.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use anyhow::Context;
use nalgebra::Vector2;
use rangehound_fusion::planner::range_only::Problem;
use rangehound_fusion::planner::{self, Plan, Planner, PlannerError, hull_certificate};
use rangehound_shared::scenario::{PlannerSpec, Scenario, ScenarioError, ScenarioFile, defaults};

use crate::files::input;
use crate::results::report::{position_covariance, position_error};
use crate::run::experiment::Given;
use crate::run::in_process::Team;
use crate::statistics;

/// How often progress is shown.
const LOOK: Duration = Duration::from_millis(50);

/// The subject of a comparison.
#[derive(Debug)]
pub struct Trials {
    /// The scenario; what varies and the seed are overridden.
    pub given: Given,
    /// What is compared.
    pub variants: Vec<Variant>,
    /// Runs of each.
    pub runs: u64,
    /// Seed of run 0.
    pub first_seed: u64,
    /// Threads to run on.
    pub threads: usize,
}

/// One of the things compared: a planner, with another sensor or another treatment of nuisances if those vary too.
#[derive(Debug, Clone)]
pub struct Variant {
    /// Its name in tables and pictures.
    pub name: String,
    /// The planner.
    pub planner: String,
    /// The named sensor that all robots have; the scenario's own if none.
    pub sensor: Option<String>,
    /// What the filter does about nuisances; the scenario's own if none.
    pub nuisances: Option<String>,
}

/// The treatments of nuisances by name: those of a scenario, and estimation.
pub const TREATMENTS: [&str; 4] = ["ignored", "inflated", "schmidt", "estimated"];

impl Variant {
    /// All combinations. A name has what varies, or the planner if nothing does.
    #[must_use]
    pub fn all(planners: &[String], sensors: &[String], nuisances: &[String]) -> Vec<Self> {
        let or_own = |names: &[String]| -> Vec<Option<String>> {
            if names.is_empty() { vec![None] } else { names.iter().cloned().map(Some).collect() }
        };
        let (own_sensors, own_nuisances) = (or_own(sensors), or_own(nuisances));
        let mut variants = Vec::new();
        for planner in planners {
            for sensor in &own_sensors {
                for treatment in &own_nuisances {
                    let varies = own_sensors.len() * own_nuisances.len() > 1;
                    let of_planner = (planners.len() > 1 || !varies).then_some(planner.as_str());
                    let parts = [of_planner, sensor.as_deref(), treatment.as_deref()];
                    variants.push(Self {
                        name: parts.into_iter().flatten().collect::<Vec<_>>().join(" "),
                        planner: planner.clone(),
                        sensor: sensor.clone(),
                        nuisances: treatment.clone(),
                    });
                }
            }
        }
        variants
    }

    fn apply(&self, file: &mut ScenarioFile) {
        file.planner.get_or_insert_default().name = Some(self.planner.clone());
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
    /// Planner's `|S|` above the certified lower bound, relative to the sum of all lambda.
    pub gap: f64,
    /// The planned position trace above the least that the bound allows, relative to the latter.
    pub trace_excess: f64,
    /// False if the bound is not proven to be the optimum to within a billionth.
    pub certified: bool,
    /// Planning time, ns.
    pub planning_ns: u64,
}

impl Trials {
    /// The scenario of one run.
    ///
    /// # Errors
    /// [`ScenarioError`] for the first fault.
    pub fn scenario(&self, variant: &Variant, run: u64) -> Result<Scenario, ScenarioError> {
        let Given { file, file_name, folder, .. } = &self.given;
        let mut file = file.clone();
        file.seed = Some(self.first_seed.wrapping_add(run));
        variant.apply(&mut file);
        input::scenario(&file, file_name, folder)
    }

    /// Runs of all variants together.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.runs.saturating_mul(self.variants.len() as u64)
    }

    /// Runs them all: for each variant its trials in order of runs, independent of the threads.
    ///
    /// # Errors
    /// If a run cannot be set up or a thread cannot be started.
    pub fn run(&self, mut on_progress: impl FnMut(u64)) -> anyhow::Result<Vec<Vec<Trial>>> {
        let (next, done) = (AtomicU64::new(0), AtomicU64::new(0));
        let mut indexed = std::thread::scope(|scope| {
            let start = |_| std::thread::Builder::new().spawn_scoped(scope, || self.work(&next, &done));
            let workers: std::io::Result<Vec<_>> = (0..self.threads).map(start).collect();
            let workers = workers
                .inspect_err(|_| next.store(u64::MAX / 2, Ordering::Relaxed))
                .with_context(|| format!("cannot start {} threads: choose fewer with --threads", self.threads))?;
            while workers.iter().any(|worker| !worker.is_finished()) {
                on_progress(done.load(Ordering::Relaxed));
                std::thread::sleep(LOOK);
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
            let trial = self
                .scenario(&self.variants[(index % variants) as usize], index / variants)
                .map_err(anyhow::Error::from)
                .and_then(|scenario| Trial::run(&scenario))
                // The other threads need not continue.
                .inspect_err(|_| next.store(u64::MAX / 2, Ordering::Relaxed))?;
            trials.push((index, trial));
            done.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl Trial {
    fn run(scenario: &Scenario) -> anyhow::Result<Self> {
        let mut team = Team::new(scenario)?;
        let yardstick = &mut Yardstick::new(scenario)?;
        let mut trial = Self { samples: Vec::with_capacity(scenario.ticks as usize), ..Self::default() };
        for tick in 0..=scenario.ticks {
            if team.tick().is_err() {
                trial.out_of_bounds = true;
                break;
            }
            if tick > 0 {
                trial.add(&team, yardstick);
            }
            team.advance();
        }
        Ok(trial)
    }

    fn add(&mut self, team: &Team, yardstick: &mut Yardstick) {
        let estimate = team.centre().estimate();
        let &[x_m, y_m, ..] = team.world().truth() else { return };
        self.nis += estimate.nis;
        self.fused += estimate.fused;
        let p = position_covariance(&estimate);
        let (squared_error_m2, nees) = position_error(&estimate, Vector2::new(x_m, y_m));
        let Distance { gap, trace_excess, certified } = yardstick.measure(team);
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

/// The certified optimum of the same situations that other planners received.
#[derive(Debug)]
struct Yardstick {
    optimiser: Box<dyn Planner>,
    optimum: Plan,
    problem: Problem,
}

/// Distance of a plan from the optimum; as in [`Sample`].
#[derive(Debug, Clone, Copy, PartialEq)]
struct Distance {
    gap: f64,
    trace_excess: f64,
    certified: bool,
}

impl Yardstick {
    fn new(scenario: &Scenario) -> Result<Self, PlannerError> {
        let certified = PlannerSpec::Certified { nodes: defaults::NODES as u32 };
        let optimiser = planner::for_team(certified, scenario.robots.len(), scenario.seed)?;
        Ok(Self { optimiser, optimum: Plan::default(), problem: Problem::default() })
    }

    fn measure(&mut self, team: &Team) -> Distance {
        let (situation, plan) = (team.centre().situation(), team.centre().last_plan());
        // A plan with its own certificate needs no second one.
        let own = plan.certificate.filter(|proven| proven.is_optimal);
        let best = own.or_else(|| {
            self.optimiser.plan(0, situation, &mut self.optimum);
            self.optimum.certificate
        });
        self.problem.pose(situation);
        let best = best.unwrap_or_else(|| hull_certificate(situation, plan));
        // The paper's |S| may be zero, a criterion of other teams is not.
        let scale = if situation.is_range_only() { self.problem.lambda_sum() } else { best.lower_bound };
        Distance {
            gap: ((plan.worth.objective - best.lower_bound) / scale).max(0.0),
            trace_excess: (plan.worth.position_trace_m2 / best.least_trace_m2 - 1.0).max(0.0),
            certified: best.is_optimal,
        }
    }
}
