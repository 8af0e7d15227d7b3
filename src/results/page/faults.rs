//! Failures of nodes and robots on the run's time line.

use std::collections::BTreeSet;
use std::fmt::Write;

use maud::{Markup, html};
use plotters::prelude::*;
use rangehound_shared::scenario::name_of;

use super::{Section, WIDTH};
use crate::draw::chart::{self, COLOURS, Drawn, ESTIMATE, KeyEntry};
use crate::results::curves::{Bucket, Curves};
use crate::results::report::{Distrust, Incident, NodeSummary, Report, of_bearings};

/// Most nodes that have their own row.
const NODES_MAX: usize = 24;

/// Most rows of the table.
const LINES_MAX: usize = 50;

/// Height of a row, px.
const ROW: u32 = 50;

/// Height of axis and margins, px.
const FRAME: u32 = 110;

/// Most marks that can be distinguished along a row.
const PLACES: f64 = 500.0;

/// A kind of trouble in the logs: its name, and the number of affected robots.
type Trouble<Name> = (Name, fn(&Bucket) -> u64);

const WITHOUT_HEADING: &str = "without heading";

const TROUBLES: [Trouble<&str>; 4] = [
    ("robots missing", |bucket| bucket.missing),
    ("ranges late", |bucket| bucket.late),
    ("robots distrusted", |bucket| bucket.distrusted),
    (WITHOUT_HEADING, |bucket| bucket.without_heading),
];

/// All failures that the logs and the supervisor recorded.
pub(super) fn section(report: &Report, curves: &Curves) -> anyhow::Result<Section> {
    let nodes: Vec<&NodeSummary> = report.nodes.iter().filter(|node| has_failed(node)).collect();
    let count = |of: fn(&Bucket) -> u64| curves.buckets.iter().map(of).fold(0, u64::saturating_add);
    // The sensors of a recording follow no headings.
    let is_meant = |name| name != WITHOUT_HEADING || report.recording.is_none();
    let troubles = TROUBLES.into_iter().filter(|(name, of)| is_meant(*name) && count(*of) > 0);
    let troubles: Vec<Trouble<String>> =
        troubles.map(|(name, of)| (name.replace("ranges", report.measured()), of)).collect();
    if nodes.is_empty() && troubles.is_empty() {
        let text = "No node ended before the run did; no robot was missing, late or distrusted.".to_owned();
        return Ok(Section { heading: "Faults", text, picture: String::new(), below: Markup::default() });
    }
    let drawn = &nodes[..nodes.len().min(NODES_MAX)];
    let titles: Vec<String> = drawn.iter().map(|node| node.title()).collect();
    let names: Vec<&str> =
        troubles.iter().map(|(name, _)| name.as_str()).chain(titles.iter().map(String::as_str)).collect();
    let key = key(!troubles.is_empty(), drawn);
    let height = chart::key_height(WIDTH, &key) + FRAME + ROW * names.len() as u32;
    let picture = chart::draw_to_string((WIDTH, height), |area| {
        let below = chart::draw_key(area, &key)?;
        let mut chart = chart::draw_rows(&below, &names, curves.span_s(), "time, s")?;
        let tops = (1..=names.len()).rev().map(|top| top as f64);
        for ((_, of), top) in troubles.iter().zip(tops.clone()) {
            draw_troubles(&mut chart, curves, report.robots, *of, top)?;
        }
        for (node, top) in drawn.iter().zip(tops.skip(troubles.len())) {
            draw_incidents(&mut chart, curves, node, top)?;
        }
        Ok(())
    })?;
    let totals = troubles.iter().map(|(name, of)| format!("{name} {}", count(*of)));
    let mut text = if nodes.is_empty() {
        "No node ended before the run did.".to_owned()
    } else {
        "Nodes that ended before the run did. Each mark is at the run's time when it happened.".to_owned()
    };
    if !troubles.is_empty() {
        let totals: Vec<String> = totals.collect();
        write!(text, " Sums over the ticks: {}. Darker grey is a larger part of the team.", totals.join(", "))?;
    }
    if let Some(more) = nodes.len().checked_sub(NODES_MAX).filter(|more| *more > 0) {
        write!(text, " {more} more nodes failed too.")?;
    }
    Ok(Section { heading: "Faults", text, picture, below: table(report, curves, &nodes) })
}

/// True if anything happened to the node after its first start.
fn has_failed(node: &NodeSummary) -> bool {
    node.starts > 1 || node.kills + node.exits > 0
}

