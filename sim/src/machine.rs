//! The simulator's part in the protocol as a state machine round a [`World`]: no clock, no port, no file.
//!
//! A driver feeds it with messages ([`Machine::on_drive`], [`Machine::on_hello`]), asks for the next [`Action`], carries it
//! out, and asks again until there is none. Nothing is fed in between. Time is an argument: monotonic, ns.

use std::borrow::Cow;

use rangehound_shared::STATE_DIM_MAX;
use rangehound_shared::message::{Drive, Truth};
use rangehound_shared::protocol::timing::Suspension;
use rangehound_shared::protocol::wake::{Event, Notification, WaitGroup};
use rangehound_shared::scenario::{Clock, Scenario, Timeout};
use rangehound_shared::sealed::SealError;
use serde::{Deserialize, Serialize};

use crate::World;

/// After this long without all answers the tick is sent again, in case messages were lost.
const REPEAT_NS: u64 = 50_000_000;

/// The driver's next action.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Action {
    /// Record the tick: [`Machine::world`] and [`Machine::drives`].
    Record,
    /// Write [`Machine::saved`] to the checkpoint, before all later actions.
    Save,
    /// Publish [`Machine::world`]'s entries.
    SendWorld,
    /// Publish [`Machine::truth`].
    SendTruth,
    /// Notify another node.
    Notify(Notification),
    /// Report that the run continues without a robot, which was silent for too long.
    ReportSilent(usize),
    /// Mark the run as finished.
    Finish,
}

/// The step after the last action.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// Saves before tick 0: after a kill between the first record and the first checkpoint a successor would find no state.
    Begin,
    Publish,
    Wake,
    PublishTruth,
    Wait,
    Advance,
    NextTick,
    NotifyRobots,
    NotifyFusion,
    Ended,
}

/// The simulator of a run, in one incarnation.
#[derive(Debug)]
pub struct Machine {
    clock: Clock,
    timeout: Timeout,
    dt_ns: u64,
    last_tick: u64,
    world: Box<dyn World>,
    tick: u64,
    drives: Vec<Option<Drive>>,
    /// True for robots that are not waited for, because they were silent for too long.
    silent: Vec<bool>,
    slowest_latency_ns: u64,
    phase: Phase,
    hello: bool,
    /// When the first answer to the tick came.
    first_answer_ns: Option<u64>,
    repeat_at_ns: u64,
    /// In real time, when the tick ends; `None` before the complete team has answered tick 0.
    due_ns: Option<u64>,
    suspension: Suspension,
    world_bytes: Vec<u8>,
}

/// State for a restarted simulator: borrowed for writing, owned after reading.
#[derive(Debug, Serialize, Deserialize)]
pub struct Saved<'a> {
    tick: u64,
    silent: Cow<'a, [bool]>,
    world: Cow<'a, [u8]>,
}

impl Machine {
    /// The simulator of a run before tick 0, round the world of the same scenario at tick 0.
    #[must_use]
    pub fn new(scenario: &Scenario, world: Box<dyn World>) -> Self {
        let robots = scenario.robots.len();
        Self {
            clock: scenario.clock,
            timeout: scenario.timeout,
            dt_ns: (scenario.dt_s * 1e9) as u64,
            last_tick: scenario.ticks,
            world,
            tick: 0,
            drives: vec![None; robots],
            silent: vec![false; robots],
            slowest_latency_ns: 0,
            phase: Phase::Begin,
            hello: false,
            first_answer_ns: None,
            repeat_at_ns: 0,
            due_ns: None,
            suspension: Suspension::default(),
            world_bytes: Vec::new(),
        }
    }

    /// Continues from the saved state of a simulator of the same run.
    ///
    /// # Errors
    /// If the state is invalid or belongs to another run.
    pub fn restore(&mut self, saved: Saved<'_>) -> Result<(), SealError> {
        let Saved { tick, silent, world } = saved;
        self.world.restore(&world)?;
        self.tick = tick;
        self.silent.fill(false);
        self.silent.iter_mut().zip(silent.iter()).for_each(|(mine, saved)| *mine = *saved);
        self.phase = if tick > self.last_tick { Phase::NextTick } else { Phase::Publish };
        Ok(())
    }

