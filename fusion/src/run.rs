//! The fusion centre's process: ports and loop round a [`Centre`].

use std::borrow::Cow;
use std::time::{Duration, Instant};

use rangehound_shared::bus::{Bed, Bell, Bus, BusError, Call, Calls, IDLE, Publisher, Sleeper, Subscriber};
use rangehound_shared::checkpoint::{Checkpoint, CheckpointError};
use rangehound_shared::clock::{Standstill, monotonic_ns, until};
use rangehound_shared::message::{Command, Estimate, Range, Refusal, Stages};
use rangehound_shared::record::EstimateRecord;
use rangehound_shared::rendezvous::{Rendezvous, RendezvousError, Role, RoleHold};
use rangehound_shared::robot_set::RobotSet;
use rangehound_shared::scenario::{Clock, PlannerSpec, Scenario};
use rangehound_shared::sealed::SealError;
use rangehound_shared::signal::Termination;
use rangehound_shared::tick_log::{TickLogError, TickLogWriter};
use serde::{Deserialize, Serialize};

use crate::centre::{self, Centre, Diverged};
use crate::intake::{self, Intake, Tally};
use crate::planner::PlannerError;
use crate::trust::{FAILURES_MAX, RECENT};

/// Most standbys of a run.
pub const STANDBYS_MAX: usize = 8;

/// How often a standby looks whether who leads gives signs of life.
const STANDBY_LOOK: Duration = Duration::from_millis(50);

/// What a step of the grid planner may take without a sign of life.
const GRID_STEP_MAX: Duration = Duration::from_secs(30);

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
        bus.take_role(rendezvous, Role::Fusion, &hold)?;
        match fusion.lead(hold, termination) {
            Err(FusionError::Deposed) => log::warn!("{}; stands by", FusionError::Deposed),
            ended => return ended,
        }
    }
}

/// The silence that is no hang, because one step of the scenario's planner may take as long.
#[must_use]
pub fn step_max(scenario: &Scenario) -> Duration {
    if matches!(scenario.planner, PlannerSpec::Grid { .. }) { GRID_STEP_MAX } else { Duration::ZERO }
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
    /// The lead, once it has it.
    hold: Option<RoleHold>,
    scenario: &'a Scenario,
    centre: Centre,
    intake: Intake,
    /// Causes of refusal that have been told.
    told: [bool; Refusal::ALL.len()],
    checkpoint: Option<Checkpoint>,
    log: Option<TickLogWriter>,
    ranges: Subscriber<Range>,
    headings: Publisher<Command>,
    estimates: Publisher<Estimate>,
    bed: Bed,
    robots: Bell,
    sim: Bell,
}

/// What a fusion started again needs: borrowed as it is written, owned as it is read.
#[derive(Serialize, Deserialize)]
struct Saved<'a> {
    centre: centre::Saved<'a>,
    intake: Cow<'a, intake::Record>,
    /// Of the last estimate.
    tally: Tally,
}

impl<'a> Fusion<'a> {
    fn new(rendezvous: &'a Rendezvous, bus: &Bus) -> Result<Self, FusionError> {
        let scenario = &rendezvous.description().scenario;
        Ok(Self {
            rendezvous,
            hold: None,
            scenario,
            centre: Centre::new(scenario)?.keeping_the_past(),
            intake: Intake::new(scenario),
            told: [false; Refusal::ALL.len()],
            checkpoint: None,
            log: None,
            ranges: bus.subscriber()?,
            headings: bus.publisher(scenario.robots.len())?,
            estimates: bus.publisher(1)?,
            bed: bus.sleep_as(Sleeper::Fusion),
            robots: bus.bell_of(Sleeper::Robots),
            sim: bus.bell_of(Sleeper::Sim),
        })
    }

