//! Shared parts of all pictures: colours, axes, labels and legends.
//!
//! The SVG backend rounds coordinates to whole pixels, so pictures and labels are large.

use std::ops::Range;
use std::path::Path;

use plotters::coord::Shift;
use plotters::coord::cartesian::Cartesian2d;
use plotters::coord::ranged1d::{AsRangedCoord, BoldPoints, DefaultFormatting, KeyPointHint, ValueFormatter};
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::files::atomic_file;

/// Colours that most people can distinguish.
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

/// Font of the legend.
const KEY: (&str, u32) = ("sans-serif", 28);

/// Height of a row of the legend, px.
const KEY_ROW: u32 = 50;

/// Width of a sample line in the legend with its margins, px.
const KEY_LINE: u32 = 110;

/// Width of a character in the legend, px: at least that of most fonts.
const KEY_CHARACTER: u32 = 16;

/// Smaller numbers need powers of ten: three decimals show none of their digits.
const SMALL: f64 = 1e-3 * (1.0 - 1e-9);

/// Most labels of an axis.
const LABELS_MAX: usize = 11;

/// Most labels of the axis below named rows, which is shorter: the names need room.
const LABELS_BENEATH_ROWS: usize = 8;

/// Larger numbers need powers of ten: their labels would overlap along a horizontal axis.
const WIDE: f64 = 1e5;

/// A part of a picture.
pub type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// A chart with two linear axes.
pub type Plane<'a, 'b> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// A chart of rows.
pub type Rows<'a, 'b, X> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<X, RangedCoordf64>>;

/// A logarithmic axis. The one of plotters draws the ends of decades twice.
#[derive(Debug, Clone)]
pub struct LogAxis(pub Range<f64>);

impl LogAxis {
    /// Numbers on the axis with these leading digits.
    fn marks(&self, leading: &[f64]) -> Vec<f64> {
        let Self(Range { start, end }) = self;
        let decades = start.log10().floor() as i32..=end.log10().ceil() as i32;
        let marks = decades.flat_map(|decade| leading.iter().map(move |leading| leading * 10_f64.powi(decade)));
        marks.filter(|mark| (start..=end).contains(&mark)).collect()
    }
}

impl Ranged for LogAxis {
    type FormatOption = DefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        RangedCoordf64::from(self.0.start.ln()..self.0.end.ln()).map(&value.ln(), limit)
    }

    /// 1, 2 and 5 times each power of ten if there is room, else the powers of ten, or every n-th of them.
    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        let most = hint.max_num_points().max(1);
        let fine = self.marks(&[1.0, 2.0, 5.0]);
        if fine.len() < 2 {
            return RangedCoordf64::from(self.0.clone()).key_points(hint);
        }
        if fine.len() <= most {
            return fine;
        }
        let decades = self.marks(&[1.0]);
        let every = decades.len().div_ceil(most).max(1);
        decades.into_iter().step_by(every).collect()
    }

    fn range(&self) -> Range<f64> {
        self.0.clone()
    }
}

/// The font of a chart's caption.
#[must_use]
pub fn caption_font(colour: &RGBColor) -> TextStyle<'static> {
    ("sans-serif", 32).into_font().color(colour)
}

/// The result of drawing.
pub type Drawn = Result<(), Box<dyn std::error::Error>>;

/// Draws a picture into a file.
///
/// # Errors
/// If it cannot be drawn or written; names the file.
pub fn draw_to_file(path: &Path, size: (u32, u32), draw: impl FnOnce(&Area<'_>) -> Drawn) -> anyhow::Result<()> {
    let svg = draw_to_string(size, draw).map_err(|error| anyhow::anyhow!("cannot draw {}: {error}", path.display()))?;
    atomic_file::write(path, svg)
}

/// Draws a picture as an `<svg>` element for a page.
///
/// # Errors
/// If it cannot be drawn.
pub fn draw_to_string(size: (u32, u32), draw: impl FnOnce(&Area<'_>) -> Drawn) -> anyhow::Result<String> {
    let mut svg = String::new();
    draw_on(SVGBackend::with_string(&mut svg, size), draw).map_err(|error| anyhow::anyhow!("{error}"))?;
    Ok(svg)
}

fn draw_on(backend: SVGBackend<'_>, draw: impl FnOnce(&Area<'_>) -> Drawn) -> Drawn {
    let root = backend.into_drawing_area();
    root.fill(&WHITE)?;
    draw(&root)?;
    root.present()?;
    Ok(())
}

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
    let axes = chart.as_coord_spec();
    let (x_number, y_number) = (numbers(axes.x_spec(), WIDE), numbers(axes.y_spec(), WIDE));
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .label_style(LABELS)
        .x_labels(LABELS_MAX)
        .y_labels(LABELS_MAX)
        .x_label_formatter(&x_number)
        .y_label_formatter(&y_number)
        .x_desc(x_label)
        .y_desc(y_label)
        .draw()?;
    Ok(())
}

