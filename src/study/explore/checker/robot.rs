//! The messages to a robot and its actions.

use std::collections::HashMap;

use rangehound_shared::message::Command;
use rangehound_shared::scenario::{Clock, Scenario};

/// Number of received headings that are remembered.
const REMEMBERED: usize = 16;

/// Ticks for which a heading is held after its own tick.
const HELD_TICKS: u64 = 3;

/// Part of a tick after which a robot goes on without a heading.
const HEADING_DEADLINE: f64 = 0.8;

/// The actions of one robot, in all its processes.
#[derive(Debug, Default)]
pub(in crate::study::explore) struct RobotHistory {
    /// The command that it obeyed at each tick.
    obeyed: HashMap<u64, Command>,
    /// The greatest incarnation of fusion whose command it carried out.
    newest_obeyed: u64,
}

/// The messages to one process of a robot, and its pending actions.
#[derive(Debug, Clone)]
pub(in crate::study::explore) struct RobotChecker {
    is_realtime: bool,
    dt_ns: f64,
    /// Greatest incarnation of fusion that it knows.
    fusion_incarnation: u64,
    /// The newest headings that reached it from the newest fusion that it knew.
    valid: Vec<Heading>,
    /// Incarnation of the simulator whose world it received last.
    sim_incarnation: u64,
    newest_tick: Option<(u64, u64)>,
    /// When it saw the newest tick, ns; `None` once it has decided what to drive.
    undecided_since_ns: Option<u64>,
    /// When it saw the newest tick, ns, if it is moving.
    moves_since_ns: Option<u64>,
    seen_ns: u64,
    obeyed: Option<u64>,
    /// The heading that it obeyed last, with its tick.
    held: Option<(u64, Command)>,
    /// The command that the actuator carried out, until it is reported.
    carried: Option<Command>,
    /// The newest tick for which it has reported what it drives without a heading, and the command.
    provided: Option<(u64, Command)>,
    /// The tick of the heading that it reported last, and when it took it, by its own clock.
    reported_held: (u64, u64),
}

#[derive(Debug, Clone, Copy)]
struct Heading {
    incarnation: u64,
    tick: u64,
    command: Command,
}

impl RobotHistory {
    /// The run was resumed: its incarnations count from the beginning.
    pub(in crate::study::explore) fn starts_anew(&mut self) {
        self.newest_obeyed = 0;
    }
}

impl RobotChecker {
    /// A robot that starts, and knows this incarnation of fusion.
    pub(in crate::study::explore) fn new(scenario: &Scenario, fusion_incarnation: u64) -> Self {
        Self {
            is_realtime: scenario.clock == Clock::Realtime,
            dt_ns: scenario.dt_s * 1e9,
            fusion_incarnation,
            valid: Vec::new(),
            sim_incarnation: 0,
            newest_tick: None,
            undecided_since_ns: None,
            moves_since_ns: None,
            seen_ns: 0,
            obeyed: None,
            held: None,
            carried: None,
            provided: None,
            reported_held: (0, 0),
        }
    }

    /// A heading reaches the robot.
    pub(in crate::study::explore) fn heading(&mut self, incarnation: u64, tick: u64, command: Command) {
        if incarnation >= self.fusion_incarnation {
            self.fusion_incarnation = incarnation;
            if self.valid.len() == REMEMBERED {
                self.valid.remove(0);
            }
            self.valid.push(Heading { incarnation, tick, command });
        }
    }

    /// A world of this incarnation of the simulator reaches the robot.
    pub(in crate::study::explore) fn world(&mut self, incarnation: u64) {
        self.sim_incarnation = incarnation;
    }

    /// The robot wakes up, after it has taken part for `well_for_ns`: in real time it must have decided if a heading
    /// was overdue.
    pub(in crate::study::explore) fn wakes(&self, now_ns: u64, well_for_ns: u64, late_ns: u64) -> Result<(), String> {
        let is_overdue = |since_ns: u64| {
            let waited_ns = now_ns - since_ns;
            well_for_ns > waited_ns && waited_ns as f64 > HEADING_DEADLINE * self.dt_ns + late_ns as f64
        };
        if self.is_realtime
            && self.newest_tick.is_some_and(|(_, tick)| tick > 0)
            && self.undecided_since_ns.is_some_and(is_overdue)
        {
            return Err("it waited for its heading beyond the deadline".to_owned());
        }
        Ok(())
    }