    /// Waits for the lead; `None` if the run ends first. It keeps its ports as ready as if it led: the newest
    /// ranges wait in their buffers.
    fn stand_by(&mut self, standby: &RoleHold, termination: &Termination) -> Result<Option<RoleHold>, FusionError> {
        let roster = self.rendezvous.roster();
        let mut file = roster.file_of(Role::Fusion);
        let silent_looks_max = SILENT_LOOKS_MAX + step_max(self.scenario).div_duration_f64(STANDBY_LOOK) as u32;
        let mut succession = roster.succeed(Role::Fusion);
        let mut last_sign = roster.last_sign(Role::Fusion);
        let mut silent_looks = 0;
        while !termination.requested() && !self.rendezvous.is_finished() {
            if let Some(hold) = roster.take_in_succession(Role::Fusion, &succession, STANDBY_LOOK)? {
                if self.rendezvous.is_removed() {
                    return Err(self.rendezvous.removed().into());
                }
                return Ok(Some(hold));
            }
            standby.sign();
            self.rendezvous.look_for_removal()?;
            self.ranges.keep_up()?;
            let sign = roster.last_sign(Role::Fusion);
            silent_looks = if sign == last_sign { silent_looks + 1 } else { 0 };
            last_sign = sign;
            if silent_looks >= silent_looks_max
                && let Some(sign) = sign
                && let Some(hold) = roster.depose(Role::Fusion, sign)?
            {
                log::warn!("fusion gave no sign of life for {:?}: deposed it", STANDBY_LOOK * silent_looks_max);
                return Ok(Some(hold));
            }
            // None where somebody is about to remove the run: no lead is founded in what is left of it.
            let named = roster.file_of(Role::Fusion);
            if named.is_some() && named != file {
                // The lock that is waited for is that of a deposed one.
                file = named;
                succession = roster.succeed(Role::Fusion);
            }
        }
        Ok(None)
    }

    /// Leads until the run ends, until asked to end, or until deposed.
    fn lead(mut self, hold: RoleHold, termination: &Termination) -> Result<(), FusionError> {
        let began = Instant::now();
        self.go_on_from_checkpoint(&hold)?;
        self.hold = Some(hold);
        let first_tick = self.centre.next_tick();
        self.expect();
        // What has waited for a standby is answered before anything else.
        self.act()?;
        log::info!("leads from tick {first_tick}, {:?} after it could", began.elapsed());
        self.sim.ring(Call::Hello);
        let mut standstill = Standstill::default();
        while !termination.requested() {
            let calls = self.wait();
            self.intake.forgive(standstill.look());
            let tick = self.centre.next_tick();
            self.act()?;
            if self.centre.next_tick() == tick {
                // It has commanded nothing, which is when it looks whether it leads.
                self.require_lead()?;
            }
            if (calls.has(Call::Finished) || calls.is_empty()) && self.rendezvous.is_finished() {
                // What never came in real time is missing, but every tick has its estimate.
                self.take_ranges()?;
                return self.predict_up_to(self.scenario.ticks + 1);
            }
        }
        Ok(())
    }

    /// Acts on whatever has come.
    fn act(&mut self) -> Result<(), FusionError> {
        self.take_ranges()?;
        while self.is_ready() {
            self.process_tick()?;
        }
        self.repeat_if_asked()
    }

    fn go_on_from_checkpoint(&mut self, hold: &RoleHold) -> Result<(), FusionError> {
        let description = self.rendezvous.description();
        self.log = EstimateRecord::writer(&description.out_dir, description.run_id, self.scenario)
            .inspect_err(|error| log::warn!("goes on without a log: {error}"))
            .ok();
        let (checkpoint, restored) = Checkpoint::of_role::<Saved<'static>>(self.rendezvous, Role::Fusion, hold)?;
        self.checkpoint = checkpoint;
        match restored {
            Some(restored) => self.restore(restored),
            None => Ok(self.rendezvous.refuse_lost_state(Role::Fusion, self.log.as_ref())?),
        }
    }