/// The format of an axis's numbers: all with powers of ten if one of them needs it; numbers from `wide` on do.
pub fn numbers<A: Ranged<ValueType = f64>>(axis: &A, wide: f64) -> impl Fn(&f64) -> String + use<A> {
    let unit = rounding(&axis.range());
    let is_plain = |mark: &f64| mark.abs() < unit || *mark == 0.0 || (SMALL..wide * (1.0 - 1e-9)).contains(&mark.abs());
    let all_plain = axis.key_points(BoldPoints(LABELS_MAX)).iter().all(is_plain);
    move |value| match value {
        value if value.abs() < unit => "0".to_owned(),
        value if all_plain => plain(*value),
        value => powers(*value),
    }
}

/// Smaller numbers on an axis are zero with a rounding error of the steps between labels.
fn rounding(axis: &Range<f64>) -> f64 {
    if axis.start <= 0.0 { 1e-12 * (axis.end - axis.start) } else { 0.0 }
}

/// Axes whose vertical one has named rows, from the top down: row `k` of `n` lies between `n - k - 1` and `n - k`.
///
/// # Errors
/// The backend's.
pub fn draw_rows<'a, 'b, X>(
    area: &'a Area<'b>,
    names: &[impl AsRef<str>],
    xs: X,
    x_label: &str,
) -> Result<Rows<'a, 'b, X::CoordDescType>, Box<dyn std::error::Error>>
where
    X: AsRangedCoord<Value = f64>,
    X::CoordDescType: ValueFormatter<f64>,
{
    let count = names.len() as f64;
    let mut chart = ChartBuilder::on(area)
        .margin(20)
        .margin_right(60)
        .x_label_area_size(60)
        .y_label_area_size(260)
        .build_cartesian_2d(xs, 0.0..count)?;
    // Each name is in the middle of its row.
    let name = |y: &f64| {
        let index = count - 0.5 - y;
        let named = ((index - index.round()).abs() < 1e-6).then(|| names.get(index.round() as usize)).flatten();
        named.map_or("", AsRef::as_ref).to_owned()
    };
    let x_number = numbers(chart.as_coord_spec().x_spec(), WIDE);
    chart
        .configure_mesh()
        .disable_mesh()
        .label_style(LABELS)
        .y_labels(2 * names.len() + 1)
        .y_label_formatter(&name)
        .x_labels(LABELS_BENEATH_ROWS)
        .x_label_formatter(&x_number)
        .x_desc(x_label)
        .draw()?;
    Ok(chart)
}

/// Limits of a logarithmic axis for all finite values above zero, with a small margin.
#[must_use]
pub fn log_limits(values: impl IntoIterator<Item = f64>) -> Range<f64> {
    let drawable = values.into_iter().filter(|value| value.is_finite() && *value > 0.0);
    let (low, high) = drawable.fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(value), high.max(value)));
    if low > high {
        return 1e-3..1.0;
    }
    let (low, high) = (low / 1.2, high * 1.2);
    // Labels start at a whole power of ten. It is included if it is near; the factor allows for rounding.
    let decade = 10_f64.powf(low.log10().floor()) * (1.0 - 1e-9);
    if decade > 0.0 && low < 3.0 * decade { decade..high } else { low..high }
}

/// The colour of a robot; colours repeat in large teams.
#[must_use]
pub fn robot_colour(id: usize) -> RGBColor {
    // The last colour is the estimate's.
    COLOURS[id % (COLOURS.len() - 1)]
}

/// A number with at most three decimals, or with a power of ten if it is small or large.
#[must_use]
pub fn short(value: f64) -> String {
    if value == 0.0 || (SMALL..WIDE).contains(&value.abs()) { plain(value) } else { powers(value) }
}

fn plain(value: f64) -> String {
    trimmed(&format!("{value:.3}")).to_owned()
}

fn powers(value: f64) -> String {
    let text = format!("{value:.3e}");
    text.split_once('e').map_or(text.clone(), |(digits, power)| format!("{}e{power}", trimmed(digits)))
}

/// Removes trailing zeros, and the point before them.
fn trimmed(digits: &str) -> &str {
    digits.trim_end_matches('0').trim_end_matches('.')
}

/// An entry of the legend: a name, and the style of its sample line.
pub type KeyEntry = (String, ShapeStyle);

/// Height of a legend with these entries in a picture of this width, px.
#[must_use]
pub fn key_height(width: u32, entries: &[KeyEntry]) -> u32 {
    let rows = key_places(width, entries).last().map_or(0, |(_, row)| row + 1);
    if rows > 0 { rows * KEY_ROW + 10 } else { 0 }
}

