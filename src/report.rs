//! The report of a run, computed from the logs of its nodes.

use std::path::Path;

use hdrhistogram::Histogram;
use nalgebra::{Matrix2, Vector2};
use rangehound_shared::STATE_DIM_MAX;
use rangehound_shared::digest::Digest;
use rangehound_shared::message::{Estimate, Refusal, Stages};
use rangehound_shared::record::{EstimateRecord, Heading, RobotRecord, WorldRecord};
use rangehound_shared::rendezvous::RunDescription;
use rangehound_shared::robot_set::RobotSet;
use rangehound_shared::scenario::Scenario;
use rangehound_shared::tick_log::TickLogError;
use serde::Serialize;

use crate::hops::{self, HopSummary, Hops};
use crate::percentiles::{self, Point};

/// File name of the report in a run folder.
pub const FILE_NAME: &str = "report.json";

/// Times of distrust that are told one by one in print; the file has all.
const DISTRUST_LINES_MAX: usize = 5;

/// What a run came to; its fields are the keys of `report.json`.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// Name of the scenario.
    pub scenario: String,
    /// Seed.
    pub seed: u64,
    /// Clock: `realtime` or `lockstep`.
    pub clock: String,
    /// Planner.
    pub planner: String,
    /// Robots (or sensors of a recording).
    pub robots: usize,
    /// Time steps done.
    pub ticks: u64,
    /// From the end of tick 0, when the team is complete, to the end of the last tick, s.
    pub wall_s: f64,
    /// `ticks / wall_s`.
    pub ticks_per_s: f64,
    /// Hash over (tick, state, covariance) bits of all ticks.
    pub digest: String,
    /// Root mean square of the position error, m; null where no truth is known.
    pub position_rmse_m: Option<f64>,
    /// Position error squared over its covariance, averaged over the ticks, per degree of freedom:
    /// 1 for a consistent filter; null where no truth is known.
    pub anees: Option<f64>,
    /// Innovation squared over its covariance, averaged over the ticks, per range: 1 for a consistent
    /// filter; null if no range was fused.
    pub nis_mean: Option<f64>,
    /// Trace of the position covariance.
    pub position_trace_m2: TraceSummary,
    /// What became of the ranges.
    pub ranges: RangeSummary,
    /// Range messages that fusion refused, by cause.
    pub refused: RefusalSummary,
    /// When robots were distrusted.
    pub distrusted: Vec<Distrust>,
    /// What the robots drove by.
    pub headings: HeadingSummary,
    /// From publishing a range to holding the heading computed from it.
    pub latency_us: LatencySummary,
    /// The same as a curve.
    #[serde(skip)]
    pub percentiles: Vec<Point>,
    /// Where that time went.
    pub hops_us: HopSummary,
    /// The processes.
    pub nodes: Vec<NodeSummary>,
}

/// Trace of the position covariance, m^2.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct TraceSummary {
    /// After the last tick.
    pub r#final: f64,
    /// Median over the ticks after tick 0.
    pub median: f64,
}

/// What became of the ranges. At each tick at which a robot has one it is fused, rejected or missing: their sum is robots
/// times ticks where every robot has a range at every tick.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct RangeSummary {
    /// Published by robots, as they told the simulator by the end of the tick: in real time, slow ones did not.
    pub published: u64,
    /// Fused, in time or late.
    pub fused: u64,
    /// Failed the gate or came from a distrusted robot, in time or late.
    pub rejected: u64,
    /// Came after their tick: fused, rejected, or, after more than a few ticks, missing.
    pub late: u64,
    /// Of the late ones, fused at their own time.
    pub fused_late: u64,
    /// Robots not heard, or too late, summed over the ticks.
    pub missing: u64,
}

/// Messages that fusion refused, by [`Refusal`].
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct RefusalSummary {
    /// [`Refusal::Impostor`].
    pub impostor: u64,
    /// [`Refusal::OutOfRange`].
    pub out_of_range: u64,
    /// [`Refusal::Malformed`].
    pub malformed: u64,
    /// [`Refusal::Future`].
    pub future: u64,
    /// [`Refusal::Contradiction`].
    pub contradiction: u64,
    /// [`Refusal::Jump`].
    pub jump: u64,
}

/// Ticks at which a robot's ranges were not fused because they kept failing the gate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Distrust {
    /// The robot.
    pub robot: usize,
    /// The tick after whose range it was distrusted.
    pub from_tick: u64,
    /// The tick after whose range it was trusted again; null if it never was.
    pub to_tick: Option<u64>,
}

