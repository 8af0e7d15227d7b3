//! Sums up a run tick by tick.

use nalgebra::{Matrix2, Vector2};
use rangehound_shared::STATE_DIM_MAX;
use rangehound_shared::measurement::Kind;
use rangehound_shared::message::{Estimate, Stages};
use rangehound_shared::record::digest::Digest;
use rangehound_shared::record::{Exchange, FusionDecision, RobotRecord};
use rangehound_shared::robot_set::RobotSet;
use rangehound_shared::scenario::{Scenario, Source};

use super::consistency::{Consistency, ConsistencySummary};
use super::found::Search;
use super::verdict::{Evidence, RecordingEvidence, SensorEvidence, TruthEvidence, Verdict};
use super::{
    BearingSummary, Distrust, HeadingSummary, LatencySummary, NodeSummary, RangeSummary, RefusalSummary, Report,
    SensorSummary, TraceSummary,
};
use crate::results::hops::Hops;
use crate::results::percentiles;
use crate::statistics::{Mean, Samples, median};

/// Largest contribution of one range to the NIS that the verdict uses: the square of a usual gate.
const SQUARE_CAP: f64 = 16.0;

/// Sums up a run tick by tick.
#[derive(Debug)]
pub struct Accumulator {
    ticks: u64,
    digest: Digest,
    squared_error_m2: Mean,
    search: Search,
    nees: Consistency,
    nis: Consistency,
    nis_all: Consistency,
    gate_widened: u64,
    sensors: Vec<Sensor>,
    traces_m2: Vec<f64>,
    ranges: RangeSummary,
    refused: RefusalSummary,
    distrusted: Vec<Distrust>,
    headings: HeadingSummary,
    latency_us: Samples,
    hops: Hops,
    /// Ranges, and distances to the estimate of bearings without a range, m.
    distances_m: Samples,
    first_end_ns: Option<u64>,
    last_end_ns: u64,
}

/// One sensor's measurements, by [`Kind`].
type Sensor = [Outcomes; Kind::COUNT];

/// One sensor's measurements of a kind.
#[derive(Debug, Clone, Copy, Default)]
struct Outcomes {
    counts: [u64; FusionDecision::ALL.len()],
    nis: Mean,
    nis_capped: Mean,
}

impl Outcomes {
    fn all(&self) -> u64 {
        self.counts.iter().sum()
    }
}

/// The summary of a sensor's measurements.
fn summary_of([of_ranges, of_bearings]: &Sensor, name: &str) -> SensorSummary {
    let [fused, rejected, distrusted] = of_ranges.counts;
    let [bearings_fused, bearings_rejected, bearings_distrusted] = of_bearings.counts;
    SensorSummary {
        name: name.to_owned(),
        ranges: of_ranges.all(),
        fused,
        rejected,
        distrusted,
        nis_mean: of_ranges.nis.value(),
        bearings: (of_bearings.all() > 0).then(|| BearingSummary {
            bearings: of_bearings.all(),
            bearings_fused,
            bearings_rejected,
            bearings_distrusted,
            bearings_nis_mean: of_bearings.nis.value(),
        }),
    }
}

impl Accumulator {
    /// An empty accumulator.
    ///
    /// # Errors
    /// If the histogram cannot be made.
    pub fn new() -> anyhow::Result<Self> {
        Ok(Self {
            ticks: 0,
            digest: Digest::default(),
            squared_error_m2: Mean::default(),
            search: Search::default(),
            nees: Consistency::default(),
            nis: Consistency::default(),
            nis_all: Consistency::default(),
            gate_widened: 0,
            sensors: Vec::new(),
            traces_m2: Vec::new(),
            ranges: RangeSummary::default(),
            refused: RefusalSummary::default(),
            distrusted: Vec::new(),
            headings: HeadingSummary::default(),
            latency_us: Samples::new()?,
            hops: Hops::new()?,
            distances_m: Samples::new()?,
            first_end_ns: None,
            last_end_ns: 0,
        })
    }

