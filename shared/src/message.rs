//! What travels on each topic: `repr(C)`, versioned by type name, sizes pinned.
//!
//! Every message is a slice of one of the payloads below under a [`Header`]. A change of fields
//! needs a new version in the type name: iceoryx2 compares names and sizes, not meanings.

#[cfg(feature = "iceoryx2")]
use iceoryx2::prelude::ZeroCopySend;
use serde::{Deserialize, Serialize};

use crate::measurement::{Measurement, Pose};
use crate::{STATE_DIM_MAX, robot_set};

/// What every message carries.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "iceoryx2", derive(ZeroCopySend), type_name("rangehound.Header.v1"))]
#[repr(C)]
pub struct Header {
    /// Id of the run: a message of another run is ignored.
    pub run_id: u64,
    /// Which start of the sender's role sent it, counted from 1.
    pub incarnation: u64,
    /// Tick that the contents belong to.
    pub tick: u64,
    /// Time that the contents are valid for, s since the run's or recording's zero.
    pub valid_at_s: f64,
    /// When it was sent, monotonic ns.
    pub sent_ns: u64,
}

/// A message of one entry, to be published.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outgoing<T> {
    /// The tick that it belongs to.
    pub tick: u64,
    /// Time that it is valid for, s.
    pub valid_at_s: f64,
    /// Its only entry.
    pub entry: T,
}

/// Topic `world`, an entry for each robot: where it is and what its sensor would measure.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "iceoryx2", derive(ZeroCopySend), type_name("rangehound.WorldEntry.v3"))]
#[repr(C)]
pub struct WorldEntry {
    /// Where it is.
    pub pose: Pose,
    /// Range to the target, m; see `range_kind`.
    pub range_m: f64,
    /// [`RangeKind`] as a number.
    pub range_kind: u64,
}

impl WorldEntry {
    /// True if its numbers are numbers and its range is of a kind.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        let Self { pose, range_m, range_kind } = *self;
        pose.numbers().iter().all(|value| value.is_finite())
            && range_m.is_finite()
            && RangeKind::from_bits(range_kind).is_some()
    }
}

/// What the range of a [`WorldEntry`] is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RangeKind {
    /// No range at this tick.
    Absent,
    /// The true distance: the robot's sensor adds its noise.
    True,
    /// A recorded measurement: the robot's sensor only calibrates it.
    Measured,
}

impl RangeKind {
    /// Its number in a message.
    #[must_use]
    pub fn to_bits(self) -> u64 {
        match self {
            Self::Absent => 0,
            Self::True => 1,
            Self::Measured => 2,
        }
    }

    /// The kind with this number.
    #[must_use]
    pub fn from_bits(bits: u64) -> Option<Self> {
        [Self::Absent, Self::True, Self::Measured].into_iter().find(|kind| kind.to_bits() == bits)
    }
}

/// Topic `range`: what one robot measured at this tick, or its word that it has nothing.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "iceoryx2", derive(ZeroCopySend), type_name("rangehound.Range.v3"))]
#[repr(C)]
pub struct Range {
    /// Id of the robot.
    pub robot: u64,
    /// What it measured, and where.
    pub measurement: Measurement,
    /// When the tick began, monotonic ns, as `world` said: what real-time deadlines count from.
    pub tick_began_ns: u64,
}

/// Topic `heading`, an entry for each robot: what it shall drive until the next tick.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "iceoryx2", derive(ZeroCopySend), type_name("rangehound.Command.v1"))]
#[repr(C)]
pub struct Command {
    /// Heading, rad counter-clockwise from the x axis.
    pub heading_rad: f64,
    /// Speed, m/s.
    pub speed_mps: f64,
}

/// Topic `drive`: what one robot carries out until the next tick.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "iceoryx2", derive(ZeroCopySend), type_name("rangehound.Drive.v2"))]
#[repr(C)]
pub struct Drive {
    /// Id of the robot.
    pub robot: u64,
    /// Heading, rad.
    pub heading_rad: f64,
    /// Speed, m/s.
    pub speed_mps: f64,
    /// When its range of this tick was ready to be published, monotonic ns; 0 if it had none.
    pub range_sent_ns: u64,
    /// When it held the heading of this tick, monotonic ns; 0 if it drives without one.
    pub heading_held_ns: u64,
    /// 1 if the heading came when it was overdue.
    pub heading_late: u64,
    /// Headings refused since the drive before: from a fusion that was deposed, or a process that never led.
    pub headings_refused: u64,
}

/// Why a message was refused: its contents are never used, but it is counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refusal {
    /// Its sender does not hold the role of the robot that it names.
    Impostor,
    /// It names a robot that the team does not have.
    OutOfRange,
    /// Not one entry, or numbers that no sensor of this run gives.
    Malformed,
    /// Of a tick that cannot have begun.
    Future,
    /// It says other than the same robot's first message of the same tick.
    Contradiction,
    /// The robot cannot have come from where it last was to where it says it is.
    Jump,
}