/// Left end and row of each entry.
fn key_places(width: u32, entries: &[KeyEntry]) -> Vec<(u32, u32)> {
    let (mut left, mut row) = (0, 0);
    let place = |(name, _): &KeyEntry| {
        let entry = KEY_LINE + KEY_CHARACTER * name.chars().count() as u32;
        if left > 0 && left + entry > width {
            (left, row) = (0, row + 1);
        }
        let place = (left, row);
        left += entry;
        place
    };
    entries.iter().map(place).collect()
}

/// Draws the legend in rows at the top, so that it covers nothing, and returns the area below.
///
/// # Errors
/// The backend's.
pub fn draw_key<'a>(area: &Area<'a>, entries: &[KeyEntry]) -> Result<Area<'a>, Box<dyn std::error::Error>> {
    let width = area.dim_in_pixel().0;
    let (key, below) = area.split_vertically(key_height(width, entries));
    for ((name, line), (left, row)) in entries.iter().zip(key_places(width, entries)) {
        let (left, middle) = ((left + 40) as i32, (row * KEY_ROW + KEY_ROW / 2 + 10) as i32);
        key.draw(&PathElement::new([(left, middle), (left + 40, middle)], *line))?;
        let style = KEY.into_font().color(&BLACK).pos(Pos::new(HPos::Left, VPos::Center));
        key.draw(&Text::new(name.clone(), (left + 52, middle), style))?;
    }
    Ok(below)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_breaks_into_rows_and_one_of_nothing_has_no_height() {
        let entries = |names: &[&str]| -> Vec<KeyEntry> {
            names.iter().map(|name| ((*name).to_owned(), BLACK.stroke_width(6))).collect()
        };
        let wide = KEY_LINE + 5 * KEY_CHARACTER;
        assert_eq!(key_places(2 * wide, &entries(&["first", "other", "third"])), [(0, 0), (wide, 0), (0, 1)]);
        assert_eq!(key_places(10, &entries(&["first", "other"])), [(0, 0), (0, 1)]);
        assert_eq!(key_height(500, &[]), 0);
    }

    #[test]
    fn numbers_on_axes_are_short_and_not_too_many() {
        assert_eq!([0.0, 0.5, 250.0, 450_000.0, 2e-4].map(short), ["0", "0.5", "250", "4.5e5", "2e-4"]);
    }

    /// The labels of an axis.
    fn labels<A: Ranged<ValueType = f64>>(axis: &A) -> Vec<String> {
        axis.key_points(BoldPoints(LABELS_MAX)).iter().map(numbers(axis, WIDE)).collect()
    }

    #[test]
    fn a_log_axis_has_each_mark_once_and_as_many_as_have_room() {
        assert_eq!(labels(&LogAxis(0.01..1.2)), ["0.01", "0.02", "0.05", "0.1", "0.2", "0.5", "1"]);
        assert_eq!(labels(&LogAxis(8.0..120.0)), ["10", "20", "50", "100"]);
        assert_eq!(labels(&LogAxis(log_limits([1.0, 5e4]))), ["1", "10", "100", "1000", "10000"]);
        assert_eq!(labels(&LogAxis(1e-12..1e9)).len(), 11);
        assert!(labels(&LogAxis(3.2..4.5)).len() > 2);
    }

    #[test]
    fn all_numbers_of_an_axis_are_written_alike() {
        assert_eq!(labels(&LogAxis(500.0..2e5)), ["5e2", "1e3", "2e3", "5e3", "1e4", "2e4", "5e4", "1e5", "2e5"]);
        assert_eq!(labels(&RangedCoordf64::from(0.0..1e5)).last().unwrap(), "1e5");
        assert_eq!(labels(&RangedCoordf64::from(98e3..1e5))[1], "9.82e4");
        let around_zero = labels(&RangedCoordf64::from(-2e-3..2e-3));
        assert!(around_zero.contains(&"0".to_owned()) && around_zero.contains(&"1e-3".to_owned()), "{around_zero:?}");
    }

    #[test]
    fn a_log_axis_starts_at_a_decade_that_is_near() {
        let limits = log_limits([0.02, 5.0, f64::NAN, -1.0]);
        assert!((limits.start - 0.01).abs() < 1e-9 && limits.end == 6.0, "{limits:?}");
        assert_eq!(log_limits([6.0, 60.0]), 5.0..72.0);
        assert_eq!(log_limits([0.0]), 1e-3..1.0);
    }

    #[test]
    fn a_drawing_in_a_string_is_one_element() {
        let names = ["<one>", "two"];
        let svg = draw_to_string((900, 300), |area| draw_rows(area, &names, 0.0..1.0, "time, s").map(drop)).unwrap();
        assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"), "{svg}");
        assert!(svg.contains("&lt;one&gt;") && svg.contains("two") && svg.matches("<svg").count() == 1, "{svg}");
    }
}