/// What the robots drove by, summed over robots and ticks; where a robot did not answer, nothing is known.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct HeadingSummary {
    /// The tick's heading.
    pub fresh: u64,
    /// The tick's heading, when it was overdue.
    pub late: u64,
    /// None for the tick: they held the last one, or stood.
    pub none: u64,
    /// Headings that they refused, of a fusion that led no more or of a stranger.
    pub refused: u64,
}

impl HeadingSummary {
    fn add(&mut self, robot: &RobotRecord) {
        match robot.heading {
            Heading::Fresh => self.fresh += 1,
            Heading::Late => self.late += 1,
            Heading::None => self.none += 1,
            Heading::Unknown => {}
        }
        self.refused += robot.headings_refused;
    }
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
    /// Percentiles of latencies in ns.
    #[must_use]
    pub fn of(latencies_ns: &Histogram<u64>) -> Self {
        let us = |quantile: f64| latencies_ns.value_at_quantile(quantile) as f64 / 1e3;
        Self {
            count: latencies_ns.len(),
            p50: us(0.5),
            p90: us(0.9),
            p99: us(0.99),
            p99_9: us(0.999),
            max: latencies_ns.max() as f64 / 1e3,
        }
    }
}

/// One process of the run.
#[derive(Debug, Clone, Serialize)]
pub struct NodeSummary {
    /// `sim`, `fusion`, `robot-0`, ...
    pub name: String,
    /// How often it was started.
    pub starts: u64,
    /// How often it was ended by a signal.
    pub kills: u64,
    /// How often it ended by itself before the run did.
    pub exits: u64,
    /// How often it was killed because it gave no sign of life: among the kills too.
    pub hangs: u64,
    /// What happened to it when, monotonic ns, in order, as far as its supervisor knows.
    #[serde(skip)]
    pub incidents: Vec<(u64, Incident)>,
}

impl NodeSummary {
    /// A process that was started so often, and of which no more is known.
    #[must_use]
    pub fn new(name: String, starts: u64) -> Self {
        Self { name, starts, kills: 0, exits: 0, hangs: 0, incidents: Vec::new() }
    }
}

/// What happens to a process.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Incident {
    /// It gave no sign of life for too long; it is killed next.
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

/// A true track: positions by time, from a file that the tracker never saw.
#[derive(Debug, Clone)]
pub struct Truth(Vec<(f64, Vector2<f64>)>);

impl Truth {
    /// A track of (time, position), in order of time.
    #[must_use]
    pub fn new(points: Vec<(f64, Vector2<f64>)>) -> Self {
        Self(points)
    }

    /// Position at a time, by linear interpolation; `None` outside the track.
    #[must_use]
    pub fn at(&self, time_s: f64) -> Option<Vector2<f64>> {
        let after = self.0.partition_point(|(t, _)| *t < time_s);
        let (t1, p1) = *self.0.get(after)?;
        if t1 == time_s {
            return Some(p1);
        }
        let (t0, p0) = *self.0.get(after.checked_sub(1)?)?;
        Some(p0 + (p1 - p0) * ((time_s - t0) / (t1 - t0)))
    }
}

impl RangeSummary {
    fn add(&mut self, estimate: &Estimate) {
        self.fused += estimate.fused + estimate.fused_late;
        self.rejected += estimate.rejected + estimate.rejected_late;
        self.late += estimate.late;
        self.fused_late += estimate.fused_late;
        // What came late was missing when its own tick was told of.
        self.missing += estimate.missing;
        self.missing = self.missing.saturating_sub(estimate.fused_late + estimate.rejected_late);
    }
}

impl RefusalSummary {
    fn add(&mut self, estimate: &Estimate) {
        for (refusal, count) in Refusal::ALL.into_iter().zip(estimate.refused) {
            *match refusal {
                Refusal::Impostor => &mut self.impostor,
                Refusal::OutOfRange => &mut self.out_of_range,
                Refusal::Malformed => &mut self.malformed,
                Refusal::Future => &mut self.future,
                Refusal::Contradiction => &mut self.contradiction,
                Refusal::Jump => &mut self.jump,
            } += count;
        }
    }
}

