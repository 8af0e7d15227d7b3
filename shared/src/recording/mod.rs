//! Recorded ranges: CSV with a row for each range, checked while it is read.

mod name;
mod options;
mod summary;

pub use name::SensorName;
pub use options::ReadOptions;
pub use summary::ReadSummary;

use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};

use crate::ROBOTS_MAX;
use crate::bounded::Rationed;

/// The columns, in any order; others are ignored.
const COLUMNS: [&str; 5] = ["time_s", "sensor_id", "sensor_x_m", "sensor_y_m", "range_m"];

/// Largest coordinate, m: leaves room for map grids such as UTM.
const COORDINATE_MAX_M: f64 = 1e8;

/// Largest time stamp, s: three thousand years.
const TIME_MAX_S: f64 = 1e11;

/// Largest range, m.
const RANGE_MAX_M: f64 = 1e6;

/// Longest row, bytes.
const ROW_LEN_MAX: usize = 1 << 16;

/// Most rows: 14 h of 20 sensors at 10 Hz; each takes up to 100 bytes of memory.
const ROWS_MAX: usize = 10_000_000;

/// Ranges from two or more sensors to one target, in order of time.
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

/// Why a recording was refused. Displays as one line with file, row, column and what was expected.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file could not be opened or read.
    #[error("{}: expected a recording that can be read: {reason}", .file.display())]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// The reader's reason.
        reason: String,
    },
    /// The header lacks a column.
    #[error("{}: row 0 (line 1, the header): expected a column {missing}; the columns are {}", .file.display(), COLUMNS.join(","))]
    MissingColumn {
        /// The file.
        file: PathBuf,
        /// The column.
        missing: &'static str,
    },
    /// A row is wrong.
    #[error("{}: row {row} (line {line}): {column}: expected {expected}, got {got}", .file.display())]
    Row {
        /// The file.
        file: PathBuf,
        /// The data row, counted from 1.
        row: usize,
        /// The line of the file, counted from 1.
        line: u64,
        /// The column.
        column: &'static str,
        /// What it takes.
        expected: String,
        /// What stood there.
        got: String,
    },
}

impl Recording {
    /// Reads and checks a CSV file.
    ///
    /// # Errors
    /// [`RecordingError`] for the first thing that is wrong.
    pub fn read(path: &Path, options: &ReadOptions) -> Result<(Self, ReadSummary), RecordingError> {
        let file = std::fs::File::open(path)
            .map_err(|error| RecordingError::Unreadable { file: path.to_owned(), reason: error.to_string() })?;
        Self::parse(file, path, options)
    }

    /// Parses CSV from a reader; `path` names it in errors.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn parse(input: impl Read, path: &Path, _options: &ReadOptions) -> Result<(Self, ReadSummary), RecordingError> {
        let mut reader = csv::ReaderBuilder::new();
        reader.trim(csv::Trim::All).flexible(true);
        let mut reader = reader.from_reader(Rationed::new(input, ROW_LEN_MAX));
        let unreadable =
            |error: csv::Error| RecordingError::Unreadable { file: path.to_owned(), reason: error.to_string() };
        let header = reader.headers().map_err(unreadable)?;
        let mut column_index = [0; COLUMNS.len()];
        for (index, column) in column_index.iter_mut().zip(COLUMNS) {
            *index = header
                .iter()
                .position(|name| name == column)
                .ok_or_else(|| RecordingError::MissingColumn { file: path.to_owned(), missing: column })?;
        }

        let mut rows: Vec<(f64, SensorName, [f64; 2], f64)> = Vec::new();
        let mut record = csv::StringRecord::new();
        let mut line = 1;
        loop {
            reader.get_mut().renew();
            match reader.read_record(&mut record) {
                Ok(true) => {}
                Ok(false) => break,
                Err(error) => return Err(unreadable_row(path, rows.len() + 1, &error)),
            }
            line = record.position().map_or(line + 1, csv::Position::line);
            let row = Row { path, row: rows.len() + 1, line, record: &record, column_index: &column_index };
            let time_s = row.number(0, -TIME_MAX_S, TIME_MAX_S, "a finite number within +-1e11")?;
            let sensor_name = row.sensor_name()?;
            let coordinate = "a finite number within +-1e8";
            let x_m = row.number(2, -COORDINATE_MAX_M, COORDINATE_MAX_M, coordinate)?;
            let y_m = row.number(3, -COORDINATE_MAX_M, COORDINATE_MAX_M, coordinate)?;
            let range_m = row.number(4, 0.0, RANGE_MAX_M, "a finite number from 0 to 1e6")?;
            if let Some(&(before_s, ..)) = rows.last()
                && time_s < before_s
            {
                return Err(row.error(0, format!("a time not before the row above ({before_s})")));
            }
            if rows.len() == ROWS_MAX {
                return Err(RecordingError::Unreadable {
                    file: path.to_owned(),
                    reason: format!("it has more than {ROWS_MAX} rows"),
                });
            }
            rows.push((time_s, sensor_name, [x_m, y_m], range_m));
        }

