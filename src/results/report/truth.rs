//! A true track, which the tracker never saw.

use nalgebra::Vector2;

/// A true track: positions by time, from a file that the tracker never saw.
#[derive(Debug, Clone)]
pub struct Truth(Vec<(f64, Vector2<f64>)>);

impl Truth {
    /// A track of (time, position), in order of time.
    #[must_use]
    pub fn new(points: Vec<(f64, Vector2<f64>)>) -> Self {
        Self(points)
    }

    /// First and last time, s.
    #[must_use]
    pub fn span_s(&self) -> [f64; 2] {
        [self.0.first(), self.0.last()].map(|point| point.map_or(0.0, |(time_s, _)| *time_s))
    }

    /// Position at a time, by linear interpolation; `None` outside the track.
    #[must_use]
    pub fn at(&self, time_s: f64) -> Option<Vector2<f64>> {
        let after = self.0.partition_point(|(t, _)| *t < time_s);
        let (t1, p1) = *self.0.get(after)?;
        if t1 == time_s {
            return Some(p1);
        }
        let (t0, p0) = *self.0.get(after.checked_sub(1)?)?;
        Some(p0 + (p1 - p0) * ((time_s - t0) / (t1 - t0)))
    }
}