impl Refusal {
    /// All of them, in the order of their counts in an [`Estimate`].
    pub const ALL: [Self; 6] =
        [Self::Impostor, Self::OutOfRange, Self::Malformed, Self::Future, Self::Contradiction, Self::Jump];

    /// What it is called in logs and reports.
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

/// Topic `estimate`: what fusion knows after a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "iceoryx2", derive(ZeroCopySend), type_name("rangehound.Estimate.v6"))]
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
    /// Normalised innovation squared of all ranges of the tick, whether they were fused or not.
    pub nis_all: f64,
    /// Ranges in it: its degrees of freedom.
    pub tested: u64,
    /// How many times larger than told the filter takes the standard deviations of ranges from the next on: more than 1
    /// while most sensors fail together.
    pub noise_scale: f64,
    /// Ranges that failed the gate, or whose robot is distrusted.
    pub rejected: u64,
    /// Robots not heard.
    pub missing: u64,
    /// Ranges of earlier ticks that came since the last estimate.
    pub late: u64,
    /// Of those, how many were fused at their own time.
    pub fused_late: u64,
    /// Of those, how many were rejected at their own time.
    pub rejected_late: u64,
    /// Messages refused since the last estimate, in the order of [`Refusal::ALL`].
    pub refused: [u64; Refusal::ALL.len()],
    /// Robots that are distrusted: bits of a [`RobotSet`](robot_set::RobotSet).
    pub distrusted: [u64; robot_set::WORDS],
    /// Planner's `|S|`, 1/m^2.
    pub objective: f64,
    /// Lower bound on it; `-inf` from planners that prove none.
    pub lower_bound: f64,
    /// No headings of this tick lead to a lesser trace of the position covariance at the next, m^2, if those who are planned
    /// for then measure; 0 from planners that prove nothing. Only a late range, of which the plan did not know, can bring it
    /// below.
    pub least_trace_m2: f64,
    /// When fusion came to each stage of the tick.
    pub stages: Stages,
    /// Rolling digest after this tick, low and high half.
    pub digest: [u64; 2],
}

/// When fusion came to each stage of a tick, monotonic ns; 0 where nobody looked at a clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "iceoryx2", derive(ZeroCopySend), type_name("rangehound.Stages.v1"))]
#[repr(C)]
pub struct Stages {
    /// The last of the tick's ranges was sent, as its robot says.
    pub last_range_ns: u64,
    /// Fusion had all that it waited for.
    pub began_ns: u64,
    /// Prediction and update were done.
    pub filtered_ns: u64,
    /// The headings were chosen.
    pub planned_ns: u64,
    /// The checkpoint was written.
    pub saved_ns: u64,
    /// The headings were sent; their robots were still to be woken.
    pub sent_ns: u64,
}

/// Topic `truth`: what only the simulator knows.
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
    /// Slowest robot's end-to-end latency in the tick before, ns; 0 if none is known.
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
            noise_scale: 1.0,
            rejected: 0,
            missing: 0,
            late: 0,
            fused_late: 0,
            rejected_late: 0,
            refused: [0; Refusal::ALL.len()],
            distrusted: [0; robot_set::WORDS],
            objective: 0.0,
            lower_bound: f64::NEG_INFINITY,
            least_trace_m2: 0.0,
            stages: Stages::default(),
            digest: [0; 2],
        }
    }
}

impl Drive {
    /// From publishing the range to holding the heading computed from it; `None` without either.
    #[must_use]
    pub fn latency_ns(&self) -> Option<u64> {
        if self.range_sent_ns == 0 || self.heading_held_ns == 0 {
            return None;
        }
        self.heading_held_ns.checked_sub(self.range_sent_ns)
    }
}

// What other builds read from shared memory: a change must be a decision.
const _: () = {
    assert!(size_of::<Header>() == 40);
    assert!(size_of::<WorldEntry>() == 64);
    assert!(size_of::<Range>() == 88);
    assert!(size_of::<Command>() == 16);
    assert!(size_of::<Drive>() == 56);
    assert!(size_of::<Estimate>() == 928);
    assert!(size_of::<Truth>() == 88);
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_entry_of_the_world_without_sense_is_told() {
        let sound = WorldEntry { range_kind: RangeKind::True.to_bits(), ..WorldEntry::default() };
        assert!(sound.is_sound());
        for nonsense in [
            WorldEntry { pose: Pose::at([f64::NAN, 0.0]), ..sound },
            WorldEntry { pose: Pose::at([0.0, f64::INFINITY]), ..sound },
            WorldEntry { range_m: f64::NAN, ..sound },
            WorldEntry { pose: Pose { height_m: f64::NAN, ..Pose::default() }, ..sound },
            WorldEntry { pose: Pose { covariance_m2: [f64::NAN, 0.0, 0.0], ..Pose::default() }, ..sound },
            WorldEntry { range_kind: 3, ..sound },
        ] {
            assert!(!nonsense.is_sound(), "{nonsense:?}");
        }
    }
}