    /// Adds fusion's side of a tick; `truth_m` is the target's true position, where it is known.
    pub fn add_estimate(&mut self, tick: u64, estimate: &Estimate, truth_m: Option<Vector2<f64>>) {
        self.digest = Digest::from_words(estimate.digest);
        self.ranges.add(estimate);
        self.refused.add(estimate);
        for kind in Kind::ALL {
            self.add_distrust(tick, kind, RobotSet::from_bits(estimate.distrusted[kind as usize]));
        }
        self.nis.add(estimate.nis, estimate.fused);
        self.nis_all.add(estimate.nis_all, estimate.tested);
        self.gate_widened += u64::from(estimate.noise_scale.iter().any(|scale| *scale > 1.0));
        if tick == 0 {
            return;
        }
        self.ticks = tick;
        let covariance = position_covariance(estimate);
        self.traces_m2.push(covariance.trace());
        self.search.add(tick, covariance.trace(), self.squared_error_m2);
        if let Some(truth_m) = truth_m {
            let (squared_error_m2, nees) = position_error(estimate, truth_m);
            self.squared_error_m2.add(squared_error_m2);
            if let Some(nees) = nees {
                self.nees.add(nees, 2);
            }
        }
    }

    /// Starts and ends the intervals of distrust.
    fn add_distrust(&mut self, tick: u64, kind: Kind, distrusted: RobotSet) {
        let mut begun = distrusted;
        let of_kind = |distrust: &&mut Distrust| distrust.kind == kind.name() && distrust.to_tick.is_none();
        for open in self.distrusted.iter_mut().filter(of_kind) {
            if distrusted.contains(open.robot) {
                begun.set(open.robot, false);
            } else {
                open.to_tick = Some(tick);
            }
        }
        if !begun.is_empty() {
            self.distrusted.extend(begun.iter().map(|robot| Distrust {
                robot,
                sensor: robot.to_string(),
                kind: kind.name(),
                from_tick: tick,
                to_tick: None,
            }));
        }
    }

