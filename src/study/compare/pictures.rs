//! The pictures of a comparison, drawn from its figures; the paths come from one more run of each planner.

use std::ops::Range;
use std::path::Path;

use nalgebra::Vector2;
use plotters::prelude::*;
use rangehound_shared::scenario::{PLANNERS, Scenario};

use super::planning_time::Scaling;
use super::summary::{Comparison, Summary};
use crate::draw::chart::{self, Area, COLOURS, Drawn, KeyEntry, LogAxis};
use crate::draw::field::{self, Paths, Square};
use crate::draw::over_time::{Band, Line, OverTime};
use crate::files::layout::COMPARISON_PICTURES;
use crate::results::report::position_covariance;
use crate::run::in_process::Team;
use crate::statistics::Interval;

const SIZE: (u32, u32) = (1_800, 1_100);
const TALL: (u32, u32) = (1_800, 1_500);

/// Side of one panel of the paths.
const PANEL: u32 = 800;

/// Ticks whose paths are drawn: later the field is so wide that robots and target coincide.
const PATH_TICKS: u64 = 100;

/// The colour of the planner that is one more than there are colours of robots and estimate.
const LAST_COLOUR: RGBColor = RGBColor(227, 119, 194);

/// Largest ANEES that is drawn: a planner that loses the target would flatten the others.
const ANEES_MOST: f64 = 10.0;

/// Draws all pictures into a folder.
///
/// # Errors
/// If a picture cannot be written.
pub fn draw(comparison: &Comparison, scenarios: &[Scenario], folder: &Path) -> anyhow::Result<()> {
    let paths: Vec<Paths> = scenarios.iter().map(paths_of).collect::<anyhow::Result<_>>()?;
    let [trace, field, consistency, gap, planning_time] = COMPARISON_PICTURES.map(|name| folder.join(name));
    chart::draw_to_file(&trace, SIZE, |area| draw_trace(comparison, area))?;
    chart::draw_to_file(&field, paths_size(&paths), |area| draw_paths(comparison, &paths, area))?;
    chart::draw_to_file(&consistency, TALL, |area| draw_consistency(comparison, area))?;
    chart::draw_to_file(&gap, SIZE, |area| draw_gap(comparison, area))?;
    chart::draw_to_file(&planning_time, SIZE, |area| draw_planning_time(comparison, area))
}

/// The planner's colour, the same in all pictures and comparisons; that of another variant follows from its place.
fn colour_of(name: &str, index: usize) -> RGBColor {
    let at = PLANNERS.iter().position(|known| *known == name).unwrap_or(index % (COLOURS.len() + 1));
    COLOURS.get(at).copied().unwrap_or(LAST_COLOUR)
}

/// Widths of lines that may coincide: earlier lines are wider, so that all remain visible.
fn widths() -> impl Iterator<Item = u32> {
    [9, 6].into_iter().chain(std::iter::repeat(3))
}

fn key_entry(text: String, name: &str, index: usize) -> KeyEntry {
    (text, colour_of(name, index).stroke_width(6))
}

fn key(planners: &[Summary]) -> Vec<KeyEntry> {
    planners.iter().enumerate().map(|(i, planner)| key_entry(planner.name.clone(), &planner.name, i)).collect()
}

/// Fig. 3 of the paper: the position trace over time.
fn draw_trace(comparison: &Comparison, area: &Area<'_>) -> Drawn {
    let Comparison { planners, time_s, .. } = comparison;
    let below = chart::draw_key(area, &key(planners))?;
    let band = |(index, Summary { name, series, .. }): (usize, &Summary)| {
        let limits = series.trace_m2.p10.iter().zip(&series.trace_m2.p90);
        let points = time_s.iter().zip(limits).map(|(time_s, (low, high))| (*time_s, *low, *high)).collect();
        Band { name: None, colour: colour_of(name, index).mix(0.12), points }
    };
    let chart = OverTime {
        label: "trace of the position covariance, m²: median and 10 to 90 %".to_owned(),
        bands: planners.iter().enumerate().map(band).collect(),
        lines: lines(comparison, |planner| &planner.series.trace_m2.median),
    };
    chart.draw_log(&below, times_s(comparison))
}

/// A line for each planner.
fn lines(comparison: &Comparison, values: impl Fn(&Summary) -> &Vec<f64>) -> Vec<Line> {
    let line = |((index, planner), width): ((usize, &Summary), u32)| Line {
        name: None,
        style: colour_of(&planner.name, index).stroke_width(width),
        points: comparison.time_s.iter().copied().zip(values(planner).iter().copied()).collect(),
    };
    comparison.planners.iter().enumerate().zip(widths()).map(line).collect()
}

fn times_s(comparison: &Comparison) -> Range<f64> {
    0.0..comparison.time_s.last().copied().unwrap_or(1.0)
}

/// The first ticks of one run.
fn paths_of(scenario: &Scenario) -> anyhow::Result<Paths> {
    let mut team = Team::new(scenario)?;
    let mut paths = Paths::of_team(scenario);
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
        for (path, pose) in paths.robots_m.iter_mut().zip(team.world().poses()) {
            path.push(pose.position_m());
        }
        team.advance();
    }
    Ok(paths)
}