    /// Goes on from where a killed forerunner stopped. It may have published the last tick or not: who
    /// missed the headings asks for them, and the log's record is written again.
    fn restore(&mut self, restored: Saved<'_>) -> Result<(), FusionError> {
        let Saved { centre, intake, tally } = restored;
        self.centre.restore(centre)?;
        if !self.intake.restore(intake.into_owned(), monotonic_ns()) {
            return Err(SealError::Malformed.into());
        }
        if let Some(last_tick) = self.centre.next_tick().checked_sub(1) {
            log::info!("goes on after tick {last_tick}");
            self.put_down(last_tick, with_tally(self.centre.estimate(), &tally));
        }
        Ok(())
    }

    /// Until called, or until the tick's ranges are overdue.
    fn wait(&self) -> Calls {
        // In real time the next tick is far away until the first range of it has come.
        if self.scenario.clock == Clock::Realtime && self.intake.is_empty() {
            self.bed.sleep(self.time_to_wait())
        } else {
            self.bed.wait(self.time_to_wait())
        }
    }

    fn time_to_wait(&self) -> Duration {
        self.intake.deadline_ns(self.centre.next_tick()).map_or(IDLE, |deadline_ns| until(deadline_ns).min(IDLE))
    }

    /// True if the tick that is being gathered has all it will wait for.
    fn is_ready(&self) -> bool {
        self.intake.is_ready(self.centre.next_tick(), monotonic_ns())
    }

    fn take_ranges(&mut self) -> Result<(), FusionError> {
        // The subscriber is borrowed while it drains; the rest of self is what the messages change.
        let Self { centre, intake, ranges, .. } = self;
        let now_ns = monotonic_ns();
        ranges.drain(|header, message| intake.take(centre, header, message, now_ns))?;
        intake.refuse(Refusal::Impostor, ranges.take_impostors());
        if let Some(tick) = self.intake.take_ahead() {
            self.catch_up(tick)?;
        }
        Ok(())
    }

    /// Others are ahead: this process was stopped or started late. The ticks between are gone for it;
    /// it predicts through them, and the repeat of the present one comes by itself.
    fn catch_up(&mut self, tick: u64) -> Result<(), FusionError> {
        if self.intake.is_empty() {
            log::warn!("missed the ticks {} to {}", self.centre.next_tick(), tick - 1);
        }
        self.predict_up_to(tick)?;
        self.sim.ring(Call::Hello);
        Ok(())
    }

    /// Processes the ticks before this one with what has come of them.
    fn predict_up_to(&mut self, tick: u64) -> Result<(), FusionError> {
        while self.centre.next_tick() < tick {
            self.process_tick()?;
        }
        Ok(())
    }

    /// Update, plan, checkpoint, publish, put down; in that order, so that robots wait for nothing else,
    /// and nothing is published that a kill could make forget.
    fn process_tick(&mut self) -> Result<(), FusionError> {
        let tick = self.centre.next_tick();
        let began_ns = monotonic_ns();
        let last_range_ns = self.intake.last_range_ns();
        let (distrusted, noise_scale) = (self.centre.distrusted(), self.centre.noise_scale());
        let time_s = self.intake.time_s(&self.centre);
        self.centre.update(time_s, self.intake.reports())?;
        let filtered_ns = monotonic_ns();
        self.centre.plan();
        let planned_ns = monotonic_ns();
        let tally = self.intake.close(tick, filtered_ns);
        // A deposed one writes nothing that its successor could read.
        self.require_lead()?;
        let centre = self.centre.saved()?;
        let saved = Saved { centre, intake: Cow::Borrowed(self.intake.record()), tally };
        Checkpoint::write_or_give_up(&mut self.checkpoint, &saved);
        let saved_ns = monotonic_ns();

        self.require_lead()?;
        self.headings.send(tick, self.centre.time_s(), self.centre.commands())?;
        let sent_ns = monotonic_ns();
        self.robots.ring(Call::Heading);
        // The robots first: on a busy core they would wait for what is only put down.
        std::thread::yield_now();
        let estimate = Estimate {
            stages: Stages { last_range_ns, began_ns, filtered_ns, planned_ns, saved_ns, sent_ns },
            ..with_tally(self.centre.estimate(), &tally)
        };
        self.estimates.send(tick, self.centre.time_s(), &[estimate])?;
        self.put_down(tick, estimate);
        self.expect();
        self.tell_of_trust(distrusted, noise_scale);
        self.tell_of_refusals(&tally);
        Ok(())
    }