    /// The robot falls asleep: in real time it must have reported what it drives without a heading, and it must not
    /// keep moving without ticks.
    pub(in crate::study::explore) fn sleeps(&self, now_ns: u64, late_ns: u64) -> Result<(), String> {
        let tick = self.newest_tick.map(|(_, tick)| tick).filter(|tick| self.is_realtime && *tick > 0);
        if tick.is_some() && self.undecided_since_ns.is_some() && self.provided.map(|(provided, _)| provided) != tick {
            return Err("it sleeps and has not reported what it drives without a heading".to_owned());
        }
        let longest_ns = (HELD_TICKS + 1) as f64 * self.dt_ns + late_ns as f64;
        if self.is_realtime && self.moves_since_ns.is_some_and(|since_ns| (now_ns - since_ns) as f64 > longest_ns) {
            return Err("it moves though no tick comes any more".to_owned());
        }
        Ok(())
    }

    /// The robot measures: once a tick, for the newest simulator.
    pub(in crate::study::explore) fn measures(&mut self, tick: u64, now_ns: u64) -> Result<(), String> {
        let newest = (self.sim_incarnation, tick);
        if self.newest_tick.is_some_and(|before| before >= newest) {
            return Err(format!("it went back to tick {tick}"));
        }
        self.newest_tick = Some(newest);
        self.undecided_since_ns = Some(now_ns);
        self.seen_ns = now_ns;
        self.moves_since_ns = self.moves_since_ns.map(|_| now_ns);
        self.obeyed = None;
        Ok(())
    }

    /// Its actuator carries out a command. If it stops because no tick has come for long, it may forget the heading that it
    /// held.
    pub(in crate::study::explore) fn carries_out(&mut self, command: Command, now_ns: u64, late_ns: u64) {
        let silent_ns = (now_ns - self.seen_ns + late_ns) as f64;
        if command == Command::default() && silent_ns >= (HELD_TICKS + 1) as f64 * self.dt_ns {
            self.held = None;
        }
        self.moves_since_ns = (command != Command::default()).then_some(self.seen_ns);
        self.undecided_since_ns = None;
        self.carried = Some(command);
    }

    /// The robot reports what it drives; true if it obeys a heading that it has not obeyed before.
    pub(in crate::study::explore) fn drives(
        &mut self,
        history: &mut RobotHistory,
        tick: u64,
        command: Command,
        held_ns: u64,
    ) -> Result<bool, String> {
        let carried = self.carried.take();
        if held_ns == 0 {
            let held = self.held.filter(|(held, _)| self.is_realtime && tick - held <= HELD_TICKS);
            let is_held = command == held.map_or(Command::default(), |(_, command)| command);
            // It may repeat a report after it has forgotten the heading.
            let is_repeat = self.provided.replace((tick, command)) == Some((tick, command));
            return if !self.is_realtime || tick == 0 {
                Err(format!("it drove at tick {tick} without a heading"))
            } else if !is_held && !is_repeat {
                Err(format!("without a heading for tick {tick} it neither held the last one nor stood"))
            } else {
                Ok(false)
            };
        }
        let is_repeat = std::mem::replace(&mut self.reported_held, (tick, held_ns)) == (tick, held_ns);
        if is_repeat && carried.is_none_or(|carried| carried != command || carried == Command::default()) {
            return Ok(false);
        }
        if self.obeyed.replace(tick) == Some(tick) {
            return Err(format!("it obeyed two headings at tick {tick}"));
        }
        let is_it = |heading: &&Heading| heading.tick == tick && heading.command == command;
        let newest = self.valid.iter().filter(is_it).map(|heading| heading.incarnation).max();
        let Some(incarnation) = newest else {
            return Err(format!("it obeyed a heading for tick {tick} of a fusion that was deposed"));
        };
        if incarnation < history.newest_obeyed {
            let newer = history.newest_obeyed;
            return Err(format!("it obeyed incarnation {incarnation} of fusion after incarnation {newer}"));
        }
        history.newest_obeyed = incarnation;
        if *history.obeyed.entry(tick).or_insert(command) != command {
            return Err(format!("it obeyed two different headings for tick {tick}"));
        }
        self.held = Some((tick, command));
        Ok(true)
    }
}
