//! What all pictures are drawn with: colours, labels, legends, lines and ellipses.
//!
//! The SVG backend rounds to whole pixels, so pictures are large and their labels with them.

use nalgebra::{Matrix2, Vector2};
use plotters::coord::Shift;
use plotters::coord::cartesian::Cartesian2d;
use plotters::coord::ranged1d::ValueFormatter;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// Colours told apart by most eyes.
pub const COLOURS: [RGBColor; 7] = [
    RGBColor(31, 119, 180),
    RGBColor(255, 127, 14),
    RGBColor(44, 160, 44),
    RGBColor(148, 103, 189),
    RGBColor(140, 86, 75),
    RGBColor(23, 190, 207),
    ESTIMATE,
];

/// The target.
pub const TARGET: RGBColor = RGBColor(20, 20, 20);

/// The estimate.
pub const ESTIMATE: RGBColor = RGBColor(214, 39, 40);

/// Font of labels.
pub const LABELS: (&str, u32) = ("sans-serif", 24);

/// Font of a key.
const KEY: (&str, u32) = ("sans-serif", 28);

/// Height of a key's row, px.
const KEY_ROW: u32 = 50;

/// Width of a key's line with the room round it, px.
const KEY_LINE: u32 = 110;

/// Width of a key's character, px: not less than those of most fonts.
const KEY_CHARACTER: u32 = 16;

/// A part of a picture.
pub type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// A chart with two linear axes.
pub type Plane<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// The font of a chart's caption.
#[must_use]
pub fn caption_font(colour: &RGBColor) -> TextStyle<'static> {
    ("sans-serif", 32).into_font().color(colour)
}

/// What drawing comes to.
pub type Drawn = Result<(), Box<dyn std::error::Error>>;

/// The labelled axes of a chart.
///
/// # Errors
/// The backend's.
pub fn draw_axes<X, Y>(
    chart: &mut ChartContext<'_, SVGBackend<'_>, Cartesian2d<X, Y>>,
    x_label: &str,
    y_label: &str,
) -> Drawn
where
    X: Ranged<ValueType = f64> + ValueFormatter<f64>,
    Y: Ranged<ValueType = f64> + ValueFormatter<f64>,
{
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .label_style(LABELS)
        .x_label_formatter(&short)
        .y_label_formatter(&short)
        .x_desc(x_label)
        .y_desc(y_label)
        .draw()?;
    Ok(())
}

/// The legend, of the series that have labels.
///
/// # Errors
/// The backend's.
pub fn draw_legend<'a, 'b: 'a, C: CoordTranslate>(
    chart: &mut ChartContext<'a, SVGBackend<'b>, C>,
    position: SeriesLabelPosition,
) -> Drawn {
    chart
        .configure_series_labels()
        .position(position)
        .background_style(WHITE.mix(0.8))
        .border_style(BLACK.mix(0.2))
        .label_font(LABELS)
        .draw()?;
    Ok(())
}

/// A line's sign in the legend.
pub fn dash<C: Color + 'static>(colour: C) -> impl Fn((i32, i32)) -> PathElement<(i32, i32)> {
    move |(x, y)| PathElement::new([(x - 12, y), (x + 12, y)], colour.stroke_width(4))
}

/// Axes' limits that hold all finite values above zero, for a log axis with a little room.
#[must_use]
pub fn log_limits(values: impl IntoIterator<Item = f64>) -> std::ops::Range<f64> {
    let drawable = values.into_iter().filter(|value| value.is_finite() && *value > 0.0);
    let (low, high) = drawable.fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(value), high.max(value)));
    if low <= high { low / 1.2..high * 1.2 } else { 1e-3..1.0 }
}

/// The colour of a robot; they repeat in large teams.
#[must_use]
pub fn robot_colour(id: usize) -> RGBColor {
    // All but the last, which is the estimate's.
    COLOURS[id % (COLOURS.len() - 1)]
}

/// The outline of an ellipse of so many standard deviations.
#[must_use]
pub fn ellipse(centre: &Vector2<f64>, covariance: &Matrix2<f64>, sigmas: f64) -> Vec<(f64, f64)> {
    let eigen = covariance.symmetric_eigen();
    let axes = eigen.eigenvalues.map(|variance| sigmas * variance.max(0.0).sqrt());
    let point = |k: i32| {
        let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / 48.0).sin_cos();
        let point = centre + eigen.eigenvectors * Vector2::new(axes.x * cos, axes.y * sin);
        (point.x, point.y)
    };
    (0..=48).map(point).collect()
}

/// A number without the noise of its last digits; powers of ten where it is small or large.
#[must_use]
pub fn short(value: &f64) -> String {
    if *value != 0.0 && !(1e-3..1e5).contains(&value.abs()) {
        return format!("{value:.0e}");
    }
    let text = format!("{value:.3}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// Rows of names at the top, each beside a line of its colour: a legend that covers nothing. Gives
/// the area below.
///
/// # Errors
/// The backend's.
pub fn draw_key<'a>(area: &Area<'a>, entries: &[(String, RGBColor)]) -> Result<Area<'a>, Box<dyn std::error::Error>> {
    let longest = entries.iter().map(|(name, _)| name.chars().count()).max().unwrap_or_default();
    let column = KEY_LINE + KEY_CHARACTER * longest as u32;
    let in_row = (area.dim_in_pixel().0 / column).max(1);
    let (key, below) = area.split_vertically((entries.len() as u32).div_ceil(in_row) * KEY_ROW + 10);
    for ((name, colour), index) in entries.iter().zip(0..) {
        let (left, middle) =
            ((index % in_row * column + 40) as i32, (index / in_row * KEY_ROW + KEY_ROW / 2 + 10) as i32);
        key.draw(&PathElement::new([(left, middle), (left + 40, middle)], colour.stroke_width(6)))?;
        let style = KEY.into_font().color(&BLACK).pos(Pos::new(HPos::Left, VPos::Center));
        key.draw(&Text::new(name.clone(), (left + 52, middle), style))?;
    }
    Ok(below)
}
