//! The outcome of a campaign: `chaos.json`, a table, and the broken promises.

use std::path::Path;

use rangehound_node::rendezvous::Role;
use rangehound_shared::scenario::{Clock, Scenario};
use serde::Serialize;

use super::faults::{Asked, Kind, Target};
use crate::files::atomic_file;
use crate::files::layout::CHAOS;
use crate::results::report::{HeadingSummary, RangeSummary};
use crate::statistics::Ascending;
use crate::study::hosts::link::Conditions;
use crate::terminal::{BAD, GOOD, TITLE, counted, field};

/// The outcome of a campaign; its fields are the keys of `chaos.json`.
#[derive(Debug, Clone, Default, Serialize)]
pub(super) struct Outcome {
    /// Name of the scenario.
    pub(super) scenario: String,
    /// Clock: `realtime` or `lockstep`.
    pub(super) clock: &'static str,
    /// Robots.
    pub(super) robots: usize,
    /// Hosts, the run's included.
    pub(super) hosts: usize,
    /// The conditions of the network between them; null on one host.
    pub(super) network: Option<Conditions>,
    /// Seed of the faults.
    pub(super) chaos_seed: u64,
    /// Number of requested faults.
    pub(super) faults_asked: u64,
    /// Faults by role and kind: number of hits.
    pub(super) faults: Vec<RoleSummary>,
    /// Time steps done.
    pub(super) ticks: u64,
    /// The outcome of the ranges.
    pub(super) ranges: RangeSummary,
    /// The headings that the robots followed.
    pub(super) headings: HeadingSummary,
    /// Number of times that a robot had no heading in time, over all ticks that it answered.
    pub(super) without_heading: u64,
    /// Position error of all runs, and of their baselines without faults, m RMS; null if the truth is unknown.
    pub(super) position_rmse_m: Option<PositionError>,
    /// Whether all estimates equal those of the baseline; null if they need not.
    pub(super) digest_equal: Option<bool>,
    /// Files in shared memory after the end, on all hosts.
    pub(super) files_left: Vec<String>,
    /// Processes still alive after the end.
    pub(super) processes_left: Vec<i32>,
    /// Broken promises.
    pub(super) broken: Vec<String>,
    /// The runs.
    pub(super) rounds: Vec<Round>,
    /// Every fault and the node that it hit.
    pub(super) injected: Vec<Injected>,
}

/// Position errors, m RMS.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct PositionError {
    /// Of the faulted runs.
    pub(super) faulted: f64,
    /// Of the baselines: the same runs in one process, where no range is ever missing.
    pub(super) baseline: f64,
}

/// Hits on nodes of one kind, and their times of recovery from kills.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct RoleSummary {
    /// `sim`, `fusion`, `robot`, `standby`, `gateway`, `host`, or `run` for all at once.
    pub(super) role: &'static str,
    /// Killed, one node at a time.
    pub(super) kill: usize,
    /// Stopped for a while.
    pub(super) stop: usize,
    /// Killed again and again while starting.
    pub(super) crash_loop: usize,
    /// Killed with others.
    pub(super) several: usize,
    /// Killed with everything.
    pub(super) total_outage: usize,
    /// Cut off in both directions.
    pub(super) cut: usize,
    /// Cut off in one direction.
    pub(super) one_way: usize,
    /// Down for a while.
    pub(super) reboot: usize,
    /// From a kill until the role is taken again; `None` before the first.
    pub(super) restart_ms: Option<Percentiles>,
    /// From a kill until the first tick with the successor; from the end of a cut or outage until the first tick in which all
    /// robots of the host have their headings in time; `None` before the first.
    pub(super) recovery_ms: Option<Percentiles>,
}

/// Percentiles of a sample.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct Percentiles {
    /// Sample size.
    pub(super) count: usize,
    /// Median.
    pub p50: f64,
    /// 99 %.
    pub p99: f64,
    /// Largest.
    pub(super) max: f64,
}

