//! The report of a run, computed from the logs of its nodes.
//!
//! | module | what |
//! |---|---|
//! | `summary` | the figures: the keys of `report.json` |
//! | `accumulator` | sums over the ticks |
//! | `consistency` | how far NIS and ANEES may be from 1 by chance |
//! | `verdict` | whether the result is credible, and the reasons |
//! | `truth` | a true track to compare with |
//! | `print` | the report on the terminal |

mod accumulator;
pub mod consistency;
mod found;
mod print;
mod summary;
mod truth;
pub mod verdict;

use std::path::Path;

use anyhow::Context;
use rangehound_node::checkpoint;
use rangehound_node::rendezvous::{Role, RunDescription};
use rangehound_node::system::bounded;
use rangehound_shared::record::FusionRecord;
use rangehound_shared::scenario::{Scenario, Source};
use serde::Deserialize;

use crate::files::atomic_file;
use crate::files::layout::REPORT;
use crate::results::frame::{Frames, LoggedTick};
pub use accumulator::{Accumulator, Background, position_covariance, position_error};
pub(crate) use print::IN_ONE_PROCESS;
pub use summary::{
    BearingSummary, Distrust, FoundSummary, HeadingSummary, Incident, LatencySummary, NodeSummary, RangeSummary,
    RefusalSummary, Report, SensorSummary, TraceSummary, measured, of_bearings,
};
pub use truth::Truth;
use verdict::{RecordingEvidence, TruthEvidence};

/// Longest report, bytes: that of the largest team fits in.
const REPORT_LEN_MAX: usize = 16 << 20;

/// Computes the report of a run from its logs; `truth` is the target's true track if the run does not know it. The logs are
/// read once: `also` receives each tick too.
///
/// # Errors
/// If a log cannot be read.
pub fn from_logs(
    description: &RunDescription,
    truth: Option<&Truth>,
    nodes: Vec<NodeSummary>,
    mut also: impl FnMut(LoggedTick<'_>),
) -> anyhow::Result<Report> {
    let mut builder = ReportBuilder::new(truth)?;
    Frames::open(description)?.for_each(|logged| {
        builder.add(logged);
        also(logged);
        Ok(())
    })?;
    let report = builder.finish(&description.scenario, nodes);
    // Nodes save their states, each in a file of its own.
    let saves = |role| description.out_dir.join(checkpoint::file_name(role)).exists();
    Ok(Report { in_one_process: report.ticks > 0 && !saves(Role::Sim) && !saves(Role::Fusion), ..report })
}

/// Sums up the report of a run tick by tick; `truth` is the target's true track if the run does not know it.
#[derive(Debug)]
pub struct ReportBuilder<'a> {
    totals: Accumulator,
    truth: Option<&'a Truth>,
    overlap: Option<Overlap>,
}

impl<'a> ReportBuilder<'a> {
    /// A report before its first tick.
    ///
    /// # Errors
    /// If the histograms cannot be allocated.
    pub fn new(truth: Option<&'a Truth>) -> anyhow::Result<Self> {
        Ok(Self { totals: Accumulator::new()?, truth, overlap: truth.map(Overlap::of) })
    }

    /// Adds the next tick.
    pub fn add(&mut self, logged: LoggedTick<'_>) {
        let Self { totals, truth, overlap } = self;
        let LoggedTick { tick, fusion, world } = logged;
        if let Some(world) = world {
            totals.add_world(world.ended_ns, &world.robots);
        }
        let Some(FusionRecord { time_s, estimate, exchanges }) = fusion else { return };
        totals.add_unlogged(exchanges, world.map_or(&[][..], |world| &world.robots));
        totals.add_sensors(estimate, exchanges);
        if let Some(world) = world {
            totals.add_hops(&estimate.stages, &world.robots);
        }
        let truth_m = logged.target_m().or_else(|| truth.and_then(|truth| truth.at(*time_s)));
        if let Some(overlap) = overlap.as_mut().filter(|_| tick > 0) {
            overlap.add(*time_s, truth_m.is_some());
        }
        totals.add_estimate(tick, estimate, truth_m);
    }

    /// The report of all ticks that were added.
    #[must_use]
    pub fn finish(self, scenario: &Scenario, nodes: Vec<NodeSummary>) -> Report {
        let recording = match &scenario.source {
            Source::Recorded(ranges) => Some(RecordingEvidence {
                doubts: ranges.summary.doubts.iter().map(|doubt| doubt.text.clone()).collect(),
                has_unused_heights: ranges.has_heights && ranges.target_height_m.is_none(),
            }),
            Source::Simulated { .. } => None,
        };
        let background = Background { truth: self.overlap.map(Overlap::evidence), recording };
        self.totals.report(scenario, background, nodes)
    }
}

/// Overlap of a true track with a run.
#[derive(Debug)]
struct Overlap {
    evidence: TruthEvidence,
    ticks: u64,
    covered: u64,
}

impl Overlap {
    fn of(truth: &Truth) -> Self {
        Self { evidence: TruthEvidence { span_s: truth.span_s(), ..TruthEvidence::default() }, ticks: 0, covered: 0 }
    }

    fn add(&mut self, time_s: f64, is_covered: bool) {
        let [first_s, last_s] = &mut self.evidence.run_span_s;
        if self.ticks == 0 {
            *first_s = time_s;
        }
        *last_s = time_s;
        self.ticks += 1;
        self.covered += u64::from(is_covered);
    }

    fn evidence(self) -> TruthEvidence {
        TruthEvidence { covered_share: self.covered as f64 / self.ticks.max(1) as f64, ..self.evidence }
    }
}

/// The processes in the `report.json` of a run folder; none if there is no report yet.
///
/// # Errors
/// If the file cannot be read as a report.
pub fn read_nodes(out_dir: &Path) -> anyhow::Result<Vec<NodeSummary>> {
    #[derive(Deserialize)]
    struct Reported {
        nodes: Vec<NodeSummary>,
    }
    let path = out_dir.join(REPORT);
    if !path.exists() {
        return Ok(Vec::new());
    }
    let unusable = || format!("cannot use {}: expected the report of a run, as `run` writes it", path.display());
    let text = bounded::read(&path, REPORT_LEN_MAX).with_context(unusable)?;
    Ok(serde_json::from_slice::<Reported>(&text).with_context(unusable)?.nodes)
}

/// Writes `report.json`.
///
/// # Errors
/// If the file cannot be written.
pub fn write(report: &Report, out_dir: &Path) -> anyhow::Result<()> {
    atomic_file::write(&out_dir.join(REPORT), serde_json::to_string_pretty(report)? + "\n")
}
