//! The pictures of a comparison, drawn from its figures alone; the paths from one more run each.

use std::path::Path;

use nalgebra::Vector2;
use plotters::prelude::*;
use rangehound_shared::scenario::{PLANNERS, Scenario};

use super::planning_time::Scaling;
use super::summary::{Comparison, Summary};
use crate::chart::{self, Area, COLOURS, Drawn};
use crate::field::{self, Paths, Square};
use crate::in_process::Team;
use crate::report::position_covariance;

/// The file names.
pub const FILE_NAMES: [&str; 5] = ["trace.svg", "paths.svg", "consistency.svg", "gap.svg", "planning_time.svg"];

const SIZE: (u32, u32) = (1_800, 1_100);
const TALL: (u32, u32) = (1_800, 1_500);

/// Side of one panel of the paths.
const PANEL: u32 = 800;

/// Height of the key above the panels.
const KEY: u32 = 60;

/// Ticks whose paths are drawn: later the field is so wide that robots and target are one.
const PATH_TICKS: u64 = 100;

/// Draws all pictures into a folder.
///
/// # Errors
/// If a picture cannot be written.
pub fn draw(comparison: &Comparison, scenarios: &[Scenario], folder: &Path) -> anyhow::Result<()> {
    let paths: Vec<Paths> = scenarios.iter().map(paths_of).collect::<anyhow::Result<_>>()?;
    let [trace, field, consistency, gap, planning_time] = FILE_NAMES.map(|name| folder.join(name));
    let named = |path: &Path, drawn: Drawn| drawn.map_err(|error| anyhow::anyhow!("{}: {error}", path.display()));
    named(&trace, draw_trace(comparison, &trace))?;
    named(&field, draw_paths(comparison, &paths, &field))?;
    named(&consistency, draw_consistency(comparison, &consistency))?;
    named(&gap, draw_gap(comparison, &gap))?;
    named(&planning_time, draw_planning_time(comparison, &planning_time))
}

/// A planner has the same colour in all pictures, whoever it is compared with.
fn colour_of(name: &str) -> RGBColor {
    COLOURS[PLANNERS.iter().position(|known| *known == name).unwrap_or_default() % COLOURS.len()]
}

/// Widths of lines that may lie on each other: what comes first is wider, so that all of them show.
fn widths() -> impl Iterator<Item = u32> {
    [9, 6].into_iter().chain(std::iter::repeat(3))
}

fn key(planners: &[Summary]) -> Vec<(String, RGBColor)> {
    planners.iter().map(|planner| (planner.name.clone(), colour_of(&planner.name))).collect()
}

/// Fig. 3 of the paper: how well the target is known over time.
fn draw_trace(comparison: &Comparison, path: &Path) -> Drawn {
    let Comparison { planners, time_s, .. } = comparison;
    let root = SVGBackend::new(path, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    let below = chart::draw_key(&root, &key(planners))?;
    let bands = planners.iter().map(|planner| &planner.series.trace_m2);
    let limits = chart::log_limits(bands.flat_map(|band| band.p10.iter().chain(&band.p90)).copied());
    let mut chart = ChartBuilder::on(&below)
        .margin(20)
        .x_label_area_size(60)
        .y_label_area_size(110)
        .build_cartesian_2d(0.0..time_s.last().copied().unwrap_or(1.0), limits.log_scale())?;
    chart::draw_axes(&mut chart, "time, s", "trace of the position covariance, m²: median and 10 to 90 %")?;
    for Summary { name, series, .. } in planners {
        let upper = points(time_s, &series.trace_m2.p90);
        let lower = points(time_s, &series.trace_m2.p10);
        let outline: Vec<(f64, f64)> = upper.chain(lower.collect::<Vec<_>>().into_iter().rev()).collect();
        chart.draw_series(std::iter::once(Polygon::new(outline, colour_of(name).mix(0.12))))?;
    }
    for (Summary { name, series, .. }, width) in planners.iter().zip(widths()) {
        let line = points(time_s, &series.trace_m2.median);
        chart.draw_series(LineSeries::new(line, colour_of(name).stroke_width(width)))?;
    }
    root.present()?;
    Ok(())
}

/// What of a series can stand on a log axis.
fn points<'a>(xs: &'a [f64], ys: &'a [f64]) -> impl Iterator<Item = (f64, f64)> {
    xs.iter().copied().zip(ys.iter().copied()).filter(|(_, y)| y.is_finite() && *y > 0.0)
}

/// The first ticks of one run.
fn paths_of(scenario: &Scenario) -> anyhow::Result<Paths> {
    let mut team = Team::new(scenario)?;
    let mut paths = Paths::of_team(scenario.robots.len());
    for _ in 0..=scenario.ticks.min(PATH_TICKS) {
        if team.tick().is_err() {
            break;
        }
        let estimate = team.centre().estimate();
        paths.estimates_m.push(Vector2::new(estimate.state[0], estimate.state[1]));
        paths.covariances_m2.push(position_covariance(&estimate));
        if let &[x_m, y_m, ..] = team.world().truth() {
            paths.truths_m.push(Some(Vector2::new(x_m, y_m)));
        }
        for (path, entry) in paths.robots_m.iter_mut().zip(team.world().entries()) {
            path.push(Vector2::new(entry.x_m, entry.y_m));
        }
        team.advance();
    }
    Ok(paths)
}

