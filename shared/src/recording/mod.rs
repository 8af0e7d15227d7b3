//! Recorded ranges and bearings: tables from loggers, checked in a single pass.
//!
//! A file passes through these parts; each depends only on those before it:
//!
//! | part | task |
//! |---|---|
//! | `lines` | lines of limited length; byte order marks |
//! | `dialect` | comments, fields, quotes, decimal marks |
//! | `table` | finds header and separator, returns rows as long as the header |
//! | `names`, `columns`, `unit`, `layout` | role and unit of each column, by name or by `--columns` |
//! | `anchors`, `wide`, `track` | places of sensors, columns for each anchor, true tracks |
//! | `rows` | rows to measurements: faults that refuse the file, and faults that skip the row |
//! | `port` | logs of a radio's port, by [`crate::radio`] |
//! | `measurements`, `gathering` | measurements to a [`Recording`]: storage, order, repeats, instants |
//! | `checks` | implausible units |
//! | `digest`, `summary`, `write` | identity of a recording, the reader's findings, CSV output |

mod anchors;
mod columns;
mod digest;
mod error;
mod measurements;
mod name;
mod options;
mod port;
mod rows;
mod summary;
mod table;
mod track;
mod write;

use std::io::{Read, Write};
use std::path::Path;

pub use anchors::{Anchor, Anchors};
pub use columns::{ColumnMap, ColumnMapError};
pub use digest::RecordingDigest;
pub use error::{Complaint, Problem, RecordingError};
pub use measurements::RecordedMeasurement;
pub use name::SensorName;
pub use options::ReadOptions;
pub use port::PortLog;
pub use summary::{Doubt, DoubtKind, ReadSummary};
pub use track::{TrackPoint, parse_track};

use measurements::Measurements;

/// Ranges and bearings from one or more sensors to one target, in order of time.
#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    sensors: Vec<Sensor>,
    instants: Vec<Instant>,
    readings: Measurements,
}

/// One sensor of a recording. Its index in [`Recording::sensors`] is its robot's id in the run.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensor {
    /// Its name in the file.
    pub name: SensorName,
    /// Its place at its first measurement, m.
    pub first_position_m: [f64; 2],
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Instant {
    time_s: f64,
    readings_end: usize,
}

impl Recording {
    /// Reads and checks a log from a reader, which may be a pipe; `path` names it in errors.
    ///
    /// # Errors
    /// [`RecordingError`] for the first fault of the file. A faulty row is skipped
    /// and counted, unless most rows are faulty or the options are strict.
    pub fn parse(input: impl Read, path: &Path, options: &ReadOptions) -> Result<(Self, ReadSummary), RecordingError> {
        match options.port {
            Some(port) => port::read(input, path, port, options),
            None => rows::read(input, path, options),
        }
    }

    /// Writes the recording as CSV that [`Self::parse`] reads back, the same to the last bit.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write_csv(&self, out: impl Write) -> std::io::Result<()> {
        write::write_csv(self, out)
    }

    /// The identity of this recording, from all its contents.
    #[must_use]
    pub fn digest(&self) -> RecordingDigest {
        digest::digest(self)
    }

    /// True if any measurement has its sensor's height.
    #[must_use]
    pub fn has_heights(&self) -> bool {
        self.readings.iter().any(|reading| reading.height_m.is_some())
    }

    /// Number of ranges.
    #[must_use]
    pub fn ranges(&self) -> usize {
        self.readings.iter().filter(|reading| reading.range_m.is_some()).count()
    }

    /// Number of bearings.
    #[must_use]
    pub fn bearings(&self) -> usize {
        self.readings.extras().iter().filter(|[bearing_rad, ..]| bearing_rad.is_some()).count()
    }

    /// True if there is any range.
    #[must_use]
    pub fn has_ranges(&self) -> bool {
        self.readings.iter().any(|reading| reading.range_m.is_some())
    }

    /// True if there is any bearing.
    #[must_use]
    pub fn has_bearings(&self) -> bool {
        self.readings.extras().iter().any(|[bearing_rad, ..]| bearing_rad.is_some())
    }

    /// The sensors by ascending name.
    #[must_use]
    pub fn sensors(&self) -> &[Sensor] {
        &self.sensors
    }

    /// Number of instants: different stamps, or more where a sensor repeats within a stamp.
    #[must_use]
    pub fn len(&self) -> usize {
        self.instants.len()
    }

    /// Never true: a recording has at least one measurement.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.instants.is_empty()
    }

    /// Time of an instant and its measurements; `None` past the end.
    #[must_use]
    pub fn instant(&self, index: usize) -> Option<(f64, impl ExactSizeIterator<Item = RecordedMeasurement>)> {
        let Instant { time_s, readings_end } = *self.instants.get(index)?;
        let start = index.checked_sub(1).map_or(0, |before| self.instants[before].readings_end);
        Some((time_s, self.readings.range(start..readings_end)))
    }
}

#[cfg(test)]
mod tests;
