//! The picture of a run: who was where, and how well the target was known.

use std::path::Path;

use nalgebra::{Matrix2, Vector2};
use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use rangehound_shared::record::{EstimateRecord, WorldRecord};
use rangehound_shared::rendezvous::RunDescription;

use crate::report::{Truth, position_covariance};

/// File name of the picture in a run folder.
pub const FILE_NAME: &str = "picture.svg";

/// Points of a curve: more would not be seen.
const POINTS_MAX: u64 = 1_500;

/// Covariance ellipses along the track.
const ELLIPSES: usize = 16;

/// Size in pixels: large, because the drawing library rounds to whole ones.
const SIZE: (u32, u32) = (1_800, 1_000);

/// Colours of the robots, told apart by most eyes; they repeat in large teams.
const ROBOTS: [RGBColor; 6] = [
    RGBColor(31, 119, 180),
    RGBColor(255, 127, 14),
    RGBColor(44, 160, 44),
    RGBColor(148, 103, 189),
    RGBColor(140, 86, 75),
    RGBColor(23, 190, 207),
];

const TARGET: RGBColor = RGBColor(20, 20, 20);
const ESTIMATE: RGBColor = RGBColor(214, 39, 40);

type Plane<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;
type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// What is drawn, thinned.
#[derive(Debug, Default)]
struct Curves {
    times_s: Vec<f64>,
    estimates_m: Vec<Vector2<f64>>,
    covariances_m2: Vec<Matrix2<f64>>,
    truths_m: Vec<Option<Vector2<f64>>>,
    robots_m: Vec<Vec<Vector2<f64>>>,
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
    let path = description.out_dir.join(FILE_NAME);
    draw_to(&curves, &path).map_err(|error| anyhow::anyhow!("{}: {error}", path.display()))
}

impl Curves {
    fn read(description: &RunDescription, truth: Option<&Truth>) -> anyhow::Result<Self> {
        let RunDescription { run_id, scenario, out_dir } = description;
        let mut curves = Self { robots_m: vec![Vec::new(); scenario.robots.len()], ..Self::default() };
        let every = scenario.ticks / POINTS_MAX + 1;
        let mut estimates = EstimateRecord::reader(out_dir, *run_id, scenario)?;
        while let Some(record) = estimates.next() {
            let (tick, words) = record?;
            if tick == 0 || tick % every != 0 {
                continue;
            }
            let EstimateRecord { time_s, estimate } = EstimateRecord::from_words(words, scenario.motion.state_dim());
            curves.times_s.push(time_s);
            curves.estimates_m.push(Vector2::new(estimate.state[0], estimate.state[1]));
            curves.covariances_m2.push(position_covariance(&estimate));
            curves.truths_m.push(truth.and_then(|truth| truth.at(time_s)));
        }
        let mut worlds = WorldRecord::reader(out_dir, *run_id, scenario)?;
        let mut index = 0;
        while let Some(record) = worlds.next() {
            let (tick, words) = record?;
            if tick == 0 || tick % every != 0 {
                continue;
            }
            let WorldRecord { truth, robots, .. } = WorldRecord::from_words(words, scenario);
            if let (Some(slot), &[x_m, y_m, ..]) = (curves.truths_m.get_mut(index), truth.as_slice()) {
                *slot = Some(Vector2::new(x_m, y_m));
            }
            index += 1;
            for (path, robot) in curves.robots_m.iter_mut().zip(robots) {
                path.push(Vector2::from(robot.position_m));
            }
        }
        Ok(curves)
    }

    fn truth_path(&self) -> Vec<(f64, f64)> {
        self.truths_m.iter().flatten().map(|p| (p.x, p.y)).collect()
    }

    fn estimate_path(&self) -> Vec<(f64, f64)> {
        self.estimates_m.iter().map(|p| (p.x, p.y)).collect()
    }

    /// Position error where the truth is known: (time, error), s and m.
    fn errors_m(&self) -> Vec<(f64, f64)> {
        let errors = self.times_s.iter().zip(&self.estimates_m).zip(&self.truths_m);
        errors.filter_map(|((t, estimate), truth)| Some((*t, (estimate - truth.as_ref()?).norm()))).collect()
    }

    /// Square root of the position trace: (time, m).
    fn deviations_m(&self) -> Vec<(f64, f64)> {
        self.times_s.iter().zip(&self.covariances_m2).map(|(t, p)| (*t, p.trace().sqrt())).collect()
    }
}

fn draw_to(curves: &Curves, path: &Path) -> Result<(), Box<dyn std::error::Error>> {
    let root = SVGBackend::new(path, SIZE).into_drawing_area();
    root.fill(&WHITE)?;
    let (field, graph) = root.split_horizontally(1_000);
    draw_field(curves, &field)?;
    draw_errors(curves, &graph)?;
    root.present()?;
    Ok(())
}

