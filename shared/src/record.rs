//! What fusion and simulator put down of each tick, as words of fixed width.

use crate::message::{Command, Drive, Estimate, RangeKind, Refusal, Stages, WorldEntry};
use crate::robot_set;
use crate::scenario::Scenario;
use serde::{Deserialize, Serialize};

/// Fusion's words of one tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EstimateRecord {
    /// Time that the estimate is valid for, s.
    pub time_s: f64,
    /// The estimate and its tallies.
    pub estimate: Estimate,
}

/// Fusion's part with one robot at one tick.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Exchange {
    /// What it took from the robot's message of this tick, if one came in time to be used.
    pub heard: Option<Heard>,
    /// What it told the robot.
    pub command: Command,
}

/// What fusion took from a robot's message.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Heard {
    /// Where the robot was, m.
    pub position_m: [f64; 2],
    /// Height of its sensor above the plane in which the target moves, m.
    pub height_m: f64,
    /// Its range and the range's standard deviation, m; `None` if its sensor had none.
    pub range_m: Option<(f64, f64)>,
    /// The first tick whose estimate knows of it: the message's own, or a later one if it came late.
    pub taken_at: u64,
    /// What fusion did with the range; `None` without one, and at tick 0.
    pub judged: Option<Judged>,
}

/// What fusion did with a range, and how well the range agreed with what was predicted of it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Judged {
    /// What was done with it.
    pub used: RangeUse,
    /// Its own normalised innovation squared, `nu^2 / S`: one degree of freedom. `None` where nothing was known that
    /// could predict it.
    pub normalised_square: Option<f64>,
}

/// What fusion did with a range.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum RangeUse {
    /// It was fused.
    Fused,
    /// It failed the gate.
    Rejected,
    /// Its robot was distrusted.
    Distrusted,
}

impl RangeUse {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Fused, Self::Rejected, Self::Distrusted];

    /// What it is called in recordings.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Fused => "fused",
            Self::Rejected => "rejected",
            Self::Distrusted => "distrusted",
        }
    }
}

/// The simulator's words of one tick.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct WorldRecord {
    /// Time of the tick, s.
    pub time_s: f64,
    /// When the tick was over, monotonic ns.
    pub ended_ns: u64,
    /// The target's true state; empty for a recording.
    pub truth: Vec<f64>,
    /// Each robot's part in the tick.
    pub robots: Vec<RobotRecord>,
}

/// One robot's part in one tick.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RobotRecord {
    /// Where it was, m.
    pub position_m: [f64; 2],
    /// Height of its sensor above the plane in which the target moves, m.
    pub height_m: f64,
    /// What the world told its sensor, m, if anything: the true range, or a recorded one.
    pub range_m: Option<f64>,
    /// When it published its range, monotonic ns, if its sensor had one.
    pub range_sent_ns: Option<u64>,
    /// When it held the tick's heading, monotonic ns, if it did.
    pub heading_held_ns: Option<u64>,
    /// What it drove by.
    pub heading: Heading,
    /// What it drove; standing if it did not answer.
    pub driven: Command,
    /// Headings that it refused, since the tick before.
    pub headings_refused: u64,
}

impl RobotRecord {
    /// From publishing the range to holding the heading computed from it, ns; `None` without either.
    #[must_use]
    pub fn latency_ns(&self) -> Option<u64> {
        self.heading_held_ns?.checked_sub(self.range_sent_ns?)
    }
}

/// What a robot drove by in one tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Heading {
    /// Nothing is known: it did not answer.
    #[default]
    Unknown,
    /// This tick's heading.
    Fresh,
    /// This tick's heading, which came when it was overdue.
    Late,
    /// None for this tick: it held the last one, or stood.
    None,
}

impl Heading {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Unknown, Self::Fresh, Self::Late, Self::None];

    fn of(drive: Option<Drive>) -> Self {
        match drive {
            None => Self::Unknown,
            Some(drive) if drive.heading_held_ns == 0 => Self::None,
            Some(drive) if drive.heading_late != 0 => Self::Late,
            Some(_) => Self::Fresh,
        }
    }
}