    /// Adds the simulator's side of a tick.
    pub fn add_world<'a>(&mut self, ended_ns: u64, robots: impl IntoIterator<Item = &'a RobotRecord>) {
        self.first_end_ns.get_or_insert(ended_ns);
        self.last_end_ns = ended_ns;
        for robot in robots {
            self.ranges.published += u64::from(robot.range_sent_ns.is_some());
            self.headings.add(robot);
            if let Some(latency_ns) = robot.latency_ns() {
                self.latency_us.add(latency_ns);
            }
        }
    }

    /// Adds the measurements of a tick that fusion has but the simulator did not count as published: the second one of a
    /// message, or a message that reached the simulator too late, or after its end.
    pub fn add_unlogged(&mut self, exchanges: &[Exchange], robots: &[RobotRecord]) {
        for (robot, exchange) in exchanges.iter().enumerate() {
            let is_reported = robots.get(robot).is_some_and(|robot| robot.range_sent_ns.is_some());
            let heard = exchange.heard.map_or(0, |heard| heard.measurement.count());
            self.ranges.published += heard.saturating_sub(u64::from(is_reported));
        }
    }

    /// Adds the outcome of a tick's measurements for each sensor.
    pub fn add_sensors(&mut self, estimate: &Estimate, exchanges: &[Exchange]) {
        let [x_m, y_m, ..] = estimate.state;
        for (robot, exchange) in exchanges.iter().enumerate() {
            if self.sensors.len() <= robot {
                self.sensors.push(Sensor::default());
            }
            let Some(heard) = exchange.heard else { continue };
            let measurement = heard.measurement;
            let distance_m = (measurement.pose.position_m() - Vector2::new(x_m, y_m)).norm();
            let seen_m = measurement.bearing().map(|_| distance_m);
            if let Some(distance_m) = measurement.range().map(|(range_m, _)| range_m).or(seen_m) {
                self.distances_m.add((distance_m * 1e3) as u64);
            }
            for (outcomes, judged) in self.sensors[robot].iter_mut().zip(heard.judged) {
                let Some(judged) = judged else { continue };
                outcomes.counts[judged.used as usize] += 1;
                if let Some(square) = judged.normalised_square {
                    outcomes.nis.add(square);
                    outcomes.nis_capped.add(square.min(SQUARE_CAP));
                }
            }
        }
    }

    /// Adds the robots' hops of one tick; fusion and simulator each know half of the stamps.
    pub fn add_hops(&mut self, stages: &Stages, robots: &[RobotRecord]) {
        for robot in robots {
            self.hops.add(stages, robot);
        }
    }

    /// The evidence for the verdict.
    fn evidence(&self, scenario: &Scenario, background: Background) -> Evidence {
        let sensors: Vec<SensorEvidence> = scenario
            .robots
            .iter()
            .zip(&self.sensors)
            .map(|(robot, sensor)| SensorEvidence {
                name: robot.label.clone(),
                ranges: sensor.iter().map(Outcomes::all).sum(),
                fused: sensor.iter().map(|outcomes| outcomes.counts[FusionDecision::Fused as usize]).sum(),
            })
            .collect();
        // A faulty sensor does not count against the result of the others.
        let of_others = |nis: fn(&Outcomes) -> Mean| {
            let others = sensors.iter().zip(&self.sensors).filter(|(evidence, _)| !evidence.is_faulty());
            let mean: Mean = others.flat_map(|(_, sensor)| sensor).map(nis).sum();
            let dof_each = mean.count() / self.ticks.max(1) as f64;
            let all = self.nis_all.summary()?;
            mean.value().map(|mean| ConsistencySummary::new(mean, all.independent_samples, dof_each))
        };
        let (nis_all, nis_capped) = (of_others(|of_kind| of_kind.nis), of_others(|of_kind| of_kind.nis_capped));
        let mut traces_m2 = self.traces_m2[self.traces_m2.len() / 2..].to_vec();
        let sensors_of = || scenario.robots.iter().map(|robot| robot.sensor);
        let mut stds_m: Vec<f64> = sensors_of().filter_map(|sensor| Some(sensor.range?.std_m)).collect();
        let mut stds_rad: Vec<f64> = sensors_of().filter_map(|sensor| sensor.bearing_std_rad).collect();
        let Background { truth, recording } = background;
        Evidence {
            sensors,
            nis: self.nis.summary(),
            nis_all,
            nis_capped,
            anees: self.nees.summary(),
            truth,
            position_std_m: median(&mut traces_m2).unwrap_or(0.0).max(0.0).sqrt(),
            median_distance_m: self.distances_m.at(0.5),
            raised_noise_share: self.gate_widened as f64 / self.ticks.max(1) as f64,
            range_std_m: median(&mut stds_m),
            bearing_std_rad: median(&mut stds_rad),
            recording,
        }
    }

    /// The report.
    #[must_use]
    pub fn report(mut self, scenario: &Scenario, background: Background, nodes: Vec<NodeSummary>) -> Report {
        for distrust in &mut self.distrusted {
            if let Some(robot) = scenario.robots.get(distrust.robot) {
                distrust.sensor.clone_from(&robot.label);
            }
        }
        let recording = match &scenario.source {
            Source::Recorded(ranges) => Some(ranges.summary.clone()),
            Source::Simulated { .. } => None,
        };
        let verdict = Verdict::of(&self.evidence(scenario, background));
        let wall_s = self.first_end_ns.map_or(0.0, |first| self.last_end_ns.saturating_sub(first) as f64 / 1e9);
        let last_trace_m2 = self.traces_m2.last().copied().unwrap_or(0.0);
        Report {
            scenario: scenario.name.clone(),
            seed: scenario.seed,
            clock: scenario.clock.name().to_owned(),
            in_one_process: false,
            planner: scenario.planner.name().to_owned(),
            robots: scenario.robots.len(),
            ticks: self.ticks,
            wall_s,
            ticks_per_s: if wall_s > 0.0 { self.ticks as f64 / wall_s } else { 0.0 },
            digest: self.digest.to_string(),
            position_rmse_m: self.squared_error_m2.value().map(f64::sqrt),
            found: self.search.end(self.distances_m.at(0.5), self.squared_error_m2),
            anees: self.nees.mean(),
            nis_mean: self.nis.mean(),
            nis_all_mean: self.nis_all.mean(),
            gate_widened: self.gate_widened,
            position_trace_m2: TraceSummary {
                r#final: last_trace_m2,
                median: median(&mut self.traces_m2).unwrap_or(0.0),
            },
            ranges: self.ranges,
            sensors: scenario
                .robots
                .iter()
                .zip(&self.sensors)
                .map(|(robot, sensor)| summary_of(sensor, &robot.label))
                .collect(),
            refused: self.refused,
            recording,
            distrusted: self.distrusted,
            headings: self.headings,
            latency_us: LatencySummary::of(&self.latency_us),
            percentiles: percentiles::curve(&self.latency_us),
            hops_us: self.hops.summary(),
            nodes,
            verdict,
        }
    }
}

/// Facts about a run that its logs do not hold.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Background {
    /// The true track that the user gave.
    pub truth: Option<TruthEvidence>,
    /// The recording.
    pub recording: Option<RecordingEvidence>,
}

