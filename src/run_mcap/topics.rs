//! What travels on the six topics, as typed messages, from a [`Frame`] and back to it, bit for bit.
//!
//! Units stand in the names; stamps (`_ns` but for `log_time`) are of the monotonic clock of the machine that ran. A run in
//! one process looks at no clock: its stamps only say that there is one.

use rangehound_shared::digest::Digest;
use rangehound_shared::message::{Command, Estimate as EstimateOfFusion, Stages as StagesOfFusion};
use rangehound_shared::record::{EstimateRecord, Exchange, Heading as Followed, Heard, RobotRecord, WorldRecord};
use rangehound_shared::robot_set::RobotSet;
use rangehound_shared::scenario::{Scenario, Source, bounds};

use crate::frame::Frame;
use prost::DecodeError;

/// Nothing that can have been recorded is farther away, m.
const PLACE_MAX_M: f64 = 1e12;

/// Topic `/world`: where all are, from the simulator to the robots.
#[derive(Clone, PartialEq, prost::Message, foxglove::Encode)]
pub struct World {
    /// The tick.
    #[prost(uint64, tag = "1")]
    pub tick: u64,
    /// Its time.
    #[prost(double, tag = "2")]
    pub time_s: f64,
    /// The robots, by id.
    #[prost(message, repeated, tag = "3")]
    pub robots: Vec<Place>,
    /// When the tick was over.
    #[prost(uint64, tag = "4")]
    pub ended_ns: u64,
}

/// One robot's place in the world.
#[derive(Clone, PartialEq, prost::Message, foxglove::Encode)]
pub struct Place {
    /// East.
    #[prost(double, tag = "1")]
    pub x_m: f64,
    /// North.
    #[prost(double, tag = "2")]
    pub y_m: f64,
    /// What its sensor is told: the true range, or a recorded one.
    #[prost(double, optional, tag = "3")]
    pub range_m: Option<f64>,
}

/// Topic `/range`: a robot's word to fusion.
#[derive(Clone, PartialEq, prost::Message, foxglove::Encode)]
pub struct Range {
    /// The tick.
    #[prost(uint64, tag = "1")]
    pub tick: u64,
    /// Its time.
    #[prost(double, tag = "2")]
    pub time_s: f64,
    /// Whose it is.
    #[prost(uint64, tag = "3")]
    pub robot: u64,
    /// Where the robot was: east.
    #[prost(double, tag = "4")]
    pub x_m: f64,
    /// North.
    #[prost(double, tag = "5")]
    pub y_m: f64,
    /// What it measured, if its sensor had a range and fusion used the message.
    #[prost(double, optional, tag = "6")]
    pub range_m: Option<f64>,
    /// Standard deviation of that.
    #[prost(double, optional, tag = "7")]
    pub range_std_m: Option<f64>,
    /// The first tick whose estimate knows of it: a later one if it came late; none if fusion never used it.
    #[prost(uint64, optional, tag = "8")]
    pub taken_at_tick: Option<u64>,
    /// When it was published, as far as the simulator was told.
    #[prost(uint64, optional, tag = "9")]
    pub sent_ns: Option<u64>,
}

/// Topic `/heading`: fusion's word to all robots.
#[derive(Clone, PartialEq, prost::Message, foxglove::Encode)]
pub struct Heading {
    /// The tick.
    #[prost(uint64, tag = "1")]
    pub tick: u64,
    /// Its time.
    #[prost(double, tag = "2")]
    pub time_s: f64,
    /// One for each robot, by id.
    #[prost(message, repeated, tag = "3")]
    pub commands: Vec<CommandTo>,
    /// When it was sent.
    #[prost(uint64, tag = "4")]
    pub sent_ns: u64,
}

/// What one robot is told.
#[derive(Clone, PartialEq, prost::Message, foxglove::Encode)]
pub struct CommandTo {
    /// Anticlockwise from east.
    #[prost(double, tag = "1")]
    pub heading_rad: f64,
    /// Its speed.
    #[prost(double, tag = "2")]
    pub speed_mps: f64,
}

