//! The pictures of the page, each below its heading, drawn with the same functions as all other pictures.

use std::fmt::Write;

use maud::Markup;
use plotters::prelude::*;

use super::{Section, WIDTH, faults};
use crate::draw::chart::{self, COLOURS, ESTIMATE, TARGET};
use crate::draw::ellipse::Ellipse;
use crate::draw::over_time::{Band, Line, OverTime};
use crate::results::curves::{Bucket, Curves, DRAWABLE_MAX};
use crate::results::percentiles;
use crate::results::report::Report;
use crate::statistics::{Ascending, Interval, chi_square_mean_bounds};

const HEIGHT: u32 = 600;

/// All sections for which there are data.
pub(super) fn of(report: &Report, curves: &Curves) -> anyhow::Result<Vec<Section>> {
    let mut sections = Vec::new();
    if curves.has_length() {
        sections.push(paths(curves)?);
        sections.extend(errors(curves)?);
        sections.push(trace(curves, report)?);
        sections.extend(nis(curves, report)?);
    }
    if report.has_latency() {
        sections.push(latency(report)?);
        sections.push(hops(report)?);
    }
    if curves.has_length() {
        sections.push(faults::section(report, curves)?);
    }
    Ok(sections)
}

fn section(heading: &'static str, text: impl Into<String>, picture: String) -> Section {
    Section { heading, text: text.into(), picture, below: Markup::default() }
}

fn paths(curves: &Curves) -> anyhow::Result<Section> {
    let size = curves.paths.complete_size(WIDTH);
    let picture = chart::draw_to_string(size, |area| curves.paths.draw_complete(area))?;
    let mut text =
        "The field from above, with 3 sigma ellipses of the estimate. Marks show the last positions.".to_owned();
    let beliefs = || curves.paths.beliefs.iter().flatten();
    if beliefs().any(|belief| belief.ray_end_m.is_some()) {
        text.push_str(" Pale lines are bearings, from where the robot believed it was.");
    }
    if beliefs().any(|belief| belief.covariance_m2.is_some()) {
        text.push_str(" Ellipses in a robot's colour are its own 3 sigma, with a line from where it was to where it believed it was.");
    }
    // On a large field the ellipse is too small to see, so the text gives its half axes.
    let last = curves.paths.estimates_m.last().zip(curves.paths.covariances_m2.last());
    if let Some((centre_m, covariance_m2)) = last {
        let [one_m, other_m] = Ellipse::new(*centre_m, covariance_m2, 3.0).half_m();
        let (long, short) = (chart::short(one_m.max(other_m)), chart::short(one_m.min(other_m)));
        write!(text, " The half axes of the last ellipse are {long} m and {short} m.")?;
    }
    Ok(section("Paths", text, picture))
}

/// The errors in x and y beside the filter's standard deviations; `None` if the truth is unknown.
fn errors(curves: &Curves) -> anyhow::Result<Option<Section>> {
    if curves.errors_m().next().is_none() {
        return Ok(None);
    }
    let limit_m = error_limit_m(curves);
    let picture = chart::draw_to_string((WIDTH, 2 * HEIGHT), |area| {
        let (upper, lower) = area.split_vertically(HEIGHT + 30);
        let limits = || -limit_m..limit_m;
        error_of_axis(curves, 0, "x: estimate − truth, m", true).draw(&upper, curves.span_s(), limits())?;
        error_of_axis(curves, 1, "y: estimate − truth, m", false).draw(&lower, curves.span_s(), limits())
    })?;
    let text = "The error on the filter's own standard deviations: if the filter is consistent, the error is within \
                1 sigma two thirds of the time, and hardly ever beyond 3. Values beyond an edge are drawn on it.";
    Ok(Some(section("Position error", text, picture)))
}

fn error_of_axis(curves: &Curves, axis: usize, label: &str, is_named: bool) -> OverTime {
    let name = |name: &str| is_named.then(|| name.to_owned());
    let band = |sigmas: f64, strength: f64| {
        let covariances = curves.times_s.iter().zip(&curves.paths.covariances_m2);
        let limit = |(time_s, p): (&f64, &nalgebra::Matrix2<f64>)| {
            let limit_m = sigmas * p[(axis, axis)].max(0.0).sqrt();
            (*time_s, -limit_m, limit_m)
        };
        Band {
            name: name(&format!("{sigmas} sigma")),
            colour: ESTIMATE.mix(strength),
            points: covariances.map(limit).collect(),
        }
    };
    let error = Line {
        name: name("error"),
        style: TARGET.stroke_width(2),
        points: curves.errors_m().map(|(time_s, error_m)| (time_s, error_m[axis])).collect(),
    };
    OverTime { label: label.to_owned(), bands: vec![band(3.0, 0.15), band(1.0, 0.25)], lines: vec![error] }
}

/// The limit of the error axes.
fn error_limit_m(curves: &Curves) -> f64 {
    let deviations = curves.paths.covariances_m2.iter().flat_map(|p| [p[(0, 0)], p[(1, 1)]]);
    let deviations = deviations.map(|variance| 3.0 * variance.max(0.0).sqrt());
    let errors = curves.errors_m().flat_map(|(_, error_m)| [error_m.x.abs(), error_m.y.abs()]);
    limit(&deviations.chain(errors).collect())
}

