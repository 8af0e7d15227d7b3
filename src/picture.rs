//! The picture of a run: who was where, and how well the target was known.

use std::path::Path;

use nalgebra::Vector2;
use plotters::prelude::*;
use rangehound_shared::record::{EstimateRecord, WorldRecord};
use rangehound_shared::rendezvous::RunDescription;

use crate::chart::{self, Area, Drawn, ESTIMATE, TARGET, dash};
use crate::field::{Paths, Square};
use crate::report::{Truth, position_covariance};

/// File name of the picture in a run folder.
pub const FILE_NAME: &str = "picture.svg";

/// Points of a curve: more would not be seen.
const POINTS_MAX: u64 = 1_500;

const SIZE: (u32, u32) = (1_800, 1_000);

/// Largest number that axes can be made for.
const DRAWABLE_MAX: f64 = 1e15;

/// What is drawn, thinned.
#[derive(Debug, Default)]
struct Curves {
    times_s: Vec<f64>,
    paths: Paths,
}

/// As [`draw`], for callers whose work is done without a picture.
pub fn draw_if_possible(description: &RunDescription, truth: Option<&Truth>) {
    if let Err(error) = draw(description, truth) {
        log::warn!("there is no picture: {error}");
    }
}

/// Draws the run from its logs to `picture.svg` in the run folder.
///
/// # Errors
/// If a log cannot be read or the picture not be written.
pub fn draw(description: &RunDescription, truth: Option<&Truth>) -> anyhow::Result<()> {
    let curves = Curves::read(description, truth)?;
    if curves.times_s.len() < 2 {
        return Ok(());
    }
    if !curves.can_be_drawn() {
        anyhow::bail!("the logs hold numbers that cannot be drawn");
    }
    let path = description.out_dir.join(FILE_NAME);
    draw_to(&curves, &path).map_err(|error| anyhow::anyhow!("{}: {error}", path.display()))
}

impl Curves {
    fn read(description: &RunDescription, truth: Option<&Truth>) -> anyhow::Result<Self> {
        let RunDescription { run_id, scenario, out_dir } = description;
        let mut curves = Self { paths: Paths::of_team(scenario.robots.len()), ..Self::default() };
        let Self { times_s, paths } = &mut curves;
        let every = scenario.ticks / POINTS_MAX + 1;
        let mut estimates = EstimateRecord::reader(out_dir, *run_id, scenario)?;
        while let Some(record) = estimates.next() {
            let (tick, words) = record?;
            if tick == 0 || tick % every != 0 {
                continue;
            }
            let EstimateRecord { time_s, estimate } = EstimateRecord::from_words(words, scenario.motion.state_dim());
            times_s.push(time_s);
            paths.estimates_m.push(Vector2::new(estimate.state[0], estimate.state[1]));
            paths.covariances_m2.push(position_covariance(&estimate));
            paths.truths_m.push(truth.and_then(|truth| truth.at(time_s)));
        }
        let mut worlds = WorldRecord::reader(out_dir, *run_id, scenario)?;
        let mut index = 0;
        while let Some(record) = worlds.next() {
            let (tick, words) = record?;
            if tick == 0 || tick % every != 0 {
                continue;
            }
            let WorldRecord { truth, robots, .. } = WorldRecord::from_words(words, scenario);
            if let (Some(slot), &[x_m, y_m, ..]) = (paths.truths_m.get_mut(index), truth.as_slice()) {
                *slot = Some(Vector2::new(x_m, y_m));
            }
            index += 1;
            for (path, robot) in paths.robots_m.iter_mut().zip(robots) {
                path.push(Vector2::from(robot.position_m));
            }
        }
        Ok(curves)
    }

    /// True if no number is one that axes or ellipses could not be made of: their loops would not end.
    fn can_be_drawn(&self) -> bool {
        let Paths { estimates_m, covariances_m2, .. } = &self.paths;
        let places = estimates_m.iter().chain(self.paths.bodies()).flat_map(|place| place.iter());
        let numbers = places.chain(covariances_m2.iter().flat_map(|covariance| covariance.iter())).chain(&self.times_s);
        numbers.into_iter().all(|number| number.abs() <= DRAWABLE_MAX) && self.times_s.is_sorted()
    }

    /// Position error where the truth is known: (time, error), s and m.
    fn errors_m(&self) -> Vec<(f64, f64)> {
        let errors = self.times_s.iter().zip(&self.paths.estimates_m).zip(&self.paths.truths_m);
        errors.filter_map(|((t, estimate), truth)| Some((*t, (estimate - truth.as_ref()?).norm()))).collect()
    }

    /// Square root of the position trace: (time, m).
    fn deviations_m(&self) -> Vec<(f64, f64)> {
        self.times_s.iter().zip(&self.paths.covariances_m2).map(|(t, p)| (*t, p.trace().sqrt())).collect()
    }
}

fn draw_to(curves: &Curves, path: &Path) -> Drawn {
    let root = SVGBackend::new(path, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    let (field, graph) = root.split_horizontally(1_000);
    let square = Square::around(curves.paths.estimates_m.iter().chain(curves.paths.bodies()));
    curves.paths.draw(&field, square, None, true)?;
    draw_errors(curves, &graph)?;
    root.present()?;
    Ok(())
}

/// Error and standard deviation over time, on a log axis: they span orders of magnitude.
fn draw_errors(curves: &Curves, area: &Area<'_>) -> Drawn {
    let (deviations, errors) = (curves.deviations_m(), curves.errors_m());
    let drawable = |&(_, value): &(f64, f64)| value.is_finite() && value > 1e-6;
    let values = deviations.iter().chain(&errors).filter(|point| drawable(point)).map(|(_, value)| *value);
    let limits = chart::log_limits(values);
    let (first, last) = (curves.times_s[0], curves.times_s[curves.times_s.len() - 1]);
    let mut chart = ChartBuilder::on(area).margin(20).x_label_area_size(50).y_label_area_size(90).build_cartesian_2d(
        first..last.max(first + first.abs() * 1e-9 + 1e-3),
        (limits.start.max(1e-3)..limits.end.max(1e-2)).log_scale(),
    )?;
    chart::draw_axes(&mut chart, "time, s", "position, m")?;
    chart
        .draw_series(LineSeries::new(deviations.into_iter().filter(drawable), ESTIMATE.stroke_width(3)))?
        .label("square root of the position trace")
        .legend(dash(ESTIMATE));
    if !errors.is_empty() {
        chart
            .draw_series(LineSeries::new(errors.into_iter().filter(drawable), TARGET.mix(0.6).stroke_width(2)))?
            .label("error")
            .legend(dash(TARGET.mix(0.6)));
    }
    chart::draw_legend(&mut chart, SeriesLabelPosition::UpperRight)
}
