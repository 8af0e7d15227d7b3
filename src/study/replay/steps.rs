//! A fresh leading fusion, fed with the messages of the recorded one: pure, a frame in, an estimate out.

use std::collections::BTreeMap;

use rangehound_fusion::LATE_TICKS_MAX;
use rangehound_fusion::centre::Diverged;
use rangehound_fusion::leader::{Action, Leader};
use rangehound_fusion::planner::PlannerError;
use rangehound_shared::message::{Command, Estimate, Header, Range};
use rangehound_shared::record::Heard;
use rangehound_shared::scenario::Scenario;

use crate::results::frame::Frame;
use crate::results::run_mcap::read::Missing;

/// Why the replay cannot go on.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum StepError {
    /// A tick is not in the recording: all later estimates depend on it.
    #[error("{0} in the recording: no tick after it can be replayed")]
    Hole(Missing),
    /// The recording contains an impossible step of fusion.
    #[error(
        "a range of robot {robot} cannot have been taken at tick {taken_at}, in tick {tick}: the file is not a valid recording"
    )]
    InvalidTick {
        /// Tick of the range.
        tick: u64,
        /// The robot.
        robot: usize,
        /// The tick at which it was taken, according to the recording.
        taken_at: u64,
    },
    /// The replayed estimate diverged.
    #[error(transparent)]
    Diverged(#[from] Diverged),
}

/// A replay in progress.
#[derive(Debug)]
pub struct Steps {
    leader: Leader,
    dt_ns: u64,
    /// Late ranges as sent, by the tick at which they were taken.
    late: BTreeMap<u64, Vec<(Header, Range)>>,
    fed: Fed,
}

/// Number of messages that the replayed centre received.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Fed {
    /// In time, with a range.
    pub in_time: u64,
    /// Late, with a range.
    pub late: u64,
}

impl Steps {
    /// A replay before its first tick; the scenario may differ from the recorded one.
    ///
    /// # Errors
    /// [`PlannerError`] if its planner cannot serve its team.
    pub fn new(scenario: &Scenario) -> Result<Self, PlannerError> {
        let dt_ns = (scenario.dt_s * 1e9) as u64;
        Ok(Self { leader: Leader::new(scenario)?, dt_ns, late: BTreeMap::new(), fed: Fed::default() })
    }

    /// Replays a tick with the messages that the recorded centre had received.
    ///
    /// # Errors
    /// [`StepError`].
    pub fn step(&mut self, frame: &Frame) -> Result<Estimate, StepError> {
        let tick = self.leader.centre().next_tick();
        if frame.tick != tick {
            return Err(StepError::Hole(Missing::between(tick, frame.tick)));
        }
        let Self { leader, dt_ns, late, fed } = self;
        // Clock on which each tick begins in time.
        let now_ns = tick.saturating_add(1).saturating_mul(*dt_ns);
        for (header, range) in late.remove(&tick).unwrap_or_default() {
            leader.on_range(&header, &[range], now_ns);
        }
        let header = Header { tick, valid_at_s: frame.fusion.time_s, ..Header::default() };
        for (robot, exchange) in frame.fusion.exchanges.iter().enumerate() {
            let Some(Heard { measurement, taken_at, .. }) = exchange.heard else { continue };
            let range = Range { robot: robot as u64, measurement };
            if taken_at == tick {
                leader.on_range(&header, &[range], now_ns);
                fed.in_time += u64::from(measurement.kinds != 0);
            } else if (tick + 1..=tick.saturating_add(LATE_TICKS_MAX as u64)).contains(&taken_at) {
                late.entry(taken_at).or_default().push((header, range));
                fed.late += u64::from(measurement.kinds != 0);
            } else {
                return Err(StepError::InvalidTick { tick, robot, taken_at });
            }
        }
        leader.end_tick();
        while leader.next_action(now_ns)?.is_some_and(|action| action != Action::Record) {}
        // A replay cannot reproduce refusals and times.
        let &Estimate { late, refused, stages, .. } = &frame.fusion.estimate;
        Ok(Estimate { late, refused, stages, ..*leader.estimate() })
    }

    /// The commands of the replayed centre at the last tick.
    #[must_use]
    pub fn commands(&self) -> &[Command] {
        self.leader.centre().commands()
    }

    /// Messages fed so far.
    #[must_use]
    pub fn fed(&self) -> Fed {
        self.fed
    }
}

/// The first difference between a replayed and a recorded tick.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Difference {
    /// The tick.
    pub tick: u64,
    /// The quantity that differs.
    pub what: String,
    /// The recorded value.
    pub recorded: f64,
    /// The replayed value.
    pub replayed: f64,
}

/// The first number of a tick that differs in any bit: of state, covariance, headings; or the digest.
#[must_use]
pub fn difference(frame: &Frame, replayed: &Estimate, commands: &[Command]) -> Option<Difference> {
    let recorded = &frame.fusion.estimate;
    let n = recorded.state_dim as usize;
    let found = |what: String, recorded: f64, replayed: f64| {
        let differs = recorded.to_bits() != replayed.to_bits();
        differs.then_some(Difference { tick: frame.tick, what, recorded, replayed })
    };
    let states = recorded.state[..n].iter().zip(&replayed.state).enumerate();
    let covariances = recorded.covariance[..n * n].iter().zip(&replayed.covariance).enumerate();
    let headings = frame.fusion.exchanges.iter().zip(commands).enumerate().flat_map(|(robot, (exchange, command))| {
        let Command { heading_rad, speed_mps } = exchange.command;
        [
            (format!("heading_rad of robot {robot}"), heading_rad, command.heading_rad),
            (format!("speed_mps of robot {robot}"), speed_mps, command.speed_mps),
        ]
    });
    let mut numbers = states
        .map(|(i, (recorded, replayed))| (format!("state[{i}]"), *recorded, *replayed))
        .chain(covariances.map(|(i, (recorded, replayed))| (format!("covariance[{i}]"), *recorded, *replayed)))
        .chain(headings);
    let number = numbers.find_map(|(what, recorded, replayed)| found(what, recorded, replayed));
    number.or_else(|| {
        let what = "the digest, although all numbers are equal".to_owned();
        let difference = Difference { tick: frame.tick, what, recorded: f64::NAN, replayed: f64::NAN };
        (recorded.digest != replayed.digest).then_some(difference)
    })
}
