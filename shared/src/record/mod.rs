//! The records that fusion and the simulator write of each tick.

pub mod digest;
mod fields;

use serde::{Deserialize, Serialize};

use crate::STATE_DIM_MAX;
use crate::measurement::{Kind, Measurement, Pose};
use crate::message::{Command, Drive, Estimate, WorldEntry};
use crate::scenario::Scenario;
pub use fields::{Fields, Record, count, describe, put, take};

/// Fusion's record of one tick.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FusionRecord {
    /// Time at which the estimate is valid, s.
    pub time_s: f64,
    /// The estimate and its counts.
    pub estimate: Estimate,
    /// Its exchange with each robot.
    pub exchanges: Vec<Exchange>,
}

/// Fusion's exchange with one robot at one tick.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Exchange {
    /// The data used from the robot's message of this tick, if one came in time.
    pub heard: Option<Heard>,
    /// The command to the robot.
    pub command: Command,
}

/// The data that fusion used from a robot's message.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Heard {
    /// The measurement and the sensor's pose.
    pub measurement: Measurement,
    /// The first tick whose estimate uses it: the message's own, or a later one if it came late.
    pub taken_at: u64,
    /// Fusion's decision on each [`Kind`]; `None` where it was not measured, and at tick 0.
    pub judged: GateResults,
}

/// Fusion's decision on each kind of a measurement.
pub type GateResults = [Option<GateResult>; Kind::COUNT];

/// Fusion's decision on a value that was measured, and the value's agreement with its prediction.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct GateResult {
    /// The decision.
    pub used: FusionDecision,
    /// The value's own normalised innovation squared, `nu^2 / S`: one degree of freedom. `None` if nothing
    /// predicted the value.
    pub normalised_square: Option<f64>,
}

/// Fusion's decision on a range or a bearing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum FusionDecision {
    /// It was fused.
    Fused,
    /// It failed the gate.
    Rejected,
    /// The sensor was distrusted.
    Distrusted,
}

impl FusionDecision {
    /// All decisions.
    pub const ALL: [Self; 3] = [Self::Fused, Self::Rejected, Self::Distrusted];

    /// Name of the decision in recordings.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Fused => "fused",
            Self::Rejected => "rejected",
            Self::Distrusted => "distrusted",
        }
    }
}

/// The simulator's record of one tick.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct WorldRecord {
    /// Time of the tick, s.
    pub time_s: f64,
    /// End of the tick, monotonic ns.
    pub ended_ns: u64,
    /// The target's true state; empty for a recording.
    pub truth: Vec<f64>,
    /// Each robot's part in the tick.
    pub robots: Vec<RobotRecord>,
}

/// One robot's part in one tick.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RobotRecord {
    /// The robot's true pose; in a recording, the pose that its localiser reported.
    pub pose: Pose,
    /// Range that the world gave its sensor, m, if any: the true range, or a recorded one.
    pub range_m: Option<f64>,
    /// The same for the bearing from the robot's true heading, rad.
    pub bearing_rad: Option<f64>,
    /// When it published its range, monotonic ns, if its sensor had one.
    pub range_sent_ns: Option<u64>,
    /// When it received the tick's heading, monotonic ns, if it did.
    pub heading_held_ns: Option<u64>,
    /// Origin of the heading that it drove.
    pub heading: Heading,
    /// Its motion; standing still if it did not answer.
    pub driven: Command,
    /// Headings that it refused since the last tick.
    pub headings_refused: u64,
    /// Time that range and heading spent beyond fusion's host, ns; 0 on one host.
    pub network_ns: u64,
    /// Part of it on the robot's host, ns.
    pub robot_host_ns: u64,
    /// Part of it in the gateway, ns.
    pub gateway_ns: u64,
}

impl RobotRecord {
    /// From publishing the range to receiving the heading computed from it, ns; `None` if either is missing.
    #[must_use]
    pub fn latency_ns(&self) -> Option<u64> {
        self.heading_held_ns?.checked_sub(self.range_sent_ns?)
    }
}

/// Origin of the heading that a robot drove in one tick.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Heading {
    /// Unknown: it did not answer.
    #[default]
    Unknown,
    /// This tick's heading.
    Fresh,
    /// This tick's heading, received after its deadline.
    Late,
    /// No heading of this tick: it kept the last one, or stood still.
    None,
}

