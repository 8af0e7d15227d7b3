//! The invariants, checked as a team goes on: what each node does is told to the witness.

use std::collections::HashMap;

use rangehound_fusion::leader::Leader;
use rangehound_shared::message::{Command, Estimate, Range, WorldEntry};
use rangehound_shared::record::RangeUse;

/// All that has been seen of a team.
#[derive(Debug, Default)]
pub(super) struct Witness {
    /// Digests of the undisturbed run by tick, where the run must have the same.
    undisturbed: Option<std::rc::Rc<Vec<[u64; 2]>>>,
    worlds: HashMap<u64, Vec<WorldEntry>>,
    newest_world: u64,
    /// What each robot said first of each tick.
    ranges: HashMap<(u64, u64), Range>,
    digests: HashMap<u64, [u64; 2]>,
    last_estimate: Option<u64>,
    headings: HashMap<u64, Vec<Command>>,
    newest_headings: u64,
    /// At which tick a robot's range of a tick was fused.
    fused: HashMap<(usize, u64), u64>,
}

/// What one process of a robot has been told.
#[derive(Debug, Clone, Default)]
pub(super) struct RobotWitness {
    /// Greatest incarnation of fusion that it knows of.
    fusion_incarnation: u64,
    /// The newest headings that it was told by whoever led, by tick.
    valid: Vec<(u64, Command)>,
    /// Of the simulator whose world was heard last.
    sim_incarnation: u64,
    newest_tick: Option<(u64, u64)>,
    obeyed: Option<u64>,
}

/// Headings that are remembered of those that a robot was told.
const REMEMBERED: usize = 8;

impl Witness {
    /// A witness that knows the digests by tick of the undisturbed run, where the run must have the same.
    pub(super) fn new(undisturbed: Option<std::rc::Rc<Vec<[u64; 2]>>>) -> Self {
        Self { undisturbed, ..Self::default() }
    }

    /// The simulator publishes a tick.
    pub(super) fn world(&mut self, tick: u64, entries: &[WorldEntry]) -> Result<(), String> {
        if tick < self.newest_world {
            return Err(format!("sim went back from tick {} to {tick}", self.newest_world));
        }
        self.newest_world = tick;
        let first = self.worlds.entry(tick).or_insert_with(|| entries.to_vec());
        if first != entries { Err(format!("two worlds of tick {tick}")) } else { Ok(()) }
    }

    /// A robot publishes its range.
    pub(super) fn range(&mut self, tick: u64, range: &Range) -> Result<(), String> {
        let said = Range { tick_began_ns: 0, ..*range };
        let first = self.ranges.entry((range.robot, tick)).or_insert(said);
        if *first != said { Err(format!("robot-{} measured twice at tick {tick}", range.robot)) } else { Ok(()) }
    }

    /// Whoever leads publishes headings.
    pub(super) fn headings(&mut self, tick: u64, commands: &[Command], is_current: bool) -> Result<(), String> {
        if is_current {
            if tick < self.newest_headings {
                return Err(format!("fusion went back from tick {} to {tick}", self.newest_headings));
            }
            self.newest_headings = tick;
        }
        let first = self.headings.entry(tick).or_insert_with(|| commands.to_vec());
        if first != commands { Err(format!("two different headings for tick {tick}")) } else { Ok(()) }
    }

    /// Whoever leads publishes an estimate.
    pub(super) fn estimate(&mut self, tick: u64, estimate: &Estimate) -> Result<(), String> {
        if *self.digests.entry(tick).or_insert(estimate.digest) != estimate.digest {
            return Err(format!("two different estimates of tick {tick}"));
        }
        match self.undisturbed.as_ref().and_then(|digests| digests.get(tick as usize)) {
            Some(digest) if *digest != estimate.digest => {
                Err(format!("the digest of tick {tick} is not that of the undisturbed run"))
            }
            _ => Ok(()),
        }
    }

    /// Whoever leads records a tick: each range is one that was measured, and fused once.
    pub(super) fn record(&mut self, tick: u64, leader: &Leader) -> Result<(), String> {
        self.estimate(tick, leader.estimate())?;
        self.last_estimate = self.last_estimate.max(Some(tick));
        let in_time =
            leader.exchanges().enumerate().filter_map(|(robot, exchange)| Some((robot, tick, exchange.heard?)));
        let late = leader.late_reports().iter().map(|late| (late.robot, late.tick, late.heard_at(tick)));
        for (robot, range_tick, heard) in in_time.chain(late) {
            let measured = self.ranges.get(&(robot as u64, range_tick)).ok_or_else(|| {
                format!("a range of robot-{robot} was taken at tick {tick} that it never measured at tick {range_tick}")
            })?;
            if heard.measurement != measured.measurement {
                return Err(format!("the range of robot-{robot} at tick {range_tick} was taken for another tick's"));
            }
            if heard.judged.is_some_and(|judged| judged.used == RangeUse::Fused)
                && *self.fused.entry((robot, range_tick)).or_insert(tick) != tick
            {
                return Err(format!("the range of robot-{robot} at tick {range_tick} was fused twice"));
            }
        }
        Ok(())
    }

    /// The last tick whose estimate has been recorded, if any has.
    pub(super) fn last_estimate(&self) -> Option<u64> {
        self.last_estimate
    }
}

impl RobotWitness {
    /// A robot that starts and knows of this incarnation of fusion.
    pub(super) fn new(fusion_incarnation: u64) -> Self {
        Self { fusion_incarnation, ..Self::default() }
    }

    /// A heading reaches the robot.
    pub(super) fn heading(&mut self, incarnation: u64, tick: u64, command: Command) {
        if incarnation >= self.fusion_incarnation {
            self.fusion_incarnation = incarnation;
            if self.valid.len() == REMEMBERED {
                self.valid.remove(0);
            }
            self.valid.push((tick, command));
        }
    }

    /// A world of this incarnation of the simulator reaches the robot.
    pub(super) fn world(&mut self, incarnation: u64) {
        self.sim_incarnation = incarnation;
    }

    /// The robot asks its sensor: once a tick, of the newest simulator.
    pub(super) fn measures(&mut self, tick: u64) -> Result<(), String> {
        let newest = (self.sim_incarnation, tick);
        if self.newest_tick.is_some_and(|before| before >= newest) {
            return Err(format!("it went back to tick {tick}"));
        }
        self.newest_tick = Some(newest);
        self.obeyed = None;
        Ok(())
    }

    /// The robot drives by a heading of its tick.
    pub(super) fn obeys(&mut self, tick: u64, command: Command) -> Result<(), String> {
        if self.obeyed.replace(tick) == Some(tick) {
            return Err(format!("it obeyed two headings at tick {tick}"));
        }
        if !self.valid.contains(&(tick, command)) {
            return Err(format!("it obeyed a heading for tick {tick} of a fusion that was deposed"));
        }
        Ok(())
    }
}