    /// Has itself called when all have spoken that it waits for.
    fn expect(&self) {
        self.bed.expect(self.intake.expected());
    }

    /// Says when most sensors fail together and when they no longer do, and names who is distrusted since the last tick, and who no longer is.
    fn tell_of_trust(&self, before: RobotSet, noise_scale_before: f64) {
        let (now, noise_scale) = (self.centre.distrusted(), self.centre.noise_scale());
        if noise_scale > 1.0 && noise_scale_before == 1.0 {
            log::warn!(
                "most sensors fail together: takes their ranges to be {noise_scale:.1} times as noisy as told, and distrusts nobody"
            );
            return;
        }
        if noise_scale == 1.0 && noise_scale_before > 1.0 {
            log::warn!("most sensors no longer fail together: takes their ranges to be as noisy as told again");
        }
        for id in now.iter().filter(|id| !before.contains(*id)) {
            log::warn!(
                "{} is distrusted: {FAILURES_MAX} of its last {RECENT} ranges failed the gate",
                self.scenario.name_of(id)
            );
        }
        for id in before.iter().filter(|id| !now.contains(*id)) {
            log::warn!("{} is trusted again: its last {RECENT} ranges passed the gate", self.scenario.name_of(id));
        }
    }

    /// Says once of each cause that messages are refused; the report counts them.
    fn tell_of_refusals(&mut self, tally: &Tally) {
        for ((refusal, count), told) in Refusal::ALL.iter().zip(tally.refused).zip(&mut self.told) {
            if count > 0 && !std::mem::replace(told, true) {
                log::warn!("refused a range message ({}); others like it are counted in the report", refusal.name());
            }
        }
    }

    /// Gives a sign of life, and sees that nobody has taken the lead meanwhile: after each sleep, and before
    /// anything is commanded. The robots check too: they obey nobody who leads no more.
    fn require_lead(&self) -> Result<(), FusionError> {
        match &self.hold {
            Some(hold) if hold.is_current() => {
                hold.sign();
                Ok(self.rendezvous.look_for_removal()?)
            }
            _ if self.rendezvous.is_removed() => Err(self.rendezvous.removed().into()),
            _ => Err(FusionError::Deposed),
        }
    }

    fn put_down(&mut self, tick: u64, estimate: Estimate) {
        if let Some(log) = &mut self.log
            && let Err(error) = write(log, self.scenario, &self.centre, self.intake.record(), tick, estimate)
        {
            log::warn!("goes on without a log: {error}");
            self.log = None;
        }
    }

    /// A robot that says again what was fused has missed its heading: all get it again, once.
    fn repeat_if_asked(&mut self) -> Result<(), FusionError> {
        if self.intake.take_repeat_asked()
            && let Some(last_tick) = self.centre.next_tick().checked_sub(1)
        {
            self.require_lead()?;
            self.headings.send(last_tick, self.centre.time_s(), self.centre.commands())?;
            self.robots.ring(Call::Heading);
        }
        Ok(())
    }
}

/// Puts a tick down, with all that it takes to go through it again: what was heard of each robot, in time or late.
fn write(
    log: &mut TickLogWriter,
    scenario: &Scenario,
    centre: &Centre,
    heard: &intake::Record,
    tick: u64,
    estimate: Estimate,
) -> Result<(), TickLogError> {
    let record = EstimateRecord { time_s: centre.time_s(), estimate };
    log.write(tick, record.to_words(centre.exchanges(tick, heard.said())))?;
    for late in heard.said_late() {
        EstimateRecord::amend(log, scenario, late.tick, late.robot, late.report.heard(tick, late.judged))?;
    }
    Ok(())
}

/// An estimate with what came besides its tick's ranges.
fn with_tally(estimate: Estimate, tally: &Tally) -> Estimate {
    let Tally { late, fused_late, rejected_late, refused } = *tally;
    Estimate { late, fused_late, rejected_late, refused, ..estimate }
}
