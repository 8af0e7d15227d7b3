//! The nodes' pure steps composed in one process: no shared memory, no other processes, no waiting.
//!
//! The same estimates to the bit as a lock-step run of the same scenario: what the processes add is
//! only transport. This is the oracle of the tests and the engine of Monte Carlo experiments.

use std::path::Path;

use rangehound_fusion::Centre;
use rangehound_fusion::centre::Diverged;
use rangehound_fusion::planner::{PlannerError, Vector};
use rangehound_fusion::report::Report;
use rangehound_robot::drive::Controller;
use rangehound_robot::sensor::{RangeSensor, Sensor};
use rangehound_shared::clock::monotonic_ns;
use rangehound_shared::message::Drive;
use rangehound_shared::record::{EstimateRecord, WorldRecord};
use rangehound_shared::rendezvous::RunDescription;
use rangehound_shared::scenario::Scenario;
use rangehound_sim::playback::PlaybackError;
use rangehound_sim::{World, world_of};

/// Runs a scenario to its end in this process and puts every tick down as the nodes would.
///
/// # Errors
/// If the team cannot be put together, the estimate diverges, or a log cannot be written.
pub fn run(description: &RunDescription, mut on_tick: impl FnMut(u64)) -> anyhow::Result<()> {
    let RunDescription { run_id, scenario, out_dir } = description;
    let mut team = Team::of_run(scenario, out_dir)?;
    let mut estimates = EstimateRecord::writer(out_dir, *run_id, scenario)?;
    let mut worlds = WorldRecord::writer(out_dir, *run_id, scenario)?;
    for tick in 0..=scenario.ticks {
        team.tick()?;
        let record = EstimateRecord { time_s: team.centre.time_s(), estimate: team.centre.estimate() };
        estimates.write(tick, record.to_words(team.centre.exchanges(tick, &team.reports)))?;
        let (world, drives) = (team.world.as_ref(), &team.drives);
        let words = WorldRecord::to_words(world.time_s(), monotonic_ns(), world.truth(), world.entries(), drives);
        worlds.write(tick, words)?;
        team.advance();
        on_tick(tick);
    }
    Ok(())
}

/// A whole team, stepped by hand.
#[derive(Debug)]
pub struct Team {
    world: Box<dyn World>,
    centre: Centre,
    robots: Vec<(Sensor, Controller)>,
    reports: Vec<Option<Report>>,
    drives: Vec<Option<Drive>>,
    planning_ns: u64,
}

/// Why a team cannot be put together.
#[derive(Debug, thiserror::Error)]
pub enum TeamError {
    /// Its recording cannot be played.
    #[error(transparent)]
    Recording(#[from] PlaybackError),
    /// Its planner cannot serve it.
    #[error(transparent)]
    Planner(#[from] PlannerError),
}

impl Team {
    /// The team of a scenario before tick 0.
    ///
    /// # Errors
    /// [`TeamError`].
    pub fn new(scenario: &Scenario) -> Result<Self, TeamError> {
        Self::of_run(scenario, Path::new(""))
    }

    /// The same; a recording that this process has not read is read from the run folder.
    ///
    /// # Errors
    /// [`TeamError`].
    pub fn of_run(scenario: &Scenario, run_folder: &Path) -> Result<Self, TeamError> {
        let robots = (0..scenario.robots.len())
            .filter_map(|id| Some((Sensor::new(scenario, id)?, Controller::new(scenario.robots[id].speed_mps))))
            .collect();
        Ok(Self {
            world: world_of(scenario, run_folder)?,
            centre: Centre::new(scenario)?,
            robots,
            reports: vec![None; scenario.robots.len()],
            drives: vec![None; scenario.robots.len()],
            planning_ns: 0,
        })
    }

    /// One tick up to the commands: world, ranges, update, plan. What it left can be looked at until
    /// [`Self::advance`].
    ///
    /// # Errors
    /// [`Diverged`] if the estimate is no longer finite.
    pub fn tick(&mut self) -> Result<(), Diverged> {
        self.tick_disturbed(|_| {})
    }

    /// The same, but what fusion is told by the robots is disturbed first.
    ///
    /// # Errors
    /// As [`Self::tick`].
    pub fn tick_disturbed(&mut self, disturb: impl FnOnce(&mut [Option<Report>])) -> Result<(), Diverged> {
        let tick = self.centre.next_tick();
        for ((report, (sensor, _)), entry) in self.reports.iter_mut().zip(&mut self.robots).zip(self.world.entries()) {
            let range_m = sensor.measure(tick, entry).map(|range_m| (range_m, sensor.std_m()));
            *report = Some(Report { position_m: Vector::new(entry.x_m, entry.y_m), height_m: entry.height_m, range_m });
        }
        disturb(&mut self.reports);
        self.centre.update(self.world.time_s(), &self.reports)?;
        let began_ns = monotonic_ns();
        let commands = self.centre.plan();
        self.planning_ns = monotonic_ns().saturating_sub(began_ns);
        for (id, ((drive, (_, controller)), command)) in
            self.drives.iter_mut().zip(&mut self.robots).zip(commands).enumerate()
        {
            let driven = controller.obey(tick, *command);
            let published = self.reports[id].is_some_and(|report| report.range_m.is_some());
            *drive = Some(Drive {
                robot: id as u64,
                heading_rad: driven.heading_rad,
                speed_mps: driven.speed_mps,
                // Stamps that say what there was, and give no latency: nobody looks at a clock here.
                range_sent_ns: if published { u64::MAX } else { 0 },
                heading_held_ns: 1,
                ..Drive::default()
            });
        }
        Ok(())
    }

    /// Moves target and robots to the next tick.
    pub fn advance(&mut self) {
        self.world.advance(&self.drives);
    }

    /// The world at the present tick.
    #[must_use]
    pub fn world(&self) -> &dyn World {
        self.world.as_ref()
    }

    /// The fusion centre after the present tick.
    #[must_use]
    pub fn centre(&self) -> &Centre {
        &self.centre
    }

    /// How long [`Centre::plan`] took at the present tick, ns.
    #[must_use]
    pub fn planning_ns(&self) -> u64 {
        self.planning_ns
    }

    /// What the robots drive after the present tick.
    #[must_use]
    pub fn drives(&self) -> &[Option<Drive>] {
        &self.drives
    }
}
