//! One tick of the fusion centre, pure: what the robots said in, estimate and commands out.

use std::borrow::Cow;

use rangehound_shared::digest::Digest;
use rangehound_shared::message::{Command, Estimate};
use rangehound_shared::robot_set::RobotSet;
use rangehound_shared::scenario::{Clearance, Scenario, Source};
use rangehound_shared::sealed::SealError;
use serde::{Deserialize, Serialize};

use crate::past::Past;
use crate::planner::{self, Plan, Planner, PlannerError, Problem, TeamMember, Vector};
use crate::tracker::Fit;
use crate::tracking::Tracking;
use crate::trust::Trust;

/// Ticks for which a robot that is not heard is believed to go on as commanded and is planned for.
const SILENCE_TICKS_MAX: u64 = 5;

/// Beyond this, m or m^2, an estimate is no longer one; not reached by anything that moves.
const BOUND: f64 = 1e18;

/// What one robot said at a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Report {
    /// Where it is, m.
    pub position_m: Vector,
    /// Its range and the range's standard deviation, m; `None` if its sensor had none.
    pub range_m: Option<(f64, f64)>,
}

/// What became of a report that came after its tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Late {
    /// Its range was fused at its own time.
    Fused,
    /// Its range was not: it failed the gate, or its robot was distrusted.
    Rejected,
    /// It holds no range.
    NoRange,
    /// Its tick is not kept any more, or the robot has been heard at it.
    Missed,
}

/// The filter, the planner, and what they carry from tick to tick.
///
/// A tick has two halves, so that a caller can publish or time each: [`Self::update`] fuses,
/// [`Self::plan`] chooses headings. Neither does I/O, knows a clock, or allocates once the buffers
/// have their sizes; ranges are fused in order of the robots' ids whatever the order they came in.
#[derive(Debug)]
pub struct Centre {
    recorded: bool,
    dt_s: f64,
    clearance: Clearance,
    speed_limits_mps: Vec<f64>,
    range_stds_m: Vec<f64>,
    tracking: Tracking,
    /// `None`: late reports are missed.
    past: Option<Past>,
    planner: Box<dyn Planner>,
    next_tick: u64,
    time_s: f64,
    digest: Digest,
    fit: Fit,
    missing: u64,
    bodies: Vec<Option<Body>>,
    problem: Problem,
    planned: Vec<usize>,
    plan: Plan,
    commands: Vec<Command>,
    tracker_bytes: Vec<u8>,
}

/// What [`Centre::restore`] needs: borrowed as it is written, owned as it is read.
#[derive(Debug, Serialize, Deserialize)]
pub struct Saved<'a> {
    next_tick: u64,
    time_s: f64,
    digest: Digest,
    fit: Fit,
    missing: u64,
    objective: f64,
    lower_bound: f64,
    bodies: Cow<'a, [Option<Body>]>,
    commands: Cow<'a, [Command]>,
    tracker: Cow<'a, [u8]>,
    trust: Cow<'a, Trust>,
}

/// Where a robot is believed to be.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Body {
    position_m: Vector,
    heard_at: u64,
}

/// The estimate is no longer one.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("the estimate left all bounds at tick {tick}: the target model is unstable or does not fit the ranges")]
pub struct Diverged {
    /// The tick.
    pub tick: u64,
}

impl Centre {
    /// The centre of a run before its first tick.
    ///
    /// # Errors
    /// [`PlannerError`] if the scenario's planner cannot serve its team.
    pub fn new(scenario: &Scenario) -> Result<Self, PlannerError> {
        let robots = scenario.robots.len();
        Ok(Self {
            recorded: matches!(scenario.source, Source::Recorded { .. }),
            dt_s: scenario.dt_s,
            clearance: scenario.clearance,
            speed_limits_mps: scenario.robots.iter().map(|robot| robot.speed_mps).collect(),
            range_stds_m: scenario.robots.iter().map(|robot| robot.range_std_m).collect(),
            tracking: Tracking::new(scenario),
            past: None,
            planner: planner::for_team(scenario.planner, robots, scenario.seed)?,
            next_tick: 0,
            time_s: 0.0,
            digest: Digest::default(),
            fit: Fit::default(),
            missing: 0,
            bodies: vec![None; robots],
            problem: Problem::default(),
            planned: Vec::with_capacity(robots),
            plan: Plan::default(),
            commands: vec![Command::default(); robots],
            tracker_bytes: Vec::new(),
        })
    }

