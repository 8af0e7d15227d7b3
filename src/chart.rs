//! What all pictures are drawn with: colours, labels, legends and lines.
//!
//! The SVG backend rounds to whole pixels, so pictures are large and their labels with them.

use std::ops::Range;
use std::path::Path;

use plotters::coord::Shift;
use plotters::coord::cartesian::Cartesian2d;
use plotters::coord::ranged1d::ValueFormatter;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::whole_file;

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

/// Draws a picture into a file.
///
/// # Errors
/// If it cannot be drawn or written; the file's name is in it.
pub fn draw_to_file(path: &Path, size: (u32, u32), draw: impl FnOnce(&Area<'_>) -> Drawn) -> anyhow::Result<()> {
    let svg = draw_to_string(size, draw).map_err(|error| anyhow::anyhow!("{}: {error}", path.display()))?;
    whole_file::write(path, svg)
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

/// The labelled axes of a chart; `y_number` is [`short`], or [`short_on_log`] where the vertical one has a logarithm.
///
/// # Errors
/// The backend's.
pub fn draw_axes<X, Y>(
    chart: &mut ChartContext<'_, SVGBackend<'_>, Cartesian2d<X, Y>>,
    x_label: &str,
    y_label: &str,
    y_number: fn(&f64) -> String,
) -> Drawn
where
    X: Ranged<ValueType = f64> + ValueFormatter<f64>,
    Y: Ranged<ValueType = f64> + ValueFormatter<f64>,
{
    let (x_unit, y_unit) = (rounding(&chart.x_range()), rounding(&chart.y_range()));
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .label_style(LABELS)
        .x_label_formatter(&|x| short(&if x.abs() < x_unit { 0.0 } else { *x }))
        .y_label_formatter(&|y| y_number(&if y.abs() < y_unit { 0.0 } else { *y }))
        .x_desc(x_label)
        .y_desc(y_label)
        .draw()?;
    Ok(())
}

/// What is less on an axis is zero: the steps from label to label are not exact.
fn rounding(axis: &Range<f64>) -> f64 {
    if axis.start <= 0.0 { 1e-12 * (axis.end - axis.start) } else { 0.0 }
}

/// Axes whose vertical one names rows, from the top down: row `k` of `n` lies between `n - k - 1` and `n - k`.
///
/// # Errors
/// The backend's.
pub fn draw_rows<'a, 'b>(
    area: &'a Area<'b>,
    names: &[impl AsRef<str>],
    xs: Range<f64>,
    x_label: &str,
) -> Result<Plane<'a, 'b>, Box<dyn std::error::Error>> {
    let count = names.len() as f64;
    let mut chart = ChartBuilder::on(area)
        .margin(20)
        .margin_right(60)
        .x_label_area_size(60)
        .y_label_area_size(260)
        .build_cartesian_2d(xs, 0.0..count)?;
    // In the middle of each row.
    let name = |y: &f64| {
        let index = count - 0.5 - y;
        let named = ((index - index.round()).abs() < 1e-6).then(|| names.get(index.round() as usize)).flatten();
        named.map_or("", AsRef::as_ref).to_owned()
    };
    chart
        .configure_mesh()
        .disable_mesh()
        .label_style(LABELS)
        .y_labels(2 * names.len() + 1)
        .y_label_formatter(&name)
        .x_label_formatter(&short)
        .x_desc(x_label)
        .draw()?;
    Ok(chart)
}

/// Axes' limits that hold all finite values above zero, for a log axis with a little room.
#[must_use]
pub fn log_limits(values: impl IntoIterator<Item = f64>) -> Range<f64> {
    let drawable = values.into_iter().filter(|value| value.is_finite() && *value > 0.0);
    let (low, high) = drawable.fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(value), high.max(value)));
    if low > high {
        return 1e-3..1.0;
    }
    let (low, high) = (low / 1.2, high * 1.2);
    // Numbers stand from the first whole decade on: it is taken in if it is near, and not missed by a rounding.
    let decade = 10_f64.powf(low.log10().floor()) * (1.0 - 1e-9);
    if decade > 0.0 && low < 3.0 * decade { decade..high } else { low..high }
}

/// The colour of a robot; they repeat in large teams.
#[must_use]
pub fn robot_colour(id: usize) -> RGBColor {
    // All but the last, which is the estimate's.
    COLOURS[id % (COLOURS.len() - 1)]
}

/// A number without the noise of its last digits; powers of ten where it is small or large.
#[must_use]
pub fn short(value: &f64) -> String {
    if *value != 0.0 && !(1e-3..1e5).contains(&value.abs()) {
        return format!("{value:.1e}").replace(".0e", "e");
    }
    let text = format!("{value:.3}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// The same, for 1, 2 and 5 in each decade only: what is between them has no room.
#[must_use]
pub fn short_on_log(value: &f64) -> String {
    let leading = value / 10_f64.powf(value.log10().floor());
    let is_round = [1.0, 2.0, 5.0, 10.0].iter().any(|round| (leading - round).abs() < 1e-6);
    if is_round { short(value) } else { String::new() }
}

/// A name in a key, and the line that is drawn beside it.
pub type KeyEntry = (String, ShapeStyle);

/// Height of the key of these entries in a picture of this width, px.
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

/// Rows of names at the top, each beside its line: a legend that covers nothing. Gives the area below.
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
        assert_eq!([0.0, 0.5, 250.0, 450_000.0, 2e-4].map(|value| short(&value)), ["0", "0.5", "250", "4.5e5", "2e-4"]);
        assert_eq!([0.1, 0.3, 5.0, 9.0, 1e3].map(|value| short_on_log(&value)), ["0.1", "", "5", "", "1000"]);
    }

    #[test]
    fn a_log_axis_starts_at_a_decade_that_is_near() {
        let limits = log_limits([0.02, 5.0, f64::NAN, -1.0]);
        assert!((limits.start - 0.01).abs() < 1e-9 && limits.end == 6.0, "{limits:?}");
        assert_eq!(log_limits([6.0, 60.0]), 5.0..72.0);
        assert_eq!(log_limits([0.0]), 1e-3..1.0);
    }

    #[test]
    fn what_is_drawn_into_a_string_is_one_element() {
        let names = ["<one>", "two"];
        let svg = draw_to_string((900, 300), |area| draw_rows(area, &names, 0.0..1.0, "time, s").map(drop)).unwrap();
        assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"), "{svg}");
        assert!(svg.contains("&lt;one&gt;") && svg.contains("two") && svg.matches("<svg").count() == 1, "{svg}");
    }
}
