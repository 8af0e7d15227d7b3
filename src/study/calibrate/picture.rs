//! Residuals over range, a panel for each sensor.

use std::path::Path;

use plotters::prelude::*;

use crate::draw::chart::{self, Area, Drawn};
use crate::files::layout::RESIDUALS;

const WIDTH: u32 = 1_800;
const PANEL: u32 = 420;

/// Largest number of panels, and of points in a panel.
const PANELS_MAX: usize = 16;
const POINTS_MAX: usize = 1_500;

/// Draws (range, residual) of each sensor into a folder.
///
/// # Errors
/// If the picture cannot be written.
pub fn draw(points: &[Vec<(f64, f64)>], names: &[String], folder: &Path) -> anyhow::Result<()> {
    let panels: Vec<(&str, &[(f64, f64)])> = names
        .iter()
        .zip(points)
        .filter(|(_, points)| !points.is_empty())
        .map(|(name, points)| (name.as_str(), points.as_slice()))
        .take(PANELS_MAX)
        .collect();
    let rows = panels.len().div_ceil(2).max(1);
    let size = (WIDTH, PANEL * rows as u32);
    chart::draw_to_file(&folder.join(RESIDUALS), size, |area| {
        for ((name, points), area) in panels.iter().zip(area.split_evenly((rows, 2))) {
            draw_panel(&area, name, points)?;
        }
        Ok(())
    })
}

fn draw_panel(area: &Area<'_>, name: &str, points: &[(f64, f64)]) -> Drawn {
    let far = points.iter().map(|point| point.0).fold(0.0, f64::max).max(1e-3) * 1.05;
    let high = points.iter().map(|point| point.1.abs()).fold(0.0, f64::max).max(1e-6) * 1.05;
    let colour = chart::robot_colour(0);
    let mut axes = ChartBuilder::on(area)
        .margin(20)
        .caption(format!("sensor {name}"), chart::caption_font(&BLACK))
        .x_label_area_size(60)
        .y_label_area_size(100)
        .build_cartesian_2d(0.0..far, -high..high)?;
    chart::draw_axes(&mut axes, "range, m", "residual, m")?;
    axes.draw_series(LineSeries::new([(0.0, 0.0), (far, 0.0)], BLACK))?;
    let every = points.len().div_ceil(POINTS_MAX).max(1);
    axes.draw_series(points.iter().step_by(every).map(|&point| Circle::new(point, 2, colour.mix(0.5).filled())))?;
    Ok(())
}