    /// State from which [`Self::restore`] continues.
    ///
    /// # Errors
    /// If the world cannot be encoded.
    pub fn saved(&mut self) -> Result<Saved<'_>, SealError> {
        self.world_bytes.clear();
        self.world.save(&mut self.world_bytes)?;
        Ok(Saved { tick: self.tick, silent: Cow::Borrowed(&self.silent), world: Cow::Borrowed(&self.world_bytes) })
    }

    /// Takes a message of the topic `drive`. The world limits speeds, and ignores NaN and infinite values.
    pub fn on_drive(&mut self, tick: u64, drive: &Drive) {
        let id = usize::try_from(drive.robot).ok().filter(|_| tick == self.tick);
        let Some(id) = id.filter(|id| *id < self.drives.len()) else { return };
        self.drives[id] = Some(*drive);
        self.silent[id] = false;
    }

    /// Takes the hello of a node that has just started and needs the present tick.
    pub fn on_hello(&mut self) {
        self.hello = true;
    }

    /// The next action; `None` until a message arrives or [`Self::wakes_at_ns`].
    pub fn next_action(&mut self, now_ns: u64) -> Option<Action> {
        let (phase, action) = match self.phase {
            Phase::Begin => (Phase::Publish, Action::Save),
            Phase::Publish => (Phase::Wake, Action::SendWorld),
            Phase::Wake => (Phase::PublishTruth, Action::Notify(Notification::always(WaitGroup::Robots, Event::World))),
            Phase::PublishTruth => {
                self.published(now_ns);
                (Phase::Wait, Action::SendTruth)
            }
            Phase::Wait => return self.wait(now_ns),
            Phase::Advance => {
                self.advance();
                (Phase::NextTick, Action::Save)
            }
            Phase::NextTick if self.tick > self.last_tick => (Phase::NotifyRobots, Action::Finish),
            Phase::NextTick => {
                self.begin_tick(now_ns);
                (Phase::Wake, Action::SendWorld)
            }
            Phase::NotifyRobots => {
                (Phase::NotifyFusion, Action::Notify(Notification::always(WaitGroup::Robots, Event::Finished)))
            }
            Phase::NotifyFusion => {
                (Phase::Ended, Action::Notify(Notification::always(WaitGroup::Fusion, Event::Finished)))
            }
            Phase::Ended => return None,
        };
        self.phase = phase;
        Some(action)
    }

    /// When it must act even if no message arrives, monotonic ns; `None` while it has something to do at once.
    #[must_use]
    pub fn wakes_at_ns(&self) -> Option<u64> {
        if self.phase != Phase::Wait {
            return None;
        }
        if self.due_ns.is_some() {
            return self.due_ns;
        }
        let timeout_ends_ns = match self.timeout() {
            Timeout::After(limit) => self.first_answer_ns.map(|first_ns| first_ns + limit.as_nanos() as u64),
            Timeout::Forever => None,
        };
        Some(timeout_ends_ns.map_or(self.repeat_at_ns, |ends_ns| ends_ns.min(self.repeat_at_ns)))
    }

    /// When the present real-time tick is over, monotonic ns: no message ends it earlier.
    #[must_use]
    pub fn due_ns(&self) -> Option<u64> {
        self.due_ns.filter(|_| self.phase == Phase::Wait)
    }

    /// True once there is nothing more to do.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.phase == Phase::Ended
    }

    /// The present tick.
    #[must_use]
    pub fn tick(&self) -> u64 {
        self.tick
    }

    /// The world at the present tick.
    #[must_use]
    pub fn world(&self) -> &dyn World {
        self.world.as_ref()
    }

    /// Each robot's drive message of the present tick.
    #[must_use]
    pub fn drives(&self) -> &[Option<Drive>] {
        &self.drives
    }

    /// How many robots the present tick waits for.
    #[must_use]
    pub fn expected(&self) -> usize {
        self.silent.iter().filter(|silent| !**silent).count()
    }

    /// The message for observers.
    #[must_use]
    pub fn truth(&self) -> Truth {
        let truth = self.world.truth();
        let mut state = [0.0; STATE_DIM_MAX];
        state[..truth.len()].copy_from_slice(truth);
        Truth { state_dim: truth.len() as u64, state, ticks: self.last_tick, latency_ns: self.slowest_latency_ns }
    }

    /// Tick 0 waits for the complete team, so that the run starts when all robots are there.
    fn timeout(&self) -> Timeout {
        if self.tick == 0 { Timeout::Forever } else { self.timeout }
    }

    /// After a suspension the simulator does not catch up: no burst of ticks, and no tick of zero length.
    fn begin_tick(&mut self, now_ns: u64) {
        if self.due_ns.is_some_and(|due_ns| due_ns <= now_ns) {
            self.due_ns = Some(now_ns + self.dt_ns);
        }
    }

    fn published(&mut self, now_ns: u64) {
        self.hello = false;
        self.repeat_at_ns = now_ns + REPEAT_NS;
        // A restarted simulator does not wait for the complete team.
        if self.clock == Clock::Realtime && self.tick > 0 {
            self.due_ns.get_or_insert(now_ns + self.dt_ns);
        }
    }

    fn wait(&mut self, now_ns: u64) -> Option<Action> {
        let suspended_ns = self.suspension.look(now_ns);
        self.first_answer_ns = self.first_answer_ns.map(|first_ns| first_ns + suspended_ns);
        if let Some(due_ns) = self.due_ns {
            if due_ns <= now_ns {
                self.due_ns = Some(due_ns + self.dt_ns);
                return self.end_tick();
            }
        } else if self.drives.iter().any(Option::is_some) {
            // Silence counts from the first answer of another robot: before that, fusion may have been waiting.
            let first_ns = *self.first_answer_ns.get_or_insert(now_ns);
            if let Some(id) = self.silent_for_too_long(now_ns.saturating_sub(first_ns)) {
                self.silent[id] = true;
                return Some(Action::ReportSilent(id));
            }
            if self.drives.iter().zip(&self.silent).all(|(drive, silent)| drive.is_some() || *silent) {
                if self.clock == Clock::Lockstep {
                    return self.end_tick();
                }
                self.due_ns = Some(now_ns + self.dt_ns);
            }
        }
        (self.hello || self.due_ns.is_none() && self.repeat_at_ns <= now_ns).then(|| {
            self.phase = Phase::Wake;
            Action::SendWorld
        })
    }

    /// A robot that is still waited for, and was silent for longer than the time-out.
    fn silent_for_too_long(&self, elapsed_ns: u64) -> Option<usize> {
        let Timeout::After(limit) = self.timeout() else { return None };
        let is_over = u128::from(elapsed_ns) >= limit.as_nanos();
        let waited_for = |(drive, silent): (&Option<Drive>, &bool)| drive.is_none() && !*silent;
        is_over.then(|| self.drives.iter().zip(&self.silent).position(waited_for)).flatten()
    }

    fn end_tick(&mut self) -> Option<Action> {
        self.phase = Phase::Advance;
        Some(Action::Record)
    }

    /// Advances the world by the driven commands.
    fn advance(&mut self) {
        self.slowest_latency_ns = self.drives.iter().flatten().filter_map(Drive::latency_ns).max().unwrap_or(0);
        self.world.advance(&self.drives);
        self.drives.fill(None);
        self.first_answer_ns = None;
        self.tick += 1;
    }
}