        let mut first_positions = BTreeMap::new();
        for (_, name, position_m, _) in &rows {
            first_positions.entry(name.clone()).or_insert(*position_m);
        }
        let count = first_positions.len();
        if !(2..=ROBOTS_MAX).contains(&count) {
            return Err(RecordingError::Row {
                file: path.to_owned(),
                row: rows.len(),
                line,
                column: "sensor_id",
                expected: format!("2 to {ROBOTS_MAX} different sensors up to this last row"),
                got: count.to_string(),
            });
        }
        let sensors: Vec<Sensor> =
            first_positions.into_iter().map(|(name, first_position_m)| Sensor { name, first_position_m }).collect();
        let summary = ReadSummary { rows: rows.len() as u64 };
        Ok((Self::group(sensors, &rows), summary))
    }

    /// Rows with one stamp become one instant, unless a sensor would be in it twice.
    fn group(sensors: Vec<Sensor>, rows: &[(f64, SensorName, [f64; 2], f64)]) -> Self {
        let mut instants: Vec<Instant> = Vec::new();
        let mut readings: Vec<RecordedRange> = Vec::with_capacity(rows.len());
        let mut instant_start = 0;
        for (time_s, name, position_m, range_m) in rows {
            let (time_s, position_m, range_m) = (*time_s, *position_m, *range_m);
            let sensor = sensors.partition_point(|sensor| sensor.name < *name);
            let joins = instants.last().is_some_and(|instant| instant.time_s == time_s)
                && readings[instant_start..].iter().all(|reading| reading.sensor != sensor);
            if !joins {
                instant_start = readings.len();
                instants.push(Instant { time_s, readings_end: 0 });
            }
            readings.push(RecordedRange { sensor, position_m, height_m: None, range_m });
            if let Some(instant) = instants.last_mut() {
                instant.readings_end = readings.len();
            }
        }
        Self { sensors, instants, readings }
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

    /// Never true: a recording has two sensors at least.
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

/// A row that the CSV reader itself refuses.
fn unreadable_row(path: &Path, row: usize, error: &csv::Error) -> RecordingError {
    RecordingError::Row {
        file: path.to_owned(),
        row,
        line: error.position().map_or(0, csv::Position::line),
        column: "row",
        expected: format!("text in UTF-8 of at most {ROW_LEN_MAX} bytes"),
        got: error.to_string(),
    }
}

/// One row under its header, for reading and for complaining.
struct Row<'a> {
    path: &'a Path,
    row: usize,
    line: u64,
    record: &'a csv::StringRecord,
    column_index: &'a [usize; COLUMNS.len()],
}

