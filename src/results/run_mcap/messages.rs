//! The typed messages of the six topics.
//!
//! Units stand in the names; stamps (`_ns` but for `log_time`) are of the monotonic clock of the machine that ran. Those of
//! ranges and headings of a run in one process only say that there was one.

use prost::DecodeError;

/// Messages with their fields as Protobuf has them, numbered in this order.
macro_rules! messages {
    ($($(#[$doc:meta])* $name:ident {
        $($(#[$field_doc:meta])* $field:ident: $type:ident $(<$of:ident>)? as $($kind:ident)+,)+
    })+) => {$(
        $(#[$doc])*
        #[derive(Clone, PartialEq, prost::Message, foxglove::Encode)]
        pub struct $name {
            $($(#[$field_doc])* #[prost($($kind),+)] pub $field: $type $(<$of>)?,)+
        }
    )+};
}

messages! {
    /// Topic `/world`: where all are, from the simulator to the robots.
    World {
        /// The tick.
        tick: u64 as uint64,
        /// Its time.
        time_s: f64 as double,
        /// The robots, by id.
        robots: Vec<Place> as repeated message,
        /// When the tick was over.
        ended_ns: u64 as uint64,
    }

    /// One robot's place in the world.
    Place {
        /// East.
        x_m: f64 as double,
        /// North.
        y_m: f64 as double,
        /// What its sensor is told: the true range, or a recorded one.
        range_m: Option<f64> as optional double,
        /// Height of its sensor above the plane in which the target moves.
        height_m: f64 as double,
        /// Covariance of its position, of x, of x and y, of y; absent where the position is exact.
        position_covariance_m2: Vec<f64> as repeated double,
    }

    /// Topic `/range`: a robot's word to fusion.
    Range {
        /// The tick.
        tick: u64 as uint64,
        /// Its time.
        time_s: f64 as double,
        /// Whose it is.
        robot: u64 as uint64,
        /// Where the robot was: east.
        x_m: f64 as double,
        /// North.
        y_m: f64 as double,
        /// What it measured, if its sensor had a range and fusion used the message.
        range_m: Option<f64> as optional double,
        /// Standard deviation of that.
        range_std_m: Option<f64> as optional double,
        /// The first tick whose estimate knows of it: a later one if it came late; none if fusion never used it.
        taken_at_tick: Option<u64> as optional uint64,
        /// When it was published, as far as the simulator was told.
        sent_ns: Option<u64> as optional uint64,
        /// Height of the sensor above the plane in which the target moves: the range is the slant one.
        height_m: f64 as double,
        /// What fusion did with it: `fused`, `rejected` by the gate, or not fused as its robot is `distrusted`.
        used: Option<String> as optional string,
        /// Its own innovation squared over its variance, of one degree of freedom, if anything predicted it.
        normalised_square: Option<f64> as optional double,
        /// Covariance of the sensor's position, of x, of x and y, of y; absent where the position is exact.
        position_covariance_m2: Vec<f64> as repeated double,
    }

    /// Topic `/heading`: fusion's word to all robots.
    Heading {
        /// The tick.
        tick: u64 as uint64,
        /// Its time.
        time_s: f64 as double,
        /// One for each robot, by id.
        commands: Vec<CommandTo> as repeated message,
        /// When it was sent.
        sent_ns: u64 as uint64,
    }

    /// What one robot is told.
    CommandTo {
        /// Anticlockwise from east.
        heading_rad: f64 as double,
        /// Its speed.
        speed_mps: f64 as double,
    }

    /// Topic `/drive`: what a robot does, to the simulator.
    Drive {
        /// The tick.
        tick: u64 as uint64,
        /// Its time.
        time_s: f64 as double,
        /// Which robot.
        robot: u64 as uint64,
        /// Anticlockwise from east.
        heading_rad: f64 as double,
        /// Its speed.
        speed_mps: f64 as double,
        /// What it drove by: `fresh`, `late`, `none` or `unknown`, as in the report.
        heading: String as string,
        /// When it had published its range.
        range_sent_ns: Option<u64> as optional uint64,
        /// When it held the heading.
        heading_held_ns: Option<u64> as optional uint64,
        /// Headings it refused since the tick before.
        headings_refused: u64 as uint64,
    }

    /// Topic `/estimate`: what fusion knows after the tick.
    Estimate {
        /// The tick.
        tick: u64 as uint64,
        /// Its time.
        time_s: f64 as double,
        /// Position first: m, then m/s and so on, as the target model has it.
        state: Vec<f64> as repeated double,
        /// Of the state, row by row.
        covariance: Vec<f64> as repeated double,
        /// Normalised innovation squared, of `fused` degrees of freedom.
        nis: f64 as double,
        /// Ranges fused.
        fused: u64 as uint64,
        /// Ranges that failed the gate, or whose robot is distrusted.
        rejected: u64 as uint64,
        /// Robots not heard.
        missing: u64 as uint64,
        /// Ranges of earlier ticks since the last estimate.
        late: u64 as uint64,
        /// Of those, fused at their own time.
        fused_late: u64 as uint64,
        /// Of those, rejected at their own time.
        rejected_late: u64 as uint64,
        /// Messages refused since the last estimate.
        refused: Option<Refused> as optional message,
        /// Ids of robots that are distrusted.
        distrusted: Vec<u64> as repeated uint64,
        /// The planner's `|S|`, 1/m^2.
        objective: f64 as double,
        /// Lower bound on it; minus infinity from planners that prove none.
        lower_bound: f64 as double,
        /// When fusion came how far.
        stages: Option<Stages> as optional message,
        /// Rolling hash over all estimates up to this one: after the last, the report's.
        digest: String as string,
        /// Normalised innovation squared of all ranges of the tick, fused or not, of `tested` degrees of freedom.
        nis_all: f64 as double,
        /// Ranges in it.
        tested: u64 as uint64,
        /// How many times larger than told ranges' standard deviations are taken from the next on: more than 1 while most
        /// sensors fail together.
        noise_scale: f64 as double,
        /// No headings of this tick lead to a lesser trace of the position covariance at the next, m^2; 0 from planners that
        /// prove nothing.
        least_trace_m2: f64 as double,
    }

    /// Messages refused, by cause.
    Refused {
        /// Its sender does not hold the role.
        impostor: u64 as uint64,
        /// Of no robot of the team.
        out_of_range: u64 as uint64,
        /// Numbers without sense.
        malformed: u64 as uint64,
        /// Of a tick that cannot have begun.
        future: u64 as uint64,
        /// Not what was said before.
        contradiction: u64 as uint64,
        /// Where the robot cannot have come.
        jump: u64 as uint64,
    }

    /// When fusion came to each stage of the tick.
    Stages {
        /// The last range was sent.
        last_range_ns: u64 as uint64,
        /// Fusion had all that it waited for.
        began_ns: u64 as uint64,
        /// The ranges were fused.
        filtered_ns: u64 as uint64,
        /// The headings were chosen.
        planned_ns: u64 as uint64,
        /// The checkpoint was written.
        saved_ns: u64 as uint64,
        /// The headings were sent.
        sent_ns: u64 as uint64,
    }

    /// Topic `/truth`: where the target is, which fusion and robots never see.
    Truth {
        /// The tick.
        tick: u64 as uint64,
        /// Its time.
        time_s: f64 as double,
        /// As in the estimate.
        state: Vec<f64> as repeated double,
    }
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
