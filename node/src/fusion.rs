//! The fusion centre's process: a [`Leader`] over shared memory, with its log and its checkpoint; and a [`Standby`] of one.

use std::time::Instant;

use rangehound_fusion::Centre;
use rangehound_fusion::centre::Diverged;
use rangehound_fusion::leader::{Action, Leader, Notice, Saved};
use rangehound_fusion::planner::{Planner, PlannerError};
use rangehound_fusion::standby::{POLL_INTERVAL, STANDBYS_MAX, Standby};
use rangehound_fusion::trust::{FAILURES_MAX, RECENT};
use rangehound_shared::message::{Command, Estimate, Range};
use rangehound_shared::record::FusionRecord;
use rangehound_shared::scenario::Scenario;
use rangehound_shared::sealed::SealError;

use crate::bus::{Bus, BusError, Event, Events, IDLE, Notifier, Publisher, Subscriber, WaitGroup, Waiter};
use crate::checkpoint::{Checkpoint, CheckpointError};
use crate::logs;
use crate::rendezvous::{Rendezvous, RendezvousError, Role, RoleLease};
use crate::system::clock::{monotonic_ns, until};
use crate::system::signal::Termination;
use crate::tick_log::{TickLogError, TickLogWriter};

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
    /// The predecessor's state cannot be used.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// The predecessor's state cannot be used, as found after opening it.
    #[error("cannot use the checkpoint: {0}: start a new run")]
    Sealed(#[from] SealError),
    /// The state of this process cannot be stored.
    #[error("cannot encode the checkpoint: {0}: please report this")]
    Unsaved(SealError),
    /// The filter diverged.
    #[error(transparent)]
    Diverged(#[from] Diverged),
    /// Another process took the role because this one sent no heartbeat.
    #[error("this fusion process sent no heartbeat, so another one took its role")]
    Deposed,
}

/// Runs the fusion centre until the run ends or until asked to end.
///
/// # Errors
/// [`FusionError`].
pub fn run(rendezvous: &Rendezvous, termination: &Termination) -> Result<(), FusionError> {
    run_with(rendezvous, None, termination)
}

/// The same with the caller's planner in place of the scenario's.
///
/// # Errors
/// [`FusionError`].
pub fn run_with(
    rendezvous: &Rendezvous,
    planner: Option<Box<dyn Planner>>,
    termination: &Termination,
) -> Result<(), FusionError> {
    let lease = rendezvous.roster().take(Role::Fusion)?;
    let bus = Bus::of_role(rendezvous, Role::Fusion, &lease)?;
    let mut driver = Driver::new(rendezvous, &bus)?;
    if let Some(planner) = planner {
        let scenario = &rendezvous.description().scenario;
        let centre = Centre::new(scenario)?.with_history().planned_by(planner);
        driver.leader = Leader::of_centre(scenario, centre);
    }
    driver.lead(lease, termination)
}

/// Runs a standby: a fusion centre that waits until the leader ends or sends no heartbeat, and then
/// resumes from its checkpoint. If it is deposed later, it stands by again.
///
/// # Errors
/// [`FusionError`].
pub fn run_standby(rendezvous: &Rendezvous, termination: &Termination) -> Result<(), FusionError> {
    loop {
        let (role, standby) = take_free_standby(rendezvous)?;
        let bus = Bus::connect(rendezvous, &role.to_string())?;
        let fusion = Driver::new(rendezvous, &bus)?;
        let Some(lease) = fusion.stand_by(&standby, termination)? else { return Ok(()) };
        drop(standby);
        bus.take_role(rendezvous, Role::Fusion, &lease)?;
        match fusion.lead(lease, termination) {
            Err(FusionError::Deposed) => log::warn!("{}; this process is now a standby", FusionError::Deposed),
            ended => return ended,
        }
    }
}

fn take_free_standby(rendezvous: &Rendezvous) -> Result<(Role, RoleLease), FusionError> {
    let mut number = 1;
    loop {
        match rendezvous.roster().take(Role::Standby(number)) {
            Ok(lease) => return Ok((Role::Standby(number), lease)),
            Err(RendezvousError::RoleTaken { .. }) if number < STANDBYS_MAX => number += 1,
            Err(error) => return Err(error.into()),
        }
    }
}

struct Driver<'a> {
    rendezvous: &'a Rendezvous,
    scenario: &'a Scenario,
    leader: Leader,
    checkpoint: Option<Checkpoint>,
    log: Option<TickLogWriter<FusionRecord>>,
    ranges: Subscriber<Range>,
    headings: Publisher<Command>,
    estimates: Publisher<Estimate>,
    waiter: Waiter,
    robots: Notifier,
    sim: Notifier,
}