/// The limit of an axis for these extents: a poor start or a short loss must not hide the rest.
fn limit(extents: &Ascending) -> f64 {
    (1.05 * extents.quantile(1.0)).min(2.0 * extents.quantile(0.95)).max(1e-6)
}

fn trace(curves: &Curves, report: &Report) -> anyhow::Result<Section> {
    // The bound of the last tick refers to a tick that is not in the run.
    let end_s = curves.span_s().end;
    let least_m2: Vec<(f64, f64)> =
        curves.least_traces_m2.iter().copied().filter(|(time_s, _)| *time_s <= end_s).collect();
    let is_proven = !least_m2.is_empty();
    let name = |name: &str| is_proven.then(|| name.to_owned());
    let trace = Line { name: name("trace"), style: ESTIMATE.stroke_width(3), points: curves.traces_m2().collect() };
    // Thin and on top: the trace mostly coincides with it.
    let least =
        is_proven.then(|| Line { name: name("proven lower bound"), style: BLACK.stroke_width(1), points: least_m2 });
    let lines = [trace].into_iter().chain(least).collect();
    let chart = OverTime { label: "trace, m²".to_owned(), lines, ..OverTime::default() };
    let picture = chart::draw_to_string((WIDTH, HEIGHT), |area| chart.draw_log(area, curves.span_s()))?;
    let mut text = "Trace of the position covariance: what the planner minimises.".to_owned();
    if is_proven {
        write!(
            text,
            " The thin line is the planner's proven lower bound: no headings at the previous tick lead to less, if all {} \
             are fused.",
            report.measured()
        )?;
    }
    Ok(section("Trace", text, picture))
}

/// Innovations beside the filter's own covariance; `None` if nothing was fused.
fn nis(curves: &Curves, report: &Report) -> anyhow::Result<Option<Section>> {
    let fused: Vec<&Bucket> =
        curves.buckets.iter().filter(|bucket| bucket.fused > 0 && bucket.nis.abs() <= DRAWABLE_MAX).collect();
    let Some(first) = fused.first() else { return Ok(None) };
    let point = |bucket: &&Bucket| (bucket.time_s, bucket.nis / bucket.fused as f64);
    let band = |bucket: &&Bucket| {
        let Interval { low, high } = chi_square_mean_bounds(1, bucket.fused as usize);
        (bucket.time_s, low, high)
    };
    let points: Vec<(f64, f64)> = fused.iter().map(point).collect();
    let bounds: Vec<(f64, f64, f64)> = fused.iter().map(band).collect();
    let values = points.iter().map(|(_, nis)| *nis).chain(bounds.iter().flat_map(|(_, low, high)| [*low, *high]));
    // Symmetric about the ideal: the mean over many ticks of a consistent filter is close to it.
    let limit = limit(&values.map(|nis| (nis - 1.0).abs()).collect());
    let limits = (1.0 - limit).max(0.0)..1.0 + limit;
    let span_s = curves.span_s();
    let chart = OverTime {
        label: format!("NIS for each {}", report.measured().trim_end_matches('s')),
        bands: vec![Band {
            name: Some("95 % of consistent filters".to_owned()),
            colour: BLACK.mix(0.15),
            points: bounds,
        }],
        lines: vec![
            Line {
                name: None,
                style: BLACK.mix(0.5).stroke_width(2),
                points: [span_s.start, span_s.end].map(|time_s| (time_s, 1.0)).into(),
            },
            Line { name: Some("NIS".to_owned()), style: COLOURS[0].stroke_width(2), points },
        ],
    };
    let picture = chart::draw_to_string((WIDTH, HEIGHT), |area| chart.draw(area, span_s, limits))?;
    let ticks = first.ticks;
    let each = if ticks > 1 { format!(" Each point is the mean of {ticks} ticks.") } else { String::new() };
    let text =
        format!("Innovations squared over their covariance: 1 is ideal; above 1 the filter is overconfident.{each}");
    Ok(Some(section("NIS", text, picture)))
}

fn latency(report: &Report) -> anyhow::Result<Section> {
    let curve = (report.percentiles.as_slice(), COLOURS[6]);
    let samples = report.latency_us.count;
    let picture = chart::draw_to_string((WIDTH, HEIGHT), |area| percentiles::draw_curves(area, &[curve], samples))?;
    let text = format!("Time from publishing a range to receiving the heading computed from it: {samples} samples.");
    Ok(section("Latency", text, picture))
}

fn hops(report: &Report) -> anyhow::Result<Section> {
    let picture = chart::draw_to_string((WIDTH, HEIGHT), |area| {
        percentiles::draw_hops(area, &report.hops_us, COLOURS[6], "µs: median (dark) and 99th percentile (pale)")
    })?;
    Ok(section("Hops", "The parts of this time, on a logarithmic axis.", picture))
}
