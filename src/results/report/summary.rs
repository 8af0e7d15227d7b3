//! The summary of a run: the keys of `report.json`.

use rangehound_node::rendezvous::Role;
use rangehound_shared::measurement::Kind;
use rangehound_shared::message::Estimate;
use rangehound_shared::record::{Heading, RobotRecord};
use rangehound_shared::recording::ReadSummary;
use rangehound_shared::scenario::{Scenario, title_of};
use serde::{Deserialize, Serialize};

use super::verdict::Verdict;
use crate::results::hops::HopSummary;
use crate::results::percentiles::Point;
use crate::statistics::Samples;

/// The summary of a run; its fields are the keys of `report.json`.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// Name of the scenario.
    pub scenario: String,
    /// Seed.
    pub seed: u64,
    /// Clock: `realtime` or `lockstep`.
    pub clock: String,
    /// True if one process made the run: then no clock paced it.
    #[serde(skip)]
    pub in_one_process: bool,
    /// Planner.
    pub planner: String,
    /// Robots (or sensors of a recording).
    pub robots: usize,
    /// Completed time steps.
    pub ticks: u64,
    /// From the end of tick 0, when the team is complete, to the end of the last tick, s.
    pub wall_s: f64,
    /// `ticks / wall_s`.
    pub ticks_per_s: f64,
    /// Hash over (tick, state, covariance) bits of all ticks.
    pub digest: String,
    /// Root mean square of the position error, m; null if the truth is unknown.
    pub position_rmse_m: Option<f64>,
    /// When the target was found; absent if its position was known at once, or never.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub found: Option<FoundSummary>,
    /// Position error squared over its covariance, averaged over the ticks, per degree of freedom:
    /// 1 for a consistent filter; null if the truth is unknown.
    pub anees: Option<f64>,
    /// Innovation squared over its covariance, averaged over the ticks, per range: 1 for a consistent
    /// filter; null if no range was fused.
    pub nis_mean: Option<f64>,
    /// The same over all ranges, fused or not: far above 1 if valid ranges are rejected.
    pub nis_all_mean: Option<f64>,
    /// Ticks after which the assumed range noise was increased, because most sensors failed the gate together.
    pub gate_widened: u64,
    /// Trace of the position covariance.
    pub position_trace_m2: TraceSummary,
    /// The outcome of the ranges.
    pub ranges: RangeSummary,
    /// The outcome of each sensor's ranges, in the order of the robots' ids.
    pub sensors: Vec<SensorSummary>,
    /// Range messages that fusion refused, by cause.
    pub refused: RefusalSummary,
    /// The used and the skipped parts of the recording; null for a simulated run.
    pub recording: Option<ReadSummary>,
    /// Intervals in which robots were distrusted.
    pub distrusted: Vec<Distrust>,
    /// The headings that the robots followed.
    pub headings: HeadingSummary,
    /// From publishing a range to holding the heading computed from it.
    pub latency_us: LatencySummary,
    /// The same as a curve.
    #[serde(skip)]
    pub percentiles: Vec<Point>,
    /// The hops of that time.
    pub hops_us: HopSummary,
    /// The processes.
    pub nodes: Vec<NodeSummary>,
    /// Whether the result is credible.
    pub verdict: Verdict,
}

impl Report {
    /// The word for what was counted: "ranges", or "measurements" if some are bearings.
    #[must_use]
    pub fn measured(&self) -> &'static str {
        measured(self.has_bearings())
    }

    /// True if fusion received bearings.
    #[must_use]
    pub fn has_bearings(&self) -> bool {
        self.sensors.iter().any(|sensor| sensor.bearings.is_some())
    }

    /// True if robots followed headings, and the time from range to heading is known. The sensors of a recording follow none.
    #[must_use]
    pub fn has_latency(&self) -> bool {
        self.recording.is_none() && self.latency_us.count > 0
    }
}

/// The word for what is counted in a run.
#[must_use]
pub fn measured(has_bearings: bool) -> &'static str {
    if has_bearings { "measurements" } else { "ranges" }
}