    /// The same centre, but it keeps its last ticks for what comes late: see [`Self::take_late`].
    #[must_use]
    pub fn keeping_the_past(self) -> Self {
        Self { past: Some(Past::default()), ..self }
    }

    /// What [`Self::restore`] needs to go on from here, to the bit; but for the ticks kept for late reports.
    ///
    /// # Errors
    /// If the tracker cannot be encoded.
    pub fn saved(&mut self) -> Result<Saved<'_>, SealError> {
        self.tracker_bytes.clear();
        self.tracking.tracker.save(&mut self.tracker_bytes)?;
        Ok(Saved {
            next_tick: self.next_tick,
            time_s: self.time_s,
            digest: self.digest,
            fit: self.fit,
            missing: self.missing,
            objective: self.plan.objective,
            lower_bound: self.plan.lower_bound,
            bodies: Cow::Borrowed(&self.bodies),
            commands: Cow::Borrowed(&self.commands),
            tracker: Cow::Borrowed(&self.tracker_bytes),
            trust: Cow::Borrowed(&self.tracking.trust),
        })
    }

    /// Goes on from what a centre of the same scenario saved.
    ///
    /// # Errors
    /// If it is not such.
    pub fn restore(&mut self, restored: Saved<'_>) -> Result<(), SealError> {
        let robots = self.bodies.len();
        let lens = [restored.bodies.len(), restored.commands.len(), restored.trust.robots()];
        if lens != [robots; 3] {
            return Err(SealError::Malformed);
        }
        self.tracking.tracker.restore(&restored.tracker)?;
        self.tracking.trust = restored.trust.into_owned();
        self.past.iter_mut().for_each(Past::clear);
        self.next_tick = restored.next_tick;
        self.time_s = restored.time_s;
        self.digest = restored.digest;
        self.fit = restored.fit;
        self.missing = restored.missing;
        self.plan.objective = restored.objective;
        self.plan.lower_bound = restored.lower_bound;
        self.bodies = restored.bodies.into_owned();
        self.commands = restored.commands.into_owned();
        Ok(())
    }

    /// The tick that [`Self::update`] takes next.
    #[must_use]
    pub fn next_tick(&self) -> u64 {
        self.next_tick
    }

    /// Fuses one tick: predicts from the tick before, updates with the ranges (k|k), extends the
    /// digest. Tick 0 has no range: its estimate is the prior.
    ///
    /// `reports` has an entry for each robot, `None` if it was not heard. `time_s` matters for
    /// recordings, whose steps are as long as their stamps say.
    ///
    /// # Errors
    /// [`Diverged`] if the estimate leaves all bounds.
    pub fn update(&mut self, time_s: f64, reports: &[Option<Report>]) -> Result<(), Diverged> {
        let tick = self.next_tick;
        self.next_tick += 1;
        for (body, report) in self.bodies.iter_mut().zip(reports) {
            let Some(Report { position_m, .. }) = *report else { continue };
            *body = Some(Body { position_m, heard_at: tick });
        }
        self.missing = reports.iter().filter(|report| report.is_none()).count() as u64;
        self.fit = Fit::default();
        if tick == 0 {
            self.missing = 0;
        } else {
            let dt_s = match (self.recorded, tick) {
                (false, _) => self.dt_s,
                (true, 1) => 0.0,
                (true, _) => time_s - self.time_s,
            };
            self.keep(tick, dt_s, reports);
            self.fit = self.tracking.step(dt_s, reports);
        }
        self.time_s = time_s;
        let (state, covariance) = (self.tracking.tracker.state(), self.tracking.tracker.covariance());
        if !state.iter().chain(covariance).all(|value| value.abs() <= BOUND) {
            return Err(Diverged { tick });
        }
        self.digest.append(tick, state, covariance);
        Ok(())
    }

    /// Writes down what a tick starts from, if the past is kept.
    fn keep(&mut self, tick: u64, dt_s: f64, reports: &[Option<Report>]) {
        let Some(past) = &mut self.past else { return };
        let mut place = past.place(reports.len());
        (place.tick, place.dt_s) = (tick, dt_s);
        place.reports.copy_from_slice(reports);
        match self.tracking.save_before(&mut place) {
            Ok(()) => past.push(place),
            // A tracker that cannot be written down has no past; what comes late is missed.
            Err(_) => past.clear(),
        }
    }

    /// What a robot said at one of the last ticks, if that is kept.
    #[must_use]
    pub fn report_at(&self, tick: u64, id: usize) -> Option<Report> {
        self.past.as_ref()?.at(tick)?.reports.get(id).copied()?
    }

    /// Takes a report of an earlier tick: goes back to before it and processes it and all ticks since again, so that
    /// the state is that of a centre which had the report in time, to the bit. What has been published stays as it
    /// was: this holds from the next prediction on. A position newer than the one known counts for the next plan.
    pub fn take_late(&mut self, tick: u64, id: usize, report: Report) -> Late {
        let Some(past) = &mut self.past else { return Late::Missed };
        let Some(slot) = past.since(tick).next().and_then(|past| past.reports.get_mut(id)) else { return Late::Missed };
        if slot.is_some() {
            return Late::Missed;
        }
        *slot = Some(report);
        if self.bodies[id].is_none_or(|body| body.heard_at < tick) {
            let steps = past.since(tick).map(|past| past.commands[id]);
            let position_m = steps.fold(report.position_m, |position_m, command| moved(position_m, command, self.dt_s));
            self.bodies[id] = Some(Body { position_m, heard_at: tick });
        }
        if report.range_m.is_none() {
            return Late::NoRange;
        }
        match self.tracking.take_again(id, past.since(tick)) {
            Ok(true) => Late::Fused,
            Ok(false) => Late::Rejected,
            Err(_) => {
                past.clear();
                Late::Missed
            }
        }
    }

    /// Plans the step to the next tick: predicts to k+1|k, chooses the headings of all robots that
    /// were heard lately; the others are told to stand. Sensors of a recording go their own way.
    pub fn plan(&mut self) -> &[Command] {
        if self.recorded {
            return &self.commands;
        }
        let tick = self.next_tick.saturating_sub(1);
        let (target, covariance) = self.tracking.tracker.predicted_position(self.dt_s);
        self.planned.clear();
        for (id, body) in self.bodies.iter().enumerate() {
            if body.is_some_and(|body| tick - body.heard_at <= SILENCE_TICKS_MAX) {
                self.planned.push(id);
            }
        }
        let team = self.planned.iter().filter_map(|&id| {
            Some(TeamMember {
                position_m: self.bodies[id]?.position_m,
                max_speed_mps: self.speed_limits_mps[id],
                range_std_m: self.range_stds_m[id],
            })
        });
        self.problem.pose(&covariance, Vector::new(target[0], target[1]), self.dt_s, &self.clearance, team);
        self.planner.plan(tick, &self.problem, &mut self.plan);
        self.commands.fill(Command::default());
        for ((&id, heading_rad), speed_mps) in
            self.planned.iter().zip(&self.plan.headings_rad).zip(&self.plan.speeds_mps)
        {
            let command = Command { heading_rad: *heading_rad, speed_mps: *speed_mps };
            self.commands[id] = command;
            if let Some(body) = &mut self.bodies[id] {
                // Where it will be if it obeys; what it says next replaces this.
                body.position_m = moved(body.position_m, command, self.dt_s);
            }
        }
        if let Some(past) = self.past.as_mut().and_then(Past::newest) {
            past.commands.copy_from_slice(&self.commands);
        }
        &self.commands
    }

    /// The problem that the last [`Self::plan`] solved.
    #[must_use]
    pub fn problem(&self) -> &Problem {
        &self.problem
    }

    /// Commands of the last [`Self::plan`].
    #[must_use]
    pub fn commands(&self) -> &[Command] {
        &self.commands
    }

    /// What the last [`Self::plan`] chose, and what it is worth.
    #[must_use]
    pub fn last_plan(&self) -> &Plan {
        &self.plan
    }

    /// Time of the last tick, s.
    #[must_use]
    pub fn time_s(&self) -> f64 {
        self.time_s
    }

    /// The state, position first.
    #[must_use]
    pub fn state(&self) -> &[f64] {
        self.tracking.tracker.state()
    }

    /// The covariance, n x n.
    #[must_use]
    pub fn covariance(&self) -> &[f64] {
        self.tracking.tracker.covariance()
    }

    /// Robots whose ranges are not fused because they kept failing the gate.
    #[must_use]
    pub fn distrusted(&self) -> RobotSet {
        self.tracking.trust.distrusted()
    }

    /// The last tick as observers are told it; durations, late ranges and refusals are the caller's to add.
    #[must_use]
    pub fn estimate(&self) -> Estimate {
        let digest = self.digest.to_bits();
        let mut estimate = Estimate {
            state_dim: self.state().len() as u64,
            nis: self.fit.nis,
            fused: u64::from(self.fit.fused),
            rejected: u64::from(self.fit.rejected),
            missing: self.missing,
            distrusted: self.distrusted().to_bits(),
            objective: self.plan.objective,
            lower_bound: self.plan.lower_bound,
            digest: [digest as u64, (digest >> 64) as u64],
            ..Estimate::default()
        };
        estimate.state[..self.state().len()].copy_from_slice(self.state());
        estimate.covariance[..self.covariance().len()].copy_from_slice(self.covariance());
        estimate
    }
}

