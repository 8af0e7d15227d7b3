//! The fusion centre's process: ports and loop round a [`Centre`].

use std::borrow::Cow;
use std::time::{Duration, Instant};

use rangehound_shared::bus::{Bell, Bus, BusError, Call, IDLE, Publisher, Sleeper, Subscriber};
use rangehound_shared::checkpoint::{Checkpoint, CheckpointError};
use rangehound_shared::clock::{Standstill, monotonic_ns, range_deadline_ns, until};
use rangehound_shared::message::{Command, Estimate, Header, Range};
use rangehound_shared::record::EstimateRecord;
use rangehound_shared::rendezvous::{Rendezvous, RendezvousError, Role, RoleHold};
use rangehound_shared::scenario::{Clock, Patience, Scenario, Source};
use rangehound_shared::sealed::SealError;
use rangehound_shared::signal::Termination;
use rangehound_shared::tick_log::TickLogWriter;
use serde::{Deserialize, Serialize};

use crate::centre::{self, Centre, Diverged, Report};
use crate::planner::{PlannerError, Vector};

/// Most standbys of a run.
pub const STANDBYS_MAX: usize = 8;

/// How often a standby looks whether who leads gives signs of life.
const STANDBY_LOOK: Duration = Duration::from_millis(50);

/// Looks in a row without a sign of life after which who leads is deposed. Counted in looks, so that a
/// standby that was stopped too, or a clock that jumps, deposes nobody.
const SILENT_LOOKS_MAX: u32 = 10;

