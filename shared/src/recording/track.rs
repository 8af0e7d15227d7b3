//! Tracks from other sources, such as the true one: `time_s,x_m,y_m` in any table form that a recording may have.

use std::io::Read;
use std::path::Path;

use super::RecordingError;
use super::columns::layout::Finder;
use super::columns::names::Kind;
use super::columns::stamp;
use super::columns::{ColumnMap, Role};
use super::table::unit::Unit;
use super::table::{Row, Table};

/// Most rows.
const ROWS_MAX: usize = 10_000_000;

/// Largest number.
const NUMBER_MAX: f64 = 1e11;

/// The target's place at a time, s and m.
pub type TrackPoint = (f64, [f64; 2]);

/// Parses a track, in order of time; `path` names it in errors.
///
/// # Errors
/// [`RecordingError`] for the first fault.
pub fn parse_track(input: impl Read, path: &Path) -> Result<Vec<TrackPoint>, RecordingError> {
    let map = ColumnMap::default();
    let mut table = Table::open(input, path, None, &|name| Kind::Track.knows(name))?;
    let mut finder = Finder::new(Kind::Track, &table, &map);
    let mut column =
        |role| finder.number(role, &table)?.ok_or_else(|| finder.missing(&[Role::Time, Role::X, Role::Y], &table, ""));
    let columns = [column(Role::Time)?, column(Role::X)?, column(Role::Y)?];
    finder.finish(&table)?;
    let mut points: Vec<TrackPoint> = Vec::new();
    while let Some(row) = table.next()? {
        if let Row::Bad(complaint) = row {
            return Err(table.row_error(complaint));
        }
        let mut numbers = [0.0; 3];
        for (number, column) in numbers.iter_mut().zip(columns) {
            let value = match column.unit {
                Unit::Iso => stamp::seconds(table.field(column.index)),
                unit => table.number(column.index, unit),
            };
            *number = value
                .filter(|value| value.abs() <= NUMBER_MAX)
                .ok_or_else(|| table.row_error(table.complaint(column.index, "a finite number within +-1e11")))?;
        }
        let [time_s, x_m, y_m] = numbers;
        if let Some((before_s, _)) = points.last().filter(|(before_s, _)| time_s < *before_s) {
            let expected = format!("a time not before the row above ({before_s})");
            return Err(table.row_error(table.complaint(columns[0].index, expected)));
        }
        if points.len() == ROWS_MAX {
            return Err(table.error("too many rows", format!("expected at most {ROWS_MAX}")));
        }
        points.push((time_s, [x_m, y_m]));
    }
    if points.len() < 2 {
        return Err(table.error("fewer than two rows", "expected two or more"));
    }
    Ok(points)
}