/// Everything that has a place, in metres with equal scales.
fn draw_field(curves: &Curves, area: &Area<'_>) -> Result<(), Box<dyn std::error::Error>> {
    let places =
        curves.estimates_m.iter().chain(curves.truths_m.iter().flatten()).chain(curves.robots_m.iter().flatten());
    let (low, high) = places.fold((Vector2::repeat(f64::MAX), Vector2::repeat(f64::MIN)), |(low, high), place| {
        (low.inf(place), high.sup(place))
    });
    let centre = (low + high) * 0.5;
    let half = ((high - low).amax() * 0.54).max(1.0);
    let mut chart = ChartBuilder::on(area)
        .margin(20)
        .x_label_area_size(50)
        .y_label_area_size(70)
        .build_cartesian_2d(centre.x - half..centre.x + half, centre.y - half..centre.y + half)?;
    let labels = ("sans-serif", 24);
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .label_style(labels)
        .x_label_formatter(&short)
        .y_label_formatter(&short)
        .x_desc("x, m")
        .y_desc("y, m")
        .draw()?;
    let few = curves.robots_m.len() <= 10;
    for (id, path) in curves.robots_m.iter().enumerate() {
        let colour = ROBOTS[id % ROBOTS.len()].mix(if few { 0.9 } else { 0.4 });
        chart.draw_series(LineSeries::new(path.iter().map(|p| (p.x, p.y)), colour.stroke_width(2)))?;
        if let Some(last) = path.last() {
            let marker = TriangleMarker::new((last.x, last.y), 12, colour.filled());
            let drawn = chart.draw_series(std::iter::once(marker))?;
            if few {
                drawn.label(format!("robot {id}")).legend(move |at| TriangleMarker::new(at, 10, colour.filled()));
            }
        }
    }
    draw_ellipses(curves, &mut chart)?;
    chart
        .draw_series(LineSeries::new(curves.estimate_path(), ESTIMATE.stroke_width(2)))?
        .label("estimate, 3 sigma")
        .legend(dash(ESTIMATE));
    let truth = curves.truth_path();
    if let Some(end) = truth.last().copied() {
        chart.draw_series(LineSeries::new(truth, TARGET.stroke_width(3)))?.label("target").legend(dash(TARGET));
        chart.draw_series(std::iter::once(Circle::new(end, 9, TARGET.filled())))?;
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperLeft)
        .background_style(WHITE.mix(0.8))
        .border_style(BLACK.mix(0.2))
        .label_font(labels)
        .draw()?;
    Ok(())
}

/// The 3 sigma ellipses of some ticks.
fn draw_ellipses(curves: &Curves, chart: &mut Plane<'_, '_>) -> Result<(), Box<dyn std::error::Error>> {
    let every = curves.times_s.len().div_ceil(ELLIPSES);
    for (centre, covariance) in curves.estimates_m.iter().zip(&curves.covariances_m2).step_by(every) {
        let eigen = covariance.symmetric_eigen();
        let outline: Vec<(f64, f64)> = (0..=48)
            .map(|k| {
                let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / 48.0).sin_cos();
                let axes = eigen.eigenvalues.map(|variance| 3.0 * variance.max(0.0).sqrt());
                let point = centre + eigen.eigenvectors * Vector2::new(axes.x * cos, axes.y * sin);
                (point.x, point.y)
            })
            .collect();
        chart.draw_series(std::iter::once(PathElement::new(outline, ESTIMATE.mix(0.5).stroke_width(2))))?;
    }
    Ok(())
}

/// Error and standard deviation over time, on a log axis: they span orders of magnitude.
fn draw_errors(curves: &Curves, area: &Area<'_>) -> Result<(), Box<dyn std::error::Error>> {
    let (deviations, errors) = (curves.deviations_m(), curves.errors_m());
    let drawable = |&(_, value): &(f64, f64)| value.is_finite() && value > 1e-6;
    let values = deviations.iter().chain(&errors).filter(|point| drawable(point)).map(|(_, value)| *value);
    let (low, high) = values.fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(value), high.max(value)));
    let (low, high) = if low <= high { (low, high) } else { (1e-3, 1.0) };
    let (first, last) = (curves.times_s[0], curves.times_s[curves.times_s.len() - 1]);
    let mut chart = ChartBuilder::on(area)
        .margin(20)
        .x_label_area_size(50)
        .y_label_area_size(90)
        .build_cartesian_2d(first..last.max(first + 1e-3), (low.max(1e-3)..high.max(1e-2) * 1.2).log_scale())?;
    let labels = ("sans-serif", 24);
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .label_style(labels)
        .x_label_formatter(&short)
        .x_desc("time, s")
        .y_desc("position, m")
        .y_label_formatter(&short)
        .draw()?;
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
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .background_style(WHITE.mix(0.8))
        .border_style(BLACK.mix(0.2))
        .label_font(labels)
        .draw()?;
    Ok(())
}

/// A line's sign in the legend.
fn dash<C: Color + 'static>(colour: C) -> impl Fn((i32, i32)) -> PathElement<(i32, i32)> {
    move |(x, y)| PathElement::new([(x - 12, y), (x + 12, y)], colour.stroke_width(3))
}

/// A number without the noise of its last digits.
fn short(value: &f64) -> String {
    let text = format!("{value:.3}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}