/// Topic `/drive`: what a robot does, to the simulator.
#[derive(Clone, PartialEq, prost::Message, foxglove::Encode)]
pub struct Drive {
    /// The tick.
    #[prost(uint64, tag = "1")]
    pub tick: u64,
    /// Its time.
    #[prost(double, tag = "2")]
    pub time_s: f64,
    /// Which robot.
    #[prost(uint64, tag = "3")]
    pub robot: u64,
    /// Anticlockwise from east.
    #[prost(double, tag = "4")]
    pub heading_rad: f64,
    /// Its speed.
    #[prost(double, tag = "5")]
    pub speed_mps: f64,
    /// What it drove by: `fresh`, `late`, `none` or `unknown`, as in the report.
    #[prost(string, tag = "6")]
    pub heading: String,
    /// When it had published its range.
    #[prost(uint64, optional, tag = "7")]
    pub range_sent_ns: Option<u64>,
    /// When it held the heading.
    #[prost(uint64, optional, tag = "8")]
    pub heading_held_ns: Option<u64>,
    /// Headings it refused since the tick before.
    #[prost(uint64, tag = "9")]
    pub headings_refused: u64,
}

/// Topic `/estimate`: what fusion knows after the tick.
#[derive(Clone, PartialEq, prost::Message, foxglove::Encode)]
pub struct Estimate {
    /// The tick.
    #[prost(uint64, tag = "1")]
    pub tick: u64,
    /// Its time.
    #[prost(double, tag = "2")]
    pub time_s: f64,
    /// Position first: m, then m/s and so on, as the target model has it.
    #[prost(double, repeated, tag = "3")]
    pub state: Vec<f64>,
    /// Of the state, row by row.
    #[prost(double, repeated, tag = "4")]
    pub covariance: Vec<f64>,
    /// Normalised innovation squared, of `fused` degrees of freedom.
    #[prost(double, tag = "5")]
    pub nis: f64,
    /// Ranges fused.
    #[prost(uint64, tag = "6")]
    pub fused: u64,
    /// Ranges that failed the gate, or whose robot is distrusted.
    #[prost(uint64, tag = "7")]
    pub rejected: u64,
    /// Robots not heard.
    #[prost(uint64, tag = "8")]
    pub missing: u64,
    /// Ranges of earlier ticks since the last estimate.
    #[prost(uint64, tag = "9")]
    pub late: u64,
    /// Of those, fused at their own time.
    #[prost(uint64, tag = "10")]
    pub fused_late: u64,
    /// Of those, rejected at their own time.
    #[prost(uint64, tag = "11")]
    pub rejected_late: u64,
    /// Messages refused since the last estimate.
    #[prost(message, optional, tag = "12")]
    pub refused: Option<Refused>,
    /// Ids of robots that are distrusted.
    #[prost(uint64, repeated, tag = "13")]
    pub distrusted: Vec<u64>,
    /// The planner's `|S|`, 1/m^2.
    #[prost(double, tag = "14")]
    pub objective: f64,
    /// Lower bound on it; minus infinity from planners that prove none.
    #[prost(double, tag = "15")]
    pub lower_bound: f64,
    /// When fusion came how far.
    #[prost(message, optional, tag = "16")]
    pub stages: Option<Stages>,
    /// Rolling hash over all estimates up to this one: after the last, the report's.
    #[prost(string, tag = "17")]
    pub digest: String,
}

/// Messages refused, by cause.
#[derive(Clone, PartialEq, prost::Message, foxglove::Encode)]
pub struct Refused {
    /// Its sender does not hold the role.
    #[prost(uint64, tag = "1")]
    pub impostor: u64,
    /// Of no robot of the team.
    #[prost(uint64, tag = "2")]
    pub out_of_range: u64,
    /// Numbers without sense.
    #[prost(uint64, tag = "3")]
    pub malformed: u64,
    /// Of a tick that cannot have begun.
    #[prost(uint64, tag = "4")]
    pub future: u64,
    /// Not what was said before.
    #[prost(uint64, tag = "5")]
    pub contradiction: u64,
    /// Where the robot cannot have come.
    #[prost(uint64, tag = "6")]
    pub jump: u64,
}