#[cfg(test)]
mod tests {
    use rangehound_shared::scenario::ScenarioFile;

    use super::*;

    /// Seed 10304 of `rangehound explore` found a tick of zero length.
    #[test]
    fn a_tick_that_begins_late_has_its_time() {
        let text = "clock = \"realtime\"\n[robots]\ncount = 1\n";
        let file = ScenarioFile::parse(text, "test").unwrap();
        let scenario = Scenario::from_file(&file, "test").unwrap();
        let world = crate::world_of(&scenario, |_| Err::<_, ()>(())).unwrap();
        let mut machine = Machine::new(&scenario, world);
        let dt_ns = (scenario.dt_s * 1e9) as u64;
        let mut began_ns = Vec::new();
        let mut go_on = |machine: &mut Machine, now_ns: u64| {
            while let Some(action) = machine.next_action(now_ns) {
                if action == Action::SendWorld && began_ns.len() as u64 == machine.tick() {
                    began_ns.push(now_ns);
                }
                if action == Action::Record && machine.tick() == 1 {
                    // It is stopped on the way to tick 2.
                    return;
                }
            }
        };
        go_on(&mut machine, 0);
        machine.on_drive(0, &Drive::default());
        go_on(&mut machine, 0);
        go_on(&mut machine, dt_ns);
        go_on(&mut machine, 2 * dt_ns);
        let late_ns = 4 * dt_ns;
        for now_ns in [late_ns, late_ns + dt_ns / 2, late_ns + dt_ns] {
            go_on(&mut machine, now_ns);
        }
        assert_eq!(began_ns, [0, dt_ns, late_ns, late_ns + dt_ns]);
    }
}