/// Adds up a run tick by tick.
#[derive(Debug)]
pub struct Tally {
    ticks: u64,
    digest: Digest,
    squared_error_m2: Mean,
    nees: Mean,
    nis: Mean,
    traces_m2: Vec<f64>,
    ranges: RangeSummary,
    refused: RefusalSummary,
    distrusted: Vec<Distrust>,
    headings: HeadingSummary,
    latency_ns: Histogram<u64>,
    hops: Hops,
    first_end_ns: Option<u64>,
    last_end_ns: u64,
}

#[derive(Debug, Default)]
struct Mean {
    sum: f64,
    count: f64,
}

impl Mean {
    fn add(&mut self, value: f64) {
        self.sum += value;
        self.count += 1.0;
    }

    fn value(&self) -> Option<f64> {
        (self.count > 0.0).then(|| self.sum / self.count)
    }
}

impl Tally {
    /// Nothing yet.
    ///
    /// # Errors
    /// If the histogram cannot be made.
    pub fn new() -> anyhow::Result<Self> {
        Ok(Self {
            ticks: 0,
            digest: Digest::default(),
            squared_error_m2: Mean::default(),
            nees: Mean::default(),
            nis: Mean::default(),
            traces_m2: Vec::new(),
            ranges: RangeSummary::default(),
            refused: RefusalSummary::default(),
            distrusted: Vec::new(),
            headings: HeadingSummary::default(),
            // Grows with the largest value; 3 digits are what the report shows.
            latency_ns: Histogram::new(3)?,
            hops: Hops::new()?,
            first_end_ns: None,
            last_end_ns: 0,
        })
    }

    /// Adds fusion's side of a tick; `truth_m` is the target's true position, where it is known.
    pub fn add_estimate(&mut self, tick: u64, estimate: &Estimate, truth_m: Option<Vector2<f64>>) {
        self.digest = Digest::from_bits(u128::from(estimate.digest[1]) << 64 | u128::from(estimate.digest[0]));
        self.ranges.add(estimate);
        self.refused.add(estimate);
        self.add_distrust(tick, RobotSet::from_bits(estimate.distrusted));
        if estimate.fused > 0 {
            self.nis.sum += estimate.nis;
            self.nis.count += estimate.fused as f64;
        }
        if tick == 0 {
            return;
        }
        self.ticks = tick;
        let covariance = position_covariance(estimate);
        self.traces_m2.push(covariance.trace());
        if let Some(truth_m) = truth_m {
            let (squared_error_m2, nees) = position_error(estimate, truth_m);
            self.squared_error_m2.add(squared_error_m2);
            if let Some(nees) = nees {
                self.nees.add(nees / 2.0);
            }
        }
    }

    /// Begins and ends the times of distrust.
    fn add_distrust(&mut self, tick: u64, distrusted: RobotSet) {
        let mut begun = distrusted;
        for open in self.distrusted.iter_mut().filter(|distrust| distrust.to_tick.is_none()) {
            if distrusted.contains(open.robot) {
                begun.set(open.robot, false);
            } else {
                open.to_tick = Some(tick);
            }
        }
        if !begun.is_empty() {
            self.distrusted.extend(begun.iter().map(|robot| Distrust { robot, from_tick: tick, to_tick: None }));
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
                // Resizes as needed, so nothing can be out of its bounds.
                let _ = self.latency_ns.record(latency_ns);
            }
        }
    }

    /// Adds the robots' ways through one tick, of which fusion and simulator know half each.
    pub fn add_hops(&mut self, stages: &Stages, robots: &[RobotRecord]) {
        for robot in robots {
            self.hops.add(stages, robot);
        }
    }

    /// The report.
    #[must_use]
    pub fn report(mut self, scenario: &Scenario, nodes: Vec<NodeSummary>) -> Report {
        let wall_s = self.first_end_ns.map_or(0.0, |first| self.last_end_ns.saturating_sub(first) as f64 / 1e9);
        let last_trace_m2 = self.traces_m2.last().copied().unwrap_or(0.0);
        self.traces_m2.sort_unstable_by(f64::total_cmp);
        Report {
            scenario: scenario.name.clone(),
            seed: scenario.seed,
            clock: scenario.clock.name().to_owned(),
            planner: scenario.planner.name().to_owned(),
            robots: scenario.robots.len(),
            ticks: self.ticks,
            wall_s,
            ticks_per_s: if wall_s > 0.0 { self.ticks as f64 / wall_s } else { 0.0 },
            digest: self.digest.to_string(),
            position_rmse_m: self.squared_error_m2.value().map(f64::sqrt),
            anees: self.nees.value(),
            nis_mean: self.nis.value(),
            position_trace_m2: TraceSummary {
                r#final: last_trace_m2,
                median: self.traces_m2.get(self.traces_m2.len() / 2).copied().unwrap_or(0.0),
            },
            ranges: self.ranges,
            refused: self.refused,
            distrusted: self.distrusted,
            headings: self.headings,
            latency_us: LatencySummary::of(&self.latency_ns),
            percentiles: percentiles::curve(&self.latency_ns),
            hops_us: self.hops.summary(),
            nodes,
        }
    }
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