/// Where a command takes a robot in a time step.
fn moved(position_m: Vector, command: Command, dt_s: f64) -> Vector {
    position_m + Vector::from_angle(command.heading_rad) * (command.speed_mps * dt_s)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rangehound_shared::scenario::ScenarioFile;

    /// A state that doubles each tick: said as such, long before numbers run out.
    #[test]
    fn an_estimate_that_leaves_all_bounds_is_told() {
        let text = "[target]\nmodel = \"custom\"\nstart = [0.0, 0.0]\nphi = [[2.0, 0.0], [0.0, 2.0]]\n\
                    qd = [[1.0, 0.0], [0.0, 1.0]]\n";
        let file = ScenarioFile::parse(text, "test").unwrap();
        let scenario = Scenario::from_file(&file, "test", std::path::Path::new("")).unwrap();
        let mut centre = Centre::new(&scenario).unwrap();
        let diverged = (0..1_000).find_map(|_| centre.update(0.0, &[None; 3]).err()).unwrap();
        assert!((20..100).contains(&diverged.tick), "{diverged}");
    }

    /// A robot that falls silent is planned for as if it obeyed, for some ticks, and then told to stand.
    #[test]
    fn a_silent_robot_is_told_to_stand_after_some_ticks() {
        let scenario = Scenario::from_file(&ScenarioFile::default(), "test", std::path::Path::new("")).unwrap();
        let mut centre = Centre::new(&scenario).unwrap();
        let heard = Some(Report { position_m: Vector::new(15.0, 0.0), range_m: None });
        centre.update(0.0, &[heard; 3]).unwrap();
        assert!(centre.plan().iter().all(|command| command.speed_mps == 10.0));
        for tick in 1..=SILENCE_TICKS_MAX + 1 {
            centre.update(0.0, &[heard, None, heard]).unwrap();
            assert_eq!(centre.estimate().missing, 1);
            let commands = centre.plan();
            assert_eq!(commands[0].speed_mps, 10.0);
            assert_eq!(commands[1].speed_mps > 0.0, tick <= SILENCE_TICKS_MAX, "tick {tick}");
        }
    }
}