/// When the target was found after a search.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FoundSummary {
    /// The first tick at which the standard deviation of the position is at most 0.3 of the median measured distance.
    pub tick: u64,
    /// Root mean square of the position error from that tick on, m; null if the truth is unknown.
    pub position_rmse_m: Option<f64>,
}

/// Trace of the position covariance, m^2.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct TraceSummary {
    /// After the last tick.
    pub r#final: f64,
    /// Median over the ticks after tick 0.
    pub median: f64,
}

/// The outcome of the ranges, and of the bearings if there are any. A robot's range of a tick is fused, rejected or missing:
/// their sum is robots times ticks where every robot has a range, and nothing else, at every tick.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct RangeSummary {
    /// Published by robots, as logged by fusion or reported to the simulator by the end of the tick.
    pub published: u64,
    /// Fused, in time or late.
    pub fused: u64,
    /// Failed the gate or came from a distrusted robot, in time or late.
    pub rejected: u64,
    /// Came after their tick: fused, rejected, or, after more than a few ticks, missing.
    pub late: u64,
    /// Of the late ones, fused at their own time.
    pub fused_late: u64,
    /// Ranges missing or too late, summed over the ticks.
    pub missing: u64,
}

/// The outcome of one sensor's ranges and bearings, in time or late: fused, rejected and distrusted add up to all.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct SensorSummary {
    /// The sensor's name in the recording, or its robot's id.
    pub name: String,
    /// Ranges that fusion received and tested.
    pub ranges: u64,
    /// Fused.
    pub fused: u64,
    /// Failed the gate.
    pub rejected: u64,
    /// Not fused because the robot was distrusted, whether or not they passed the gate.
    pub distrusted: u64,
    /// Each range's squared innovation over its variance, averaged over all ranges with a prediction: 1 if the sensor is
    /// as accurate as specified.
    pub nis_mean: Option<f64>,
    /// The same of its bearings, if it had any.
    #[serde(flatten)]
    pub bearings: Option<BearingSummary>,
}

/// The outcome of one sensor's bearings, as that of its ranges in [`SensorSummary`].
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct BearingSummary {
    /// Bearings that fusion received and tested.
    pub bearings: u64,
    /// Fused.
    pub bearings_fused: u64,
    /// Failed the gate.
    pub bearings_rejected: u64,
    /// Not fused because the robot's bearings were distrusted.
    pub bearings_distrusted: u64,
    /// Each bearing's squared innovation over its variance, averaged.
    pub bearings_nis_mean: Option<f64>,
}

/// Messages that fusion refused, by [`Refusal`](rangehound_shared::message::Refusal).
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct RefusalSummary {
    /// Its sender does not hold the role.
    pub impostor: u64,
    /// The id is of no robot of the team.
    pub out_of_range: u64,
    /// Invalid numbers.
    pub malformed: u64,
    /// The tick cannot have begun.
    pub future: u64,
    /// Contradicts an earlier message.
    pub contradiction: u64,
    /// The robot cannot have reached this position.
    pub jump: u64,
}

/// Ticks at which a robot's ranges or bearings were not fused because they kept failing the gate.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Distrust {
    /// The robot.
    pub robot: usize,
    /// The sensor's name in the recording, or the robot's id.
    pub sensor: String,
    /// The kind that was not fused: `range` or `bearing`.
    pub kind: &'static str,
    /// The tick after whose range it was distrusted.
    pub from_tick: u64,
    /// The tick after whose range it was trusted again; null if it never was.
    pub to_tick: Option<u64>,
}

/// The suffix of a sensor's name if only its bearings are meant.
#[must_use]
pub fn of_bearings(kind: &str) -> &'static str {
    if kind == Kind::Bearing.name() { " (bearings)" } else { "" }
}

/// The headings that the robots followed, summed over robots and ticks; ticks without the robot's answer do not count.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct HeadingSummary {
    /// The tick's heading.
    pub fresh: u64,
    /// The tick's heading, when it was overdue.
    pub late: u64,
    /// No heading for the tick: the robot kept its last one, or stood still.
    pub none: u64,
    /// Refused headings: from a deposed fusion or a stranger.
    pub refused: u64,
}