impl Percentiles {
    fn of(sample: Vec<f64>) -> Option<Self> {
        let sample: Ascending = sample.into_iter().collect();
        let [p50, p99, max] = [0.5, 0.99, 1.0].map(|quantile| sample.measured(quantile));
        Some(Self { count: sample.count(), p50: p50?, p99: p99?, max: max? })
    }
}

/// One node hit by one fault.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Injected {
    /// Number of the fault; hits with one number came at once.
    pub(super) fault: u64,
    /// Which run, counted from 1.
    pub(super) round: usize,
    /// Since the run's start, s.
    pub(super) at_s: f64,
    /// Newest tick that had ended.
    pub(super) tick: u64,
    /// The kind of fault.
    pub(super) kind: Kind,
    /// The node or host.
    #[serde(rename = "role", serialize_with = "by_name")]
    pub(super) target: Target,
    /// How long it was stopped, cut off or down, s.
    pub(super) lasts_s: Option<f64>,
    /// From the (last) kill until the successor takes the role, ms.
    pub(super) restart_ms: Option<f64>,
    /// From the (last) kill, or the end of the outage, until the first tick with the target, ms; in lock step that tick waits
    /// for all others too. `None` for a stop, and if the node was killed again first or the run ended.
    pub(super) recovery_ms: Option<f64>,
}

fn by_name<S: serde::Serializer>(target: &Target, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(target)
}

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Ended {
    /// At its last tick.
    Done,
    /// With an error before that.
    Failed,
    /// It did not end by itself.
    Hung,
    /// On request.
    Interrupted,
}

/// One run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Round {
    /// Seed of the run.
    pub(super) seed: u64,
    /// How it ended.
    pub(super) ended: Ended,
    /// Its last message, if it failed.
    pub(super) last_message: String,
    /// Wall time, s.
    pub(super) wall_s: f64,
    /// The result in its logs.
    pub(super) result: RunResult,
    /// The result of the baseline.
    pub(super) baseline: Option<RunResult>,
    /// True if both must be equal: in lock step.
    pub(super) is_repeatable: bool,
    /// Files in shared memory after the end.
    pub(super) files_left: Vec<String>,
    /// Processes still alive after the end.
    pub(super) processes_left: Vec<i32>,
}

/// The result in a run's logs.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub(super) struct RunResult {
    /// Time steps done.
    pub(super) ticks: u64,
    /// Hash over all estimates.
    pub(super) digest: String,
    /// The outcome of the ranges.
    pub(super) ranges: RangeSummary,
    /// The headings that the robots followed.
    pub(super) headings: HeadingSummary,
    /// Position error, m RMS, if the truth is known.
    pub(super) position_rmse_m: Option<f64>,
}

impl Outcome {
    /// An empty outcome.
    #[must_use]
    pub(super) fn new(scenario: &Scenario, asked: &Asked) -> Self {
        Self {
            scenario: scenario.name.clone(),
            clock: scenario.clock.name(),
            robots: scenario.robots.len(),
            hosts: asked.hosts.map_or(1, |hosts| hosts.count),
            network: asked.hosts.map(|hosts| hosts.conditions),
            chaos_seed: asked.seed,
            faults_asked: asked.faults,
            ..Self::default()
        }
    }

    /// Adds a run.
    pub(super) fn add(&mut self, round: Round) {
        let ranges = &round.result.ranges;
        self.ticks += round.result.ticks;
        self.ranges.published += ranges.published;
        self.ranges.fused += ranges.fused;
        self.ranges.rejected += ranges.rejected;
        self.ranges.late += ranges.late;
        self.ranges.fused_late += ranges.fused_late;
        self.ranges.missing += ranges.missing;
        let headings = &round.result.headings;
        self.headings.fresh += headings.fresh;
        self.headings.late += headings.late;
        self.headings.none += headings.none;
        self.headings.refused += headings.refused;
        self.without_heading = self.headings.late + self.headings.none;
        self.files_left.extend_from_slice(&round.files_left);
        self.processes_left.extend_from_slice(&round.processes_left);
        if let Some(baseline) = round.baseline.as_ref().filter(|_| round.is_repeatable) {
            self.digest_equal = Some(self.digest_equal.unwrap_or(true) && round.result.digest == baseline.digest);
        }
        self.rounds.push(round);
    }