/// When fusion came to each stage of the tick.
#[derive(Clone, PartialEq, prost::Message, foxglove::Encode)]
pub struct Stages {
    /// The last range was sent.
    #[prost(uint64, tag = "1")]
    pub last_range_ns: u64,
    /// Fusion had all that it waited for.
    #[prost(uint64, tag = "2")]
    pub began_ns: u64,
    /// The ranges were fused.
    #[prost(uint64, tag = "3")]
    pub filtered_ns: u64,
    /// The headings were chosen.
    #[prost(uint64, tag = "4")]
    pub planned_ns: u64,
    /// The checkpoint was written.
    #[prost(uint64, tag = "5")]
    pub saved_ns: u64,
    /// The headings were sent.
    #[prost(uint64, tag = "6")]
    pub sent_ns: u64,
}

/// Topic `/truth`: where the target is, which fusion and robots never see.
#[derive(Clone, PartialEq, prost::Message, foxglove::Encode)]
pub struct Truth {
    /// The tick.
    #[prost(uint64, tag = "1")]
    pub tick: u64,
    /// Its time.
    #[prost(double, tag = "2")]
    pub time_s: f64,
    /// As in the estimate.
    #[prost(double, repeated, tag = "3")]
    pub state: Vec<f64>,
}

/// A message of one of the topics.
#[derive(Debug, Clone, PartialEq)]
#[expect(missing_docs, reason = "each is named as what it holds")]
pub enum OnTopic {
    World(World),
    Range(Range),
    Heading(Heading),
    Drive(Drive),
    Estimate(Box<Estimate>),
    Truth(Truth),
}

/// The topics, in the order of [`OnTopic`].
pub const TOPICS: [&str; 6] = ["/world", "/range", "/heading", "/drive", "/estimate", "/truth"];

/// Puts a message's bytes after what is there.
///
/// # Errors
/// If they cannot be put there.
pub fn encode(message: &impl foxglove::Encode, out: &mut Vec<u8>) -> std::io::Result<()> {
    message.encode(out).map_err(|error| std::io::Error::other(error.to_string()))
}

impl OnTopic {
    /// Place of its topic in [`TOPICS`].
    #[must_use]
    pub fn topic(&self) -> usize {
        match self {
            Self::World(_) => 0,
            Self::Range(_) => 1,
            Self::Heading(_) => 2,
            Self::Drive(_) => 3,
            Self::Estimate(_) => 4,
            Self::Truth(_) => 5,
        }
    }

    /// When it was published, monotonic ns, if that is known.
    #[must_use]
    pub fn sent_ns(&self) -> Option<u64> {
        let stamp = match self {
            Self::Range(range) => range.sent_ns?,
            Self::Heading(heading) => heading.sent_ns,
            Self::Estimate(estimate) => estimate.stages.as_ref()?.sent_ns,
            Self::World(_) | Self::Drive(_) | Self::Truth(_) => return None,
        };
        // A run in one process has stamps of no clock.
        (1..u64::MAX).contains(&stamp).then_some(stamp)
    }

    /// Puts its bytes after what is there: every field, for the sign of a zero counts too.
    ///
    /// # Errors
    /// If they cannot be put there.
    pub fn encode(&self, out: &mut Vec<u8>) -> std::io::Result<()> {
        match self {
            Self::World(message) => encode(message, out),
            Self::Range(message) => encode(message, out),
            Self::Heading(message) => encode(message, out),
            Self::Drive(message) => encode(message, out),
            Self::Estimate(message) => encode(&**message, out),
            Self::Truth(message) => encode(message, out),
        }
    }

    /// The message that these bytes are, on the topic with this place in [`TOPICS`].
    ///
    /// # Errors
    /// [`DecodeError`].
    pub fn decode(topic: usize, bytes: &[u8]) -> Result<Self, DecodeError> {
        Ok(match topic {
            0 => Self::World(prost::Message::decode(bytes)?),
            1 => Self::Range(prost::Message::decode(bytes)?),
            2 => Self::Heading(prost::Message::decode(bytes)?),
            3 => Self::Drive(prost::Message::decode(bytes)?),
            4 => Self::Estimate(Box::new(prost::Message::decode(bytes)?)),
            _ => Self::Truth(prost::Message::decode(bytes)?),
        })
    }

