//! Charts of quantities over time.

use std::ops::Range;

use plotters::coord::ranged1d::{AsRangedCoord, ValueFormatter};
use plotters::prelude::*;

use crate::draw::chart::{self, Area, Drawn, KeyEntry, LogAxis};

/// Largest ratio of the ends of a logarithmic axis; lower values are drawn on its edge.
const SPAN_MAX: f64 = 1e9;

/// Curves and bands over time, all in one unit.
#[derive(Debug, Default)]
pub struct OverTime {
    /// The quantity and its unit.
    pub label: String,
    /// Areas behind the lines, the first lowest.
    pub bands: Vec<Band>,
    /// Lines, the first lowest.
    pub lines: Vec<Line>,
}

/// The area between two curves.
#[derive(Debug)]
pub struct Band {
    /// Name in the legend; `None` if another legend has it.
    pub name: Option<String>,
    /// Its colour.
    pub colour: RGBAColor,
    /// (time, lower, upper).
    pub points: Vec<(f64, f64, f64)>,
}

/// A curve.
#[derive(Debug)]
pub struct Line {
    /// Name in the legend; `None` if another legend has it.
    pub name: Option<String>,
    /// Its colour and width.
    pub style: ShapeStyle,
    /// (time, value).
    pub points: Vec<(f64, f64)>,
}

impl OverTime {
    /// Draws on a logarithmic axis for all lines and bands; values without a logarithm are left out.
    ///
    /// # Errors
    /// The backend's.
    pub fn draw_log(self, area: &Area<'_>, times_s: Range<f64>) -> Drawn {
        self.draw_log_up_to(f64::INFINITY, area, times_s)
    }

    /// As [`Self::draw_log`], on an axis that ends at most at `most`.
    ///
    /// # Errors
    /// The backend's.
    pub fn draw_log_up_to(mut self, most: f64, area: &Area<'_>, times_s: Range<f64>) -> Drawn {
        let drawable = |value: &f64| value.is_finite() && *value > 0.0;
        for line in &mut self.lines {
            line.points.retain(|(_, value)| drawable(value));
        }
        for band in &mut self.bands {
            // A band may begin at zero: it is drawn from the edge.
            band.points.retain(|(_, low, high)| low.is_finite() && drawable(high));
        }
        let of_lines = self.lines.iter().flat_map(|line| &line.points).map(|(_, value)| *value);
        let of_bands = self.bands.iter().flat_map(|band| &band.points).flat_map(|(_, low, high)| [*low, *high]);
        let limits = chart::log_limits(of_lines.chain(of_bands));
        let end = limits.end.min(most);
        let limits = limits.start.max(end / SPAN_MAX)..end;
        self.draw(area, times_s, LogAxis(limits))
    }

    /// Draws on these axes; values beyond an edge are drawn on it.
    ///
    /// # Errors
    /// The backend's.
    pub fn draw<Y>(&self, area: &Area<'_>, times_s: Range<f64>, values: Y) -> Drawn
    where
        Y: AsRangedCoord<Value = f64>,
        Y::CoordDescType: ValueFormatter<f64>,
    {
        let below = chart::draw_key(area, &self.key())?;
        let mut chart = ChartBuilder::on(&below)
            .margin(20)
            .margin_right(40)
            .x_label_area_size(60)
            .y_label_area_size(110)
            .build_cartesian_2d(times_s, values)?;
        let edges = chart.y_range();
        let inside = |value: f64| value.clamp(edges.start, edges.end);
        chart::draw_axes(&mut chart, "time, s", &self.label)?;
        for Band { colour, points, .. } in &self.bands {
            let upper = points.iter().map(|(time_s, _, high)| (*time_s, inside(*high)));
            let lower = points.iter().rev().map(|(time_s, low, _)| (*time_s, inside(*low)));
            let outline: Vec<(f64, f64)> = upper.chain(lower).collect();
            chart.draw_series(std::iter::once(Polygon::new(outline, *colour)))?;
        }
        for Line { style, points, .. } in &self.lines {
            let points = points.iter().map(|(time_s, value)| (*time_s, inside(*value)));
            chart.draw_series(LineSeries::new(points, *style))?;
        }
        Ok(())
    }

    fn key(&self) -> Vec<KeyEntry> {
        let lines = self.lines.iter().filter_map(|line| Some((line.name.clone()?, line.style.stroke_width(6))));
        let bands = self.bands.iter().filter_map(|band| Some((band.name.clone()?, band.colour.stroke_width(24))));
        lines.chain(bands).collect()
    }
}
