//! The roles' machines in one process: no shared memory, no other processes, no waiting, no faults.
//!
//! The estimates equal those of a lock-step run of the same scenario bit for bit: processes add only
//! transport. This is the oracle of the tests and the engine of Monte Carlo experiments.

use std::path::Path;

use rangehound_fusion::Centre;
use rangehound_fusion::centre::Diverged;
use rangehound_fusion::leader::{self, Leader};
use rangehound_fusion::planner::{Planner, PlannerError};
use rangehound_node::logs;
use rangehound_node::rendezvous::RunDescription;
use rangehound_node::system::clock::monotonic_ns;
use rangehound_node::world::{PlaybackError, world_of};
use rangehound_robot::machine as robot;
use rangehound_robot::pose::{self, PoseSource};
use rangehound_robot::sensor::{self, Sensor, measure};
use rangehound_shared::message::{Drive, Header, Outgoing, Range};
use rangehound_shared::record::{FusionRecord, WorldRecord};
use rangehound_shared::scenario::{Clock, Scenario, Timeout};
use rangehound_sim::World;
use rangehound_sim::machine as sim;

/// Stamps that only show that ranges and headings exist; they give no latency.
const RANGE_SENT_NS: u64 = u64::MAX;
const HEADING_HELD_NS: u64 = 1;

/// Runs a scenario to its end in this process and records every tick as the nodes would.
///
/// # Errors
/// If the team cannot be put together, the estimate diverges, or a log cannot be written.
pub fn run(description: &RunDescription, mut on_tick: impl FnMut(u64)) -> anyhow::Result<()> {
    let RunDescription { scenario, out_dir, .. } = description;
    let mut team = Team::of_run(scenario, out_dir)?;
    let mut estimates = logs::write_estimates(description)?.in_batches();
    let mut worlds = logs::write_worlds(description)?.in_batches();
    let mut run = || -> anyhow::Result<()> {
        for tick in 0..=scenario.ticks {
            team.tick()?;
            estimates.write(tick, |record| team.record_estimate(record))?;
            worlds.write(tick, |record| team.record_world(record))?;
            team.advance();
            on_tick(tick);
        }
        Ok(())
    };
    let ended = run();
    // Also the ticks before an error.
    estimates.flush()?;
    worlds.flush()?;
    ended
}

/// A complete team, stepped by the caller.
#[derive(Debug)]
pub struct Team {
    sim: sim::Machine,
    leader: Leader,
    robots: Vec<Robot>,
    /// The tick's messages of the topic `range`.
    ranges: Vec<Outgoing<Range>>,
}

/// One robot with its sensor and its localiser.
#[derive(Debug)]
struct Robot {
    machine: robot::Machine,
    sensor: Box<dyn Sensor>,
    poses: Box<dyn PoseSource>,
}

impl Robot {
    fn new(scenario: &Scenario, id: usize, sensor: Option<Box<dyn Sensor>>) -> Option<Self> {
        let machine = robot::Machine::new(scenario, id, 0)?;
        let sensor = sensor.or_else(|| sensor::of_scenario(scenario, id))?;
        Some(Self { machine, sensor, poses: pose::of_scenario(scenario, id)? })
    }
}

/// Parts of a team that replace those of its scenario.
#[derive(Debug, Default)]
pub struct Parts {
    /// The planner.
    pub planner: Option<Box<dyn Planner>>,
    /// The sensors, in order of the robots' ids; robots without one here have their scenario's.
    pub sensors: Vec<Box<dyn Sensor>>,
    /// Target and robots.
    pub world: Option<Box<dyn World>>,
}