    /// Its tick.
    #[must_use]
    pub fn tick(&self) -> u64 {
        match self {
            Self::World(World { tick, .. })
            | Self::Range(Range { tick, .. })
            | Self::Heading(Heading { tick, .. })
            | Self::Drive(Drive { tick, .. })
            | Self::Truth(Truth { tick, .. }) => *tick,
            Self::Estimate(estimate) => estimate.tick,
        }
    }
}

/// All that travelled in a tick.
pub fn messages_of(frame: &Frame) -> impl Iterator<Item = OnTopic> + '_ {
    let Frame { tick, estimate: EstimateRecord { time_s, estimate }, exchanges, world } = frame;
    let (tick, time_s) = (*tick, *time_s);
    let places = world.robots.iter().map(|robot| {
        let [x_m, y_m] = robot.position_m;
        Place { x_m, y_m, range_m: robot.range_m }
    });
    let world_message = World { tick, time_s: world.time_s, robots: places.collect(), ended_ns: world.ended_ns };
    let ranges = exchanges.iter().zip(&world.robots).zip(0..).filter_map(move |((exchange, body), robot)| {
        let sent_ns = body.range_sent_ns;
        let (position_m, range_m, taken_at) = match exchange.heard {
            Some(Heard { position_m, range_m, taken_at }) => (position_m, range_m, Some(taken_at)),
            None => (body.position_m, None, None),
        };
        // What nobody sent and nobody heard was not.
        (taken_at.is_some() || sent_ns.is_some()).then(|| {
            let ([x_m, y_m], (range_m, range_std_m)) = (position_m, range_m.unzip());
            OnTopic::Range(Range {
                tick,
                time_s,
                robot,
                x_m,
                y_m,
                range_m,
                range_std_m,
                taken_at_tick: taken_at,
                sent_ns,
            })
        })
    });
    let commands = exchanges
        .iter()
        .map(|Exchange { command: Command { heading_rad, speed_mps }, .. }| CommandTo {
            heading_rad: *heading_rad,
            speed_mps: *speed_mps,
        })
        .collect();
    let heading = Heading { tick, time_s, commands, sent_ns: estimate.stages.sent_ns };
    let drives = world.robots.iter().zip(0..).filter_map(move |(body, robot)| {
        let silent = RobotRecord { position_m: body.position_m, range_m: body.range_m, ..RobotRecord::default() };
        let drive = || {
            let Command { heading_rad, speed_mps } = body.driven;
            OnTopic::Drive(Drive {
                tick,
                time_s,
                robot,
                heading_rad,
                speed_mps,
                heading: name_of(body.heading).to_owned(),
                range_sent_ns: body.range_sent_ns,
                heading_held_ns: body.heading_held_ns,
                headings_refused: body.headings_refused,
            })
        };
        (*body != silent).then(drive)
    });
    let truth = (!world.truth.is_empty())
        .then(|| OnTopic::Truth(Truth { tick, time_s: world.time_s, state: world.truth.clone() }));
    // As things happen in a tick.
    std::iter::once(OnTopic::World(world_message))
        .chain(truth)
        .chain(ranges)
        .chain([OnTopic::Heading(heading), OnTopic::Estimate(Box::new(estimate_message(tick, time_s, estimate)))])
        .chain(drives)
}

fn estimate_message(tick: u64, time_s: f64, estimate: &EstimateOfFusion) -> Estimate {
    let n = estimate.state_dim as usize;
    let [impostor, out_of_range, malformed, future, contradiction, jump] = estimate.refused;
    let StagesOfFusion { last_range_ns, began_ns, filtered_ns, planned_ns, saved_ns, sent_ns } = estimate.stages;
    Estimate {
        tick,
        time_s,
        state: estimate.state[..n].to_vec(),
        covariance: estimate.covariance[..n * n].to_vec(),
        nis: estimate.nis,
        fused: estimate.fused,
        rejected: estimate.rejected,
        missing: estimate.missing,
        late: estimate.late,
        fused_late: estimate.fused_late,
        rejected_late: estimate.rejected_late,
        refused: Some(Refused { impostor, out_of_range, malformed, future, contradiction, jump }),
        distrusted: RobotSet::from_bits(estimate.distrusted).iter().map(|id| id as u64).collect(),
        objective: estimate.objective,
        lower_bound: estimate.lower_bound,
        stages: Some(Stages { last_range_ns, began_ns, filtered_ns, planned_ns, saved_ns, sent_ns }),
        digest: digest_of(estimate).to_string(),
    }
}