impl Row<'_> {
    fn field(&self, column: usize) -> &str {
        self.record.get(self.column_index[column]).unwrap_or("")
    }

    fn number(&self, column: usize, min: f64, max: f64, expected: &str) -> Result<f64, RecordingError> {
        match self.field(column).parse::<f64>() {
            Ok(value) if (min..=max).contains(&value) => Ok(value),
            _ => Err(self.error(column, expected.to_owned())),
        }
    }

    fn sensor_name(&self) -> Result<SensorName, RecordingError> {
        self.field(1).parse().map_err(|error: name::SensorNameError| self.error(1, error.to_string()))
    }

    fn error(&self, column: usize, expected: String) -> RecordingError {
        // A field of a damaged file may be of any length; the message stays one readable line.
        let field: String = self.field(column).chars().take(40).collect();
        RecordingError::Row {
            file: self.path.to_owned(),
            row: self.row,
            line: self.line,
            column: COLUMNS[column],
            expected,
            got: format!("{field:?}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const HEADER: &str = "time_s,sensor_id,sensor_x_m,sensor_y_m,range_m\n";

    fn parse(rows: &str) -> Result<Recording, RecordingError> {
        let text = format!("{HEADER}{rows}");
        Recording::parse(text.as_bytes(), Path::new("r.csv"), &ReadOptions::default()).map(|(recording, _)| recording)
    }

    fn complaint(rows: &str) -> String {
        parse(rows).unwrap_err().to_string()
    }

    #[test]
    fn equal_stamps_become_one_instant_but_never_with_a_sensor_twice() {
        let recording = parse("0,9,0,0,1\n0,4,1,0,2\n1,9,0,0,3\n1,9,0,0,4\n").unwrap();
        assert_eq!(recording.sensors().iter().map(|s| s.name.as_str()).collect::<Vec<_>>(), ["4", "9"]);
        assert_eq!(recording.len(), 3);
        let (time_s, ranges) = recording.instant(0).unwrap();
        assert_eq!((time_s, ranges.len(), ranges[0].sensor, ranges[1].sensor), (0.0, 2, 1, 0));
        assert_eq!(recording.instant(1).unwrap().1[0].range_m, 3.0);
        assert_eq!(recording.instant(2).unwrap(), (1.0, &recording.readings[3..]));
        assert!(recording.instant(3).is_none());
    }

    #[test]
    fn every_refusal_names_row_column_and_expectation() {
        assert_eq!(
            complaint("0,1,0,0,1\n1,2,0,zero,1\n"),
            "r.csv: row 2 (line 3): sensor_y_m: expected a finite number within +-1e8, got \"zero\""
        );
        assert!(complaint("0,1,0,0,NaN\n").contains("row 1 (line 2): range_m: expected a finite number from 0"));
        assert!(complaint("0,1,0,0,-1\n").contains("range_m: expected a finite number from 0"));
        assert!(complaint("inf,1,0,0,1\n").contains("time_s: expected a finite number"));
        assert!(complaint("1e308,1,0,0,1\n").contains("time_s: expected a finite number within"));
        assert!(complaint("0,,0,0,1\n").contains("sensor_id: expected a name"));
        assert!(complaint("2,1,0,0,1\n1,2,0,0,1\n").contains("row 2 (line 3): time_s: expected a time not before"));
        assert!(complaint("0,1,0,0\n").contains("range_m: expected a finite number from 0 to 1e6, got \"\""));
        assert!(complaint("0,1,0,0,1\n1,1,0,0,1\n").contains("row 2 (line 3): sensor_id: expected 2 to 256 different"));
        assert!(complaint("").contains("row 0 (line 1): sensor_id: expected 2 to 256 different"));
    }

    #[test]
    fn a_missing_column_is_named() {
        let error =
            Recording::parse("time_s,range_m\n".as_bytes(), Path::new("r.csv"), &ReadOptions::default()).unwrap_err();
        assert!(error.to_string().contains("expected a column sensor_id"), "{error}");
    }

    proptest! {
        #[test]
        fn no_bytes_make_it_panic(bytes in proptest::collection::vec(any::<u8>(), 0..400), headed in any::<bool>()) {
            let mut text = if headed { HEADER.as_bytes().to_vec() } else { Vec::new() };
            text.extend(bytes);
            let _ = Recording::parse(text.as_slice(), Path::new("r.csv"), &ReadOptions::default());
        }

        #[test]
        fn what_is_written_is_read(rows in proptest::collection::vec((0.0..10.0_f64, 0_u64..5, -9.0..9.0_f64, 0.0..9.0_f64), 2..50)) {
            let mut time_s = 0.0;
            let text: String = rows.iter().map(|(dt, id, x, range)| {
                time_s += dt;
                format!("{time_s},{id},{x},0,{range}\n")
            }).collect();
            if let Ok(recording) = parse(&text) {
                prop_assert_eq!(recording.readings.len(), rows.len());
                for (reading, (_, id, x, range)) in recording.readings.iter().zip(&rows) {
                    prop_assert_eq!(recording.sensors[reading.sensor].name.as_str(), id.to_string());
                    prop_assert_eq!((reading.position_m[0], reading.range_m), (*x, *range));
                }
            }
        }
    }
}
