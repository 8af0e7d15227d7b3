//! `report.html`: the report of a run to look at, in one file that needs no other and no net.
//!
//! | module | what |
//! |---|---|
//! | `sections` | the pictures, each under its heading |
//! | `faults` | who failed when, on the run's time line |

mod faults;
mod sections;

use std::fmt::Write;
use std::path::Path;

use crate::curves::Curves;
use crate::report::Report;
use crate::report::verdict::Verdict;
use crate::whole_file;

/// Width of all pictures, px: labels can be read on a phone.
const WIDTH: u32 = 1_000;

/// File name of the page in a run folder.
pub const FILE_NAME: &str = "report.html";

const STYLE: &str = include_str!("style.css");

/// A picture under its heading.
struct Section {
    heading: &'static str,
    /// What the picture shows, as HTML.
    text: String,
    /// An `<svg>` element; empty where there is nothing to draw.
    picture: String,
    /// What follows the picture, as HTML.
    below: String,
}

/// Writes the page into a run folder.
///
/// # Errors
/// If a picture cannot be drawn, or the file not be written.
pub fn write(report: &Report, curves: &Curves, out_dir: &Path) -> anyhow::Result<()> {
    whole_file::write(&out_dir.join(FILE_NAME), page(report, curves)?)
}

fn page(report: &Report, curves: &Curves) -> anyhow::Result<String> {
    let title = escaped(&report.scenario);
    let mut html = format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>{title}: report of a run</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<h1>{title}</h1>\n"
    );
    write_verdict(&mut html, &report.verdict)?;
    html.push_str("<dl>\n");
    for (name, value) in key_figures(report) {
        writeln!(html, "<div><dt>{name}</dt><dd>{}</dd></div>", escaped(&value))?;
    }
    for (name, value) in [("ranges", report.ranges.to_string()), ("headings", report.headings.to_string())] {
        writeln!(html, "<div class=\"broad\"><dt>{name}</dt><dd>{value}</dd></div>")?;
    }
    writeln!(html, "<div class=\"wide\"><dt>digest</dt><dd>{}</dd></div>\n</dl>\n<main>", escaped(&report.digest))?;
    for Section { heading, text, picture, below } in sections::of(report, curves)? {
        writeln!(html, "<section>\n<h2>{heading}</h2>\n<p>{text}</p>")?;
        if !picture.is_empty() {
            writeln!(html, "<figure>\n{picture}</figure>")?;
        }
        writeln!(html, "{below}</section>")?;
    }
    html.push_str("</main>\n</body>\n</html>\n");
    Ok(html)
}

/// Whether the result can be believed, before all figures.
fn write_verdict(html: &mut String, verdict: &Verdict) -> std::fmt::Result {
    let Verdict { sound, summary, reasons, notes } = verdict;
    let (class, word) = if *sound { ("sound", "Sound") } else { ("unsound", "Not sound") };
    write!(html, "<div class=\"verdict {class}\"><strong>{word}</strong><span>{}</span>", escaped(summary))?;
    for (label, text) in
        reasons.iter().map(|reason| ("likely reason", reason)).chain(notes.iter().map(|note| ("note", note)))
    {
        write!(html, "<p>{label}: {}</p>", escaped(text))?;
    }
    html.write_str("</div>\n")
}

/// What the run was and what it came to.
fn key_figures(report: &Report) -> Vec<(&'static str, String)> {
    let Report { position_trace_m2: trace, latency_us: latency, .. } = report;
    let mut figures = vec![
        ("robots", report.robots.to_string()),
        ("planner", report.planner.clone()),
        ("clock", report.clock.clone()),
        ("seed", report.seed.to_string()),
        ("ticks", format!("{} in {:.2} s", report.ticks, report.wall_s)),
    ];
    let position_error = report.position_rmse_m.map(|rmse_m| ("position error, RMS", format!("{rmse_m:.3} m")));
    let anees = report.anees.map(|anees| ("ANEES, 1 is ideal", format!("{anees:.2}")));
    let nis = report.nis_mean.map(|nis| ("NIS, 1 is ideal", format!("{nis:.2}")));
    let nis_all = report.nis_all_mean.filter(|_| report.ranges.rejected > 0);
    let nis_all = nis_all.map(|nis| ("NIS with the rejected ranges", format!("{nis:.2}")));
    figures.extend([position_error, anees, nis, nis_all].into_iter().flatten());
    figures.push(("position trace, end", format!("{:.3} m²", trace.r#final)));
    figures.push(("position trace, median", format!("{:.3} m²", trace.median)));
    if latency.count > 0 {
        figures.push(("range to heading, p50", format!("{:.0} µs", latency.p50)));
        figures.push(("range to heading, p99", format!("{:.0} µs", latency.p99)));
    }
    figures
}

/// Text as it stands in HTML.
fn escaped(text: &str) -> String {
    text.chars().fold(String::with_capacity(text.len()), |mut html, c| {
        match c {
            '<' => html.push_str("&lt;"),
            '>' => html.push_str("&gt;"),
            '&' => html.push_str("&amp;"),
            '"' => html.push_str("&quot;"),
            '\'' => html.push_str("&#39;"),
            other => html.push(other),
        }
        html
    })
}

#[cfg(test)]
mod tests {
    use rangehound_shared::scenario::{Scenario, ScenarioFile};

    use super::*;
    use crate::report::{Background, Tally};

    #[test]
    fn names_are_text_whatever_they_hold() {
        assert_eq!(escaped("<a href='x'>\"&\""), "&lt;a href=&#39;x&#39;&gt;&quot;&amp;&quot;");
        let mut scenario = Scenario::from_file(&ScenarioFile::default(), "test").unwrap();
        scenario.name = "<script>".to_owned();
        let report = Tally::new().unwrap().report(&scenario, Background::default(), Vec::new());
        let html = page(&report, &Curves::default()).unwrap();
        assert!(html.contains("<h1>&lt;script&gt;</h1>") && !html.contains("<script>"), "{html}");
    }

    #[test]
    fn a_run_without_ticks_has_a_page_without_pictures() {
        let scenario = Scenario::from_file(&ScenarioFile::default(), "test").unwrap();
        let html =
            page(&Tally::new().unwrap().report(&scenario, Background::default(), Vec::new()), &Curves::default())
                .unwrap();
        assert!(html.contains("<dt>robots</dt>") && !html.contains("<svg"), "{html}");
    }
}
