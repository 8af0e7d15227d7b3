//! The simulator's process: ports and loop round a [`World`].

use std::borrow::Cow;
use std::time::{Duration, Instant};

use rangehound_shared::STATE_DIM_MAX;
use rangehound_shared::bus::{Bed, Bell, Bus, BusError, Call, Calls, IDLE, Publisher, Sleeper, Subscriber};
use rangehound_shared::checkpoint::{Checkpoint, CheckpointError};
use rangehound_shared::clock::{Standstill, monotonic_ns, until};
use rangehound_shared::message::{Drive, Truth, WorldEntry};
use rangehound_shared::record::WorldRecord;
use rangehound_shared::rendezvous::{Rendezvous, RendezvousError, Role, RoleHold};
use rangehound_shared::scenario::{Clock, Patience, Scenario};
use rangehound_shared::sealed::SealError;
use rangehound_shared::signal::Termination;
use rangehound_shared::tick_log::TickLogWriter;
use serde::{Deserialize, Serialize};

use crate::playback::PlaybackError;
use crate::{World, world_of};

/// After this long without all answers the tick is sent again: mends whatever was lost.
const REPEAT: Duration = Duration::from_millis(50);

/// How late a bed's time limit may come, which counts in the kernel's ticks: the rest of a real-time tick is slept
/// out deaf, but on time.
const BED_LATE: Duration = Duration::from_millis(8);