    /// True if the campaign was asked to end.
    pub(super) fn is_interrupted(&self) -> bool {
        self.rounds.iter().any(|round| round.ended == Ended::Interrupted)
    }

    /// Number of faults that were injected.
    pub(super) fn faults_done(&self) -> u64 {
        self.injected.iter().map(|hit| hit.fault + 1).max().unwrap_or(0)
    }

    /// Summarises the faults, and finds broken promises.
    pub(super) fn judge(&mut self) {
        let always = ["sim", "fusion", "robot"].map(|role| self.of_role(role));
        let sometimes = ["standby", "gateway", "host", "run"].map(|role| self.of_role(role));
        let is_hit = |role: &RoleSummary| self.injected.iter().any(|hit| kind_of_target(hit.target) == role.role);
        self.faults = always.into_iter().chain(sometimes.into_iter().filter(is_hit)).collect();
        self.position_rmse_m = self.position_error();
        self.broken = self.rounds.iter().flat_map(Round::broken).collect();
    }

    fn of_role(&self, role: &'static str) -> RoleSummary {
        let hits = || self.injected.iter().filter(|hit| kind_of_target(hit.target) == role);
        let count = |kind: Kind| hits().filter(|hit| hit.kind == kind).count();
        RoleSummary {
            role,
            kill: count(Kind::Kill),
            stop: count(Kind::Stop),
            crash_loop: count(Kind::CrashLoop),
            several: count(Kind::Several),
            total_outage: count(Kind::TotalOutage),
            cut: count(Kind::Cut),
            one_way: count(Kind::OneWay),
            reboot: count(Kind::Reboot),
            restart_ms: Percentiles::of(hits().filter_map(|hit| hit.restart_ms).collect()),
            recovery_ms: Percentiles::of(hits().filter_map(|hit| hit.recovery_ms).collect()),
        }
    }

    fn position_error(&self) -> Option<PositionError> {
        let mean = |of: fn(&Round) -> Option<&RunResult>| {
            let squares = self.rounds.iter().map(|round| {
                let RunResult { ticks, position_rmse_m, .. } = of(round)?;
                Some((*ticks as f64, position_rmse_m.as_ref()?.powi(2)))
            });
            let squares: Vec<(f64, f64)> = squares.collect::<Option<_>>()?;
            let ticks: f64 = squares.iter().map(|(ticks, _)| ticks).sum();
            (ticks > 0.0).then(|| (squares.iter().map(|(ticks, square)| ticks * square).sum::<f64>() / ticks).sqrt())
        };
        Some(PositionError {
            faulted: mean(|round| Some(&round.result))?,
            baseline: mean(|round| round.baseline.as_ref())?,
        })
    }

    /// Writes `chaos.json`.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub(super) fn write(&self, out_dir: &Path) -> anyhow::Result<()> {
        atomic_file::write(&out_dir.join(CHAOS), serde_json::to_string_pretty(self)? + "\n")
    }
}

fn kind_of_target(target: Target) -> &'static str {
    match target {
        Target::Node(Role::Sim) => "sim",
        Target::Node(Role::Fusion) => "fusion",
        Target::Node(Role::Standby(_)) => "standby",
        Target::Node(Role::Robot(_)) => "robot",
        Target::Node(Role::Supervisor) => "run",
        Target::Node(Role::Gateway) => "gateway",
        Target::Host(_) => "host",
    }
}

