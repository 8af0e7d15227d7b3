//! One tick of the fusion centre, pure: the robots' reports in, estimate and commands out.

use std::borrow::Cow;

use rangehound_shared::measurement::{Kind, Measurement, Pose};
use rangehound_shared::message::{Command, Estimate};
use rangehound_shared::record::digest::Digest;
use rangehound_shared::record::{Exchange, GateResults, Heard};
use rangehound_shared::robot_set::RobotSet;
use rangehound_shared::scenario::{RangeNoise, RobotSpec, Scenario, SensorSpec, Source, Treatment};
use rangehound_shared::sealed::SealError;
use serde::{Deserialize, Serialize};

use crate::past::TickHistory;
use crate::planner::{self, Certificate, Plan, Planner, PlannerError, Predicted, Situation, TeamMember};
use crate::tracker::Fit;
use crate::tracking::Tracking;
use crate::trust::Trust;
use crate::vector::Vector;

/// A silent robot is assumed to follow its commands, and is planned for, for this many ticks.
const SILENCE_TICKS_MAX: u64 = 5;

/// Largest magnitude of a valid estimate, m or m^2: far beyond any real target.
const BOUND: f64 = 1e18;

/// Outcome of a report that arrived after its tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Late {
    /// Its range or its bearing was fused at its own time.
    Fused,
    /// Its measurement was rejected: it failed the gate, or its sensor was distrusted.
    Rejected,
    /// It measured nothing.
    Nothing,
    /// Its tick is no longer stored, or the robot's report of that tick has already arrived.
    Missed,
}

/// The filter, the planner, and their state between ticks.
///
/// A tick has two halves, so that a caller can publish or time each: [`Self::update`] fuses,
/// [`Self::plan`] chooses headings. Neither does I/O, knows a clock, or allocates once the buffers
/// have their sizes; ranges are fused in order of the robots' ids whatever the order they came in.
#[derive(Debug)]
pub struct Centre {
    recorded: bool,
    dt_s: f64,
    robots: Vec<RobotSpec>,
    /// True if the planner takes the robots' poses as exact.
    ignores_nuisances: bool,
    tracking: Tracking,
    /// `None`: late reports are missed.
    past: Option<TickHistory>,
    planner: Box<dyn Planner>,
    next_tick: u64,
    time_s: f64,
    digest: Digest,
    fit: Fit,
    /// How each robot's report was used at the last tick.
    judged: Vec<GateResults>,
    missing: u64,
    bodies: Vec<Option<Body>>,
    situation: Situation,
    planned: Vec<usize>,
    plan: Plan,
    commands: Vec<Command>,
    tracker_bytes: Vec<u8>,
}

/// State for [`Centre::restore`]: borrowed for writing, owned after reading.
#[derive(Debug, Serialize, Deserialize)]
pub struct Saved<'a> {
    next_tick: u64,
    time_s: f64,
    digest: Digest,
    fit: Fit,
    judged: Cow<'a, [GateResults]>,
    missing: u64,
    predicted: Predicted,
    certificate: Option<Certificate>,
    bodies: Cow<'a, [Option<Body>]>,
    commands: Cow<'a, [Command]>,
    tracker: Cow<'a, [u8]>,
    trust: Cow<'a, Trust>,
}

/// A robot's last known or predicted pose.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Body {
    position_m: Vector,
    /// Covariance of the position, m^2, and standard deviation of the heading, rad, as it last reported them.
    covariance_m2: [f64; 3],
    heading_std_rad: f64,
    heard_at: u64,
    /// Standard deviation of its last measurement of each kind, m or rad, if it has had one.
    stds: [Option<f64>; Kind::COUNT],
}

impl Body {
    /// A robot that has reported this, and was known like that before.
    fn of(report: &Measurement, position_m: Vector, heard_at: u64, before: Option<Self>) -> Self {
        let Pose { covariance_m2, heading_std_rad, .. } = report.pose;
        let stds = Kind::ALL.map(|kind| {
            let measured = report.of(kind).map(|(_, std)| std);
            measured.or(before.and_then(|before| before.stds[kind as usize]))
        });
        Self { position_m, covariance_m2, heading_std_rad, heard_at, stds }
    }

    fn is_valid(&self, next_tick: u64) -> bool {
        let numbers = self.covariance_m2.iter().chain([&self.position_m.x, &self.position_m.y, &self.heading_std_rad]);
        self.heard_at < next_tick
            && numbers.copied().all(|value| value.abs() <= BOUND)
            && self.stds.iter().flatten().all(|std| *std > 0.0 && *std <= BOUND)
    }
}