fn colour_of(incident: Incident) -> RGBColor {
    match incident {
        Incident::Started => COLOURS[2],
        Incident::Killed => ESTIMATE,
        Incident::Exited => COLOURS[1],
        Incident::Hung => COLOURS[3],
    }
}

fn key(has_troubles: bool, nodes: &[&NodeSummary]) -> Vec<KeyEntry> {
    let troubles = has_troubles.then(|| ("affected part of the team".to_owned(), grey(0.5).stroke_width(24)));
    let happened = |incident| nodes.iter().any(|node| incidents(node).any(|(_, what)| what == incident));
    let incidents = Incident::ALL.into_iter().filter(|incident| happened(*incident));
    let incidents = incidents.map(|incident| (incident.to_string(), colour_of(incident).stroke_width(16)));
    troubles.into_iter().chain(incidents).collect()
}

/// Incidents of a node after its first start.
fn incidents(node: &NodeSummary) -> impl Iterator<Item = (u64, Incident)> {
    node.incidents.iter().copied().skip(1)
}

/// Black for the whole team; opaque, because neighbouring buckets meet in one column of pixels.
fn grey(part: f64) -> RGBColor {
    let shade = (200.0 * (1.0 - part.min(1.0))) as u8;
    RGBColor(shade, shade, shade)
}

/// The darkness of a bucket is the affected part of the team.
fn draw_troubles(
    chart: &mut chart::Plane<'_, '_>,
    curves: &Curves,
    robots: usize,
    of: fn(&Bucket) -> u64,
    top: f64,
) -> Drawn {
    let ends = curves.buckets.iter().skip(1).map(|next| next.time_s).chain([curves.span_s().end]);
    for (bucket, end_s) in curves.buckets.iter().zip(ends).filter(|(bucket, _)| of(bucket) > 0) {
        let part = of(bucket) as f64 / (bucket.ticks as f64 * robots as f64);
        let corners = [(bucket.time_s, top - 0.85), (end_s, top - 0.15)];
        chart.draw_series(std::iter::once(Rectangle::new(corners, grey(part).filled())))?;
    }
    Ok(())
}

/// Ends are drawn above, starts below: in a fast run they coincide.
fn draw_incidents(chart: &mut chart::Plane<'_, '_>, curves: &Curves, node: &NodeSummary, top: f64) -> Drawn {
    let span_s = curves.span_s();
    let mut drawn = BTreeSet::new();
    for (at_ns, incident) in incidents(node) {
        let Some(time_s) = curves.time_s_at(at_ns).map(|time_s| time_s.clamp(span_s.start, span_s.end)) else {
            continue;
        };
        let place = PLACES * (time_s - span_s.start) / (span_s.end - span_s.start);
        if !drawn.insert((place as u64, incident)) {
            continue;
        }
        let fill = colour_of(incident).filled();
        match incident {
            Incident::Started => chart.draw_series([TriangleMarker::new((time_s, top - 0.72), 9, fill)])?,
            Incident::Killed | Incident::Exited | Incident::Hung => {
                chart.draw_series([Circle::new((time_s, top - 0.3), 8, fill)])?
            }
        };
    }
    Ok(())
}

/// The first incidents, as a table.
fn table(report: &Report, curves: &Curves, nodes: &[&NodeSummary]) -> Markup {
    let mut incidents: Vec<(u64, Incident, String)> = nodes
        .iter()
        .flat_map(|node| incidents(node).map(|(at_ns, incident)| (at_ns, incident, node.title())))
        .collect();
    incidents.sort_unstable();
    let incidents = incidents.into_iter().map(|(at_ns, incident, node)| {
        let time_s = curves.time_s_at(at_ns).unwrap_or_default();
        (format!("{time_s:.2} s"), format!("{node} {incident}"))
    });
    let distrusted = report.distrusted.iter().map(|Distrust { robot, sensor, kind, from_tick, to_tick }| {
        let until = to_tick.map_or("the end".to_owned(), |tick| tick.to_string());
        let name = name_of(*robot, report.recording.as_ref().map(|_| sensor.as_str()));
        (format!("tick {from_tick} to {until}"), format!("{name} distrusted{}", of_bearings(kind)))
    });
    let lines: Vec<(String, String)> = incidents.chain(distrusted).collect();
    html! {
        @if !lines.is_empty() {
            table {
                tr { th { "when" } th { "what" } }
                @for (when, what) in lines.iter().take(LINES_MAX) { tr { td { (when) } td { (what) } } }
            }
        }
        @if lines.len() > LINES_MAX { p { "And " (lines.len() - LINES_MAX) " more." } }
    }
}
