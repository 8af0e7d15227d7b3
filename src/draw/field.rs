//! The field seen from above: paths of target, estimate and robots, with covariance ellipses.

use std::ops::Range;

use nalgebra::{Matrix2, Vector2};
use plotters::prelude::*;
use rangehound_shared::scenario::Scenario;

use crate::draw::belief::Belief;
use crate::draw::chart::{self, Area, Drawn, ESTIMATE, KeyEntry, Plane, TARGET};
use crate::draw::ellipse::Ellipse;

/// Number of covariance ellipses along the track.
const ELLIPSES: usize = 16;

/// Corners of an ellipse.
const ELLIPSE_STEPS: u32 = 48;

/// Steps of a straight line.
const LINE_STEPS: u32 = 12;

/// Teams up to this size have each robot in the legend.
const FEW_ROBOTS: usize = 10;

/// The legend of the colours, for one field or several.
#[must_use]
pub fn key(robots: &[String]) -> Vec<KeyEntry> {
    let bodies = [("target".to_owned(), TARGET), ("estimate, 3 sigma".to_owned(), ESTIMATE)];
    let named = if robots.len() <= FEW_ROBOTS { robots } else { &[] };
    let robots = named.iter().enumerate().map(|(id, name)| (name.clone(), chart::robot_colour(id)));
    bodies.into_iter().chain(robots).map(|(name, colour)| (name, colour.stroke_width(6))).collect()
}

/// Positions of target and robots by tick, in m and m^2.
#[derive(Debug, Clone, Default)]
pub struct Paths {
    /// Estimated positions of the target.
    pub estimates_m: Vec<Vector2<f64>>,
    /// Their covariances.
    pub covariances_m2: Vec<Matrix2<f64>>,
    /// True positions of the target, where they are known.
    pub truths_m: Vec<Option<Vector2<f64>>>,
    /// A path for each robot.
    pub robots_m: Vec<Vec<Vector2<f64>>>,
    /// Each robot's own view, at the ticks at which there is something to show of it.
    pub beliefs: Vec<Vec<Belief>>,
    /// Display name of each robot.
    pub names: Vec<String>,
}

/// A square part of the field: the same scale in both directions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Square {
    centre: Vector2<f64>,
    half: f64,
}

impl Square {
    /// The smallest square around these places, with a margin.
    #[must_use]
    pub fn around<'a>(places: impl IntoIterator<Item = &'a Vector2<f64>>) -> Self {
        let none = (Vector2::repeat(f64::MAX), Vector2::repeat(f64::MIN));
        let (low, high) = places.into_iter().fold(none, |(low, high), place| (low.inf(place), high.sup(place)));
        if low.x > high.x {
            return Self { centre: Vector2::zeros(), half: 1.0 };
        }
        Self { centre: (low + high) * 0.5, half: ((high - low).amax() * 0.54).max(1.0) }
    }

    fn ranges(&self) -> (Range<f64>, Range<f64>) {
        let range = |middle: f64| middle - self.half..middle + self.half;
        (range(self.centre.x), range(self.centre.y))
    }

    /// The pieces of a path that lie inside: the backend does not clip.
    fn pieces(&self, path: impl IntoIterator<Item = (f64, f64)>) -> Vec<Vec<(f64, f64)>> {
        let mut pieces = vec![Vec::new()];
        for (x, y) in path {
            if (Vector2::new(x, y) - self.centre).amax() <= self.half {
                if let Some(piece) = pieces.last_mut() {
                    piece.push((x, y));
                }
            } else if pieces.last().is_some_and(|piece| !piece.is_empty()) {
                pieces.push(Vec::new());
            }
        }
        pieces
    }
}

impl Paths {
    /// Empty paths of a scenario's team.
    #[must_use]
    pub fn of_team(scenario: &Scenario) -> Self {
        let robots = scenario.robots.len();
        let names = (0..robots).map(|robot| scenario.name_of(robot)).collect();
        Self { robots_m: vec![Vec::new(); robots], beliefs: vec![Vec::new(); robots], names, ..Self::default() }
    }

    /// All true positions of target and robots, and where robots believed they were.
    pub fn bodies(&self) -> impl Iterator<Item = &Vector2<f64>> {
        let believed = self.beliefs.iter().flatten().map(|belief| &belief.place_m);
        self.truths_m.iter().flatten().chain(self.robots_m.iter().flatten()).chain(believed)
    }

    /// Size of a picture of this width by [`Self::draw_complete`], px.
    #[must_use]
    pub fn complete_size(&self, width: u32) -> (u32, u32) {
        (width, width + chart::key_height(width, &key(&self.names)))
    }

    /// Draws the whole field below a legend.
    ///
    /// # Errors
    /// The backend's.
    pub fn draw_complete(&self, area: &Area<'_>) -> Drawn {
        let below = chart::draw_key(area, &key(&self.names))?;
        self.draw(&below, Square::around(self.estimates_m.iter().chain(self.bodies())), None)
    }

