//! The payload of each topic: `repr(C)`, versioned by type name, sizes pinned.
//!
//! Every message is a slice of one of the payloads below under a [`Header`]. A change of fields
//! needs a new version in the type name: iceoryx2 compares names and sizes, not meanings.

#[cfg(feature = "iceoryx2")]
use iceoryx2::prelude::ZeroCopySend;
use serde::{Deserialize, Serialize};

use crate::measurement::{Kind, Measurement, Pose};
use crate::{STATE_DIM_MAX, robot_set};

/// Header of every message.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "iceoryx2", derive(ZeroCopySend), type_name("rangehound.Header.v1"))]
#[repr(C)]
pub struct Header {
    /// Id of the run: messages of other runs are ignored.
    pub run_id: u64,
    /// Incarnation of the sender in its role, counted from 1.
    pub incarnation: u64,
    /// Tick of the contents.
    pub tick: u64,
    /// Time at which the contents are valid, s since the run's or recording's zero.
    pub valid_at_s: f64,
    /// Time of sending, monotonic ns of the sender's clock: for statistics within one host, never for a deadline.
    pub sent_ns: u64,
}

/// A message of one entry, to be published.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outgoing<T> {
    /// Tick of the message.
    pub tick: u64,
    /// Time at which it is valid, s.
    pub valid_at_s: f64,
    /// Its only entry.
    pub entry: T,
}

/// Topic `world`, an entry for each robot: the output of its localiser and the input of its sensor.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "iceoryx2", derive(ZeroCopySend), type_name("rangehound.WorldEntry.v4"))]
#[repr(C)]
pub struct WorldEntry {
    /// Where the robot's simulated or recorded localiser says that it is.
    pub pose: Pose,
    /// The kinds that its sensor can measure at this tick: their [bits](Kind::bit). The other fields are zero.
    pub kinds: u64,
    /// [`Origin`] of range and bearing, as a number.
    pub origin: u64,
    /// Range to the target, m.
    pub range_m: f64,
    /// Bearing of the target from the robot's true heading, rad.
    pub bearing_rad: f64,
}

impl WorldEntry {
    /// The range and the bearing of this origin, as far as there are any.
    #[must_use]
    pub fn of(&self, origin: Origin) -> (Option<f64>, Option<f64>) {
        let value = |kind: Kind, value: f64| {
            (self.origin == origin.to_bits() && self.kinds & kind.bit() != 0 && value.is_finite()).then_some(value)
        };
        (value(Kind::Range, self.range_m), value(Kind::Bearing, self.bearing_rad))
    }

    /// The numbers of which each must be finite.
    pub fn numbers(&self) -> impl Iterator<Item = f64> {
        self.pose.numbers().into_iter().chain([self.range_m, self.bearing_rad])
    }

    /// True if its numbers are finite, and its kinds and origin are known.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        self.numbers().all(f64::is_finite) && self.kinds >> Kind::COUNT == 0 && Origin::from_bits(self.origin).is_some()
    }
}

/// Where the measurements of a [`WorldEntry`] come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Origin {
    /// From the simulated target: the true values, to which the robot's sensor adds its noise.
    #[default]
    Simulated,
    /// From a recording: measured values, which the robot's sensor only calibrates.
    Recorded,
}

impl Origin {
    /// The number of this origin in a message.
    #[must_use]
    pub fn to_bits(self) -> u64 {
        self as u64
    }

    /// The origin with this number.
    #[must_use]
    pub fn from_bits(bits: u64) -> Option<Self> {
        [Self::Simulated, Self::Recorded].into_iter().find(|origin| origin.to_bits() == bits)
    }
}

/// Topic `range`: one robot's measurement at this tick, a range, a bearing or both; also sent without any.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "iceoryx2", derive(ZeroCopySend), type_name("rangehound.Range.v5"))]
#[repr(C)]
pub struct Range {
    /// Id of the robot.
    pub robot: u64,
    /// The measurement and the sensor's pose.
    pub measurement: Measurement,
}

/// Topic `heading`, an entry for each robot: its command until the next tick.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "iceoryx2", derive(ZeroCopySend), type_name("rangehound.Command.v1"))]
#[repr(C)]
pub struct Command {
    /// Heading, rad counter-clockwise from the x axis.
    pub heading_rad: f64,
    /// Speed, m/s.
    pub speed_mps: f64,
}