impl EstimateRecord {
    /// Words before the state: single ones, then those of `refused` and `distrusted`.
    const TALLIES: usize = Self::SINGLE_WORDS + Refusal::ALL.len() + robot_set::WORDS;

    const SINGLE_WORDS: usize = 22;

    /// Words of the part with one robot: what was heard, and the command.
    const WORDS_PER_ROBOT: usize = Self::WORDS_HEARD + 2;
    const WORDS_HEARD: usize = 8;

    /// Words before the parts with the robots.
    fn words_of_estimate(state_dim: usize) -> usize {
        Self::TALLIES + state_dim + state_dim * state_dim
    }

    /// Words of a tick.
    #[must_use]
    pub fn words(scenario: &Scenario) -> usize {
        Self::words_of_estimate(scenario.motion.state_dim()) + Self::WORDS_PER_ROBOT * scenario.robots.len()
    }

    /// The record as words, with the parts with all robots in the order of their ids.
    pub fn to_words(&self, exchanges: impl IntoIterator<Item = Exchange>) -> impl Iterator<Item = u64> {
        let e = &self.estimate;
        let n = e.state_dim as usize;
        let tallies = [
            self.time_s.to_bits(),
            e.nis.to_bits(),
            e.fused,
            e.rejected,
            e.missing,
            e.late,
            e.objective.to_bits(),
            e.lower_bound.to_bits(),
            e.digest[0],
            e.digest[1],
            e.fused_late,
            e.rejected_late,
            e.stages.last_range_ns,
            e.stages.began_ns,
            e.stages.filtered_ns,
            e.stages.planned_ns,
            e.stages.saved_ns,
            e.stages.sent_ns,
            e.nis_all.to_bits(),
            e.tested,
            e.noise_scale.to_bits(),
            e.least_trace_m2.to_bits(),
        ];
        let numbers = e.state[..n].iter().chain(&e.covariance[..n * n]).map(|value| value.to_bits());
        let robots = exchanges.into_iter().flat_map(|Exchange { heard, command }| {
            let heard = heard.map_or([0; Self::WORDS_HEARD], Heard::to_words);
            heard.into_iter().chain([command.heading_rad.to_bits(), command.speed_mps.to_bits()])
        });
        tallies.into_iter().chain(e.refused).chain(e.distrusted).chain(numbers).chain(robots)
    }

    /// Where in the words of a tick that begin which are of what was heard of a robot.
    #[must_use]
    pub fn heard_at(scenario: &Scenario, robot: usize) -> usize {
        Self::words_of_estimate(scenario.motion.state_dim()) + Self::WORDS_PER_ROBOT * robot
    }

    /// The parts with all robots, in the order of their ids, in words that [`Self::to_words`] made.
    pub fn exchanges(words: &[u64], state_dim: usize) -> impl Iterator<Item = Exchange> {
        let robots = words.get(Self::words_of_estimate(state_dim)..).unwrap_or_default();
        robots.as_chunks::<{ Self::WORDS_PER_ROBOT }>().0.iter().map(|[heard @ .., heading, speed]| Exchange {
            heard: Heard::from_words(*heard),
            command: Command { heading_rad: f64::from_bits(*heading), speed_mps: f64::from_bits(*speed) },
        })
    }