/// The estimate exceeds all bounds.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error(
    "the estimate left all bounds at tick {tick}: the target model is unstable or does not fit the ranges: check target.model, target.noise_psd and the units of the ranges"
)]
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
            robots: scenario.robots.clone(),
            ignores_nuisances: scenario.treatment == Treatment::Ignored,
            tracking: Tracking::new(scenario),
            past: None,
            planner: planner::for_team(scenario.planner, robots, scenario.seed)?,
            next_tick: 0,
            time_s: 0.0,
            digest: Digest::default(),
            fit: Fit::default(),
            judged: vec![GateResults::default(); robots],
            missing: 0,
            bodies: vec![None; robots],
            situation: Situation {
                motion: scenario.filter_motion.clone(),
                team: Vec::with_capacity(robots),
                clearance: scenario.clearance,
                criterion: scenario.criterion,
                step_s: scenario.dt_s,
                ..Situation::default()
            },
            planned: Vec::with_capacity(robots),
            plan: Plan::default(),
            commands: vec![Command::default(); robots],
            tracker_bytes: Vec::new(),
        })
    }

    /// The same centre, but it stores its last ticks for late reports: see [`Self::take_late`].
    #[must_use]
    pub fn with_history(self) -> Self {
        Self { past: Some(TickHistory::default()), ..self }
    }

    /// The same centre with another planner than its scenario's.
    #[must_use]
    pub fn planned_by(self, planner: Box<dyn Planner>) -> Self {
        Self { planner, ..self }
    }

    /// State from which [`Self::restore`] continues bit for bit, without the ticks stored for late reports.
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
            judged: Cow::Borrowed(&self.judged),
            missing: self.missing,
            predicted: self.plan.predicted,
            certificate: self.plan.certificate,
            bodies: Cow::Borrowed(&self.bodies),
            commands: Cow::Borrowed(&self.commands),
            tracker: Cow::Borrowed(&self.tracker_bytes),
            trust: Cow::Borrowed(&self.tracking.trust),
        })
    }

    /// Continues from the saved state of a centre of the same scenario.
    ///
    /// # Errors
    /// If the state is invalid or belongs to another scenario.
    pub fn restore(&mut self, restored: Saved<'_>) -> Result<(), SealError> {
        let robots = self.bodies.len();
        let Saved { bodies, commands, judged, trust, .. } = &restored;
        let is_valid = bodies.iter().flatten().all(|body| body.is_valid(restored.next_tick))
            && commands.iter().all(|command| command.heading_rad.is_finite() && command.speed_mps.is_finite());
        if [bodies.len(), commands.len(), judged.len()] != [robots; 3] || !trust.is_of(robots) || !is_valid {
            return Err(SealError::Malformed);
        }
        self.tracking.tracker.restore(&restored.tracker)?;
        self.tracking.trust = restored.trust.into_owned();
        self.past.iter_mut().for_each(TickHistory::clear);
        self.next_tick = restored.next_tick;
        self.time_s = restored.time_s;
        self.digest = restored.digest;
        self.fit = restored.fit;
        self.judged = restored.judged.into_owned();
        self.missing = restored.missing;
        self.plan.predicted = restored.predicted;
        self.plan.certificate = restored.certificate;
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
    /// `reports` has an entry for each robot, `None` if it has not reported. `time_s` matters for recordings: their
    /// time stamps give the length of each step.
    ///
    /// # Errors
    /// [`Diverged`] if the estimate leaves all bounds.
    pub fn update(&mut self, time_s: f64, reports: &[Option<Measurement>]) -> Result<(), Diverged> {
        let tick = self.next_tick;
        self.next_tick += 1;
        for (body, report) in self.bodies.iter_mut().zip(reports) {
            let Some(report) = report else { continue };
            *body = Some(Body::of(report, report.pose.into(), tick, *body));
        }
        self.missing = reports.iter().filter(|report| report.is_none()).count() as u64;
        self.fit = Fit::default();
        self.judged.fill(GateResults::default());
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
            self.judged.copy_from_slice(self.tracking.judged());
            if let Some(past) = self.past.as_mut().and_then(TickHistory::newest) {
                past.judged.copy_from_slice(&self.judged);
            }
        }
        self.time_s = time_s;
        let (state, covariance) = (self.tracking.tracker.state(), self.tracking.tracker.covariance());
        if !state.iter().chain(covariance).all(|value| value.abs() <= BOUND) {
            return Err(Diverged { tick });
        }
        self.digest.append(tick, state, covariance);
        Ok(())
    }

    /// Stores the state before the tick, if past ticks are stored.
    fn keep(&mut self, tick: u64, dt_s: f64, reports: &[Option<Measurement>]) {
        let Some(past) = &mut self.past else { return };
        let mut place = past.place(reports.len(), &self.tracking.trust);
        (place.tick, place.dt_s) = (tick, dt_s);
        place.reports.copy_from_slice(reports);
        match self.tracking.save_before(&mut place) {
            Ok(()) => past.push(place),
            // Without the tracker's saved state, late reports cannot be fused: they count as missed.
            Err(_) => past.clear(),
        }
    }

    /// A robot's report of one of the last ticks, if that tick is stored.
    #[must_use]
    pub fn report_at(&self, tick: u64, id: usize) -> Option<Measurement> {
        self.past.as_ref()?.at(tick)?.reports.get(id).copied()?
    }

    /// The gate's decisions on a robot's report of one of the last ticks; none if that tick is not stored.
    #[must_use]
    pub fn judged_at(&self, tick: u64, id: usize) -> GateResults {
        let past = self.past.as_ref().and_then(|past| past.at(tick));
        past.and_then(|past| past.judged.get(id).copied()).unwrap_or_default()
    }

    /// Takes a report of an earlier tick: restores the state before that tick, and processes it and all later ticks
    /// again. The state is then that of a centre that had the report in time, to the bit. Published estimates do not
    /// change; the report counts from the next prediction on. If its position is newer than the one known, the next
    /// plan uses it.
    pub fn take_late(&mut self, tick: u64, id: usize, report: Measurement) -> Late {
        let Some(past) = &mut self.past else { return Late::Missed };
        let Some(slot) = past.since(tick).next().and_then(|past| past.reports.get_mut(id)) else { return Late::Missed };
        if slot.is_some() {
            return Late::Missed;
        }
        *slot = Some(report);
        if self.bodies[id].is_none_or(|body| body.heard_at < tick) {
            let steps = past.since(tick).map(|past| past.commands[id]);
            let position_m =
                steps.fold(report.pose.into(), |position_m, command| moved(position_m, command, self.dt_s));
            self.bodies[id] = Some(Body::of(&report, position_m, tick, self.bodies[id]));
        }
        if report.count() == 0 {
            return Late::Nothing;
        }
        match self.tracking.reprocess(id, past.since(tick)) {
            Ok(true) => Late::Fused,
            Ok(false) => Late::Rejected,
            Err(_) => {
                past.clear();
                Late::Missed
            }
        }
    }

    /// Plans the step to the next tick: predicts to k+1|k, chooses the headings of all robots that
    /// reported recently; the others are commanded to stop. Sensors of a recording are not commanded.
    ///
    /// The plan counts only measurements that will be fused, with the standard deviations of the robots' last messages. A
    /// distrusted robot does not count. It is still sent to where its measurements would add most information to the
    /// others', so that it is useful as soon as it is trusted again.
    pub fn plan(&mut self) -> &[Command] {
        if self.recorded {
            return &self.commands;
        }
        let tick = self.next_tick.saturating_sub(1);
        self.tracking.tracker.predict_into(self.dt_s, &mut self.situation.belief);
        self.planned.clear();
        for (id, body) in self.bodies.iter().enumerate() {
            if body.is_some_and(|body| tick - body.heard_at <= SILENCE_TICKS_MAX) {
                self.planned.push(id);
            }
        }
        let (trust, noise_scales) = (&self.tracking.trust, self.tracking.noise_scales());
        let team = self.planned.iter().filter_map(|&id| {
            let (spec, body) = (&self.robots[id], self.bodies[id]?);
            let sensor = sensor_of(&spec.reported, &body, noise_scales);
            let trusted = trusted_part(sensor, Kind::ALL.map(|kind| trust.distrusts(id, kind)));
            let pose = if self.ignores_nuisances {
                Pose::default()
            } else {
                Pose { covariance_m2: body.covariance_m2, ..Pose::default() }
            };
            Some(TeamMember {
                position_m: body.position_m,
                position_covariance_m2: pose.position_covariance_m2(),
                heading_std_rad: if self.ignores_nuisances { 0.0 } else { body.heading_std_rad },
                max_speed_mps: spec.speed_mps,
                sensor: trusted.unwrap_or(sensor),
                is_fused: trusted.is_some(),
            })
        });
        self.situation.team.clear();
        self.situation.team.extend(team);
        self.planner.plan(tick, &self.situation, &mut self.plan);
        self.commands.fill(Command::default());
        for (&id, command) in self.planned.iter().zip(&self.plan.commands) {
            self.commands[id] = *command;
            if let Some(body) = &mut self.bodies[id] {
                // The position if the robot obeys; its next report replaces it.
                body.position_m = moved(body.position_m, *command, self.dt_s);
            }
        }
        if let Some(past) = self.past.as_mut().and_then(TickHistory::newest) {
            past.commands.copy_from_slice(&self.commands);
        }
        &self.commands
    }

    /// The planner's input in the last [`Self::plan`].
    #[must_use]
    pub fn situation(&self) -> &Situation {
        &self.situation
    }

    /// Commands of the last [`Self::plan`].
    #[must_use]
    pub fn commands(&self) -> &[Command] {
        &self.commands
    }

    /// The last tick's exchange with each robot, for the record, given the robots' reports.
    pub fn exchanges<'a>(
        &'a self,
        tick: u64,
        reports: &'a [Option<Measurement>],
    ) -> impl Iterator<Item = Exchange> + 'a {
        reports.iter().zip(&self.judged).zip(&self.commands).map(move |((report, judged), command)| Exchange {
            heard: report.map(|measurement| Heard { measurement, taken_at: tick, judged: *judged }),
            command: *command,
        })
    }

    /// The result of the last [`Self::plan`].
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

    /// Robots whose measurements of each kind are not fused because they kept failing the gate.
    #[must_use]
    pub fn distrusted(&self) -> [RobotSet; Kind::COUNT] {
        self.tracking.distrusted()
    }

    /// Factors on the reported standard deviations of each kind: 1 unless most sensors fail together.
    #[must_use]
    pub fn noise_scales(&self) -> [f64; Kind::COUNT] {
        self.tracking.noise_scales()
    }

    /// The last tick's message for observers; the caller adds durations, late ranges and refusals.
    #[must_use]
    pub fn estimate(&self) -> Estimate {
        let (digest, certificate) = (self.digest.to_bits(), self.plan.certificate);
        let mut estimate = Estimate {
            state_dim: self.state().len() as u64,
            nis: self.fit.nis,
            fused: u64::from(self.fit.fused),
            nis_all: self.fit.nis_all,
            tested: u64::from(self.fit.tested),
            noise_scale: self.noise_scales(),
            rejected: u64::from(self.fit.rejected),
            missing: self.missing,
            distrusted: self.distrusted().map(RobotSet::to_bits),
            objective: self.plan.predicted.objective,
            lower_bound: certificate.map_or(f64::NEG_INFINITY, |proven| proven.lower_bound),
            least_trace_m2: certificate.map_or(0.0, |proven| proven.least_trace_m2),
            digest: [digest as u64, (digest >> 64) as u64],
            ..Estimate::default()
        };
        estimate.state[..self.state().len()].copy_from_slice(self.state());
        estimate.covariance[..self.covariance().len()].copy_from_slice(self.covariance());
        estimate
    }
}

