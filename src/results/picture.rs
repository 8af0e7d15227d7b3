//! The picture of a run: positions of all bodies, and the accuracy of the estimate.

use std::path::Path;

use plotters::prelude::*;

use crate::draw::chart::{self, Area, Drawn, ESTIMATE, TARGET};
use crate::draw::over_time::{Line, OverTime};
use crate::files::layout::PICTURE;
use crate::results::curves::Curves;

/// Width of the field; its height leaves room for the key.
const FIELD: u32 = 1_000;

/// Width of the graph beside it.
const GRAPH: u32 = 800;

/// Draws the run to `picture.svg` in its folder; nothing if it has no ticks.
///
/// # Errors
/// If the picture cannot be written.
pub fn draw(curves: &Curves, out_dir: &Path) -> anyhow::Result<()> {
    if !curves.has_length() {
        return Ok(());
    }
    let (width, height) = curves.paths.complete_size(FIELD);
    chart::draw_to_file(&out_dir.join(PICTURE), (width + GRAPH, height), |area| {
        let (field, graph) = area.split_horizontally(width);
        curves.paths.draw_complete(&field)?;
        draw_errors(curves, &graph)
    })
}

/// Error and standard deviation over time, on a log axis: they span orders of magnitude.
fn draw_errors(curves: &Curves, area: &Area<'_>) -> Drawn {
    let deviation = Line {
        name: Some("square root of the position trace".to_owned()),
        style: ESTIMATE.stroke_width(3),
        points: curves.traces_m2().map(|(time_s, trace_m2)| (time_s, trace_m2.sqrt())).collect(),
    };
    let errors: Vec<(f64, f64)> = curves.errors_m().map(|(time_s, error_m)| (time_s, error_m.norm())).collect();
    let error = (!errors.is_empty()).then(|| Line {
        name: Some("error".to_owned()),
        style: TARGET.mix(0.6).stroke_width(2),
        points: errors,
    });
    let lines = std::iter::once(deviation).chain(error).collect();
    OverTime { label: "position error, m".to_owned(), lines, ..OverTime::default() }.draw_log(area, curves.span_s())
}