/// Computes the report of a run from its logs.
///
/// # Errors
/// If a log cannot be read.
pub fn from_logs(
    description: &RunDescription,
    truth: Option<&Truth>,
    nodes: Vec<NodeSummary>,
) -> anyhow::Result<Report> {
    let RunDescription { run_id, scenario, out_dir } = description;
    let mut tally = Tally::new()?;
    let mut worlds = Worlds::open(description)?;
    let mut estimates = EstimateRecord::reader(out_dir, *run_id, scenario)?;
    let state_dim = scenario.motion.state_dim();
    while let Some(record) = estimates.next() {
        let (tick, words) = record?;
        let EstimateRecord { time_s, estimate } = EstimateRecord::from_words(words, state_dim);
        let world = worlds.at(tick, &mut tally)?;
        if let Some(world) = world {
            tally.add_hops(&estimate.stages, &world.robots);
        }
        let simulated = world.and_then(|world| Some(Vector2::new(*world.truth.first()?, *world.truth.get(1)?)));
        let truth_m = simulated.or_else(|| truth.and_then(|truth| truth.at(time_s)));
        tally.add_estimate(tick, &estimate, truth_m);
    }
    worlds.at(u64::MAX, &mut tally)?;
    Ok(tally.report(scenario, nodes))
}

/// Walks through the simulator's log beside fusion's.
struct Worlds<'a> {
    scenario: &'a Scenario,
    reader: rangehound_shared::tick_log::TickLogReader,
    last: Option<(u64, WorldRecord)>,
}

impl<'a> Worlds<'a> {
    fn open(description: &'a RunDescription) -> Result<Self, TickLogError> {
        let RunDescription { run_id, scenario, out_dir } = description;
        Ok(Self { scenario, reader: WorldRecord::reader(out_dir, *run_id, scenario)?, last: None })
    }

    /// The record of a tick, if there is one; all up to it are added to the tally.
    fn at(&mut self, tick: u64, tally: &mut Tally) -> Result<Option<&WorldRecord>, TickLogError> {
        while self.last.as_ref().is_none_or(|(last, _)| *last < tick) {
            let Some(record) = self.reader.next() else { break };
            let (at, words) = record?;
            let record = WorldRecord::from_words(words, self.scenario);
            tally.add_world(record.ended_ns, &record.robots);
            self.last = Some((at, record));
        }
        Ok(self.last.as_ref().filter(|(last, _)| *last == tick).map(|(_, record)| record))
    }
}

/// Writes `report.json`.
///
/// # Errors
/// If the file cannot be written.
pub fn write(report: &Report, out_dir: &Path) -> anyhow::Result<()> {
    let path = out_dir.join(FILE_NAME);
    std::fs::write(&path, serde_json::to_string_pretty(report)? + "\n")
        .map_err(|error| anyhow::anyhow!("{}: {error}", path.display()))
}