/// A robot's sensor for the planner: with the standard deviations of its last measurements, as far as it has had any.
fn sensor_of(reported: &SensorSpec, body: &Body, noise_scales: [f64; Kind::COUNT]) -> SensorSpec {
    let [range_std_m, bearing_std_rad] = body.stds;
    let [range_scale, bearing_scale] = noise_scales;
    let range = match reported.range {
        // The noise at the distance of the last range is not that at the next.
        Some(range) if range.std_per_m > 0.0 => Some(range),
        range => range_std_m.map(|std_m| RangeNoise { std_m, std_per_m: 0.0 }).or(range),
    };
    let range = range.map(|RangeNoise { std_m, std_per_m }| RangeNoise {
        std_m: std_m * range_scale,
        std_per_m: std_per_m * range_scale,
    });
    let bearing_std_rad = bearing_std_rad.or(reported.bearing_std_rad).map(|std_rad| std_rad * bearing_scale);
    SensorSpec { range, bearing_std_rad, ..*reported }
}

/// A sensor without its distrusted kinds; `None` without any kind.
fn trusted_part(sensor: SensorSpec, [no_range, no_bearing]: [bool; Kind::COUNT]) -> Option<SensorSpec> {
    let range = sensor.range.filter(|_| !no_range);
    let bearing_std_rad = sensor.bearing_std_rad.filter(|_| !no_bearing);
    (range.is_some() || bearing_std_rad.is_some()).then_some(SensorSpec { range, bearing_std_rad, ..sensor })
}

/// Where a command takes a robot in a time step.
fn moved(position_m: Vector, command: Command, dt_s: f64) -> Vector {
    position_m + Vector::from_angle(command.heading_rad) * (command.speed_mps * dt_s)
}

#[cfg(test)]
mod tests;
