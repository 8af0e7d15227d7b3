//! Pictures of latency percentiles: the curve, and a bar for each hop.

use plotters::prelude::*;
use serde::Serialize;

use crate::draw::chart::{self, Area, Drawn, LogAxis};
use crate::results::hops::HopSummary;
use crate::statistics::Samples;

/// Points of a curve each time the remaining part halves.
const POINTS_PER_HALVING: u32 = 5;

/// Latencies from here on are labelled with powers of ten: there is little room beside the axis.
const WIDE_US: f64 = 1e6;

/// A point of a percentile curve.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Point {
    /// Part of the samples, %.
    pub percentile: f64,
    /// The largest latency of this part, us.
    pub latency_us: f64,
}

/// The percentile curve of latencies.
#[must_use]
pub fn curve(latencies_us: &Samples) -> Vec<Point> {
    let points = latencies_us.curve(POINTS_PER_HALVING);
    points.map(|(quantile, latency_us)| Point { percentile: 100.0 * quantile, latency_us }).collect()
}

/// Position of a point on the axis: the number of tenfold reductions of the samples above it.
fn tenths(point: &Point, last: f64) -> f64 {
    (-(1.0 - point.percentile / 100.0).log10()).min(last)
}

/// The percentile at this axis position.
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

/// Draws curves on the axis of HdrHistogram: each step to the right leaves a tenth of the samples. The last point is
/// the largest of the `samples`.
///
/// # Errors
/// The backend's.
pub fn draw_curves(area: &Area<'_>, curves: &[(&[Point], RGBColor)], samples: u64) -> Drawn {
    let last = (samples.max(10) as f64).log10();
    let values = curves.iter().flat_map(|(points, _)| points.iter().map(|point| point.latency_us));
    let mut chart = ChartBuilder::on(area)
        .margin(20)
        .margin_right(60)
        .x_label_area_size(60)
        .y_label_area_size(110)
        .build_cartesian_2d(0.0..last, LogAxis(chart::log_limits(values)))?;
    let number = chart::numbers(chart.as_coord_spec().y_spec(), WIDE_US);
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .label_style(chart::LABELS)
        .x_labels(last as usize + 1)
        .x_label_formatter(&percentile)
        .y_label_formatter(&number)
        .x_desc("part of the samples that take no longer")
        .y_desc("from range to heading, µs")
        .draw()?;
    for (points, colour) in curves {
        let line = points.iter().filter(|point| point.latency_us > 0.0);
        let line = line.map(|point| (tenths(point, last), point.latency_us));
        chart.draw_series(LineSeries::new(line, colour.stroke_width(4)))?;
    }
    Ok(())
}

/// Draws the duration of each hop on a log axis: a rare duration may be a thousand times as long as a usual one.
///
/// # Errors
/// The backend's.
pub fn draw_hops(area: &Area<'_>, hops_us: &HopSummary, colour: RGBColor, label: &str) -> Drawn {
    let (names, hops_us): (Vec<_>, Vec<_>) = hops_us.named().into_iter().unzip();
    // Room for the shortest bar, which starts below its median.
    let limits = chart::log_limits(hops_us.iter().flat_map(|hop| [hop.p50 / 2.0, hop.p99]));
    let start_us = limits.start;
    let mut chart = chart::draw_rows(area, &names, LogAxis(limits), label)?;
    for (hop, top) in hops_us.iter().zip((1..=hops_us.len()).rev()) {
        let bar = |to_us: f64, strength: f64| {
            let corners = [(start_us, top as f64 - 0.85), (to_us.max(start_us), top as f64 - 0.15)];
            Rectangle::new(corners, colour.mix(strength).filled())
        };
        chart.draw_series([bar(hop.p99, 0.25), bar(hop.p50, 1.0)])?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_ends_with_the_largest() {
        let mut latencies_us = Samples::new().unwrap();
        (1..=1_000).for_each(|us| latencies_us.add(1_000 * us));
        let curve = curve(&latencies_us);
        let last = curve.last().unwrap();
        assert!(last.percentile == 100.0 && (last.latency_us / 1_000.0 - 1.0).abs() < 1e-3, "{last:?}");
        assert!(curve.is_sorted_by(|one, next| one.percentile <= next.percentile && one.latency_us <= next.latency_us));
    }

    #[test]
    fn each_step_of_the_axis_leaves_a_tenth() {
        let point = |percentile| Point { percentile, latency_us: 1.0 };
        assert!((tenths(&point(99.0), 6.0) - 2.0).abs() < 1e-9);
        assert_eq!(tenths(&point(100.0), 6.0), 6.0);
        assert_eq!([0.0, 1.0, 2.0, 4.0, 0.5].map(|at| percentile(&at)), ["0 %", "90 %", "99 %", "99.99 %", ""]);
    }
}