impl std::fmt::Display for Report {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { ranges, headings, refused, distrusted, latency_us, .. } = self;
        writeln!(f, "{}: {} robots, {} planner, seed {}", self.scenario, self.robots, self.planner, self.seed)?;
        writeln!(
            f,
            "  {:<16} {} ticks in {:.2} s ({:.0} ticks/s)",
            self.clock, self.ticks, self.wall_s, self.ticks_per_s
        )?;
        if let Some(rmse_m) = self.position_rmse_m {
            writeln!(f, "  position error   {rmse_m:.3} m RMS")?;
        }
        let ratio = |value: Option<f64>| value.map_or("unknown".to_owned(), |value| format!("{value:.2}"));
        writeln!(f, "  consistency      ANEES {}, NIS {}; 1 is ideal", ratio(self.anees), ratio(self.nis_mean))?;
        writeln!(
            f,
            "  position trace   {:.3} m^2 at the end, {:.3} median",
            self.position_trace_m2.r#final, self.position_trace_m2.median
        )?;
        writeln!(
            f,
            "  ranges           {} published: {} fused, {} rejected, {} late, {} missing",
            ranges.published, ranges.fused, ranges.rejected, ranges.late, ranges.missing
        )?;
        writeln!(
            f,
            "  headings         {} fresh, {} late, {} none, {} refused",
            headings.fresh, headings.late, headings.none, headings.refused
        )?;
        if *refused != RefusalSummary::default() {
            let RefusalSummary { impostor, out_of_range, malformed, future, contradiction, jump } = refused;
            writeln!(
                f,
                "  refused          {impostor} impostor, {out_of_range} out of range, {malformed} malformed, \
                 {future} future, {contradiction} contradiction, {jump} jump"
            )?;
        }
        for Distrust { robot, from_tick, to_tick } in distrusted.iter().take(DISTRUST_LINES_MAX) {
            let until = to_tick.map_or("the end".to_owned(), |tick| format!("tick {tick}"));
            writeln!(f, "  distrusted       robot {robot} from tick {from_tick} to {until}")?;
        }
        if let Some(more) = distrusted.len().checked_sub(DISTRUST_LINES_MAX).filter(|more| *more > 0) {
            writeln!(f, "  distrusted       {more} times more")?;
        }
        if latency_us.count > 0 {
            writeln!(
                f,
                "  range to heading {:.0} us p50, {:.0} p90, {:.0} p99, {:.0} p99.9, {:.0} max",
                latency_us.p50, latency_us.p90, latency_us.p99, latency_us.p99_9, latency_us.max
            )?;
            let hops = hops::NAMES.iter().zip(self.hops_us.in_order());
            let hops: Vec<String> = hops.map(|(name, hop)| format!("{name} {:.1}", hop.p50)).collect();
            writeln!(f, "  hops, us p50     {}", hops.join(", "))?;
        }
        for node in self.nodes.iter().filter(|node| node.starts != 1 || node.kills + node.exits > 0) {
            let NodeSummary { name, starts, kills, exits, hangs, .. } = node;
            let hung = if *hangs > 0 { format!(", hung {hangs} times") } else { String::new() };
            writeln!(f, "  {name:<16} {starts} starts, {kills} kills, {exits} early exits{hung}")?;
        }
        write!(f, "  digest           {}", self.digest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_came_late_was_not_missing_after_all() {
        let mut tally = Tally::new().unwrap();
        let tick = |fused, missing| Estimate { fused, missing, ..Estimate::default() };
        tally.add_estimate(1, &tick(1, 2), None);
        tally.add_estimate(2, &Estimate { late: 3, fused_late: 1, rejected_late: 1, ..tick(3, 0) }, None);
        tally.add_estimate(3, &Estimate { rejected: 1, ..tick(1, 1) }, None);
        let expected = RangeSummary { published: 0, fused: 6, rejected: 2, late: 3, fused_late: 1, missing: 1 };
        assert_eq!(tally.ranges, expected);
        assert_eq!(tally.ranges.fused + tally.ranges.rejected + tally.ranges.missing, 3 * 3);
    }

    #[test]
    fn times_of_distrust_begin_and_end() {
        let mut tally = Tally::new().unwrap();
        let distrusted = [&[][..], &[1], &[1, 70], &[70], &[1, 70]];
        for (tick, robots) in distrusted.iter().enumerate() {
            let mut set = RobotSet::default();
            robots.iter().for_each(|robot| set.set(*robot, true));
            let estimate = Estimate { distrusted: set.to_bits(), ..Estimate::default() };
            tally.add_estimate(tick as u64, &estimate, None);
        }
        let distrust = |robot, from_tick, to_tick| Distrust { robot, from_tick, to_tick };
        assert_eq!(tally.distrusted, [distrust(1, 1, Some(3)), distrust(70, 2, None), distrust(1, 4, None)]);
    }

    #[test]
    fn refusals_are_told_by_cause() {
        let mut tally = Tally::new().unwrap();
        let estimate = Estimate { refused: [1, 2, 3, 4, 5, 6], ..Estimate::default() };
        tally.add_estimate(1, &estimate, None);
        tally.add_estimate(2, &estimate, None);
        let json = serde_json::to_string(&tally.refused).unwrap();
        let expected = r#"{"impostor":2,"out_of_range":4,"malformed":6,"future":8,"contradiction":10,"jump":12}"#;
        assert_eq!(json, expected);
    }
}