    /// The record in words that [`Self::to_words`] made, for a state of this dimension.
    #[must_use]
    pub fn from_words(words: &[u64], state_dim: usize) -> Self {
        let word = |index: usize| words.get(index).copied().unwrap_or(0);
        let mut estimate = Estimate {
            state_dim: state_dim as u64,
            nis: f64::from_bits(word(1)),
            fused: word(2),
            rejected: word(3),
            missing: word(4),
            late: word(5),
            objective: f64::from_bits(word(6)),
            lower_bound: f64::from_bits(word(7)),
            digest: [word(8), word(9)],
            fused_late: word(10),
            rejected_late: word(11),
            stages: Stages {
                last_range_ns: word(12),
                began_ns: word(13),
                filtered_ns: word(14),
                planned_ns: word(15),
                saved_ns: word(16),
                sent_ns: word(17),
            },
            nis_all: f64::from_bits(word(18)),
            tested: word(19),
            noise_scale: f64::from_bits(word(20)),
            least_trace_m2: f64::from_bits(word(21)),
            refused: std::array::from_fn(|i| word(Self::SINGLE_WORDS + i)),
            distrusted: std::array::from_fn(|i| word(Self::SINGLE_WORDS + Refusal::ALL.len() + i)),
            ..Estimate::default()
        };
        for (i, value) in estimate.state.iter_mut().take(state_dim).enumerate() {
            *value = f64::from_bits(word(Self::TALLIES + i));
        }
        for (i, value) in estimate.covariance.iter_mut().take(state_dim * state_dim).enumerate() {
            *value = f64::from_bits(word(Self::TALLIES + state_dim + i));
        }
        Self { time_s: f64::from_bits(word(0)), estimate }
    }
}

impl Heard {
    /// The words that stand at [`EstimateRecord::heard_at`].
    #[must_use]
    pub fn to_words(self) -> [u64; EstimateRecord::WORDS_HEARD] {
        let Self { position_m: [x_m, y_m], height_m, range_m, taken_at, judged } = self;
        // No sensor has a standard deviation of zero.
        let (range_m, std_m) = range_m.unwrap_or_default();
        let used = judged.map_or(0, |judged| judged.used as u64 + 1);
        // A range that nothing predicted has no square.
        let square = judged.and_then(|judged| judged.normalised_square).unwrap_or(f64::NAN);
        let [x, y, height, range, std, square] = [x_m, y_m, height_m, range_m, std_m, square].map(f64::to_bits);
        [x, y, height, range, std, taken_at + 1, used, square]
    }

    fn from_words([x, y, height, range, std, taken, used, square]: [u64; EstimateRecord::WORDS_HEARD]) -> Option<Self> {
        let range_m = (std != 0).then_some((f64::from_bits(range), f64::from_bits(std)));
        let taken_at = taken.checked_sub(1)?;
        let used = used.checked_sub(1).and_then(|used| RangeUse::ALL.get(usize::try_from(used).ok()?).copied());
        let normalised_square = Some(f64::from_bits(square)).filter(|square| !square.is_nan());
        Some(Self {
            position_m: [f64::from_bits(x), f64::from_bits(y)],
            height_m: f64::from_bits(height),
            range_m,
            taken_at,
            judged: used.map(|used| Judged { used, normalised_square }),
        })
    }
}

impl WorldRecord {
    const WORDS_PER_ROBOT: usize = 10;

    /// Words of a tick.
    #[must_use]
    pub fn words(scenario: &Scenario) -> usize {
        2 + Self::truth_dim(scenario) + Self::WORDS_PER_ROBOT * scenario.robots.len()
    }

    fn truth_dim(scenario: &Scenario) -> usize {
        match scenario.source {
            crate::scenario::Source::Simulated { .. } => scenario.motion.state_dim(),
            crate::scenario::Source::Recorded { .. } => 0,
        }
    }

