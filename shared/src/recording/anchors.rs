//! Places of sensors, from an anchors file.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};

use super::columns::layout::{Column, Finder};
use super::columns::names::Kind;
use super::columns::{ColumnMap, Role};
use super::table::{Row, Table};
use super::{RecordingError, SensorName};
use crate::ROBOTS_MAX;

/// Most anchors of a site: a log may cover only some of them.
const ANCHORS_MAX: usize = 64 * ROBOTS_MAX;

/// Largest coordinate, m: as in recordings.
const COORDINATE_MAX_M: f64 = 1e8;

/// The anchors of a site: `sensor_id,x_m,y_m[,z_m]`, in any table form that a recording may have.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Anchors {
    file: PathBuf,
    by_name: BTreeMap<SensorName, Anchor>,
}

/// Place of one anchor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Anchor {
    /// Its place, m.
    pub position_m: [f64; 2],
    /// Its height, m; `None` if the file has no heights.
    pub height_m: Option<f64>,
}

impl Anchors {
    /// Parses an anchors file; `path` names it in errors. Of the user's columns, it uses `x`, `y` and `z`, and `sensor` if
    /// the file has that column.
    ///
    /// # Errors
    /// [`RecordingError`] for the first fault.
    pub fn parse(input: impl Read, path: &Path, columns: &ColumnMap) -> Result<Self, RecordingError> {
        let knows = |name: &str| Kind::Anchors.knows(name) || columns.names(name);
        let mut table = Table::open(input, path, None, &knows)?;
        let mut finder = Finder::new(Kind::Anchors, &table, columns);
        let sensor = finder.text(Role::Sensor, &table)?;
        let (x, y, z) =
            (finder.number(Role::X, &table)?, finder.number(Role::Y, &table)?, finder.number(Role::Z, &table)?);
        let Some(sensor) = sensor else { return Err(finder.missing(&[Role::Sensor], &table, "")) };
        let (Some(x), Some(y)) = (x, y) else {
            return Err(finder.missing(&[Role::X, Role::Y], &table, ":UNIT"));
        };
        finder.finish(&table)?;
        let mut by_name = BTreeMap::new();
        while let Some(row) = table.next()? {
            if let Row::Bad(complaint) = row {
                return Err(table.row_error(complaint));
            }
            let name = std::str::from_utf8(table.field(sensor)).ok().and_then(|text| text.parse::<SensorName>().ok());
            let Some(name) = name else {
                let expected = super::name::SensorNameError.to_string();
                return Err(table.row_error(table.complaint(sensor, expected)));
            };
            let height_m = match z {
                Some(z) if !table.field(z.index).is_empty() => Some(coordinate_m(&mut table, z)?),
                _ => None,
            };
            let position_m = [coordinate_m(&mut table, x)?, coordinate_m(&mut table, y)?];
            let anchor = Anchor { position_m, height_m };
            if by_name.insert(name, anchor).is_some_and(|before| before != anchor) {
                return Err(table.row_error(table.complaint(sensor, "each anchor at one place")));
            }
            if by_name.len() > ANCHORS_MAX {
                return Err(table.error("too many anchors", format!("expected at most {ANCHORS_MAX}")));
            }
        }
        if by_name.is_empty() {
            return Err(table.error("no row", "expected a row for each anchor"));
        }
        Ok(Self { file: path.to_owned(), by_name })
    }

    /// Place of an anchor.
    #[must_use]
    pub fn get(&self, name: &SensorName) -> Option<Anchor> {
        self.by_name.get(name).copied()
    }

    /// The anchors by name.
    pub fn iter(&self) -> impl Iterator<Item = (&SensorName, &Anchor)> {
        self.by_name.iter()
    }

    /// Path of the anchors file.
    #[must_use]
    pub fn file(&self) -> &Path {
        &self.file
    }
}

fn coordinate_m<R: Read>(table: &mut Table<R>, column: Column) -> Result<f64, RecordingError> {
    let value = table.number(column.index, column.unit).filter(|value| value.abs() <= COORDINATE_MAX_M);
    value.ok_or_else(|| table.row_error(table.complaint(column.index, "a finite number within +-1e8")))
}