impl Round {
    /// The promises that this run broke. Ticks, ranges and digest are checked in lock step only: real time
    /// continues without late nodes.
    fn broken(&self) -> Vec<String> {
        let mut broken = Vec::new();
        match self.ended {
            Ended::Done => {}
            Ended::Failed => broken.push(format!("the run failed: {}", self.last_message)),
            Ended::Hung => broken.push(format!("the run hung after tick {}", self.result.ticks)),
            // The user wanted it.
            Ended::Interrupted => {}
        }
        if let Some(baseline) = self.baseline.as_ref().filter(|_| self.is_repeatable) {
            let (got, expected) = (&self.result, baseline);
            for (what, got, expected) in [
                ("ticks", got.ticks, expected.ticks),
                ("ranges published", got.ranges.published, expected.ranges.published),
                ("ranges fused", got.ranges.fused, expected.ranges.fused),
                ("ranges missing", got.ranges.missing, expected.ranges.missing),
            ] {
                if got != expected {
                    broken.push(format!("{got} {what}, expected {expected}"));
                }
            }
            if got.digest != expected.digest {
                broken.push(format!("digest {}, expected {}", got.digest, expected.digest));
            }
        }
        if !self.files_left.is_empty() {
            broken.push(format!("left in shared memory: {}", self.files_left.join(", ")));
        }
        if !self.processes_left.is_empty() {
            broken.push(format!("left running: processes {:?}", self.processes_left));
        }
        broken.iter().map(|what| format!("seed {}: {what}", self.seed)).collect()
    }
}

impl std::fmt::Display for Outcome {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { scenario, clock, robots, chaos_seed, ticks, ranges, headings, .. } = self;
        let done = self.faults_done();
        let wall_s: f64 = self.rounds.iter().map(|round| round.wall_s).sum();
        let asked = self.faults_asked;
        writeln!(
            f,
            "{TITLE}chaos{TITLE:#}: {scenario}, {}, {done} of {asked} faults, seed {chaos_seed}",
            counted(robots, "robot")
        )?;
        let runs = counted(self.rounds.len(), "run");
        writeln!(f, "{}", field(clock, format_args!("{ticks} ticks in {runs}, {wall_s:.1} s")))?;
        if let Some(network) = &self.network {
            writeln!(f, "{}", field("network", format_args!("{} hosts, {network}", self.hosts)))?;
        }
        self.fmt_faults(f)?;
        let RangeSummary { published, fused, missing, .. } = ranges;
        writeln!(f, "{}", field("ranges", format_args!("{published} published: {fused} fused, {missing} missing")))?;
        let HeadingSummary { fresh, late, none, refused } = headings;
        let driven = format!("{fresh} fresh, {late} late, {none} none, {refused} refused");
        writeln!(f, "{}", field("headings", driven))?;
        // If the estimates must be equal, so must their error.
        if let Some(PositionError { faulted, baseline }) =
            self.position_rmse_m.as_ref().filter(|_| self.digest_equal.is_none())
        {
            let more = 100.0 * (faulted / baseline - 1.0);
            let error = format!("{faulted:.3} m RMS, {baseline:.3} without faults: {more:+.1} %");
            writeln!(f, "{}", field("position error", error))?;
        }
        let digest = match self.digest_equal {
            Some(true) => "equal to the same run without faults".to_owned(),
            Some(false) => format!("{BAD}NOT equal{BAD:#} to the same run without faults"),
            None => "not compared".to_owned(),
        };
        writeln!(f, "{}", field("digest", digest))?;
        let (files, processes) = (self.files_left.len(), self.processes_left.len());
        writeln!(f, "{}", field("left over", format_args!("{files} files, {processes} processes")))?;
        let promises = match self.broken.len() {
            0 if self.is_interrupted() => "none broken until it was interrupted".to_owned(),
            0 => format!("{GOOD}all kept{GOOD:#}"),
            broken => format!("{BAD}{broken} broken{BAD:#}"),
        };
        write!(f, "{}", field("promises", promises))
    }
}

