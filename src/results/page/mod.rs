//! `report.html`: the report of a run as one page that needs no other file and no network.
//!
//! | module | what |
//! |---|---|
//! | `sections` | the pictures, each under its heading |
//! | `faults` | failures on the run's time line |

mod faults;
mod sections;

use std::path::Path;

use maud::{DOCTYPE, Markup, PreEscaped, html};

use crate::files::atomic_file;
use crate::files::layout::PAGE;
use crate::results::curves::Curves;
use crate::results::report::verdict::Verdict;
use crate::results::report::{IN_ONE_PROCESS, Report};

/// Width of all pictures, px: labels are legible on a phone.
const WIDTH: u32 = 1_000;

const STYLE: &str = include_str!("style.css");

/// A picture under its heading.
struct Section {
    heading: &'static str,
    /// Explanation of the picture.
    text: String,
    /// An `<svg>` element; empty where there is nothing to draw.
    picture: String,
    /// Content below the picture.
    below: Markup,
}

/// Writes the page into a run folder.
///
/// # Errors
/// If a picture cannot be drawn, or the file not be written.
pub fn write(report: &Report, curves: &Curves, out_dir: &Path) -> anyhow::Result<()> {
    atomic_file::write(&out_dir.join(PAGE), page(report, curves)?)
}

fn page(report: &Report, curves: &Curves) -> anyhow::Result<String> {
    // The sensors of a recording follow no headings.
    let headings = report.recording.is_none().then(|| ("headings", report.headings.to_string()));
    let broad = [(report.measured(), report.ranges.to_string())].into_iter().chain(headings);
    let sections = sections::of(report, curves)?;
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (report.scenario) ": report of a run" }
                style { (PreEscaped(STYLE)) }
            }
            body {
                h1 { (report.scenario) }
                (verdict(&report.verdict))
                dl {
                    @for (name, value) in key_figures(report) { div { dt { (name) } dd { (value) } } }
                    @for (name, value) in broad { div.broad { dt { (name) } dd { (value) } } }
                    div.wide { dt { "digest" } dd { (report.digest) } }
                }
                main {
                    @for Section { heading, text, picture, below } in sections {
                        section {
                            h2 { (heading) }
                            p { (text) }
                            @if !picture.is_empty() { figure { (PreEscaped(picture)) } }
                            (below)
                        }
                    }
                }
            }
        }
    };
    Ok(page.into_string())
}

/// Whether the result is credible, above all figures.
fn verdict(verdict: &Verdict) -> Markup {
    let Verdict { valid, summary, reasons, notes, .. } = verdict;
    let (class, word) = if *valid { ("valid", "Valid") } else { ("invalid", "Not valid") };
    html! {
        div.verdict.(class) {
            strong { (word) }
            span { (summary) }
            @for reason in reasons { p { "likely reason: " (reason) } }
            @for note in notes { p { "note: " (note) } }
        }
    }
}

/// The key figures of the run.
fn key_figures(report: &Report) -> Vec<(&'static str, String)> {
    let Report { position_trace_m2: trace, latency_us: latency, .. } = report;
    let mut figures = vec![
        ("robots", report.robots.to_string()),
        ("planner", report.planner.clone()),
        ("clock", if report.in_one_process { IN_ONE_PROCESS.to_owned() } else { report.clock.clone() }),
        ("seed", report.seed.to_string()),
        ("ticks", format!("{} in {:.2} s", report.ticks, report.wall_s)),
    ];
    let position_error = report.position_rmse_m.map(|rmse_m| ("position error, RMS", format!("{rmse_m:.3} m")));
    let anees = report.anees.map(|anees| ("ANEES, 1 is ideal", format!("{anees:.2}")));
    let nis = report.nis_mean.map(|nis| ("NIS, 1 is ideal", format!("{nis:.2}")));
    let nis_all = report.nis_all_mean.filter(|_| report.ranges.rejected > 0);
    let with_rejected = match report.has_bearings() {
        true => "NIS with the rejected measurements",
        false => "NIS with the rejected ranges",
    };
    let nis_all = nis_all.map(|nis| (with_rejected, format!("{nis:.2}")));
    figures.extend([position_error, anees, nis, nis_all].into_iter().flatten());
    figures.push(("position trace, end", format!("{:.3} m²", trace.r#final)));
    figures.push(("position trace, median", format!("{:.3} m²", trace.median)));
    if report.has_latency() {
        figures.push(("range to heading, p50", format!("{:.0} µs", latency.p50)));
        figures.push(("range to heading, p99", format!("{:.0} µs", latency.p99)));
    }
    figures
}

#[cfg(test)]
mod tests {
    use rangehound_shared::scenario::{Scenario, ScenarioFile};

    use super::*;
    use crate::results::report::{Accumulator, Background};

    #[test]
    fn names_are_escaped() {
        let mut scenario = Scenario::from_file(&ScenarioFile::default(), "test").unwrap();
        scenario.name = "<script>".to_owned();
        let report = Accumulator::new().unwrap().report(&scenario, Background::default(), Vec::new());
        let html = page(&report, &Curves::default()).unwrap();
        assert!(html.contains("<h1>&lt;script&gt;</h1>") && !html.contains("<script>"), "{html}");
    }

    #[test]
    fn a_run_without_ticks_has_a_page_without_pictures() {
        let scenario = Scenario::from_file(&ScenarioFile::default(), "test").unwrap();
        let html =
            page(&Accumulator::new().unwrap().report(&scenario, Background::default(), Vec::new()), &Curves::default())
                .unwrap();
        assert!(html.contains("<dt>robots</dt>") && !html.contains("<svg"), "{html}");
    }
}