/// Topic `drive`: one robot's motion until the next tick.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "iceoryx2", derive(ZeroCopySend), type_name("rangehound.Drive.v4"))]
#[repr(C)]
pub struct Drive {
    /// Id of the robot.
    pub robot: u64,
    /// Heading, rad.
    pub heading_rad: f64,
    /// Speed, m/s.
    pub speed_mps: f64,
    /// When the robot's range of this tick was ready to be published, monotonic ns; 0 without a range.
    pub range_sent_ns: u64,
    /// When the robot had the heading of this tick, monotonic ns; 0 if it drives without one.
    pub heading_held_ns: u64,
    /// 1 if the heading came after its deadline.
    pub heading_late: u32,
    /// Headings refused since the last drive message: from a deposed fusion, or a process that never led.
    pub headings_refused: u32,
    /// Time that range and heading spent beyond fusion's host, ns; 0 on one host. The next two are parts of it.
    pub network_ns: u64,
    /// On the robot's host: until the range was sent, and from the frame with the heading until the robot had it, ns.
    pub robot_host_ns: u32,
    /// In the gateway: from the heading until it was sent to the robot, ns.
    pub gateway_ns: u32,
}

/// Why a message was refused. Its contents are never used, but the refusal is counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refusal {
    /// The sender does not hold the role of the robot in the message.
    Impostor,
    /// The robot id is not in the team.
    OutOfRange,
    /// The message has more or fewer than one entry, or invalid numbers for a sensor of this run.
    Malformed,
    /// The tick cannot have begun.
    Future,
    /// The message contradicts the same robot's first message of the same tick.
    Contradiction,
    /// The robot cannot have moved this far since its last message.
    Jump,
}

impl Refusal {
    /// All refusals, in the order of their counts in an [`Estimate`].
    pub const ALL: [Self; 6] =
        [Self::Impostor, Self::OutOfRange, Self::Malformed, Self::Future, Self::Contradiction, Self::Jump];

    /// Name of the refusal in logs and reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Impostor => "impostor",
            Self::OutOfRange => "out of range",
            Self::Malformed => "malformed",
            Self::Future => "future",
            Self::Contradiction => "contradiction",
            Self::Jump => "jump",
        }
    }
}

/// Topic `estimate`: fusion's result of a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "iceoryx2", derive(ZeroCopySend), type_name("rangehound.Estimate.v7"))]
#[repr(C)]
pub struct Estimate {
    /// Dimension n of the state.
    pub state_dim: u64,
    /// State; the first n entries count.
    pub state: [f64; STATE_DIM_MAX],
    /// Covariance, n x n; the first n^2 entries count.
    pub covariance: [f64; STATE_DIM_MAX * STATE_DIM_MAX],
    /// Normalised innovation squared.
    pub nis: f64,
    /// Ranges fused: degrees of freedom of the NIS.
    pub fused: u64,
    /// Normalised innovation squared of all ranges of the tick, fused or not.
    pub nis_all: f64,
    /// Number of these ranges: the degrees of freedom.
    pub tested: u64,
    /// Factor on the stated standard deviations of each [`Kind`], from the next measurement on: more than 1 while most
    /// sensors of that kind fail together.
    pub noise_scale: [f64; Kind::COUNT],
    /// Ranges that failed the gate, or whose robot is distrusted.
    pub rejected: u64,
    /// Robots without a message.
    pub missing: u64,
    /// Ranges of earlier ticks that came since the last estimate.
    pub late: u64,
    /// Of those, how many were fused at their own time.
    pub fused_late: u64,
    /// Of those, how many were rejected at their own time.
    pub rejected_late: u64,
    /// Messages refused since the last estimate, in the order of [`Refusal::ALL`].
    pub refused: [u64; Refusal::ALL.len()],
    /// Robots whose measurements of each [`Kind`] are distrusted: bits of a [`RobotSet`](robot_set::RobotSet).
    pub distrusted: [[u64; robot_set::WORDS]; Kind::COUNT],
    /// Planner's `|S|`, 1/m^2.
    pub objective: f64,
    /// Lower bound on it; `-inf` from planners that prove none.
    pub lower_bound: f64,
    /// Lower bound on the trace of the position covariance at the next tick, m^2, for any headings of this tick, if the robots of
    /// the plan then measure; 0 from planners that prove nothing. Only a late range, unknown to the plan, can reduce the trace
    /// further.
    pub least_trace_m2: f64,
    /// When fusion reached each stage of the tick.
    pub stages: Stages,
    /// Rolling digest after this tick, low and high half.
    pub digest: [u64; 2],
}