/// The rolling digest after an estimate.
#[must_use]
pub fn digest_of(estimate: &EstimateOfFusion) -> Digest {
    Digest::from_bits(u128::from(estimate.digest[1]) << 64 | u128::from(estimate.digest[0]))
}

/// Why messages are no tick of a run.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Senseless {
    /// Their bytes are damaged, or their numbers.
    #[error("tick {tick}: a message on {topic} makes no sense")]
    Message {
        /// The tick.
        tick: u64,
        /// Of which topic.
        topic: &'static str,
    },
    /// One is lacking.
    #[error("tick {tick}: nothing on {topic}")]
    Lacking {
        /// The tick.
        tick: u64,
        /// Of which topic.
        topic: &'static str,
    },
}

/// The messages of one tick, until they are a [`Frame`].
#[derive(Debug)]
pub struct Gathering {
    tick: u64,
    robots: usize,
    state_dim: usize,
    has_truth: bool,
    world: Option<WorldRecord>,
    estimate: Option<EstimateRecord>,
    exchanges: Vec<Exchange>,
    driven: Vec<Option<Drive>>,
    truth: Vec<f64>,
    has_headings: bool,
}

impl Gathering {
    /// Nothing yet, of a tick of a run of this scenario.
    #[must_use]
    pub fn of(scenario: &Scenario, tick: u64) -> Self {
        let robots = scenario.robots.len();
        Self {
            tick,
            robots,
            state_dim: scenario.motion.state_dim(),
            has_truth: matches!(scenario.source, Source::Simulated { .. }),
            world: None,
            estimate: None,
            exchanges: vec![Exchange::default(); robots],
            driven: vec![None; robots],
            truth: Vec::new(),
            has_headings: false,
        }
    }

    /// Takes a message of this tick.
    ///
    /// # Errors
    /// If it cannot be of such a run.
    pub fn take(&mut self, message: OnTopic) -> Result<(), Senseless> {
        let topic = TOPICS[message.topic()];
        self.admit(message).ok_or(Senseless::Message { tick: self.tick, topic })
    }

    fn admit(&mut self, message: OnTopic) -> Option<()> {
        match message {
            OnTopic::World(World { time_s, robots, ended_ns, .. }) => {
                let sound =
                    |place: &Place| [place.x_m, place.y_m, place.range_m.unwrap_or(0.0)].into_iter().all(is_near);
                (robots.len() == self.robots && robots.iter().all(sound) && time_s.is_finite()).then_some(())?;
                let robots = robots.into_iter().map(|Place { x_m, y_m, range_m }| RobotRecord {
                    position_m: [x_m, y_m],
                    range_m,
                    ..RobotRecord::default()
                });
                self.world = Some(WorldRecord { time_s, ended_ns, truth: Vec::new(), robots: robots.collect() });
            }
            OnTopic::Range(range) => {
                let slot = self.exchanges.get_mut(usize::try_from(range.robot).ok()?)?;
                let Range { x_m, y_m, range_m, range_std_m, taken_at_tick, .. } = range;
                let range_m = range_m.zip(range_std_m);
                let is_sound =
                    range_m.is_none_or(|(range_m, std_m)| is_near(range_m) && bounds::STD_M.contains(&std_m));
                (is_near(x_m) && is_near(y_m) && is_sound).then_some(())?;
                slot.heard = taken_at_tick.map(|taken_at| Heard { position_m: [x_m, y_m], range_m, taken_at });
                slot.heard.is_none_or(|heard| heard.taken_at >= self.tick).then_some(())?;
            }
            OnTopic::Heading(Heading { commands, .. }) => {
                (commands.len() == self.robots).then_some(())?;
                for (slot, CommandTo { heading_rad, speed_mps }) in self.exchanges.iter_mut().zip(commands) {
                    slot.command = Command { heading_rad, speed_mps };
                }
                self.has_headings = true;
            }
            OnTopic::Drive(drive) => {
                let slot = self.driven.get_mut(usize::try_from(drive.robot).ok()?)?;
                *slot = Some(drive);
            }
            OnTopic::Estimate(estimate) => self.estimate = Some(record_of(&estimate, self.state_dim)?),
            OnTopic::Truth(Truth { state, .. }) => {
                (self.has_truth && state.len() == self.state_dim).then_some(())?;
                self.truth = state;
            }
        }
        Some(())
    }

