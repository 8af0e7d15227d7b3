//! The typed messages of the six topics.
//!
//! Units stand in the names; stamps (`_ns` but for `log_time`) are of the monotonic clock of the machine that ran. Those of
//! ranges and headings of a run in one process only say that there was one.

use prost::DecodeError;

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
    /// Height of its sensor above the plane in which the target moves.
    #[prost(double, tag = "4")]
    pub height_m: f64,
    /// Covariance of its position, of x, of x and y, of y; absent where the position is exact.
    #[prost(double, repeated, tag = "5")]
    pub position_covariance_m2: Vec<f64>,
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
    /// Height of the sensor above the plane in which the target moves: the range is the slant one.
    #[prost(double, tag = "10")]
    pub height_m: f64,
    /// What fusion did with it: `fused`, `rejected` by the gate, or not fused as its robot is `distrusted`.
    #[prost(string, optional, tag = "11")]
    pub used: Option<String>,
    /// Its own innovation squared over its variance, of one degree of freedom, if anything predicted it.
    #[prost(double, optional, tag = "12")]
    pub normalised_square: Option<f64>,
    /// Covariance of the sensor's position, of x, of x and y, of y; absent where the position is exact.
    #[prost(double, repeated, tag = "13")]
    pub position_covariance_m2: Vec<f64>,
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
    /// Normalised innovation squared of all ranges of the tick, fused or not, of `tested` degrees of freedom.
    #[prost(double, tag = "18")]
    pub nis_all: f64,
    /// Ranges in it.
    #[prost(uint64, tag = "19")]
    pub tested: u64,
    /// How many times larger than told ranges' standard deviations are taken from the next on: more than 1 while most
    /// sensors fail together.
    #[prost(double, tag = "20")]
    pub noise_scale: f64,
    /// No headings of this tick lead to a lesser trace of the position covariance at the next, m^2; 0 from planners that
    /// prove nothing.
    #[prost(double, tag = "21")]
    pub least_trace_m2: f64,
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