impl Heading {
    /// All origins.
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

impl FusionRecord {
    /// A record sized for a run of this scenario.
    #[must_use]
    pub fn of(scenario: &Scenario) -> Self {
        let estimate = Estimate { state_dim: scenario.motion.state_dim() as u64, ..Estimate::default() };
        Self { time_s: 0.0, estimate, exchanges: vec![Exchange::default(); scenario.robots.len()] }
    }

    /// Replaces the contents by those of a tick. The number of exchanges stays the same.
    pub fn set(&mut self, time_s: f64, estimate: &Estimate, exchanges: impl Iterator<Item = Exchange>) {
        (self.time_s, self.estimate) = (time_s, *estimate);
        self.exchanges.iter_mut().zip(exchanges).for_each(|(slot, exchange)| *slot = exchange);
    }
}

impl Record for FusionRecord {
    fn fields(&mut self, fields: &mut impl Fields) {
        let Self { time_s, estimate, exchanges } = self;
        let Estimate { stages, .. } = estimate;
        fields.number("time_s", time_s);
        fields.number("nis", &mut estimate.nis);
        fields.whole("fused", &mut estimate.fused);
        fields.number("nis_all", &mut estimate.nis_all);
        fields.whole("tested", &mut estimate.tested);
        fields.numbers("noise_scale", &mut estimate.noise_scale);
        fields.whole("rejected", &mut estimate.rejected);
        fields.whole("missing", &mut estimate.missing);
        fields.whole("late", &mut estimate.late);
        fields.whole("fused_late", &mut estimate.fused_late);
        fields.whole("rejected_late", &mut estimate.rejected_late);
        fields.integers("refused", &mut estimate.refused);
        let [ranges, bearings] = &mut estimate.distrusted;
        fields.integers("distrusted_bits", ranges);
        fields.integers("distrusted_bearing_bits", bearings);
        fields.number("objective", &mut estimate.objective);
        fields.number("lower_bound", &mut estimate.lower_bound);
        fields.number("least_trace_m2", &mut estimate.least_trace_m2);
        fields.whole("last_range_ns", &mut stages.last_range_ns);
        fields.whole("began_ns", &mut stages.began_ns);
        fields.whole("filtered_ns", &mut stages.filtered_ns);
        fields.whole("planned_ns", &mut stages.planned_ns);
        fields.whole("saved_ns", &mut stages.saved_ns);
        fields.whole("sent_ns", &mut stages.sent_ns);
        fields.integers("digest", &mut estimate.digest);
        let n = (estimate.state_dim as usize).min(STATE_DIM_MAX);
        fields.numbers("state", &mut estimate.state[..n]);
        fields.numbers("covariance", &mut estimate.covariance[..n * n]);
        fields.each("robots", exchanges, Exchange::fields);
    }
}

impl Exchange {
    fn fields(&mut self, fields: &mut impl Fields) {
        let Heard { mut measurement, taken_at, mut judged } = self.heard.unwrap_or_default();
        let mut taken = self.heard.map_or(0, |_| taken_at + 1);
        pose_fields(&mut measurement.pose, fields);
        fields.whole("kinds", &mut measurement.kinds);
        fields.number("range_m", &mut measurement.range_m);
        fields.number("range_std_m", &mut measurement.range_std_m);
        fields.number("bearing_rad", &mut measurement.bearing_rad);
        fields.number("bearing_std_rad", &mut measurement.bearing_std_rad);
        fields.whole("taken_at_plus_1", &mut taken);
        let [range, bearing] = &mut judged;
        judged_fields(range, ["used", "normalised_square"], fields);
        judged_fields(bearing, ["bearing_used", "bearing_normalised_square"], fields);
        fields.number("heading_rad", &mut self.command.heading_rad);
        fields.number("speed_mps", &mut self.command.speed_mps);
        self.heard = taken.checked_sub(1).map(|taken_at| Heard { measurement, taken_at, judged });
    }
}

fn judged_fields(judged: &mut Option<GateResult>, [used_name, square_name]: [&str; 2], fields: &mut impl Fields) {
    let mut used = judged.map_or(0, |judged| judged.used as u64 + 1);
    // A value without a prediction has no normalised innovation.
    let mut square = judged.and_then(|judged| judged.normalised_square).unwrap_or(f64::NAN);
    fields.whole(used_name, &mut used);
    fields.number(square_name, &mut square);
    let used = used.checked_sub(1).and_then(|used| FusionDecision::ALL.get(usize::try_from(used).ok()?).copied());
    let normalised_square = Some(square).filter(|square| !square.is_nan());
    *judged = used.map(|used| GateResult { used, normalised_square });
}

fn pose_fields(pose: &mut Pose, fields: &mut impl Fields) {
    fields.number("x_m", &mut pose.x_m);
    fields.number("y_m", &mut pose.y_m);
    fields.number("height_m", &mut pose.height_m);
    fields.number("pose_heading_rad", &mut pose.heading_rad);
    fields.numbers("position_covariance_m2", &mut pose.covariance_m2);
    fields.number("heading_std_rad", &mut pose.heading_std_rad);
}

impl WorldRecord {
    /// A record sized for a run of this scenario.
    #[must_use]
    pub fn of(scenario: &Scenario) -> Self {
        let truth_dim = if scenario.has_truth() { scenario.motion.state_dim() } else { 0 };
        let robots = vec![RobotRecord::default(); scenario.robots.len()];
        Self { time_s: 0.0, ended_ns: 0, truth: vec![0.0; truth_dim], robots }
    }

