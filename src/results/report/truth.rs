//! A true track, which the tracker never reads.

use std::io::Read;
use std::path::Path;

use nalgebra::Vector2;
use rangehound_shared::recording::{TrackPoint, parse_track};

use crate::failure::Failure;
use crate::files::input;

/// A true track: positions by time, from a file that the tracker never reads.
#[derive(Debug, Clone)]
pub struct Truth(Vec<(f64, Vector2<f64>)>);

impl From<Vec<TrackPoint>> for Truth {
    /// A track in order of time.
    fn from(points: Vec<TrackPoint>) -> Self {
        Self(points.into_iter().map(|(time_s, [x_m, y_m])| (time_s, Vector2::new(x_m, y_m))).collect())
    }
}

impl Truth {
    /// Reads a true track, `time_s,x_m,y_m` in any of the forms that a recording may have, in order of time.
    ///
    /// # Errors
    /// [`Failure::Input`] with file and row of the first error.
    pub fn read(path: &Path) -> Result<Self, Failure> {
        Ok(input::track(path).map_err(Failure::input)?.into())
    }

    /// Parses a true track from a reader.
    ///
    /// # Errors
    /// The first error, in one line.
    pub fn parse(input: impl Read) -> Result<Self, String> {
        let track = parse_track(input, Path::new("the true track")).map_err(|problem| problem.to_string())?;
        Ok(track.into())
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