/// When fusion reached each stage of a tick, monotonic ns; 0 if the time was not taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "iceoryx2", derive(ZeroCopySend), type_name("rangehound.Stages.v1"))]
#[repr(C)]
pub struct Stages {
    /// The last of the tick's ranges was sent, by its robot's time stamp.
    pub last_range_ns: u64,
    /// Fusion had all expected ranges.
    pub began_ns: u64,
    /// Prediction and update were done.
    pub filtered_ns: u64,
    /// The headings were chosen.
    pub planned_ns: u64,
    /// The checkpoint was written.
    pub saved_ns: u64,
    /// The headings were sent; the robots were not yet woken.
    pub sent_ns: u64,
}

/// Topic `truth`: data that only the simulator has.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "iceoryx2", derive(ZeroCopySend), type_name("rangehound.Truth.v1"))]
#[repr(C)]
pub struct Truth {
    /// Dimension n of the state; 0 if there is no truth, as in a recording.
    pub state_dim: u64,
    /// Target's true state; the first n entries count.
    pub state: [f64; STATE_DIM_MAX],
    /// Ticks of the run.
    pub ticks: u64,
    /// End-to-end latency of the slowest robot in the last tick, ns; 0 if unknown.
    pub latency_ns: u64,
}

impl Default for Estimate {
    fn default() -> Self {
        Self {
            state_dim: 0,
            state: [0.0; STATE_DIM_MAX],
            covariance: [0.0; STATE_DIM_MAX * STATE_DIM_MAX],
            nis: 0.0,
            fused: 0,
            nis_all: 0.0,
            tested: 0,
            noise_scale: [1.0; Kind::COUNT],
            rejected: 0,
            missing: 0,
            late: 0,
            fused_late: 0,
            rejected_late: 0,
            refused: [0; Refusal::ALL.len()],
            distrusted: [[0; robot_set::WORDS]; Kind::COUNT],
            objective: 0.0,
            lower_bound: f64::NEG_INFINITY,
            least_trace_m2: 0.0,
            stages: Stages::default(),
            digest: [0; 2],
        }
    }
}

impl Drive {
    /// From publishing the range to receiving the heading computed from it; `None` if either is missing.
    #[must_use]
    pub fn latency_ns(&self) -> Option<u64> {
        if self.range_sent_ns == 0 || self.heading_held_ns == 0 {
            return None;
        }
        self.heading_held_ns.checked_sub(self.range_sent_ns)
    }
}

// The memory layout that other builds read: change it only on purpose.
const _: () = {
    assert!(size_of::<Header>() == 40);
    assert!(size_of::<WorldEntry>() == 96);
    assert!(size_of::<Range>() == 112);
    assert!(size_of::<Command>() == 16);
    assert!(size_of::<Drive>() == 64);
    assert!(size_of::<Estimate>() == 1064);
    assert!(size_of::<Truth>() == 88);
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_invalid_world_entry_is_detected() {
        let valid = WorldEntry { kinds: 3, origin: Origin::Recorded.to_bits(), ..WorldEntry::default() };
        assert!(valid.is_valid());
        for nonsense in [
            WorldEntry { pose: Pose::at([f64::NAN, 0.0]), ..valid },
            WorldEntry { pose: Pose::at([0.0, f64::INFINITY]), ..valid },
            WorldEntry { range_m: f64::NAN, ..valid },
            WorldEntry { bearing_rad: f64::INFINITY, ..valid },
            WorldEntry { pose: Pose { height_m: f64::NAN, ..Pose::default() }, ..valid },
            WorldEntry { pose: Pose { heading_rad: f64::NAN, ..Pose::default() }, ..valid },
            WorldEntry { pose: Pose { covariance_m2: [f64::NAN, 0.0, 0.0], ..Pose::default() }, ..valid },
            WorldEntry { kinds: 4, ..valid },
            WorldEntry { origin: 2, ..valid },
        ] {
            assert!(!nonsense.is_valid(), "{nonsense:?}");
        }
    }
}
