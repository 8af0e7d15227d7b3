//! The percentile curves, on the axis that users of HdrHistogram know: each step to the right leaves a tenth.

use std::path::Path;

use plotters::prelude::*;

use super::outcome::{Contender, Each, Outcome, Point};
use crate::chart::{self, COLOURS, Drawn};
use crate::hops;

/// File name of the picture in the output folder.
pub(super) const FILE_NAME: &str = "latency.svg";

const SIZE: (u32, u32) = (1_800, 1_300);

/// Height of the bars beneath the curves.
const BARS: u32 = 300;

/// Draws the picture into a folder.
///
/// # Errors
/// If it cannot be written.
pub(super) fn draw(outcome: &Outcome, folder: &Path) -> anyhow::Result<()> {
    let path = folder.join(FILE_NAME);
    draw_to(outcome, &path).map_err(|error| anyhow::anyhow!("{}: {error}", path.display()))
}

fn colours() -> Each<RGBColor> {
    Each { system: COLOURS[6], iceoryx2: COLOURS[0], futex: COLOURS[2] }
}

fn draw_to(outcome: &Outcome, path: &Path) -> Drawn {
    let root = SVGBackend::new(path, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    let colours = colours();
    let name = |contender| format!("{contender}: median {:.1} us", outcome.latency_us.get(contender).p50);
    let key: Vec<_> = Contender::ALL.into_iter().map(|one| (name(one), *colours.get(one))).collect();
    let below = chart::draw_key(&root, &key)?;
    let height = below.dim_in_pixel().1;
    let (curves, bars) = below.split_vertically(height.saturating_sub(BARS));
    draw_curves(outcome, &curves)?;
    draw_hops(outcome, &bars)?;
    root.present()?;
    Ok(())
}

/// Where a point stands on the axis: the tenths to which the samples above it come down.
fn tenths(point: &Point, last: f64) -> f64 {
    (-(1.0 - point.percentile / 100.0).log10()).min(last)
}

/// The percentile at so many tenths.
fn percentile(tenths: &f64) -> String {
    if tenths.fract().abs() > 1e-9 {
        return String::new();
    }
    let nines = *tenths as usize;
    match nines {
        0 => "0 %".to_owned(),
        1 => "90 %".to_owned(),
        2 => "99 %".to_owned(),
        more => format!("99.{} %", "9".repeat(more - 2)),
    }
}

fn draw_curves(outcome: &Outcome, area: &chart::Area<'_>) -> Drawn {
    let curves = Contender::ALL.map(|contender| (contender, outcome.percentiles.get(contender)));
    let samples = Contender::ALL.map(|contender| outcome.latency_us.get(contender).count).into_iter().max();
    // The largest sample is the last of so many.
    let last = (samples.unwrap_or(0).max(10) as f64).log10();
    let values = curves.iter().flat_map(|(_, points)| points.iter().map(|point| point.latency_us));
    let mut chart = ChartBuilder::on(area)
        .margin(20)
        .margin_right(60)
        .x_label_area_size(60)
        .y_label_area_size(110)
        .build_cartesian_2d(0.0..last, chart::log_limits(values).log_scale())?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .label_style(chart::LABELS)
        .x_labels(last as usize + 1)
        .x_label_formatter(&percentile)
        .y_label_formatter(&chart::short)
        .x_desc("part of the samples that take no longer")
        .y_desc("from range to heading, us")
        .draw()?;
    for (contender, points) in curves {
        let line = points.iter().filter(|point| point.latency_us > 0.0);
        let line = line.map(|point| (tenths(point, last), point.latency_us));
        chart.draw_series(LineSeries::new(line, colours().get(contender).stroke_width(4)))?;
    }
    Ok(())
}

/// Where the system's time goes, hop by hop.
fn draw_hops(outcome: &Outcome, area: &chart::Area<'_>) -> Drawn {
    let hops_us = outcome.hops_us.in_order();
    let widest = hops_us.iter().map(|hop| hop.p99).fold(1e-3, f64::max);
    let count = hops_us.len() as f64;
    let colour = colours().system;
    let mut chart = ChartBuilder::on(area)
        .margin(20)
        .margin_right(60)
        .x_label_area_size(60)
        .y_label_area_size(260)
        .build_cartesian_2d(0.0..widest * 1.02, 0.0..count)?;
    // From the top down, each in the middle of its row.
    let name = |row: &f64| {
        let middle = count - 0.5 - row;
        let index = middle.round();
        if (middle - index).abs() < 1e-6 { hops::NAMES.get(index as usize).map_or("", |name| *name) } else { "" }
            .to_owned()
    };
    chart
        .configure_mesh()
        .disable_mesh()
        .label_style(chart::LABELS)
        .y_labels(2 * hops_us.len() + 1)
        .y_label_formatter(&name)
        .x_label_formatter(&chart::short)
        .x_desc("hops of the system, us: median, and pale up to 99 %")
        .draw()?;
    for (index, hop) in hops_us.iter().enumerate() {
        let top = count - index as f64;
        let bar = |to_us: f64, strength: f64| {
            Rectangle::new([(0.0, top - 0.85), (to_us, top - 0.15)], colour.mix(strength).filled())
        };
        chart.draw_series([bar(hop.p99, 0.25), bar(hop.p50, 1.0)])?;
    }
    Ok(())
}