/// Why a team cannot be put together.
#[derive(Debug, thiserror::Error)]
pub enum TeamError {
    /// Its recording cannot be played.
    #[error(transparent)]
    Recording(#[from] PlaybackError),
    /// Its target is real.
    #[error(
        "target.real is true: simulated robots cannot measure a real target: expected a simulated target, or a live run with `rangehound run --external`"
    )]
    RealTarget,
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

    /// As [`Self::new`]; a recording that this process has not read is read from the run folder.
    ///
    /// # Errors
    /// [`TeamError`].
    pub fn of_run(scenario: &Scenario, run_folder: &Path) -> Result<Self, TeamError> {
        Self::of_parts(scenario, run_folder, Parts::default())
    }

    /// As [`Self::of_run`] with other parts than its scenario's.
    ///
    /// # Errors
    /// [`TeamError`].
    pub fn of_parts(scenario: &Scenario, run_folder: &Path, parts: Parts) -> Result<Self, TeamError> {
        let Parts { planner, sensors, world } = parts;
        if scenario.has_real_target {
            return Err(TeamError::RealTarget);
        }
        // The caller decides how long the run lasts.
        let ticks = u64::MAX - 1;
        let scenario = &Scenario { clock: Clock::Lockstep, timeout: Timeout::Forever, ticks, ..scenario.clone() };
        let team = 0..scenario.robots.len();
        let world = world.map_or_else(|| world_of(scenario, run_folder), Ok)?;
        let centre = Centre::new(scenario)?;
        let centre = match planner {
            Some(planner) => centre.planned_by(planner),
            None => centre,
        };
        let mut sensors = sensors.into_iter();
        Ok(Self {
            sim: sim::Machine::new(scenario, world),
            // No report is late here: past ticks are not stored.
            leader: Leader::of_centre(scenario, centre),
            robots: team.filter_map(|id| Robot::new(scenario, id, sensors.next())).collect(),
            ranges: Vec::with_capacity(scenario.robots.len()),
        })
    }

    /// One tick up to the drives: world, ranges, update, plan. The results can be read until
    /// [`Self::advance`].
    ///
    /// # Errors
    /// [`Diverged`] if the estimate is no longer finite.
    pub fn tick(&mut self) -> Result<(), Diverged> {
        self.tick_disturbed(|_| {})
    }

    /// As [`Self::tick`], but `disturb` changes the robots' messages to fusion first.
    ///
    /// # Errors
    /// As [`Self::tick`].
    pub fn tick_disturbed(&mut self, disturb: impl FnOnce(&mut Vec<Outgoing<Range>>)) -> Result<(), Diverged> {
        self.step_sim();
        self.step_robots();
        disturb(&mut self.ranges);
        for Outgoing { tick, valid_at_s, entry } in self.ranges.drain(..) {
            let header = Header { tick, valid_at_s, ..Header::default() };
            self.leader.on_range(&header, &[entry], 0);
        }
        self.leader.end_tick();
        while let Some(action) = self.leader.next_action(monotonic_ns())? {
            if action == leader::Action::SendHeadings {
                let centre = self.leader.centre();
                let header = Header { tick: centre.next_tick() - 1, ..Header::default() };
                self.robots.iter_mut().for_each(|robot| robot.machine.on_heading(&header, centre.commands()));
            }
        }
        self.step_robots();
        Ok(())
    }

    /// Moves target and robots to the next tick.
    pub fn advance(&mut self) {
        // The next one: that which ends the tick was the last answer.
        while !matches!(self.sim.next_action(0), Some(sim::Action::Save) | None) {}
    }

    /// Steps the simulator until it waits for the robots, which receive the world.
    fn step_sim(&mut self) {
        while let Some(action) = self.sim.next_action(0) {
            if action == sim::Action::SendWorld {
                let (tick, world) = (self.sim.tick(), self.sim.world());
                let header = Header { incarnation: 1, tick, valid_at_s: world.time_s(), ..Header::default() };
                self.robots.iter_mut().for_each(|robot| robot.machine.on_world(&header, world.entries(), 0));
            }
        }
    }

    fn step_robots(&mut self) {
        let Self { sim, robots, ranges, .. } = self;
        for Robot { machine: robot, sensor, poses } in robots {
            while let Some(action) = robot.next_action(HEADING_HELD_NS) {
                match action {
                    robot::Action::Measure { tick, time_s, entry } => {
                        let measurement = measure(sensor.as_mut(), poses.as_mut(), (tick, time_s), &entry);
                        robot.measured(measurement, RANGE_SENT_NS);
                    }
                    robot::Action::CarryOut(command) => robot.carried_out(command),
                    robot::Action::SendRange => ranges.extend(robot.range()),
                    robot::Action::SendDrive(message) => sim.on_drive(message.tick, &message.entry),
                    robot::Action::Notify(_) => {}
                }
            }
        }
    }

    /// The world at the present tick.
    #[must_use]
    pub fn world(&self) -> &dyn World {
        self.sim.world()
    }

    /// The fusion centre after the present tick.
    #[must_use]
    pub fn centre(&self) -> &Centre {
        self.leader.centre()
    }

    /// Records the present tick as fusion does.
    pub fn record_estimate(&self, record: &mut FusionRecord) {
        let centre = self.centre();
        record.set(centre.time_s(), &centre.estimate(), self.leader.exchanges());
    }

    /// Records the present tick as the simulator does.
    pub fn record_world(&self, record: &mut WorldRecord) {
        let world = self.world();
        let times = (world.time_s(), monotonic_ns());
        record.set(times, world.truth(), world.poses(), world.entries(), self.drives());
    }

    /// How long [`Centre::plan`] took at the present tick, ns.
    #[must_use]
    pub fn planning_ns(&self) -> u64 {
        let stages = self.leader.stages();
        stages.planned_ns.saturating_sub(stages.filtered_ns)
    }

    /// The robots' drives after the present tick.
    #[must_use]
    pub fn drives(&self) -> &[Option<Drive>] {
        self.sim.drives()
    }
}
