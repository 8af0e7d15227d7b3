//! All output that is made from a run's logs: the report (printed and written), tables, page and picture.

use std::path::Path;

use rangehound_node::rendezvous::RunDescription;

use super::curves::CurvesBuilder;
use super::frame::LoggedTick;
use super::report::{self, NodeSummary, Report, Truth};
use super::tables::{write_estimate_csv, write_recording};
use super::{page, picture};
use crate::failure::{self, Failure};
use crate::terminal;

/// Ticks times robots above which the report takes seconds, so that a message announces it.
const LONG: u64 = 1_000_000;

/// Outputs beyond the report, and how the report is printed.
#[derive(Debug, Default)]
pub struct Keep {
    /// The ranges and the true track are written as a recording.
    pub ranges: bool,
    /// The true track to compare with, if the run does not know it.
    pub truth: Option<Truth>,
    /// The report is printed as JSON.
    pub json: bool,
    /// An invalid result is a failure.
    pub strict: bool,
}

/// Prints the report of a run and writes all other output. A file that cannot be written does not prevent the others.
///
/// # Errors
/// [`Failure::Running`] with the first file that could not be read or written.
pub fn report_and_tables(
    description: &RunDescription,
    keep: &Keep,
    nodes: Vec<NodeSummary>,
) -> Result<Report, Failure> {
    let &Keep { ranges, ref truth, strict, .. } = keep;
    let truth = truth.as_ref();
    let mut curves = CurvesBuilder::new(&description.scenario, truth);
    let (report, printed) = make_report(description, keep, nodes, |logged| curves.add(logged))?;
    let written = report::write(&report, &description.out_dir);
    let table = write_estimate_csv(description);
    let recorded = if ranges { write_recording(description) } else { Ok(()) };
    if let Err(error) = draw(&report, curves, &description.out_dir) {
        log::warn!("cannot draw the picture or the page: {error}");
    }
    written.and(table).and(recorded)?;
    printed?;
    if strict && !report.verdict.valid {
        return Err(Failure::Running(anyhow::anyhow!(
            "the result is not valid (--strict): see the likely reasons above"
        )));
    }
    Ok(report)
}

/// Prints the report of a run that another process logs.
///
/// # Errors
/// [`Failure::Running`] if a log cannot be read, or standard output not written.
pub fn print_report(description: &RunDescription, keep: &Keep, nodes: Vec<NodeSummary>) -> Result<Report, Failure> {
    let (report, printed) = make_report(description, keep, nodes, |_| ())?;
    printed.map(|()| report)
}

/// A run's report, and whether it could be printed. The logs are read once: `also` receives each tick too.
fn make_report(
    description: &RunDescription,
    keep: &Keep,
    nodes: Vec<NodeSummary>,
    also: impl FnMut(LoggedTick<'_>),
) -> anyhow::Result<(Report, Result<(), Failure>)> {
    let &Keep { ref truth, json, .. } = keep;
    let truth = truth.as_ref();
    let scenario = &description.scenario;
    if scenario.ticks.saturating_mul(scenario.robots.len() as u64) >= LONG {
        failure::print_stderr("the run is over; making its report");
    }
    let report = report::from_logs(description, truth, nodes, also)?;
    let printed = if json {
        failure::print_json(&report)
    } else {
        let folder = terminal::field("run folder", from_here(&description.out_dir).display());
        failure::print(format!("{report}\n{folder}\n"))
    };
    Ok((report, printed))
}

/// A path as typed relative to the current folder.
pub(crate) fn from_here(path: &Path) -> &Path {
    let here = std::env::current_dir().ok();
    let below = here.and_then(|here| path.strip_prefix(here).ok()).filter(|below| !below.as_os_str().is_empty());
    below.unwrap_or(path)
}

/// Draws the page and the picture.
///
/// # Errors
/// If the logs hold numbers that cannot be drawn, or a file cannot be written.
pub fn draw(report: &Report, curves: CurvesBuilder<'_>, out_dir: &Path) -> anyhow::Result<()> {
    let curves = curves.finish()?;
    picture::draw(&curves, out_dir)?;
    page::write(report, &curves, out_dir)
}