    /// Draws the paths on a square of the field.
    ///
    /// # Errors
    /// The backend's.
    pub fn draw(&self, area: &Area<'_>, square: Square, caption: Option<(&str, RGBColor)>) -> Drawn {
        let (x, y) = square.ranges();
        let mut builder = ChartBuilder::on(area);
        // Equal margins horizontally and vertically, so that a square stays a square.
        builder.margin(20).margin_top(40).margin_bottom(40).x_label_area_size(60).y_label_area_size(100);
        if let Some((caption, colour)) = caption {
            builder.caption(caption, chart::caption_font(&colour));
        }
        let mut chart = builder.build_cartesian_2d(x, y)?;
        chart::draw_axes(&mut chart, "x, m", "y, m")?;
        self.draw_beliefs(&mut chart, square)?;
        self.draw_robots(&mut chart, square)?;
        self.draw_ellipses(&mut chart, square)?;
        let estimates = square.pieces(self.estimates_m.iter().map(|p| (p.x, p.y)));
        for piece in estimates {
            chart.draw_series(LineSeries::new(piece, ESTIMATE.stroke_width(2)))?;
        }
        let truth: Vec<(f64, f64)> = self.truths_m.iter().flatten().map(|p| (p.x, p.y)).collect();
        if let Some(end) = truth.last().copied() {
            chart.draw_series(LineSeries::new(truth, TARGET.stroke_width(3)))?;
            chart.draw_series(std::iter::once(Circle::new(end, 9, TARGET.filled())))?;
        }
        Ok(())
    }

    fn draw_robots(&self, chart: &mut Plane<'_, '_>, square: Square) -> Drawn {
        let few = self.robots_m.len() <= FEW_ROBOTS;
        for (id, path) in self.robots_m.iter().enumerate() {
            let colour = chart::robot_colour(id).mix(if few { 0.9 } else { 0.4 });
            for piece in square.pieces(path.iter().map(|p| (p.x, p.y))) {
                chart.draw_series(LineSeries::new(piece, colour.stroke_width(2)))?;
            }
            if let Some(last) = path.last() {
                let marker = TriangleMarker::new((last.x, last.y), 12, colour.filled());
                chart.draw_series(std::iter::once(marker))?;
            }
        }
        Ok(())
    }

    /// The robots' own views at some ticks: the ray of a bearing, the 3 sigma ellipse of the own position, and a line from the
    /// true to the believed place. Not of large teams, whose lines would hide the paths.
    fn draw_beliefs(&self, chart: &mut Plane<'_, '_>, square: Square) -> Drawn {
        if self.beliefs.len() > FEW_ROBOTS {
            return Ok(());
        }
        for (id, beliefs) in self.beliefs.iter().enumerate() {
            let colour = chart::robot_colour(id);
            let every = beliefs.len().div_ceil(ELLIPSES).max(1);
            for Belief { true_m, place_m, covariance_m2, ray_end_m } in beliefs.iter().rev().step_by(every) {
                let ray = ray_end_m.map(|end_m| line_between(*place_m, end_m)).into_iter().flatten();
                let error = line_between(*true_m, *place_m);
                let outline = covariance_m2.map(|covariance_m2| Ellipse::new(*place_m, &covariance_m2, 3.0));
                let outline = outline.into_iter().flat_map(|ellipse| ellipse.outline_m(ELLIPSE_STEPS));
                let lines = [
                    (square.pieces(ray), colour.mix(0.3).stroke_width(2)),
                    (square.pieces(error), colour.mix(0.7).stroke_width(2)),
                    (square.pieces(outline.map(|p| (p.x, p.y))), colour.mix(0.5).stroke_width(2)),
                ];
                for (piece, style) in
                    lines.into_iter().flat_map(|(pieces, style)| pieces.into_iter().map(move |piece| (piece, style)))
                {
                    chart.draw_series(std::iter::once(PathElement::new(piece, style)))?;
                }
            }
        }
        Ok(())
    }

    /// The 3 sigma ellipses of some ticks.
    fn draw_ellipses(&self, chart: &mut Plane<'_, '_>, square: Square) -> Drawn {
        let every = self.estimates_m.len().div_ceil(ELLIPSES).max(1);
        for (centre, covariance) in self.estimates_m.iter().zip(&self.covariances_m2).step_by(every) {
            let outline_m = Ellipse::new(*centre, covariance, 3.0).outline_m(ELLIPSE_STEPS);
            for piece in square.pieces(outline_m.map(|p| (p.x, p.y))) {
                chart.draw_series(std::iter::once(PathElement::new(piece, ESTIMATE.mix(0.5).stroke_width(2))))?;
            }
        }
        Ok(())
    }
}

/// Points on a straight line, so that it can be cut at the edge of a square.
fn line_between(from_m: Vector2<f64>, to_m: Vector2<f64>) -> impl Iterator<Item = (f64, f64)> {
    (0..=LINE_STEPS).map(move |step| {
        let p = from_m.lerp(&to_m, f64::from(step) / f64::from(LINE_STEPS));
        (p.x, p.y)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_that_leaves_the_square_is_cut() {
        let square = Square::around(&[Vector2::new(-1.0, -1.0), Vector2::new(1.0, 1.0)]);
        let path = [(0.0, 0.0), (0.5, 0.0), (9.0, 0.0), (9.0, 9.0), (1.0, 1.0)];
        assert_eq!(square.pieces(path), [vec![(0.0, 0.0), (0.5, 0.0)], vec![(1.0, 1.0)]]);
    }

    #[test]
    fn an_empty_field_has_the_default_square() {
        assert_eq!(Square::around(&[]).ranges(), (-1.0..1.0, -1.0..1.0));
    }
}