/// Fig. 4 of the paper: the same run of each planner from above.
fn draw_paths(comparison: &Comparison, paths: &[Paths], path: &Path) -> Drawn {
    // Rows of three or four, evenly filled.
    let rows = paths.len().div_ceil(if paths.len() > 6 { 4 } else { 3 }).max(1);
    let columns = paths.len().div_ceil(rows).max(1);
    let root = SVGBackend::new(path, (PANEL * columns as u32, PANEL * rows as u32 + KEY)).into_drawing_area();
    root.fill(&WHITE)?;
    let robots = paths.first().map_or(0, |paths| paths.robots_m.len());
    let below = chart::draw_key(&root, &field::key(robots))?;
    // One scale for all, by where bodies are: an estimate that is lost may be anywhere.
    let square = Square::around(paths.iter().flat_map(Paths::bodies));
    for (index, (panel, paths)) in below.split_evenly((rows, columns)).iter().zip(paths).enumerate() {
        let name = comparison.planners.get(index).map_or("", |planner| planner.name.as_str());
        paths.draw(panel, square, Some((name, colour_of(name))), false)?;
    }
    root.present()?;
    Ok(())
}

/// Whether errors are as large as the filter believes, and how large they are.
fn draw_consistency(comparison: &Comparison, path: &Path) -> Drawn {
    let Comparison { planners, anees_bounds, .. } = comparison;
    let root = SVGBackend::new(path, TALL).into_drawing_area();
    root.fill(&WHITE)?;
    let below = chart::draw_key(&root, &key(planners))?;
    let (upper, lower) = below.split_vertically(below.dim_in_pixel().1 / 2);
    let bounds = [anees_bounds.low, anees_bounds.high];
    let label = format!("ANEES; grey: 95 % of consistent filters ({:.2} to {:.2})", bounds[0], bounds[1]);
    draw_series(&upper, comparison, &label, |planner| &planner.series.anees, &bounds)?;
    draw_series(&lower, comparison, "RMS position error, m", |planner| &planner.series.rmse_m, &[])?;
    root.present()?;
    Ok(())
}

/// A line for each planner over time; `band` are values between which the chart is grey.
fn draw_series(
    area: &Area<'_>,
    comparison: &Comparison,
    label: &str,
    values: impl Fn(&Summary) -> &Vec<f64>,
    band: &[f64],
) -> Drawn {
    let Comparison { planners, time_s, .. } = comparison;
    let limits = chart::log_limits(planners.iter().flat_map(&values).chain(band).copied());
    let end_s = time_s.last().copied().unwrap_or(1.0);
    let mut chart = ChartBuilder::on(area)
        .margin(20)
        .x_label_area_size(60)
        .y_label_area_size(110)
        .build_cartesian_2d(0.0..end_s, limits.log_scale())?;
    if let &[low, high] = band {
        chart.draw_series(std::iter::once(Rectangle::new([(0.0, low), (end_s, high)], BLACK.mix(0.2).filled())))?;
    }
    chart::draw_axes(&mut chart, "time, s", label)?;
    for (planner, width) in planners.iter().zip(widths()) {
        let line = points(time_s, values(planner));
        chart.draw_series(LineSeries::new(line, colour_of(&planner.name).stroke_width(width)))?;
    }
    Ok(())
}

/// How far from the optimum planners are, and how often.
fn draw_gap(comparison: &Comparison, path: &Path) -> Drawn {
    let planners = &comparison.planners;
    let root = SVGBackend::new(path, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    let below = chart::draw_key(&root, &key(planners))?;
    let gaps = planners.iter().flat_map(|planner| &planner.gap_distribution).map(|(gap, _)| *gap);
    let mut chart = ChartBuilder::on(&below)
        .margin(20)
        .x_label_area_size(60)
        .y_label_area_size(110)
        .build_cartesian_2d(chart::log_limits(gaps).log_scale(), 0.0..1.02)?;
    let label = "|S| above the certified lower bound, relative to the sum of all lambda";
    chart::draw_axes(&mut chart, label, "part of the steps with at most this gap")?;
    for (planner, width) in planners.iter().zip(widths()) {
        let line = planner.gap_distribution.iter().copied();
        chart.draw_series(LineSeries::new(line, colour_of(&planner.name).stroke_width(width)))?;
    }
    root.present()?;
    Ok(())
}

/// How planning time grows with the team.
fn draw_planning_time(comparison: &Comparison, path: &Path) -> Drawn {
    let scalings = &comparison.planning_time;
    let root = SVGBackend::new(path, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    let name = |scaling: &Scaling| match scaling.law {
        Some(law) => format!("{}  M^{:.2}", scaling.name, law.exponent),
        None => scaling.name.clone(),
    };
    let key: Vec<_> = scalings.iter().map(|scaling| (name(scaling), colour_of(&scaling.name))).collect();
    let below = chart::draw_key(&root, &key)?;
    let points = || scalings.iter().flat_map(|scaling| &scaling.points);
    let robots = chart::log_limits(points().map(|point| point.robots as f64));
    let times_us = chart::log_limits(points().map(|point| point.planning_us));
    let mut chart = ChartBuilder::on(&below)
        .margin(20)
        .x_label_area_size(60)
        .y_label_area_size(110)
        .build_cartesian_2d(robots.log_scale(), times_us.log_scale())?;
    chart::draw_axes(&mut chart, "M, robots", "time to plan a step, us: median, and the power law through it")?;
    for scaling in scalings {
        let colour = colour_of(&scaling.name);
        let points = || scaling.points.iter().map(|point| (point.robots as f64, point.planning_us));
        chart.draw_series(LineSeries::new(points(), colour.mix(0.25).stroke_width(3)))?;
        if let (Some(law), [first, .., last]) = (scaling.law, scaling.fitted()) {
            let line = [first, last].map(|point| {
                let robots = point.robots as f64;
                (robots, law.factor * robots.powf(law.exponent))
            });
            chart.draw_series(LineSeries::new(line, colour.stroke_width(3)))?;
        }
        chart.draw_series(points().map(|point| Circle::new(point, 9, colour.filled())))?;
    }
    root.present()?;
    Ok(())
}
