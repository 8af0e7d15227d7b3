//! The invariants, checked during an exploration: every action of a node is reported to the checker.
//!
//! | module | what |
//! |---|---|
//! | this one | worlds, ranges, headings and estimates: there is one of each for a tick |
//! | `robot` | which headings robots obey, hold and drive |
//! | `link` | what a gateway sends robots on other hosts, and publishes for them |
//! | `timing` | when ticks begin and end, and which robots they wait for |
//! | `succession` | when a standby takes the lead |
//! | `supervision` | which nodes the supervisor kills, starts and gives up |

pub(super) mod link;
pub(super) mod robot;
pub(super) mod succession;
pub(super) mod supervision;
pub(super) mod timing;

use std::collections::HashMap;
use std::rc::Rc;

use rangehound_fusion::leader::Leader;
use rangehound_shared::message::{Command, Drive, Estimate, Range, Refusal, WorldEntry};
use rangehound_shared::record::FusionDecision;
use rangehound_shared::scenario::{Clock, Scenario, Timeout};

use super::plan::Plan;
use link::Reports;
use robot::RobotHistory;
use timing::{Missing, Timing};

/// All that has been observed of a team.
#[derive(Debug)]
pub(super) struct Checker {
    /// Digests of the undisturbed run by tick.
    undisturbed: Rc<Vec<[u64; 2]>>,
    /// The last tick up to which no robot was missing and all robots obeyed: up to it the run must equal the
    /// undisturbed one.
    complete_until: u64,
    is_realtime: bool,
    /// The simulator has recorded a tick.
    has_drives: bool,
    /// Robots without which the simulator goes on.
    is_left_out: Vec<bool>,
    /// True if no robot is ever left out.
    waits_for_all: bool,
    /// Causes for which messages may be refused.
    may_refuse: [bool; Refusal::ALL.len()],
    /// The robots' actions.
    pub(super) robots: Vec<RobotHistory>,
    /// The messages from robots on other hosts.
    pub(super) links: Reports,
    /// When ticks began and ended.
    pub(super) timing: Timing,
    /// The last tick at which each robot reported in time.
    heard_at: Vec<Option<u64>>,
    worlds: HashMap<u64, Vec<WorldEntry>>,
    newest_world: u64,
    /// The ranges of each robot and tick: one, unless robots measure anew.
    ranges: HashMap<(u64, u64), Vec<Range>>,
    measures_anew: bool,
    digests: HashMap<u64, [u64; 2]>,
    last_estimate: Option<u64>,
    headings: HashMap<u64, Vec<Command>>,
    newest_headings: Option<u64>,
    /// The tick at which a robot's range of a tick was fused.
    fused: HashMap<(usize, u64), u64>,
}

impl Checker {
    /// A checker with the digests by tick of the undisturbed run.
    pub(super) fn new(scenario: &Scenario, undisturbed: Rc<Vec<[u64; 2]>>, plan: &Plan) -> Self {
        let robots = scenario.robots.len();
        let is_realtime = scenario.clock == Clock::Realtime;
        let mut may_refuse = [plan.network.garbled > 0.0; Refusal::ALL.len()];
        // With different clocks a tick may come before its time.
        may_refuse[Refusal::Future as usize] |= !plan.has_one_rate();
        Self {
            // If robots measure anew, the run differs from the undisturbed one.
            undisturbed: if plan.measures_anew { Rc::default() } else { undisturbed },
            complete_until: u64::MAX,
            is_realtime,
            has_drives: false,
            is_left_out: vec![false; robots],
            waits_for_all: !is_realtime && scenario.timeout == Timeout::Forever,
            may_refuse,
            robots: (0..robots).map(|_| RobotHistory::default()).collect(),
            links: Reports::default(),
            timing: Timing::new(scenario),
            heard_at: vec![None; robots],
            worlds: HashMap::new(),
            newest_world: 0,
            ranges: HashMap::new(),
            measures_anew: plan.measures_anew,
            digests: HashMap::new(),
            last_estimate: None,
            headings: HashMap::new(),
            newest_headings: None,
            fused: HashMap::new(),
        }
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
        let ranges = self.ranges.entry((range.robot, tick)).or_default();
        if !ranges.contains(range) {
            ranges.push(*range);
        }
        if ranges.len() > 1 && !self.measures_anew {
            return Err(format!("robot-{} measured twice at tick {tick}", range.robot));
        }
        Ok(())
    }

    /// A fusion publishes headings.
    pub(super) fn headings(&mut self, tick: u64, commands: &[Command], is_current: bool) -> Result<(), String> {
        if is_current {
            if let Some(newest) = self.newest_headings.filter(|newest| tick < *newest) {
                return Err(format!("fusion went back from tick {newest} to {tick}"));
            }
            self.newest_headings = Some(tick);
        }
        let first = self.headings.entry(tick).or_insert_with(|| commands.to_vec());
        if first != commands { Err(format!("two different headings for tick {tick}")) } else { Ok(()) }
    }

