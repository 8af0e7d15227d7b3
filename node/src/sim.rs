//! The simulator's process: a [`Machine`] over shared memory, with its log and its checkpoint.

use std::time::Duration;

use rangehound_shared::message::{Drive, Truth, WorldEntry};
use rangehound_shared::record::WorldRecord;
use rangehound_shared::scenario::Timeout;
use rangehound_shared::sealed::SealError;
use rangehound_sim::machine::{Action, Machine, Saved};

use crate::bus::{Bus, BusError, Event, Events, IDLE, Notifier, Publisher, Subscriber, WaitGroup, Waiter};
use crate::checkpoint::{Checkpoint, CheckpointError};
use crate::logs;
use crate::rendezvous::{Rendezvous, RendezvousError, Role, RoleLease};
use crate::system::clock::{monotonic_ns, until};
use crate::system::signal::Termination;
use crate::tick_log::TickLogWriter;
use crate::world::{PlaybackError, world_of};

/// Bound on the delay of a waiter's time-out, which has the resolution of kernel ticks: the rest of a real-time tick is slept
/// out exactly, without reaction to events.
const WAITER_LATE: Duration = Duration::from_millis(8);

/// Why the simulator ended early.
#[derive(Debug, thiserror::Error)]
pub enum SimError {
    /// It cannot take part in the run.
    #[error(transparent)]
    Rendezvous(#[from] RendezvousError),
    /// The bus failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The predecessor's state cannot be used.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// The predecessor's state cannot be used, as found after opening it.
    #[error("cannot use the checkpoint: {0}: start a new run")]
    Sealed(#[from] SealError),
    /// The state of this process cannot be stored.
    #[error("cannot encode the checkpoint: {0}: please report this")]
    Unsaved(SealError),
    /// The recording cannot be played.
    #[error(transparent)]
    Recording(#[from] PlaybackError),
}

/// Runs the simulator of a run until its last tick or until asked to end.
///
/// # Errors
/// [`SimError`].
pub fn run(rendezvous: &Rendezvous, termination: &Termination) -> Result<(), SimError> {
    let lease = rendezvous.roster().take(Role::Sim)?;
    let bus = Bus::of_role(rendezvous, Role::Sim, &lease)?;
    let mut sim = Driver::new(rendezvous, &bus, lease)?;
    sim.act()?;
    while !sim.machine.has_ended() && !termination.requested() {
        let events = sim.wait();
        let now_ns = monotonic_ns();
        sim.lease.renew(now_ns);
        rendezvous.look_for_removal(now_ns)?;
        sim.receive(events)?;
        if events.is_empty() && rendezvous.is_ending() {
            break;
        }
        if !termination.requested() {
            sim.act()?;
        }
    }
    Ok(())
}

struct Driver<'a> {
    rendezvous: &'a Rendezvous,
    lease: RoleLease,
    machine: Machine,
    checkpoint: Option<Checkpoint>,
    log: Option<TickLogWriter<WorldRecord>>,
    worlds: Publisher<WorldEntry>,
    truths: Publisher<Truth>,
    drives: Subscriber<Drive>,
    waiter: Waiter,
    robots: Notifier,
    fusion: Notifier,
}

impl<'a> Driver<'a> {
    fn new(rendezvous: &'a Rendezvous, bus: &Bus, lease: RoleLease) -> Result<Self, SimError> {
        let description = rendezvous.description();
        let scenario = &description.scenario;
        let log = logs::write_worlds(description)
            .inspect_err(|error| {
                log::warn!("{error}: the run continues without this log; report and recording will miss these ticks")
            })
            .ok();
        let (checkpoint, restored) = Checkpoint::of_role::<Saved<'static>>(rendezvous, Role::Sim, &lease)?;
        let mut machine = Machine::new(scenario, world_of(scenario, &description.out_dir)?);
        match restored {
            Some(saved) => {
                machine.restore(saved)?;
                log::info!("continues with tick {}", machine.tick());
            }
            None => rendezvous.refuse_lost_state(Role::Sim, log.as_ref())?,
        }
        Ok(Self {
            rendezvous,
            lease,
            machine,
            checkpoint,
            log,
            worlds: bus.publisher(scenario.robots.len())?,
            truths: bus.publisher(1)?,
            drives: bus.subscriber()?,
            waiter: bus.waiter_of(WaitGroup::Sim),
            robots: bus.notifier_of(WaitGroup::Robots),
            fusion: bus.notifier_of(WaitGroup::Fusion),
        })
    }

    /// Waits for an event, or until the machine has something to do.
    fn wait(&mut self) -> Events {
        let left = self.machine.wakes_at_ns().map_or(IDLE, until);
        match self.machine.due_ns() {
            None => self.waiter.wait(left),
            Some(_) if left > WAITER_LATE => self.waiter.sleep((left - WAITER_LATE).min(IDLE)),
            Some(_) => {
                std::thread::sleep(left);
                Events::default()
            }
        }
    }

    fn receive(&mut self, events: Events) -> Result<(), BusError> {
        if events.has(Event::Hello) {
            self.machine.on_hello();
        }
        let Self { machine, drives, .. } = self;
        drives.drain(|header, message| {
            if let [drive] = message {
                machine.on_drive(header.tick, drive);
            }
        })
    }

    fn act(&mut self) -> Result<(), SimError> {
        while let Some(action) = self.machine.next_action(monotonic_ns()) {
            match action {
                Action::Record => self.record(),
                Action::Save => {
                    let saved = self.machine.saved().map_err(SimError::Unsaved)?;
                    Checkpoint::write_or_give_up(&mut self.checkpoint, &saved);
                }
                Action::SendWorld => {
                    self.waiter.expect(self.machine.expected());
                    let world = self.machine.world();
                    self.worlds.send(self.machine.tick(), world.time_s(), world.entries())?;
                }
                Action::SendTruth => {
                    let time_s = self.machine.world().time_s();
                    self.truths.send(self.machine.tick(), time_s, &[self.machine.truth()])?;
                }
                Action::Notify(notification) => match notification.to {
                    WaitGroup::Fusion => self.fusion.notify(&notification),
                    WaitGroup::Robots | WaitGroup::Sim => self.robots.notify(&notification),
                },
                Action::ReportSilent(id) => self.report_silent(id),
                Action::Finish => self.rendezvous.finish()?,
            }
        }
        Ok(())
    }

    fn record(&mut self) {
        let (machine, Some(log)) = (&self.machine, &mut self.log) else { return };
        let world = machine.world();
        let fill = |record: &mut WorldRecord| {
            let times = (world.time_s(), monotonic_ns());
            record.set(times, world.truth(), world.poses(), world.entries(), machine.drives());
        };
        if let Err(error) = log.write(machine.tick(), fill) {
            log::warn!("{error}: the run continues without this log; report and recording will miss these ticks");
            self.log = None;
        }
    }

    fn report_silent(&self, id: usize) {
        let scenario = &self.rendezvous.description().scenario;
        let Timeout::After(limit) = scenario.timeout else { return };
        log::warn!(
            "tick {}: continues without {}, which was silent for {limit:?}",
            self.machine.tick(),
            scenario.name_of(id)
        );
    }
}