/// Why fusion ended early.
#[derive(Debug, thiserror::Error)]
pub enum FusionError {
    /// It cannot take part in the run.
    #[error(transparent)]
    Rendezvous(#[from] RendezvousError),
    /// The bus failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The planner cannot serve the team.
    #[error(transparent)]
    Planner(#[from] PlannerError),
    /// The state that a forerunner left cannot be used.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// The same, found later.
    #[error("the checkpoint {0}")]
    Sealed(#[from] SealError),
    /// The filter diverged.
    #[error(transparent)]
    Diverged(#[from] Diverged),
    /// Another process took its role while it gave no sign of life.
    #[error("gave no sign of life and was deposed")]
    Deposed,
}

/// Runs the fusion centre until the run ends or until asked to end.
///
/// # Errors
/// [`FusionError`].
pub fn run(rendezvous: &Rendezvous, termination: &Termination) -> Result<(), FusionError> {
    let hold = rendezvous.roster().take(Role::Fusion)?;
    let bus = Bus::of_role(rendezvous, Role::Fusion, &hold)?;
    Fusion::new(rendezvous, &bus)?.lead(hold, termination)
}

/// Runs a standby: a fusion centre that waits until nobody leads, or until who leads gives no sign of life,
/// and goes on from its checkpoint. Deposed in its turn, it stands by again.
///
/// # Errors
/// [`FusionError`].
pub fn run_standby(rendezvous: &Rendezvous, termination: &Termination) -> Result<(), FusionError> {
    loop {
        let (role, standby) = take_free_standby(rendezvous)?;
        let bus = Bus::connect(rendezvous, &role.to_string())?;
        let mut fusion = Fusion::new(rendezvous, &bus)?;
        let Some(hold) = fusion.stand_by(&standby, termination)? else { return Ok(()) };
        drop(standby);
        bus.speak_as(hold.incarnation);
        match fusion.lead(hold, termination) {
            Err(FusionError::Deposed) => log::warn!("{}; stands by", FusionError::Deposed),
            ended => return ended,
        }
    }
}

fn take_free_standby(rendezvous: &Rendezvous) -> Result<(Role, RoleHold), FusionError> {
    let mut number = 1;
    loop {
        match rendezvous.roster().take(Role::Standby(number)) {
            Ok(hold) => return Ok((Role::Standby(number), hold)),
            Err(RendezvousError::RoleTaken { .. }) if number < STANDBYS_MAX => number += 1,
            Err(error) => return Err(error.into()),
        }
    }
}

struct Fusion<'a> {
    rendezvous: &'a Rendezvous,
    bus: &'a Bus,
    /// The lead, once it has it.
    hold: Option<RoleHold>,
    /// The first tick of its lead.
    first_tick: u64,
    scenario: &'a Scenario,
    centre: Centre,
    /// What has come for the tick that is being gathered.
    gathering: Gathering,
    /// Ticks in a row at which each robot was missing.
    misses: Vec<u32>,
    /// Who was heard at the tick that was processed last.
    fused: Vec<bool>,
    late: u64,
    repeat_asked: bool,
    checkpoint: Option<Checkpoint>,
    log: Option<TickLogWriter>,
    ranges: Subscriber<Range>,
    headings: Publisher<Command>,
    estimates: Publisher<Estimate>,
    robots: Bell,
    sim: Bell,
}

/// What a fusion started again needs: borrowed as it is written, owned as it is read.
#[derive(Serialize, Deserialize)]
struct Saved<'a> {
    centre: centre::Saved<'a>,
    misses: Cow<'a, [u32]>,
    fused: Cow<'a, [bool]>,
    /// Of the last estimate.
    late: u64,
}

/// The reports of one tick.
#[derive(Debug, Default)]
struct Gathering {
    reports: Vec<Option<Report>>,
    heard: usize,
    time_s: f64,
    /// When the first report came.
    first: Option<Instant>,
    /// When the real-time tick began.
    began_ns: u64,
}

impl<'a> Fusion<'a> {
    fn new(rendezvous: &'a Rendezvous, bus: &'a Bus) -> Result<Self, FusionError> {
        let scenario = &rendezvous.description().scenario;
        let robots = scenario.robots.len();
        Ok(Self {
            rendezvous,
            bus,
            hold: None,
            first_tick: 0,
            scenario,
            centre: Centre::new(scenario)?,
            gathering: Gathering { reports: vec![None; robots], ..Gathering::default() },
            misses: vec![0; robots],
            fused: vec![false; robots],
            late: 0,
            repeat_asked: false,
            checkpoint: None,
            log: None,
            ranges: bus.subscriber()?,
            headings: bus.publisher(robots)?,
            estimates: bus.publisher(1)?,
            robots: bus.bell_of(Sleeper::Robots)?,
            sim: bus.bell_of(Sleeper::Sim)?,
        })
    }

    /// Waits for the lead; `None` if the run ends first. It keeps its ports as ready as if it led: the newest
    /// ranges wait in their buffers.
    fn stand_by(&mut self, standby: &RoleHold, termination: &Termination) -> Result<Option<RoleHold>, FusionError> {
        let roster = self.rendezvous.roster();
        let mut leader = roster.starts(Role::Fusion);
        let mut succession = roster.succeed(Role::Fusion);
        let mut last_sign = roster.last_sign(Role::Fusion);
        let mut silent_looks = 0;
        while !termination.requested() && !self.rendezvous.is_finished() {
            if let Some(hold) = roster.take_in_succession(Role::Fusion, &succession, STANDBY_LOOK)? {
                return Ok(Some(hold));
            }
            standby.sign();
            self.ranges.keep_up()?;
            let sign = roster.last_sign(Role::Fusion);
            silent_looks = if sign == last_sign { silent_looks + 1 } else { 0 };
            last_sign = sign;
            if silent_looks >= SILENT_LOOKS_MAX
                && let Some(sign) = sign
                && let Some(hold) = roster.depose(Role::Fusion, sign)?
            {
                log::warn!("fusion gave no sign of life for {:?}: deposed it", STANDBY_LOOK * SILENT_LOOKS_MAX);
                return Ok(Some(hold));
            }
            if roster.starts(Role::Fusion) != leader {
                // The file whose lock is waited for may be that of a deposed one.
                leader = roster.starts(Role::Fusion);
                succession = roster.succeed(Role::Fusion);
            }
        }
        Ok(None)
    }

    /// Leads until the run ends, until asked to end, or until deposed.
    fn lead(mut self, hold: RoleHold, termination: &Termination) -> Result<(), FusionError> {
        self.hold = Some(hold);
        // A standby has none: every ring would cost the ringer a wake-up of it.
        let bed = self.bus.sleep_as(Sleeper::Fusion)?;
        self.go_on_from_checkpoint()?;
        self.first_tick = self.centre.next_tick();
        self.take_ranges()?;
        self.sim.ring(Call::Hello);
        let mut standstill = Standstill::default();
        while !termination.requested() {
            let calls = bed.sleep(self.time_to_wait());
            self.require_lead()?;
            let stood_still = standstill.look();
            self.gathering.first = self.gathering.first.map(|first| first + stood_still);
            self.take_ranges()?;
            while self.is_ready() {
                self.process_tick()?;
            }
            self.repeat_if_asked()?;
            if (calls.has(Call::Finished) || !calls.has(Call::Data)) && self.rendezvous.is_finished() {
                // What never came in real time is missing, but every tick has its estimate.
                self.take_ranges()?;
                return self.predict_up_to(self.scenario.ticks + 1);
            }
        }
        Ok(())
    }

    fn go_on_from_checkpoint(&mut self) -> Result<(), FusionError> {
        let description = self.rendezvous.description();
        self.log = EstimateRecord::writer(&description.out_dir, description.run_id, self.scenario)
            .inspect_err(|error| log::warn!("goes on without a log: {error}"))
            .ok();
        let (checkpoint, restored) = Checkpoint::of_role::<Saved<'static>>(self.rendezvous, Role::Fusion)?;
        self.checkpoint = checkpoint;
        match restored {
            Some(restored) => self.restore(restored),
            None => Ok(self.rendezvous.refuse_lost_state(Role::Fusion, self.log.as_ref())?),
        }
    }

    /// Goes on from where a killed forerunner stopped. It may have published the last tick or not: who
    /// missed the headings asks for them, and the log's record is written again.
    fn restore(&mut self, restored: Saved<'_>) -> Result<(), FusionError> {
        let Saved { centre, misses, fused, late } = restored;
        self.centre.restore(centre)?;
        self.misses = misses.into_owned();
        self.fused = fused.into_owned();
        let robots = self.scenario.robots.len();
        self.misses.resize(robots, 0);
        self.fused.resize(robots, false);
        if let Some(last_tick) = self.centre.next_tick().checked_sub(1) {
            log::info!("goes on after tick {last_tick}");
            self.put_down(last_tick, Estimate { late, ..self.centre.estimate() });
        }
        Ok(())
    }

    /// When waiting for the rest of a tick ends, if it ever does: tick 0 waits for the whole team.
    fn deadline(&self) -> Option<Duration> {
        let first = self.gathering.first?;
        if self.centre.next_tick() == 0 {
            return None;
        }
        match (self.scenario.clock, self.scenario.patience) {
            (Clock::Realtime, _) => Some(until(range_deadline_ns(self.gathering.began_ns, self.scenario.dt_s))),
            (Clock::Lockstep, Patience::Forever) => None,
            (Clock::Lockstep, Patience::After(limit)) => Some(limit.saturating_sub(first.elapsed())),
        }
    }

    /// Misses in a row after which a robot is not waited for until it speaks again.
    fn misses_max(&self) -> u32 {
        match self.scenario.clock {
            // The deadline has cut short a busy robot now and then; a dead one costs all of them latency.
            Clock::Realtime => 3,
            Clock::Lockstep => 1,
        }
    }

    fn time_to_wait(&self) -> Duration {
        self.deadline().map_or(IDLE, |left| left.min(IDLE))
    }

    /// True if the tick that is being gathered has all it will wait for.
    fn is_ready(&self) -> bool {
        let Gathering { reports, heard, .. } = &self.gathering;
        if *heard == 0 {
            return false;
        }
        *heard == reports.len()
            || reports.iter().zip(&self.misses).all(|(report, misses)| report.is_some() || *misses >= self.misses_max())
            || self.deadline().is_some_and(|left| left.is_zero())
    }

    fn take_ranges(&mut self) -> Result<(), FusionError> {
        // The subscriber is borrowed while it drains; the rest of self is what the messages change.
        let Self { scenario, centre, gathering, misses, fused, late, repeat_asked, ranges, first_tick, .. } = self;
        let mut ahead = None;
        ranges.drain(|header, message| {
            let [range] = message else { return };
            let Some((id, report)) = sound_report(range, gathering.reports.len()) else { return };
            if header.tick > scenario.ticks || !header.valid_at_s.is_finite() {
                return;
            }
            if header.tick + 1 < *first_tick {
                // A forerunner had it; it waited here in case that one had not.
                return;
            }
            misses[id] = 0;
            let next = centre.next_tick();
            if header.tick > next {
                ahead = ahead.max(Some(header.tick));
            } else if header.tick == next {
                gathering.take(id, report, header, range);
            } else {
                let is_of_last = header.tick + 1 == next;
                *repeat_asked |= is_of_last;
                if !(is_of_last && fused[id]) {
                    *late += range.present;
                }
            }
        })?;
        if let Some(tick) = ahead {
            self.catch_up(tick)?;
        }
        Ok(())
    }

    /// Others are ahead: this process was stopped or started late. The ticks between are gone for it;
    /// it predicts through them, and the repeat of the present one comes by itself.
    fn catch_up(&mut self, tick: u64) -> Result<(), FusionError> {
        if self.gathering.heard == 0 {
            log::warn!("missed the ticks {} to {}", self.centre.next_tick(), tick - 1);
        }
        self.predict_up_to(tick)?;
        self.sim.ring(Call::Hello);
        Ok(())
    }

    /// Processes the ticks before this one with what has come of them.
    fn predict_up_to(&mut self, tick: u64) -> Result<(), FusionError> {
        while self.centre.next_tick() < tick {
            if self.gathering.heard == 0 {
                self.gathering.time_s = match self.scenario.source {
                    Source::Simulated { .. } => self.centre.next_tick() as f64 * self.scenario.dt_s,
                    Source::Recorded { .. } => self.centre.time_s(),
                };
            }
            self.process_tick()?;
        }
        Ok(())
    }

    /// Update, plan, checkpoint, publish, put down; in that order, so that robots wait for nothing else,
    /// and nothing is published that a kill could make forget.
    fn process_tick(&mut self) -> Result<(), FusionError> {
        let tick = self.centre.next_tick();
        let began_ns = monotonic_ns();
        self.centre.update(self.gathering.time_s, &self.gathering.reports)?;
        let updated_ns = monotonic_ns();
        self.centre.plan();
        let planned_ns = monotonic_ns();
        for ((fused, misses), report) in self.fused.iter_mut().zip(&mut self.misses).zip(&self.gathering.reports) {
            *fused = report.is_some();
            *misses = if report.is_some() { 0 } else { misses.saturating_add(1) };
        }
        let late = std::mem::take(&mut self.late);
        let centre = self.centre.saved()?;
        let saved = Saved { centre, misses: Cow::Borrowed(&self.misses), fused: Cow::Borrowed(&self.fused), late };
        Checkpoint::write_or_give_up(&mut self.checkpoint, &saved);

        self.require_lead()?;
        self.headings.send(tick, self.centre.time_s(), self.centre.commands())?;
        self.robots.ring(Call::Data);
        let estimate = Estimate {
            late,
            filter_ns: updated_ns - began_ns,
            planner_ns: planned_ns - updated_ns,
            ..self.centre.estimate()
        };
        self.estimates.send(tick, self.centre.time_s(), &[estimate])?;
        self.put_down(tick, estimate);
        self.gathering.clear();
        Ok(())
    }

    /// Gives a sign of life, and sees that nobody has taken the lead meanwhile: after each sleep, and before
    /// anything is commanded. The robots check too: they obey nobody who leads no more.
    fn require_lead(&self) -> Result<(), FusionError> {
        match &self.hold {
            Some(hold) if hold.is_current() => {
                hold.sign();
                Ok(())
            }
            _ => Err(FusionError::Deposed),
        }
    }

    fn put_down(&mut self, tick: u64, estimate: Estimate) {
        let record = EstimateRecord { time_s: self.centre.time_s(), estimate };
        if let Some(log) = &mut self.log
            && let Err(error) = log.write(tick, record.to_words())
        {
            log::warn!("goes on without a log: {error}");
            self.log = None;
        }
    }

    /// A robot that says again what was fused has missed its heading: all get it again, once.
    fn repeat_if_asked(&mut self) -> Result<(), FusionError> {
        if std::mem::take(&mut self.repeat_asked)
            && let Some(last_tick) = self.centre.next_tick().checked_sub(1)
        {
            self.require_lead()?;
            self.headings.send(last_tick, self.centre.time_s(), self.centre.commands())?;
            self.robots.ring(Call::Data);
        }
        Ok(())
    }
}

impl Gathering {
    /// The first report of a robot counts; a repeat says the same.
    fn take(&mut self, id: usize, report: Report, header: &Header, range: &Range) {
        if self.reports[id].is_none() {
            self.reports[id] = Some(report);
            self.heard += 1;
            self.time_s = header.valid_at_s;
            self.began_ns = range.tick_began_ns;
            self.first.get_or_insert_with(Instant::now);
        }
    }

    fn clear(&mut self) {
        self.reports.fill(None);
        self.heard = 0;
        self.first = None;
    }
}

/// Robot and report of a message, or `None` if it is no sound report of this team's.
fn sound_report(range: &Range, robots: usize) -> Option<(usize, Report)> {
    let id = usize::try_from(range.robot).ok().filter(|id| *id < robots)?;
    let numbers = [range.x_m, range.y_m, range.range_m, range.range_std_m];
    if !numbers.iter().all(|value| value.is_finite()) || range.range_std_m <= 0.0 {
        return None;
    }
    let range_m = (range.present == 1).then_some((range.range_m, range.range_std_m));
    Some((id, Report { position_m: Vector::new(range.x_m, range.y_m), range_m }))
}