impl<'a> Driver<'a> {
    fn new(rendezvous: &'a Rendezvous, bus: &Bus) -> Result<Self, FusionError> {
        let scenario = &rendezvous.description().scenario;
        Ok(Self {
            rendezvous,
            scenario,
            leader: Leader::new(scenario)?,
            checkpoint: None,
            log: None,
            ranges: bus.subscriber()?,
            headings: bus.publisher(scenario.robots.len())?,
            estimates: bus.publisher(1)?,
            waiter: bus.waiter_of(WaitGroup::Fusion),
            robots: bus.notifier_of(WaitGroup::Robots),
            sim: bus.notifier_of(WaitGroup::Sim),
        })
    }

    /// Waits for the lead; `None` if the run ends first. It keeps its ports connected as a leader does: the newest
    /// ranges stay queued.
    fn stand_by(&self, own: &RoleLease, termination: &Termination) -> Result<Option<RoleLease>, FusionError> {
        let roster = self.rendezvous.roster();
        let mut standby =
            Standby::new(self.scenario, roster.last_heartbeat(Role::Fusion), roster.file_of(Role::Fusion));
        let mut succession = roster.succeed(Role::Fusion);
        // A leader that dies after the last tick leaves its last estimates to a standby.
        while !termination.requested() && !self.rendezvous.is_complete() && !self.rendezvous.is_ending() {
            if let Some(lease) = roster.take_when_free(Role::Fusion, &succession, POLL_INTERVAL)? {
                if self.rendezvous.is_removed() {
                    return Err(self.rendezvous.removed().into());
                }
                return Ok(Some(lease));
            }
            let now_ns = monotonic_ns();
            own.renew(now_ns);
            self.rendezvous.look_for_removal(now_ns)?;
            self.ranges.keep_up()?;
            if let Some(silent_since) = standby.look(roster.last_heartbeat(Role::Fusion))
                && let Some(lease) = roster.depose(Role::Fusion, silent_since)?
            {
                log::warn!("fusion sent no heartbeat for {:?}: this standby takes its role", standby.silence_max());
                return Ok(Some(lease));
            }
            if standby.restart_wait(roster.file_of(Role::Fusion)) {
                succession = roster.succeed(Role::Fusion);
            }
        }
        Ok(None)
    }

    /// Leads until the run ends, until asked to end, or until deposed.
    fn lead(mut self, lease: RoleLease, termination: &Termination) -> Result<(), FusionError> {
        let began = Instant::now();
        self.go_on_from_checkpoint(&lease)?;
        let first_tick = self.leader.centre().next_tick();
        self.waiter.expect(self.leader.expected());
        // Ranges that queued up during standby are answered first.
        self.receive()?;
        self.act(&lease)?;
        log::info!("leads from tick {first_tick}, {:?} after the lead was free", began.elapsed());
        while !termination.requested() {
            let events = self.wait();
            let tick = self.leader.centre().next_tick();
            self.receive()?;
            self.act(&lease)?;
            if self.leader.centre().next_tick() == tick {
                // Nothing was commanded yet, so this is the time to check that it still leads.
                self.require_lead(&lease)?;
            }
            if events.has(Event::Finished) || events.is_empty() {
                if self.rendezvous.is_finished() {
                    self.receive()?;
                    self.leader.finish();
                    self.act(&lease)?;
                    return Ok(self.rendezvous.mark_estimated()?);
                }
                if self.rendezvous.is_ending() {
                    return Ok(());
                }
            }
        }
        Ok(())
    }

    fn go_on_from_checkpoint(&mut self, lease: &RoleLease) -> Result<(), FusionError> {
        let description = self.rendezvous.description();
        self.log = logs::write_estimates(description)
            .inspect_err(|error| {
                log::warn!("{error}: the run continues without this log; report and recording will miss these ticks")
            })
            .ok();
        let (checkpoint, restored) = Checkpoint::of_role::<Saved<'static>>(self.rendezvous, Role::Fusion, lease)?;
        self.checkpoint = checkpoint;
        let Some(saved) = restored else {
            return Ok(self.rendezvous.refuse_lost_state(Role::Fusion, self.log.as_ref())?);
        };
        self.leader.restore(saved, monotonic_ns())?;
        if let Some(last_tick) = self.leader.centre().next_tick().checked_sub(1) {
            log::info!("goes on after tick {last_tick}");
        }
        Ok(())
    }