/// Rows and columns of three or four, evenly filled.
fn grid(panels: usize) -> (usize, usize) {
    let rows = panels.div_ceil(if panels > 6 { 4 } else { 3 }).max(1);
    (rows, panels.div_ceil(rows).max(1))
}

fn paths_size(paths: &[Paths]) -> (u32, u32) {
    let (rows, columns) = grid(paths.len());
    let width = PANEL * columns as u32;
    (width, PANEL * rows as u32 + chart::key_height(width, &paths_key(paths)))
}

fn paths_key(paths: &[Paths]) -> Vec<KeyEntry> {
    field::key(paths.first().map_or(&[], |paths| &paths.names))
}

/// Fig. 4 of the paper: the same run of each planner from above.
fn draw_paths(comparison: &Comparison, paths: &[Paths], area: &Area<'_>) -> Drawn {
    let below = chart::draw_key(area, &paths_key(paths))?;
    // One scale for all, from the positions of the bodies: an estimate that is lost may be anywhere.
    let square = Square::around(paths.iter().flat_map(Paths::bodies));
    for (index, (panel, paths)) in below.split_evenly(grid(paths.len())).iter().zip(paths).enumerate() {
        let name = comparison.planners.get(index).map_or("", |planner| planner.name.as_str());
        paths.draw(panel, square, Some((name, colour_of(name, index))))?;
    }
    Ok(())
}

/// Whether errors are as large as the filter assumes, and how large they are.
fn draw_consistency(comparison: &Comparison, area: &Area<'_>) -> Drawn {
    let Comparison { planners, anees_bounds, .. } = comparison;
    let below = chart::draw_key(area, &key(planners))?;
    let (upper, lower) = below.split_vertically(below.dim_in_pixel().1 / 2);
    let Interval { low, high } = *anees_bounds;
    let times_s = times_s(comparison);
    let anees = OverTime {
        label: format!("ANEES, cut at {ANEES_MOST}; grey: 95 % band of a consistent filter, {low:.2} to {high:.2}"),
        bands: vec![Band {
            name: None,
            colour: BLACK.mix(0.2),
            points: [times_s.start, times_s.end].map(|time_s| (time_s, low, high)).into(),
        }],
        lines: lines(comparison, |planner| &planner.series.anees),
    };
    anees.draw_log_up_to(ANEES_MOST, &upper, times_s.clone())?;
    let error = OverTime {
        label: "RMS position error, m".to_owned(),
        lines: lines(comparison, |planner| &planner.series.rmse_m),
        ..OverTime::default()
    };
    error.draw_log(&lower, times_s)
}

/// The planners' distance from the optimum, as a distribution.
fn draw_gap(comparison: &Comparison, area: &Area<'_>) -> Drawn {
    let planners = &comparison.planners;
    let below = chart::draw_key(area, &key(planners))?;
    let gaps = planners.iter().flat_map(|planner| &planner.gap_distribution).map(|(gap, _)| *gap);
    let mut chart = ChartBuilder::on(&below)
        .margin(20)
        .x_label_area_size(60)
        .y_label_area_size(110)
        .build_cartesian_2d(LogAxis(chart::log_limits(gaps)), 0.0..1.02)?;
    chart::draw_axes(&mut chart, comparison.gap_meaning, "part of the steps with at most this gap")?;
    for ((index, planner), width) in planners.iter().enumerate().zip(widths()) {
        let line = planner.gap_distribution.iter().copied();
        chart.draw_series(LineSeries::new(line, colour_of(&planner.name, index).stroke_width(width)))?;
    }
    Ok(())
}

/// Planning time over the size of the team.
fn draw_planning_time(comparison: &Comparison, area: &Area<'_>) -> Drawn {
    let scalings = &comparison.planning_time;
    let name = |scaling: &Scaling| match scaling.law {
        Some(law) => format!("{}  M^{:.2}", scaling.name, law.exponent),
        None => scaling.name.clone(),
    };
    let key: Vec<_> =
        scalings.iter().enumerate().map(|(i, scaling)| key_entry(name(scaling), &scaling.name, i)).collect();
    let below = chart::draw_key(area, &key)?;
    let points = || scalings.iter().flat_map(|scaling| &scaling.points);
    let robots = chart::log_limits(points().map(|point| point.robots as f64));
    let times_us = chart::log_limits(points().map(|point| point.planning_us));
    let mut chart = ChartBuilder::on(&below)
        .margin(20)
        .x_label_area_size(60)
        .y_label_area_size(110)
        .build_cartesian_2d(LogAxis(robots), LogAxis(times_us))?;
    chart::draw_axes(&mut chart, "M, robots", "time to plan a step, µs: median, and the power law through it")?;
    for (index, scaling) in scalings.iter().enumerate() {
        let colour = colour_of(&scaling.name, index);
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
    Ok(())
}