/// Why the simulator ended early.
#[derive(Debug, thiserror::Error)]
pub enum SimError {
    /// It cannot take part in the run.
    #[error(transparent)]
    Rendezvous(#[from] RendezvousError),
    /// The bus failed.
    #[error(transparent)]
    Bus(#[from] BusError),
    /// The state that a forerunner left cannot be used.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// The same, found later.
    #[error("the checkpoint {0}")]
    Sealed(#[from] SealError),
    /// The recording cannot be played.
    #[error(transparent)]
    Recording(#[from] PlaybackError),
}

/// Runs the simulator of a run until its last tick or until asked to end.
///
/// # Errors
/// [`SimError`].
pub fn run(rendezvous: &Rendezvous, termination: &Termination) -> Result<(), SimError> {
    let hold = rendezvous.roster().take(Role::Sim)?;
    let bus = Bus::of_role(rendezvous, Role::Sim, &hold)?;
    let mut sim = Sim::new(rendezvous, &bus, hold)?;
    let ended = match sim.scenario.clock {
        Clock::Lockstep => sim.run_in_lockstep(termination)?,
        Clock::Realtime => sim.run_in_real_time(termination)?,
    };
    if ended {
        rendezvous.finish()?;
        sim.robots.ring(Call::Finished);
        sim.fusion.ring(Call::Finished);
    }
    Ok(())
}

struct Sim<'a> {
    rendezvous: &'a Rendezvous,
    hold: RoleHold,
    scenario: &'a Scenario,
    world: Box<dyn World>,
    tick: u64,
    drives: Vec<Option<Drive>>,
    /// Robots that are not waited for.
    silent: Vec<bool>,
    slowest_latency_ns: u64,
    world_bytes: Vec<u8>,
    checkpoint: Option<Checkpoint>,
    log: Option<TickLogWriter>,
    worlds: Publisher<WorldEntry>,
    truths: Publisher<Truth>,
    drives_in: Subscriber<Drive>,
    bed: Bed,
    robots: Bell,
    fusion: Bell,
}

/// What a simulator started again needs: borrowed as it is written, owned as it is read.
#[derive(Serialize, Deserialize)]
struct Saved<'a> {
    tick: u64,
    silent: Cow<'a, [bool]>,
    world: Cow<'a, [u8]>,
}

impl<'a> Sim<'a> {
    fn new(rendezvous: &'a Rendezvous, bus: &Bus, hold: RoleHold) -> Result<Self, SimError> {
        let description = rendezvous.description();
        let scenario = &description.scenario;
        let robots = scenario.robots.len();
        let log = WorldRecord::writer(&description.out_dir, description.run_id, scenario)
            .inspect_err(|error| log::warn!("goes on without a log: {error}"))
            .ok();
        let (checkpoint, restored) = Checkpoint::of_role::<Saved<'static>>(rendezvous, Role::Sim, &hold)?;
        let mut sim = Self {
            rendezvous,
            hold,
            scenario,
            world: world_of(scenario, &description.out_dir)?,
            tick: 0,
            drives: vec![None; robots],
            silent: vec![false; robots],
            slowest_latency_ns: 0,
            world_bytes: Vec::new(),
            checkpoint,
            log,
            worlds: bus.publisher(robots)?,
            truths: bus.publisher(1)?,
            drives_in: bus.subscriber()?,
            bed: bus.sleep_as(Sleeper::Sim),
            robots: bus.bell_of(Sleeper::Robots),
            fusion: bus.bell_of(Sleeper::Fusion),
        };
        match restored {
            Some(Saved { tick, silent, world }) => {
                sim.world.restore(&world)?;
                sim.tick = tick;
                sim.silent = silent.into_owned();
                sim.silent.resize(robots, false);
                log::info!("goes on with tick {tick}");
            }
            None => {
                rendezvous.refuse_lost_state(Role::Sim, sim.log.as_ref())?;
                // Before tick 0 is put down: killed between that and its checkpoint, it would be refused.
                sim.save()?;
            }
        }
        Ok(sim)
    }

    /// Every tick starts as soon as all robots have answered the one before. True if the run came to
    /// its end.
    fn run_in_lockstep(&mut self, termination: &Termination) -> Result<bool, SimError> {
        while self.tick <= self.scenario.ticks {
            let patience = if self.tick == 0 { Patience::Forever } else { self.scenario.patience };
            if !self.tick_until_answered(patience, termination)? {
                return Ok(false);
            }
            self.end_tick()?;
        }
        Ok(true)
    }

    /// A tick every dt of wall time. Tick 0 waits for the whole team, so that the run starts when
    /// everybody is there; a simulator that was started again waits for nobody.
    fn run_in_real_time(&mut self, termination: &Termination) -> Result<bool, SimError> {
        if self.tick > self.scenario.ticks {
            return Ok(true);
        }
        if self.tick > 0 {
            self.publish()?;
        } else if !self.tick_until_answered(Patience::Forever, termination)? {
            return Ok(false);
        }
        let dt_ns = (self.scenario.dt_s * 1e9) as u64;
        let mut due_ns = monotonic_ns() + dt_ns;
        loop {
            self.sleep_until(due_ns, termination)?;
            if termination.requested() {
                return Ok(false);
            }
            self.end_tick()?;
            if self.tick > self.scenario.ticks {
                return Ok(true);
            }
            self.publish()?;
            due_ns += dt_ns;
            // Time lost to a stopped process is not made up by a burst of ticks, nor by one of no length.
            let now_ns = monotonic_ns();
            if due_ns <= now_ns {
                due_ns = now_ns + dt_ns;
            }
        }
    }

    /// Publishes the present tick until every robot has answered it, or all but those whose silence
    /// exceeds the patience while others go on. False if asked to end.
    fn tick_until_answered(&mut self, patience: Patience, termination: &Termination) -> Result<bool, SimError> {
        self.publish()?;
        let mut first_answer: Option<Instant> = None;
        let mut standstill = Standstill::default();
        let mut repeat_at = Instant::now() + REPEAT;
        while !termination.requested() {
            let calls = self.bed.wait(repeat_at.saturating_duration_since(Instant::now()));
            self.sign()?;
            let stood_still = standstill.look();
            first_answer = first_answer.map(|first| first + stood_still);
            self.take_drives()?;
            if self.drives.iter().any(Option::is_some) {
                // Silence counts only while others go on: fusion may have been waiting until now.
                let first_answer = *first_answer.get_or_insert_with(Instant::now);
                if self.leave_out_the_silent(patience, first_answer.elapsed()) {
                    return Ok(true);
                }
            }
            if calls.has(Call::Hello) || Instant::now() >= repeat_at {
                self.publish()?;
                repeat_at = Instant::now() + REPEAT;
            }
        }
        Ok(false)
    }

    /// Leaves out who has been silent for too long since the first answer. True once nobody is waited
    /// for any more.
    fn leave_out_the_silent(&mut self, patience: Patience, elapsed: Duration) -> bool {
        if let Patience::After(limit) = patience
            && elapsed >= limit
        {
            for (id, (silent, drive)) in self.silent.iter_mut().zip(&self.drives).enumerate() {
                if drive.is_none() && !*silent {
                    log::warn!(
                        "tick {}: goes on without {}, silent for {limit:?}",
                        self.tick,
                        self.scenario.name_of(id)
                    );
                    *silent = true;
                }
            }
        }
        self.drives.iter().zip(&self.silent).all(|(drive, silent)| drive.is_some() || *silent)
    }

    fn sleep_until(&mut self, due_ns: u64, termination: &Termination) -> Result<(), SimError> {
        while !until(due_ns).is_zero() && !termination.requested() {
            let left = until(due_ns);
            let calls = if left > BED_LATE {
                self.bed.sleep((left - BED_LATE).min(IDLE))
            } else {
                std::thread::sleep(left);
                Calls::default()
            };
            self.sign()?;
            self.take_drives()?;
            if calls.has(Call::Hello) {
                // Whoever has just started can still take part in this tick.
                self.publish()?;
            }
        }
        Ok(())
    }

    /// Gives a sign of life, and sees that the run is still there.
    fn sign(&self) -> Result<(), SimError> {
        self.hold.sign();
        Ok(self.rendezvous.look_for_removal()?)
    }

    fn publish(&mut self) -> Result<(), SimError> {
        self.bed.expect(self.silent.iter().filter(|silent| !**silent).count());
        let time_s = self.world.time_s();
        self.worlds.send(self.tick, time_s, self.world.entries())?;
        self.robots.ring(Call::World);
        let truth = self.world.truth();
        let mut state = [0.0; STATE_DIM_MAX];
        state[..truth.len()].copy_from_slice(truth);
        let message = Truth {
            state_dim: truth.len() as u64,
            state,
            ticks: self.scenario.ticks,
            latency_ns: self.slowest_latency_ns,
        };
        self.truths.send(self.tick, time_s, &[message])?;
        Ok(())
    }

    fn take_drives(&mut self) -> Result<(), SimError> {
        let Self { tick, drives, silent, drives_in, .. } = self;
        drives_in.drain(|header, message| {
            let [drive] = message else { return };
            let Some(id) = usize::try_from(drive.robot).ok().filter(|_| header.tick == *tick) else { return };
            if let (Some(slot), Some(silent)) = (drives.get_mut(id), silent.get_mut(id)) {
                // Whatever speed and heading it says: the world moves nobody faster than he is, or by no number.
                *slot = Some(*drive);
                *silent = false;
            }
        })?;
        Ok(())
    }

    /// Puts the tick down, advances the world by what was driven, and makes a checkpoint of where it is
    /// then: before anybody is told.
    fn end_tick(&mut self) -> Result<(), SimError> {
        if let Some(log) = &mut self.log {
            let world = &self.world;
            let words =
                WorldRecord::to_words(world.time_s(), monotonic_ns(), world.truth(), world.entries(), &self.drives);
            if let Err(error) = log.write(self.tick, words) {
                log::warn!("goes on without a log: {error}");
                self.log = None;
            }
        }
        self.slowest_latency_ns = self.drives.iter().flatten().filter_map(Drive::latency_ns).max().unwrap_or(0);
        self.world.advance(&self.drives);
        self.drives.fill(None);
        self.tick += 1;
        self.save()
    }

    fn save(&mut self) -> Result<(), SimError> {
        self.world_bytes.clear();
        self.world.save(&mut self.world_bytes)?;
        let (silent, world) = (Cow::Borrowed(&self.silent[..]), Cow::Borrowed(&self.world_bytes[..]));
        let saved = Saved { tick: self.tick, silent, world };
        Checkpoint::write_or_give_up(&mut self.checkpoint, &saved);
        Ok(())
    }
}
