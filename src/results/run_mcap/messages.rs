//! The typed messages of the six topics.
//!
//! Names contain the units. Stamps (`_ns` except `log_time`) are of the recording machine's monotonic clock. In a run in
//! one process, the stamps of ranges and headings only show that the message existed.

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
    /// Topic `/world`: all positions, from the simulator to the robots.
    World {
        /// The tick.
        tick: u64 as uint64,
        /// Its time.
        time_s: f64 as double,
        /// The robots, by id.
        robots: Vec<Place> as repeated message,
        /// End of the tick.
        ended_ns: u64 as uint64,
    }

    /// One robot's place in the world.
    Place {
        /// East.
        x_m: f64 as double,
        /// North.
        y_m: f64 as double,
        /// Input of its sensor: the true range, or a recorded one.
        range_m: Option<f64> as optional double,
        /// Height of its sensor above the plane in which the target moves.
        height_m: f64 as double,
        /// Covariance of its position: x, x and y, y; absent if the position is exact.
        position_covariance_m2: Vec<f64> as repeated double,
        /// Input of its sensor: the true bearing from its heading, or a recorded one.
        bearing_rad: Option<f64> as optional double,
        /// Where it faces, anticlockwise from east.
        heading_rad: f64 as double,
    }

    /// Topic `/range`: a robot's message to fusion.
    Range {
        /// The tick.
        tick: u64 as uint64,
        /// Its time.
        time_s: f64 as double,
        /// The robot.
        robot: u64 as uint64,
        /// Position of the robot: east.
        x_m: f64 as double,
        /// North.
        y_m: f64 as double,
        /// The measured range, if the sensor had one and fusion used the message.
        range_m: Option<f64> as optional double,
        /// Its standard deviation.
        range_std_m: Option<f64> as optional double,
        /// The first tick whose estimate includes it: a later tick if it came late; none if fusion never used it.
        taken_at_tick: Option<u64> as optional uint64,
        /// Time of publication, if the simulator received it.
        sent_ns: Option<u64> as optional uint64,
        /// Height of the sensor above the plane in which the target moves: the range is the slant one.
        height_m: f64 as double,
        /// Result of the fusion: `fused`, `rejected` by the gate, or `distrusted` (not fused because the robot is distrusted).
        used: Option<String> as optional string,
        /// Its squared innovation over its variance, of one degree of freedom, if there was a prediction.
        normalised_square: Option<f64> as optional double,
        /// Covariance of the sensor's position: x, x and y, y; absent if the position is exact.
        position_covariance_m2: Vec<f64> as repeated double,
        /// The measured bearing, anticlockwise from the robot's heading.
        bearing_rad: Option<f64> as optional double,
        /// Its standard deviation.
        bearing_std_rad: Option<f64> as optional double,
        /// Where the robot faces, as it knows it, anticlockwise from east.
        heading_rad: f64 as double,
        /// Standard deviation of that.
        heading_std_rad: f64 as double,
        /// Result of the bearing's fusion, as `used` for the range.
        bearing_used: Option<String> as optional string,
        /// The bearing's squared innovation over its variance.
        bearing_normalised_square: Option<f64> as optional double,
    }

    /// Topic `/heading`: fusion's message to all robots.
    Heading {
        /// The tick.
        tick: u64 as uint64,
        /// Its time.
        time_s: f64 as double,
        /// One for each robot, by id.
        commands: Vec<CommandTo> as repeated message,
        /// Time of sending.
        sent_ns: u64 as uint64,
    }

    /// The command to one robot.
    CommandTo {
        /// Anticlockwise from east.
        heading_rad: f64 as double,
        /// Its speed.
        speed_mps: f64 as double,
    }

    /// Topic `/drive`: a robot's action, to the simulator.
    Drive {
        /// The tick.
        tick: u64 as uint64,
        /// Its time.
        time_s: f64 as double,
        /// The robot.
        robot: u64 as uint64,
        /// Anticlockwise from east.
        heading_rad: f64 as double,
        /// Its speed.
        speed_mps: f64 as double,
        /// The heading that it followed: `fresh`, `late`, `none` or `unknown`, as in the report.
        heading: String as string,
        /// When it published its range.
        range_sent_ns: Option<u64> as optional uint64,
        /// When it received the heading.
        heading_held_ns: Option<u64> as optional uint64,
        /// Headings that it refused since the tick before.
        headings_refused: u64 as uint64,
        /// Time that range and heading spent beyond fusion's host; 0 on one host.
        network_ns: u64 as uint64,
        /// Part of it on the robot's host.
        robot_host_ns: u64 as uint64,
        /// Part of it in the gateway.
        gateway_ns: u64 as uint64,
    }

    /// Topic `/estimate`: fusion's estimate after the tick.
    Estimate {
        /// The tick.
        tick: u64 as uint64,
        /// Its time.
        time_s: f64 as double,
        /// Position first: m, then m/s and so on, according to the target model.
        state: Vec<f64> as repeated double,
        /// Covariance of the state, row by row.
        covariance: Vec<f64> as repeated double,
        /// Normalised innovation squared, of `fused` degrees of freedom.
        nis: f64 as double,
        /// Ranges fused.
        fused: u64 as uint64,
        /// Ranges that failed the gate, or of a distrusted robot.
        rejected: u64 as uint64,
        /// Robots whose range was missing.
        missing: u64 as uint64,
        /// Ranges of earlier ticks since the last estimate.
        late: u64 as uint64,
        /// Of those, the ranges fused at their own time.
        fused_late: u64 as uint64,
        /// Of those, the ranges rejected at their own time.
        rejected_late: u64 as uint64,
        /// Messages refused since the last estimate.
        refused: Option<Refused> as optional message,
        /// Ids of robots that are distrusted.
        distrusted: Vec<u64> as repeated uint64,
        /// The planner's `|S|`, 1/m^2.
        objective: f64 as double,
        /// Lower bound of `|S|`; minus infinity from planners that prove none.
        lower_bound: f64 as double,
        /// Times of fusion's stages.
        stages: Option<Stages> as optional message,
        /// Rolling hash over all estimates up to this one; after the last tick it equals the report's.
        digest: String as string,
        /// Normalised innovation squared of all ranges of the tick, fused or not, of `tested` degrees of freedom.
        nis_all: f64 as double,
        /// Ranges in it.
        tested: u64 as uint64,
        /// Factor by which the assumed standard deviations of ranges are increased from the next tick on: above 1 while most
        /// sensors fail the gate together.
        noise_scale: f64 as double,
        /// Lower bound, m^2, of the trace of the position covariance at the next tick for any headings of this tick; 0 from
        /// planners that prove none.
        least_trace_m2: f64 as double,
        /// Ids of robots whose bearings are distrusted.
        distrusted_bearings: Vec<u64> as repeated uint64,
        /// The same factor as `noise_scale` for bearings.
        bearing_noise_scale: f64 as double,
    }

    /// Messages refused, by cause.
    Refused {
        /// Its sender does not hold the role.
        impostor: u64 as uint64,
        /// The id is of no robot of the team.
        out_of_range: u64 as uint64,
        /// Invalid numbers.
        malformed: u64 as uint64,
        /// The tick cannot have begun.
        future: u64 as uint64,
        /// Contradicts an earlier message.
        contradiction: u64 as uint64,
        /// The robot cannot have reached this position.
        jump: u64 as uint64,
    }

    /// Times at which fusion reached each stage of the tick.
    Stages {
        /// The last range was sent.
        last_range_ns: u64 as uint64,
        /// Fusion had received all that it waited for.
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

    /// Topic `/truth`: the target's true state, which fusion and robots never receive.
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

/// Appends a message's bytes.
///
/// # Errors
/// If they cannot be appended.
pub fn encode(message: &impl foxglove::Encode, out: &mut Vec<u8>) -> std::io::Result<()> {
    message.encode(out).map_err(|error| std::io::Error::other(error.to_string()))
}

impl OnTopic {
    /// Index of its topic in [`TOPICS`].
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

    /// Time of publication, monotonic ns, if known.
    #[must_use]
    pub fn sent_ns(&self) -> Option<u64> {
        let stamp = match self {
            Self::Range(range) => range.sent_ns?,
            Self::Heading(heading) => heading.sent_ns,
            Self::Estimate(estimate) => estimate.stages.as_ref()?.sent_ns,
            Self::World(_) | Self::Drive(_) | Self::Truth(_) => return None,
        };
        // In a run in one process, stamps are not clock times.
        (1..u64::MAX).contains(&stamp).then_some(stamp)
    }

    /// Appends its bytes with every field, because the sign of a zero matters too.
    ///
    /// # Errors
    /// If they cannot be appended.
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

    /// Decodes a message of the topic with this index in [`TOPICS`].
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