impl Outcome {
    /// Number of hits by kind, and recovery times of each kind of node.
    fn fmt_faults(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [kill, stop, crash_loop, several, outage] = ["kill", "stop", "crash loop", "several", "outage"];
        writeln!(f, "  {:<16} {kill:>8} {stop:>8} {crash_loop:>11} {several:>8} {outage:>8}", "hits")?;
        let of_hosts = |role: &&RoleSummary| role.cut + role.one_way + role.reboot > 0;
        for role in self.faults.iter().filter(|role| !of_hosts(role)) {
            let RoleSummary { role, kill, stop, crash_loop, several, total_outage, .. } = role;
            writeln!(f, "  {role:<16} {kill:>8} {stop:>8} {crash_loop:>11} {several:>8} {total_outage:>8}")?;
        }
        for RoleSummary { role, cut, one_way, reboot, .. } in self.faults.iter().filter(of_hosts) {
            writeln!(f, "  {role:<16} {cut} cut off, {one_way} cut off in one direction, {reboot} restarted")?;
        }
        writeln!(f, "  {:<16} {:>26} {:>30}", "recovery, ms", "until its role is taken", "until it takes part")?;
        let [p50, p99, max] = ["p50", "p99", "max"];
        writeln!(f, "  {:<16} {p50:>8} {p99:>8} {max:>8} {p50:>12} {p99:>8} {max:>8}", "")?;
        for RoleSummary { role, restart_ms, recovery_ms, .. } in &self.faults {
            let [taken, takes_part] = [restart_ms, recovery_ms].map(|times_ms| match times_ms {
                Some(Percentiles { p50, p99, max, .. }) => [p50, p99, max].map(|time_ms| format!("{time_ms:.1}")),
                None => ["-"; 3].map(str::to_owned),
            });
            let [[a, b, c], [d, e, g]] = [taken, takes_part];
            writeln!(f, "  {role:<16} {a:>8} {b:>8} {c:>8} {d:>12} {e:>8} {g:>8}")?;
        }
        Ok(())
    }
}

/// True if a run of this clock must equal its baseline.
#[must_use]
pub(super) fn is_repeatable(scenario: &Scenario) -> bool {
    scenario.clock == Clock::Lockstep
}

#[cfg(test)]
mod tests {
    use super::*;

    fn round() -> Round {
        let ranges = RangeSummary { published: 30, fused: 30, ..RangeSummary::default() };
        let result = RunResult { ticks: 10, digest: "a".to_owned(), ranges, ..RunResult::default() };
        Round {
            seed: 1,
            ended: Ended::Done,
            last_message: String::new(),
            wall_s: 1.0,
            result: result.clone(),
            baseline: Some(result),
            is_repeatable: true,
            files_left: Vec::new(),
            processes_left: Vec::new(),
        }
    }

    #[test]
    fn each_broken_promise_is_reported() {
        assert_eq!(round().broken(), [""; 0]);
        type Fault = fn(&mut Round);
        let faults: [(Fault, &str); 8] = [
            (|round| round.result.digest = "b".to_owned(), "seed 1: digest b, expected a"),
            (|round| round.result.ranges.published = 29, "seed 1: 29 ranges published, expected 30"),
            (|round| round.result.ranges.fused = 29, "seed 1: 29 ranges fused, expected 30"),
            (|round| round.result.ranges.missing = 1, "seed 1: 1 ranges missing, expected 0"),
            (|round| round.ended = Ended::Hung, "seed 1: the run hung after tick 10"),
            (|round| round.ended = Ended::Failed, "seed 1: the run failed: "),
            (|round| round.files_left.push("x".to_owned()), "seed 1: left in shared memory: x"),
            (|round| round.processes_left.push(7), "seed 1: left running: processes [7]"),
        ];
        let interrupted = Round { ended: Ended::Interrupted, baseline: None, ..round() };
        assert_eq!(interrupted.broken(), [""; 0], "the user's wish breaks no promise");
        for (inject, expected) in faults {
            let mut round = round();
            inject(&mut round);
            assert_eq!(round.broken(), [expected]);
        }
    }

    /// In real time ranges may be missing: there is no run to compare with.
    #[test]
    fn real_time_may_miss_ranges() {
        let mut round = Round { is_repeatable: false, ..round() };
        round.result.ranges.missing = 5;
        assert_eq!(round.broken(), [""; 0]);
    }

    #[test]
    fn percentiles_are_of_the_sample() {
        assert_eq!(Percentiles::of(Vec::new()), None);
        let sample = (1..=100).rev().map(f64::from).collect();
        assert_eq!(Percentiles::of(sample), Some(Percentiles { count: 100, p50: 50.0, p99: 99.0, max: 100.0 }));
    }
}