    /// Replaces the contents by those of a tick. The numbers of states and robots stay the same.
    ///
    /// `poses` are the robots' true ones.
    pub fn set<'a>(
        &mut self,
        (time_s, ended_ns): (f64, u64),
        truth: &[f64],
        poses: &[Pose],
        world: &[WorldEntry],
        drives: impl IntoIterator<Item = &'a Option<Drive>>,
    ) {
        (self.time_s, self.ended_ns) = (time_s, ended_ns);
        self.truth.iter_mut().zip(truth).for_each(|(slot, value)| *slot = *value);
        for (((slot, pose), entry), drive) in self.robots.iter_mut().zip(poses).zip(world).zip(drives) {
            *slot = RobotRecord::of(*pose, entry, *drive);
        }
    }
}

impl Record for WorldRecord {
    fn fields(&mut self, fields: &mut impl Fields) {
        fields.number("time_s", &mut self.time_s);
        fields.whole("ended_ns", &mut self.ended_ns);
        fields.numbers("truth", &mut self.truth);
        fields.each("robots", &mut self.robots, RobotRecord::fields);
    }
}

impl RobotRecord {
    fn of(pose: Pose, entry: &WorldEntry, drive: Option<Drive>) -> Self {
        let stamp = |ns: u64| (ns != 0).then_some(ns);
        let has = |kind: Kind| entry.kinds & kind.bit() != 0;
        Self {
            pose,
            range_m: has(Kind::Range).then_some(entry.range_m),
            bearing_rad: has(Kind::Bearing).then_some(entry.bearing_rad),
            range_sent_ns: drive.and_then(|drive| stamp(drive.range_sent_ns)),
            heading_held_ns: drive.and_then(|drive| stamp(drive.heading_held_ns)),
            heading: Heading::of(drive),
            driven: drive.map_or_else(Command::default, |drive| Command {
                heading_rad: drive.heading_rad,
                speed_mps: drive.speed_mps,
            }),
            headings_refused: drive.map_or(0, |drive| drive.headings_refused.into()),
            network_ns: drive.map_or(0, |drive| drive.network_ns),
            robot_host_ns: drive.map_or(0, |drive| drive.robot_host_ns.into()),
            gateway_ns: drive.map_or(0, |drive| drive.gateway_ns.into()),
        }
    }