    /// A fusion publishes an estimate.
    pub(super) fn estimate(&mut self, tick: u64, estimate: &Estimate) -> Result<(), String> {
        if *self.digests.entry(tick).or_insert(estimate.digest) != estimate.digest {
            return Err(format!("two different estimates of tick {tick}"));
        }
        let refused = estimate.refused.iter().zip(self.may_refuse).zip(Refusal::ALL);
        match refused.into_iter().find(|((count, may), _)| **count > 0 && !may) {
            Some((_, refusal)) => Err(format!("a valid range was refused at tick {tick}: {}", refusal.name())),
            None => Ok(()),
        }
    }

    /// The simulator ends a tick with the robots' drives.
    pub(super) fn drives(&mut self, tick: u64, drives: &[Option<Drive>]) -> Result<(), String> {
        self.has_drives = true;
        for (robot, drive) in drives.iter().enumerate() {
            if drive.is_none() && !self.is_realtime && !self.is_left_out[robot] {
                return Err(format!("sim did not wait for robot-{robot} at tick {tick}"));
            }
            self.is_left_out[robot] &= drive.is_none();
        }
        let is_complete = drives.iter().all(|drive| drive.is_some_and(|drive| drive.heading_held_ns != 0));
        if !is_complete {
            self.complete_until = self.complete_until.min(tick);
        }
        Ok(())
    }

    /// The simulator goes on without a robot until that robot sends a message.
    pub(super) fn leaves_out(&mut self, robot: usize) {
        self.is_left_out[robot] = true;
    }

    /// True if the simulator has recorded a tick.
    pub(super) fn has_drives(&self) -> bool {
        self.has_drives
    }

    /// A fusion records a tick: each range must have been measured, and is fused once. Returns which robots are
    /// missing. `is_calm` is true for robots without a recent fault.
    pub(super) fn record(
        &mut self,
        tick: u64,
        leader: &Leader,
        is_calm: impl Fn(usize) -> bool,
    ) -> Result<Missing, String> {
        self.estimate(tick, leader.estimate())?;
        let next = self.last_estimate.map_or(0, |last| last + 1);
        if tick > next {
            return Err(format!("tick {next} was never recorded"));
        }
        self.last_estimate = self.last_estimate.max(Some(tick));
        let missing = self.hear(tick, leader, is_calm)?;
        let digest = self.undisturbed.get(tick as usize).filter(|_| tick <= self.complete_until);
        if digest.is_some_and(|digest| *digest != leader.estimate().digest) {
            return Err(format!("the digest of tick {tick} is not that of the undisturbed run"));
        }
        self.check_ranges(tick, leader)?;
        Ok(missing)
    }

    /// Records which robots reported in time.
    fn hear(&mut self, tick: u64, leader: &Leader, is_calm: impl Fn(usize) -> bool) -> Result<Missing, String> {
        let mut missing = Missing::Nobody;
        for (robot, exchange) in leader.exchanges().enumerate() {
            if exchange.heard.is_some() {
                self.heard_at[robot] = self.heard_at[robot].max(Some(tick));
                continue;
            }
            if self.waits_for_all || is_calm(robot) {
                return Err(format!("tick {tick} went on without robot-{robot}"));
            }
            self.complete_until = self.complete_until.min(tick.saturating_sub(1));
            // After this many misses in a row a tick no longer waits for the robot.
            let misses_max = if self.is_realtime { 3 } else { 1 };
            let is_new =
                tick == 0 || self.heard_at[robot].is_some_and(|heard| heard < tick && heard + misses_max >= tick);
            missing = missing.max(if is_new { Missing::Another } else { Missing::AsBefore });
        }
        Ok(missing)
    }

    fn check_ranges(&mut self, tick: u64, leader: &Leader) -> Result<(), String> {
        let in_time =
            leader.exchanges().enumerate().filter_map(|(robot, exchange)| Some((robot, tick, exchange.heard?)));
        let late = leader.late_reports().iter().map(|late| (late.robot, late.tick, late.heard_at(tick)));
        for (robot, range_tick, heard) in in_time.chain(late) {
            let measured = self.ranges.get(&(robot as u64, range_tick)).ok_or_else(|| {
                format!("a range of robot-{robot} was taken at tick {tick} that it never measured at tick {range_tick}")
            })?;
            if measured.iter().all(|range| range.measurement != heard.measurement) {
                return Err(format!("the range of robot-{robot} at tick {range_tick} was taken for another tick's"));
            }
            if heard.judged.iter().flatten().any(|judged| judged.used == FusionDecision::Fused)
                && *self.fused.entry((robot, range_tick)).or_insert(tick) != tick
            {
                return Err(format!("the range of robot-{robot} at tick {range_tick} was fused twice"));
            }
        }
        Ok(())
    }

    /// The simulator's newest tick.
    pub(super) fn newest_world(&self) -> u64 {
        self.newest_world
    }

    /// The newest tick whose headings have been published, if any have.
    pub(super) fn newest_headings(&self) -> Option<u64> {
        self.newest_headings
    }

    /// True if so far no robot was missing, and all robots obeyed.
    pub(super) fn is_complete(&self) -> bool {
        self.complete_until == u64::MAX
    }

    /// The last tick whose estimate has been recorded, if any has.
    pub(super) fn last_estimate(&self) -> Option<u64> {
        self.last_estimate
    }
}