impl HeadingSummary {
    pub(super) fn add(&mut self, robot: &RobotRecord) {
        match robot.heading {
            Heading::Fresh => self.fresh += 1,
            Heading::Late => self.late += 1,
            Heading::None => self.none += 1,
            Heading::Unknown => {}
        }
        count(&mut self.refused, robot.headings_refused);
    }
}

/// Adds without overflow; a damaged log may hold any number.
fn count(sum: &mut u64, more: u64) {
    *sum = sum.saturating_add(more);
}

/// Percentiles of the end-to-end latency, us.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct LatencySummary {
    /// Samples.
    pub count: u64,
    /// Median.
    pub p50: f64,
    /// 90 %.
    pub p90: f64,
    /// 99 %.
    pub p99: f64,
    /// 99.9 %.
    pub p99_9: f64,
    /// Largest.
    pub max: f64,
}

impl LatencySummary {
    /// Percentiles of latencies.
    #[must_use]
    pub fn of(latencies_us: &Samples) -> Self {
        Self {
            count: latencies_us.count(),
            p50: latencies_us.at(0.5),
            p90: latencies_us.at(0.9),
            p99: latencies_us.at(0.99),
            p99_9: latencies_us.at(0.999),
            max: latencies_us.max(),
        }
    }
}

/// One process of the run.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct NodeSummary {
    /// `sim`, `fusion`, `robot-0`, ...
    pub name: String,
    /// The name of a robot's sensor in the recording; left out for other nodes, and in a simulated run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor: Option<String>,
    /// How often it was started.
    pub starts: u64,
    /// How often a signal ended it.
    pub kills: u64,
    /// How often it ended by itself before the run did.
    pub exits: u64,
    /// How often it was killed because it sent no heartbeat; included in the kills.
    pub hangs: u64,
    /// Its incidents, monotonic ns, in order, as far as its supervisor knows.
    #[serde(skip)]
    pub incidents: Vec<(u64, Incident)>,
}

impl NodeSummary {
    /// A process with this number of starts and no other incidents.
    #[must_use]
    pub fn new(role: Role, scenario: &Scenario, starts: u64) -> Self {
        let sensor = role.robot().and_then(|id| scenario.sensor_of(id)).map(str::to_owned);
        Self { name: role.to_string(), sensor, starts, kills: 0, exits: 0, hangs: 0, incidents: Vec::new() }
    }

    /// Its display name: `robot-0 (2938)`.
    #[must_use]
    pub fn title(&self) -> String {
        title_of(&self.name, self.sensor.as_deref())
    }
}

/// An incident of a process.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Incident {
    /// It sent no heartbeat for too long; it is killed next.
    Hung,
    /// It was ended by a signal.
    Killed,
    /// It ended by itself before the run did.
    Exited,
    /// It was started.
    Started,
}

impl Incident {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Hung, Self::Killed, Self::Exited, Self::Started];
}

impl std::fmt::Display for Incident {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Hung => "hung",
            Self::Killed => "killed",
            Self::Exited => "exited",
            Self::Started => "started",
        })
    }
}

impl RangeSummary {
    /// Adds a tick as logged by fusion.
    pub fn add(&mut self, estimate: &Estimate) {
        let in_time_and_late = [
            (&mut self.fused, estimate.fused, estimate.fused_late),
            (&mut self.rejected, estimate.rejected, estimate.rejected_late),
        ];
        for (sum, in_time, late) in in_time_and_late {
            count(sum, in_time);
            count(sum, late);
        }
        count(&mut self.late, estimate.late);
        count(&mut self.fused_late, estimate.fused_late);
        // A late range was counted as missing at its own tick.
        count(&mut self.missing, estimate.missing);
        self.missing = self.missing.saturating_sub(estimate.fused_late).saturating_sub(estimate.rejected_late);
    }
}

impl RefusalSummary {
    pub(super) fn add(&mut self, estimate: &Estimate) {
        let Self { impostor, out_of_range, malformed, future, contradiction, jump } = self;
        // In the order of `Refusal::ALL`.
        let sums = [impostor, out_of_range, malformed, future, contradiction, jump];
        sums.into_iter().zip(estimate.refused).for_each(|(sum, refused)| count(sum, refused));
    }
}