    fn fields(&mut self, fields: &mut impl Fields) {
        let [mut range_m, mut bearing_rad] = [self.range_m, self.bearing_rad].map(|value| value.unwrap_or(f64::NAN));
        let [mut sent_ns, mut held_ns] = [self.range_sent_ns, self.heading_held_ns].map(Option::unwrap_or_default);
        let mut heading = self.heading as u64;
        pose_fields(&mut self.pose, fields);
        fields.number("range_m", &mut range_m);
        fields.number("bearing_rad", &mut bearing_rad);
        fields.whole("range_sent_ns", &mut sent_ns);
        fields.whole("heading_held_ns", &mut held_ns);
        fields.whole("heading", &mut heading);
        fields.number("heading_rad", &mut self.driven.heading_rad);
        fields.number("speed_mps", &mut self.driven.speed_mps);
        fields.whole("headings_refused", &mut self.headings_refused);
        fields.whole("network_ns", &mut self.network_ns);
        fields.whole("robot_host_ns", &mut self.robot_host_ns);
        fields.whole("gateway_ns", &mut self.gateway_ns);
        let stamp = |ns: u64| (ns != 0).then_some(ns);
        [self.range_m, self.bearing_rad] = [range_m, bearing_rad].map(|value| Some(value).filter(|it| !it.is_nan()));
        (self.range_sent_ns, self.heading_held_ns) = (stamp(sent_ns), stamp(held_ns));
        self.heading = usize::try_from(heading).ok().and_then(|i| Heading::ALL.get(i).copied()).unwrap_or_default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::Stages;

    fn through_words<R: Record>(record: &mut R, other: &mut R) {
        let mut bytes = vec![0; 8 * count(record)];
        put(record, &mut bytes);
        take(other, &bytes);
    }

    #[test]
    fn fusions_record_is_decoded_from_its_words() {
        let mut estimate = Estimate {
            state_dim: 2,
            nis: 1.5,
            fused: 3,
            nis_all: 2.5,
            tested: 27,
            noise_scale: [1.75, 1.25],
            rejected: 4,
            missing: 5,
            late: 6,
            fused_late: 7,
            rejected_late: 8,
            refused: [9, 10, 11, 12, 13, 14],
            distrusted: std::array::from_fn(|kind| std::array::from_fn(|word| (15 + 64 * kind + word) as u64)),
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
        let heard = Heard::default();
        let judged = [
            (FusionDecision::Rejected, Some(20.0)),
            (FusionDecision::Fused, None),
            (FusionDecision::Distrusted, Some(0.5)),
        ]
        .map(|(used, normalised_square)| Some(GateResult { used, normalised_square }));
        let late = Heard {
            measurement: Measurement::new(
                Pose { height_m: 3.5, heading_rad: 0.7, covariance_m2: [0.1, 0.2, 0.3], ..Pose::at([1.0, -2.0]) },
                Some((-0.5, 1.5)),
            )
            .with_bearing(Some((2.5, 0.02))),
            taken_at: 12,
            judged: [judged[0], judged[1]],
        };
        let [fused, distrusted] = [1, 2].map(|i| Heard { judged: [judged[i], None], ..late });
        let command = Command { heading_rad: -3.0, speed_mps: 4.0 };
        let exchanges =
            [None, Some(heard), Some(late), Some(fused), Some(distrusted)].map(|heard| Exchange { heard, command });
        let mut record = FusionRecord { time_s: 0.7, estimate, exchanges: exchanges.to_vec() };
        let estimate = Estimate { state_dim: 2, ..Estimate::default() };
        let mut other = FusionRecord { time_s: 0.0, estimate, exchanges: vec![Exchange::default(); 5] };
        through_words(&mut record, &mut other);
        assert_eq!(other, record);
    }

    #[test]
    fn the_simulators_record_is_decoded_from_its_words() {
        let driven = Command { heading_rad: 0.5, speed_mps: 1.5 };
        let silent = RobotRecord { pose: Pose { height_m: 3.0, ..Pose::at([1.0, 2.0]) }, ..RobotRecord::default() };
        let heading = Heading::Late;
        let busy = RobotRecord {
            range_m: Some(-0.5),
            bearing_rad: Some(1.5),
            range_sent_ns: Some(7),
            heading_held_ns: Some(9),
            heading,
            driven,
            headings_refused: 4,
            network_ns: 5,
            robot_host_ns: 2,
            gateway_ns: 1,
            ..silent
        };
        let mut record = WorldRecord { time_s: 0.1, ended_ns: 5, truth: vec![1.0, 2.0], robots: vec![silent, busy] };
        let mut other =
            WorldRecord { time_s: 0.0, ended_ns: 0, truth: vec![0.0; 2], robots: vec![RobotRecord::default(); 2] };
        through_words(&mut record, &mut other);
        assert_eq!(other, record);
        let described = describe(&mut record);
        assert!(
            described
                .starts_with(r#"["time_s","<f8"],["ended_ns","<u8"],["truth","<f8",[2]],["robots",[["x_m","<f8"],"#)
        );
        assert!(described.ends_with(r#"["gateway_ns","<u8"]],[2]]"#), "{described}");
    }
}