    /// Waits for an event, or until the tick's ranges are overdue.
    fn wait(&self) -> Events {
        let left = self.leader.wakes_at_ns().map_or(IDLE, |at_ns| until(at_ns).min(IDLE));
        // In real time the next tick is far away until its first range arrives.
        if self.leader.waits_for_tick() { self.waiter.sleep(left) } else { self.waiter.wait(left) }
    }

    fn receive(&mut self) -> Result<(), BusError> {
        let Self { leader, ranges, .. } = self;
        let now_ns = monotonic_ns();
        ranges.drain(|header, message| leader.on_range(header, message, now_ns))?;
        leader.refuse_impostors(ranges.take_impostors());
        Ok(())
    }

    fn act(&mut self, lease: &RoleLease) -> Result<(), FusionError> {
        while let Some(action) = self.leader.next_action(monotonic_ns())? {
            let centre = self.leader.centre();
            let (last_tick, time_s) = (centre.next_tick().saturating_sub(1), centre.time_s());
            match action {
                Action::Continue => {}
                Action::RequireLead => self.require_lead(lease)?,
                Action::Save => {
                    let saved = self.leader.saved().map_err(FusionError::Unsaved)?;
                    Checkpoint::write_or_give_up(&mut self.checkpoint, &saved);
                }
                Action::SendHeadings => _ = self.headings.send(last_tick, time_s, centre.commands())?,
                Action::Notify(notification) => self.notify(&notification),
                Action::SendEstimate => {
                    self.estimates.send(last_tick, time_s, std::slice::from_ref(self.leader.estimate()))?;
                }
                Action::Record => {
                    self.record(last_tick);
                    self.waiter.expect(self.leader.expected());
                }
                Action::Report(notice) => self.tell(notice),
            }
        }
        Ok(())
    }

    fn notify(&self, notification: &rangehound_shared::protocol::wake::Notification) {
        match notification.to {
            WaitGroup::Sim => self.sim.notify(notification),
            WaitGroup::Robots | WaitGroup::Fusion => {
                self.robots.notify(notification);
                // Robots first: on a busy core they would otherwise wait for the log.
                rustix::thread::sched_yield();
            }
        }
    }

    /// Sends a heartbeat, and checks that this process still leads: after each sleep, and before
    /// each command. The robots check too: they ignore a deposed leader.
    fn require_lead(&self, lease: &RoleLease) -> Result<(), FusionError> {
        if lease.is_current() {
            let now_ns = monotonic_ns();
            lease.renew(now_ns);
            return Ok(self.rendezvous.look_for_removal(now_ns)?);
        }
        Err(if self.rendezvous.is_removed() { self.rendezvous.removed().into() } else { FusionError::Deposed })
    }

    fn record(&mut self, tick: u64) {
        if let Some(log) = &mut self.log
            && let Err(error) = write(log, &self.leader, tick)
        {
            log::warn!("{error}: the run continues without this log; report and recording will miss these ticks");
            self.log = None;
        }
    }

    fn tell(&self, notice: Notice) {
        let name_of = |id| self.scenario.name_of(id);
        match notice {
            Notice::Missed { first, last } => log::warn!(
                "fusion did not run at ticks {first} to {last}, because it was suspended or started late: it predicts through them"
            ),
            Notice::NoiseRaised(kind, noise_scale) => log::warn!(
                "most sensors fail the gate together: the filter assumes {noise_scale:.1} times their stated {} noise and \
                 distrusts no sensor",
                kind.name()
            ),
            Notice::NoiseAsStated(kind) => {
                log::warn!("most sensors pass the gate again: the filter assumes their stated {} noise", kind.name());
            }
            Notice::Distrusted(kind, id) => log::warn!(
                "{} is distrusted: {FAILURES_MAX} of its last {RECENT} {}s failed the gate",
                name_of(id),
                kind.name()
            ),
            Notice::Trusted(kind, id) => {
                log::warn!("{} is trusted again: its last {RECENT} {}s passed the gate", name_of(id), kind.name());
            }
            Notice::Refused(refusal) => {
                log::warn!("refused a robot's message: {}; the report counts further ones", refusal.name());
            }
        }
    }
}

/// Logs a tick with all data needed to replay it: what came from each robot, in time or late.
fn write(log: &mut TickLogWriter<FusionRecord>, leader: &Leader, tick: u64) -> Result<(), TickLogError> {
    log.write(tick, |record| record.set(leader.centre().time_s(), leader.estimate(), leader.exchanges()))?;
    for late in leader.late_reports() {
        log.amend(late.tick, |record| {
            if let Some(exchange) = record.exchanges.get_mut(late.robot) {
                exchange.heard = Some(late.heard_at(tick));
            }
        })?;
    }
    Ok(())
}