/// The 2 x 2 block of the position.
#[must_use]
pub fn position_covariance(estimate: &Estimate) -> Matrix2<f64> {
    let n = (estimate.state_dim as usize).clamp(2, STATE_DIM_MAX);
    let p = &estimate.covariance;
    Matrix2::new(p[0], p[1], p[n], p[n + 1])
}

/// Squared position error, m^2, and the same normalised by the covariance (NEES, two degrees of freedom);
/// `None` for the latter if the covariance is singular.
#[must_use]
pub fn position_error(estimate: &Estimate, truth_m: Vector2<f64>) -> (f64, Option<f64>) {
    let error_m = Vector2::new(estimate.state[0], estimate.state[1]) - truth_m;
    let inverse = position_covariance(estimate).try_inverse();
    (error_m.norm_squared(), inverse.map(|inverse| error_m.dot(&(inverse * error_m))))
}

#[cfg(test)]
mod tests {
    use rangehound_shared::measurement::{Measurement, Pose};
    use rangehound_shared::message::Command;
    use rangehound_shared::record::{GateResult, Heard};

    use super::*;

    #[test]
    fn a_late_range_no_longer_counts_as_missing() {
        let mut totals = Accumulator::new().unwrap();
        let tick = |fused, missing| Estimate { fused, missing, ..Estimate::default() };
        totals.add_estimate(1, &tick(1, 2), None);
        totals.add_estimate(2, &Estimate { late: 3, fused_late: 1, rejected_late: 1, ..tick(3, 0) }, None);
        totals.add_estimate(3, &Estimate { rejected: 1, ..tick(1, 1) }, None);
        let expected = RangeSummary { published: 0, fused: 6, rejected: 2, late: 3, fused_late: 1, missing: 1 };
        assert_eq!(totals.ranges, expected);
        assert_eq!(totals.ranges.fused + totals.ranges.rejected + totals.ranges.missing, 3 * 3);
    }

    #[test]
    fn a_range_that_fusion_has_counts_as_published_without_a_record_of_the_simulator() {
        let exchange = |range_m| Exchange {
            heard: Some(Heard {
                measurement: Measurement::new(Pose::default(), range_m),
                taken_at: 1,
                judged: [None; 2],
            }),
            command: Command::default(),
        };
        let heard = [exchange(Some((5.0, 1.0))), exchange(Some((6.0, 1.0))), exchange(None), Exchange::default()];
        let answered = RobotRecord { range_sent_ns: Some(1), ..RobotRecord::default() };
        let robots = [answered, RobotRecord::default(), RobotRecord::default(), answered];
        let mut totals = Accumulator::new().unwrap();
        totals.add_world(1, &robots);
        totals.add_unlogged(&heard, &robots);
        assert_eq!(totals.ranges.published, 3);
        // The tick in progress at the end of a run: the simulator has not logged it.
        totals.add_unlogged(&heard, &[]);
        assert_eq!(totals.ranges.published, 5);
    }

    #[test]
    fn each_sensor_has_the_outcome_of_its_ranges() {
        let exchange = |judged: Option<(FusionDecision, Option<f64>)>| Exchange {
            heard: Some(Heard {
                measurement: Measurement::new(Pose::default(), judged.map(|_| (1.0, 1.0))),
                taken_at: 1,
                judged: [judged.map(|(used, normalised_square)| GateResult { used, normalised_square }), None],
            }),
            command: Command::default(),
        };
        let mut totals = Accumulator::new().unwrap();
        let (fused, rejected, distrusted) =
            (FusionDecision::Fused, FusionDecision::Rejected, FusionDecision::Distrusted);
        let estimate = Estimate::default();
        totals.add_sensors(
            &estimate,
            &[exchange(Some((fused, None))), exchange(None), exchange(Some((distrusted, Some(5.0))))],
        );
        totals.add_sensors(
            &estimate,
            &[exchange(Some((fused, Some(0.5)))), Exchange::default(), exchange(Some((rejected, Some(20.0))))],
        );
        let summaries: Vec<SensorSummary> = totals.sensors.iter().map(|sensor| summary_of(sensor, "a")).collect();
        let expected = [(2, 2, 0, 0, Some(0.5)), (0, 0, 0, 0, None), (2, 0, 1, 1, Some(12.5))];
        for (summary, (ranges, fused, rejected, distrusted, nis_mean)) in summaries.into_iter().zip(expected) {
            let name = "a".to_owned();
            assert_eq!(summary, SensorSummary { name, ranges, fused, rejected, distrusted, nis_mean, bearings: None });
        }
    }

