//! Recorded ranges: tables as loggers write them, checked while they are read, once, from start to end.
//!
//! A file goes through these, each of which knows nothing of those above it:
//!
//! | part | what it does |
//! |---|---|
//! | `lines` | lines of at most so many bytes; byte order marks |
//! | `dialect` | comments, fields, quotes, decimal marks |
//! | `table` | finds header and separator, gives rows as long as the header |
//! | `names`, `columns`, `unit`, `layout` | which column is what and in which unit, by name or by `--columns` |
//! | `anchors`, `wide`, `track` | places of sensors, columns for each anchor, true tracks |
//! | `rows` | rows to ranges: what is refused, what is passed over and counted |
//! | `port` | logs of a radio's port, by [`crate::radio`] |
//! | `gathering` | ranges to a [`Recording`]: order, repeats, instants |
//! | `checks` | units that cannot be |
//! | `digest`, `summary`, `write` | what tells a recording from all others, what the reader found, CSV again |

mod anchors;
mod columns;
mod digest;
mod error;
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
pub use name::SensorName;
pub use options::ReadOptions;
pub use port::PortLog;
pub use summary::{Doubt, DoubtKind, ReadSummary};
pub use track::{TrackPoint, parse_track};

/// Ranges from one or more sensors to one target, in order of time.
#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    sensors: Vec<Sensor>,
    instants: Vec<Instant>,
    readings: Vec<RecordedRange>,
}

/// One sensor of a recording. Its index in [`Recording::sensors`] is its robot's id in the run.
#[derive(Debug, Clone, PartialEq)]
pub struct Sensor {
    /// What the file calls it.
    pub name: SensorName,
    /// Where it was at its first range, m.
    pub first_position_m: [f64; 2],
}

/// One range of a recording.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RecordedRange {
    /// Index of the sensor.
    pub sensor: usize,
    /// Where the sensor was, m.
    pub position_m: [f64; 2],
    /// Its height in the recording's frame, m; `None` if the recording has none.
    pub height_m: Option<f64>,
    /// What it measured, m.
    pub range_m: f64,
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
    /// [`RecordingError`] for the first thing that is wrong with the file. A row that is bad by itself is passed over
    /// and counted, unless most are, or the options are strict.
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

    /// Tells this recording from every other, by all that it says.
    #[must_use]
    pub fn digest(&self) -> RecordingDigest {
        digest::digest(self)
    }

    /// Whether any range has its sensor's height.
    #[must_use]
    pub fn has_heights(&self) -> bool {
        self.readings.iter().any(|reading| reading.height_m.is_some())
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

    /// Never true: a recording has one range at least.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.instants.is_empty()
    }

    /// Time of an instant and its ranges; `None` past the end.
    #[must_use]
    pub fn instant(&self, index: usize) -> Option<(f64, &[RecordedRange])> {
        let Instant { time_s, readings_end } = *self.instants.get(index)?;
        let start = index.checked_sub(1).map_or(0, |before| self.instants[before].readings_end);
        Some((time_s, &self.readings[start..readings_end]))
    }
}

#[cfg(test)]
mod tests;