    /// The words of a tick, from what the simulator holds, without building a record.
    pub fn to_words<'a>(
        time_s: f64,
        ended_ns: u64,
        truth: &'a [f64],
        world: &'a [WorldEntry],
        drives: &'a [Option<Drive>],
    ) -> impl Iterator<Item = u64> + 'a {
        let robots = world.iter().zip(drives).flat_map(|(entry, drive)| {
            let [sent_ns, held_ns] = drive.map_or([0; 2], |drive| [drive.range_sent_ns, drive.heading_held_ns]);
            let (heading, refused) = (Heading::of(*drive) as u64, drive.map_or(0, |drive| drive.headings_refused));
            let [heading_rad, speed_mps] = drive.map_or([0.0; 2], |drive| [drive.heading_rad, drive.speed_mps]);
            let is_absent = entry.range_kind == RangeKind::Absent.to_bits();
            let range_m = if is_absent { f64::NAN } else { entry.range_m };
            let [x, y, height, range] = [entry.x_m, entry.y_m, entry.height_m, range_m].map(f64::to_bits);
            let [rad, mps] = [heading_rad, speed_mps].map(f64::to_bits);
            [x, y, height, range, sent_ns, held_ns, heading, rad, mps, refused]
        });
        [time_s.to_bits(), ended_ns].into_iter().chain(truth.iter().map(|value| value.to_bits())).chain(robots)
    }

    /// The record in words that [`Self::to_words`] made in a run of this scenario.
    #[must_use]
    pub fn from_words(words: &[u64], scenario: &Scenario) -> Self {
        let float = |word: &u64| f64::from_bits(*word);
        let stamp = |word: u64| (word != 0).then_some(word);
        let truth_end = 2 + Self::truth_dim(scenario);
        Self {
            time_s: words.first().map_or(0.0, float),
            ended_ns: words.get(1).copied().unwrap_or(0),
            truth: words.get(2..truth_end).unwrap_or_default().iter().map(float).collect(),
            robots: words
                .get(truth_end..)
                .unwrap_or_default()
                .as_chunks::<{ Self::WORDS_PER_ROBOT }>()
                .0
                .iter()
                .map(|[x, y, height, range, sent_ns, held_ns, heading, rad, mps, refused]| RobotRecord {
                    position_m: [float(x), float(y)],
                    height_m: float(height),
                    range_m: Some(float(range)).filter(|range_m| !range_m.is_nan()),
                    range_sent_ns: stamp(*sent_ns),
                    heading_held_ns: stamp(*held_ns),
                    heading: Heading::ALL.get(*heading as usize).copied().unwrap_or_default(),
                    driven: Command { heading_rad: float(rad), speed_mps: float(mps) },
                    headings_refused: *refused,
                })
                .collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_estimate_comes_back_from_its_words() {
        let mut estimate = Estimate {
            state_dim: 2,
            nis: 1.5,
            fused: 3,
            nis_all: 2.5,
            tested: 27,
            noise_scale: 1.75,
            rejected: 4,
            missing: 5,
            late: 6,
            fused_late: 7,
            rejected_late: 8,
            refused: [9, 10, 11, 12, 13, 14],
            distrusted: [15, 16, 17, 18],
            objective: 0.25,
            lower_bound: 0.125,
            least_trace_m2: 0.75,
            digest: [19, 20],
            stages: Stages {
                last_range_ns: 21,
                began_ns: 22,
                filtered_ns: 23,
                planned_ns: 24,
                saved_ns: 25,
                sent_ns: 26,
            },
            ..Estimate::default()
        };
        estimate.state[..2].copy_from_slice(&[0.5, -0.5]);
        estimate.covariance[..4].copy_from_slice(&[4.0, 1.0, 1.0, 2.0]);
        let record = EstimateRecord { time_s: 0.7, estimate };
        let heard = Heard { position_m: [0.0, 0.0], height_m: 0.0, range_m: None, taken_at: 0, judged: None };
        let judged = [(RangeUse::Rejected, Some(20.0)), (RangeUse::Fused, None), (RangeUse::Distrusted, Some(0.5))]
            .map(|(used, normalised_square)| Some(Judged { used, normalised_square }));
        let late = Heard {
            position_m: [1.0, -2.0],
            range_m: Some((-0.5, 1.5)),
            taken_at: 12,
            height_m: 3.5,
            judged: judged[0],
        };
        let [fused, distrusted] = [1, 2].map(|i| Heard { judged: judged[i], ..late });
        let command = Command { heading_rad: -3.0, speed_mps: 4.0 };
        let exchanges =
            [None, Some(heard), Some(late), Some(fused), Some(distrusted)].map(|heard| Exchange { heard, command });
        let words: Vec<u64> = record.to_words(exchanges).collect();
        assert_eq!(words.len(), EstimateRecord::words_of_estimate(2) + 5 * EstimateRecord::WORDS_PER_ROBOT);
        assert_eq!(EstimateRecord::from_words(&words, 2), record);
        assert!(EstimateRecord::exchanges(&words, 2).eq(exchanges));
    }
}