    #[test]
    fn bearings_are_counted_beside_ranges_and_both_as_published() {
        let both = Measurement::new(Pose::at([3.0, 4.0]), Some((5.5, 0.1))).with_bearing(Some((0.5, 0.02)));
        let alone = Measurement::new(Pose::at([3.0, 4.0]), None).with_bearing(Some((0.5, 0.02)));
        let [fused, rejected] = [(FusionDecision::Fused, 0.5), (FusionDecision::Rejected, 20.0)]
            .map(|(used, square)| Some(GateResult { used, normalised_square: Some(square) }));
        let exchange = |measurement, judged| Exchange {
            heard: Some(Heard { measurement, taken_at: 1, judged }),
            command: Command::default(),
        };
        let exchanges = [exchange(both, [fused, rejected]), exchange(alone, [None, fused])];
        let answered = RobotRecord { range_sent_ns: Some(1), ..RobotRecord::default() };
        let mut totals = Accumulator::new().unwrap();
        totals.add_world(1, &[answered, answered]);
        totals.add_unlogged(&exchanges, &[answered, answered]);
        totals.add_sensors(&Estimate::default(), &exchanges);
        assert_eq!(totals.ranges.published, 3);
        assert!((totals.distances_m.at(1.0) - 5.5).abs() < 0.01 && (totals.distances_m.at(0.0) - 5.0).abs() < 0.01);
        let json = |sensor| serde_json::to_string(&summary_of(&totals.sensors[sensor], "a")).unwrap();
        let counts = r#""bearings":1,"bearings_fused":0,"bearings_rejected":1,"bearings_distrusted":0,"bearings_nis_mean":20.0}"#;
        let expected = r#"{"name":"a","ranges":1,"fused":1,"rejected":0,"distrusted":0,"nis_mean":0.5,"#;
        assert_eq!(json(0), format!("{expected}{counts}"));
        assert!(json(1).starts_with(r#"{"name":"a","ranges":0,"#) && json(1).contains(r#""bearings_fused":1"#));
    }

    #[test]
    fn the_nis_of_all_ranges_is_beside_that_of_the_fused_ones() {
        let mut totals = Accumulator::new().unwrap();
        totals.add_estimate(
            1,
            &Estimate { nis: 1.5, fused: 2, nis_all: 30.0, tested: 4, rejected: 2, ..Estimate::default() },
            None,
        );
        totals.add_estimate(
            2,
            &Estimate { nis_all: 20.0, tested: 1, noise_scale: [2.0, 1.0], rejected: 1, ..Estimate::default() },
            None,
        );
        assert_eq!((totals.nis.mean(), totals.nis_all.mean(), totals.gate_widened), (Some(0.75), Some(10.0), 1));
    }

    #[test]
    fn times_of_distrust_begin_and_end() {
        let mut totals = Accumulator::new().unwrap();
        let distrusted = [&[][..], &[1], &[1, 70], &[70], &[1, 70]];
        for (tick, robots) in distrusted.iter().enumerate() {
            let mut set = RobotSet::default();
            robots.iter().for_each(|robot| set.set(*robot, true));
            let estimate = Estimate { distrusted: [set.to_bits(), [0; 16]], ..Estimate::default() };
            totals.add_estimate(tick as u64, &estimate, None);
        }
        let distrust = |robot, from_tick, to_tick| Distrust {
            robot,
            sensor: robot.to_string(),
            kind: "range",
            from_tick,
            to_tick,
        };
        assert_eq!(totals.distrusted, [distrust(1, 1, Some(3)), distrust(70, 2, None), distrust(1, 4, None)]);
    }

    #[test]
    fn refusals_are_counted_by_cause() {
        let mut totals = Accumulator::new().unwrap();
        let estimate = Estimate { refused: [1, 2, 3, 4, 5, 6], ..Estimate::default() };
        totals.add_estimate(1, &estimate, None);
        totals.add_estimate(2, &estimate, None);
        let json = serde_json::to_string(&totals.refused).unwrap();
        let expected = r#"{"impostor":2,"out_of_range":4,"malformed":6,"future":8,"contradiction":10,"jump":12}"#;
        assert_eq!(json, expected);
    }
}