    /// The tick, if all is there.
    ///
    /// # Errors
    /// With what is lacking.
    pub fn into_frame(self) -> Result<Frame, Senseless> {
        let Self { tick, has_truth, world, estimate, exchanges, driven, truth, has_headings, .. } = self;
        let lacking = |topic| Senseless::Lacking { tick, topic };
        if !has_headings {
            return Err(lacking("/heading"));
        }
        if has_truth && truth.is_empty() {
            return Err(lacking("/truth"));
        }
        let mut world = world.ok_or(lacking("/world"))?;
        world.truth = truth;
        for (robot, drive) in world.robots.iter_mut().zip(driven) {
            let Some(drive) = drive else { continue };
            robot.driven = Command { heading_rad: drive.heading_rad, speed_mps: drive.speed_mps };
            robot.heading =
                Followed::ALL.into_iter().find(|heading| name_of(*heading) == drive.heading).unwrap_or_default();
            robot.range_sent_ns = drive.range_sent_ns;
            robot.heading_held_ns = drive.heading_held_ns;
            robot.headings_refused = drive.headings_refused;
        }
        Ok(Frame { tick, estimate: estimate.ok_or(lacking("/estimate"))?, exchanges, world })
    }
}

/// What is in a message of what a robot drove by.
fn name_of(heading: Followed) -> &'static str {
    match heading {
        Followed::Unknown => "unknown",
        Followed::Fresh => "fresh",
        Followed::Late => "late",
        Followed::None => "none",
    }
}

fn is_near(value: f64) -> bool {
    value.abs() <= PLACE_MAX_M
}

/// An estimate as fusion put it down, if its sizes are those of the run.
fn record_of(message: &Estimate, state_dim: usize) -> Option<EstimateRecord> {
    let n = state_dim;
    (message.state.len() == n && message.covariance.len() == n * n && message.time_s.is_finite()).then_some(())?;
    let digest = u128::from_str_radix(&message.digest, 16).ok()?;
    let Refused { impostor, out_of_range, malformed, future, contradiction, jump } =
        message.refused.clone().unwrap_or_default();
    let Stages { last_range_ns, began_ns, filtered_ns, planned_ns, saved_ns, sent_ns } =
        message.stages.clone().unwrap_or_default();
    let mut distrusted = RobotSet::default();
    for id in &message.distrusted {
        distrusted.set(usize::try_from(*id).ok().filter(|id| *id < rangehound_shared::ROBOTS_MAX)?, true);
    }
    let mut estimate = EstimateOfFusion {
        state_dim: n as u64,
        nis: message.nis,
        fused: message.fused,
        rejected: message.rejected,
        missing: message.missing,
        late: message.late,
        fused_late: message.fused_late,
        rejected_late: message.rejected_late,
        refused: [impostor, out_of_range, malformed, future, contradiction, jump],
        distrusted: distrusted.to_bits(),
        objective: message.objective,
        lower_bound: message.lower_bound,
        stages: StagesOfFusion { last_range_ns, began_ns, filtered_ns, planned_ns, saved_ns, sent_ns },
        digest: [digest as u64, (digest >> 64) as u64],
        ..EstimateOfFusion::default()
    };
    estimate.state[..n].copy_from_slice(&message.state);
    estimate.covariance[..n * n].copy_from_slice(&message.covariance);
    Some(EstimateRecord { time_s: message.time_s, estimate })
}
