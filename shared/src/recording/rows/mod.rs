//! Reads a log of ranges and bearings row by row.

mod checks;
pub(super) mod gathering;
mod wide;

use std::f64::consts::{PI, TAU};
use std::io::Read;
use std::ops::RangeInclusive;
use std::path::Path;

use crate::recording::anchors::Anchors;
use crate::recording::columns::layout::{Column, Finder, unit_of_epoch};
use crate::recording::columns::names::Kind;
use crate::recording::columns::stamp;
use crate::recording::columns::{ColumnOption, Role};
use crate::recording::error::{Complaint, Problem, RecordingError, listed, quoted, shown};
use crate::recording::table::unit::Unit;
use crate::recording::table::{Row, Table};
use crate::recording::{ReadOptions, ReadSummary, RecordedMeasurement, Recording};
use gathering::{Gathering, Refusal};
use wide::AnchorColumn;

/// Largest coordinate, m: leaves room for map grids such as UTM.
const COORDINATE_MAX_M: f64 = 1e8;

/// Largest time stamp, s: three thousand years.
const TIME_MAX_S: f64 = 1e11;

/// Largest range, m; also the largest standard deviation of a place.
const RANGE_MAX_M: f64 = 1e6;

/// Angles, rad: more than two turns is probably degrees.
const ANGLES_RAD: RangeInclusive<f64> = -2.0 * TAU..=2.0 * TAU;

/// Standard deviations of a heading, rad.
const ANGLE_STDS_RAD: RangeInclusive<f64> = 0.0..=PI;

/// Most targets that a message names.
const TARGETS_MAX: usize = 64;

const A_TIME: &str = "a finite number within +-1e11";
const A_STAMP: &str = "seconds, or date and time by ISO 8601 as in 2024-05-01T12:00:00.5Z";
const A_COORDINATE: &str = "a finite number within +-1e8";
const A_RANGE: &str = "a finite number from 0 to 1e6";
const A_MEASUREMENT: &str = "a range, a bearing or both";
const AN_ANGLE: &str = "a finite angle of at most two turns";
const AN_ANGLE_STD: &str = "a finite angle from 0 to half a turn";

/// The columns of a row by role.
struct Layout {
    time: Column,
    target: Option<usize>,
    ranges: Ranges,
}

enum Ranges {
    /// One measurement a row. Boxed, because it is moved for each row.
    Long(Box<Long>),
    /// One column per anchor, with the anchor's number.
    Wide(Vec<(AnchorColumn, usize)>),
}

/// The columns of a measurement. One of range and bearing is there.
struct Long {
    sensor: usize,
    range: Option<Column>,
    bearing: Option<Column>,
    /// `None` if the places are those of the anchors.
    place: Option<Place>,
    heading: Option<Column>,
    position_std: Option<Column>,
    heading_std: Option<Column>,
}

struct Place {
    x: Column,
    y: Column,
    z: Option<Column>,
}

/// Why a row gives no measurement.
enum RowError {
    /// The row is skipped and counted.
    Bad(Complaint),
    /// The file is refused.
    Fatal(RecordingError),
}

impl From<RecordingError> for RowError {
    fn from(error: RecordingError) -> Self {
        Self::Fatal(error)
    }
}

/// Reads a log in a single pass.
pub(super) fn read<R: Read>(
    input: R,
    path: &Path,
    options: &ReadOptions,
) -> Result<(Recording, ReadSummary), RecordingError> {
    let ReadOptions { columns, anchors, .. } = options;
    let anchors = anchors.as_ref();
    let mut measured = [Role::Range, Role::Bearing].into_iter().filter_map(|role| columns.get(role));
    let is_wide = !measured.any(ColumnOption::is_by_number);
    let knows = |name: &str| {
        let is_anchor = is_wide && anchors.is_some_and(|anchors| wide::is_of_anchor(name, anchors, columns));
        Kind::Log.knows(name) || columns.names(name) || is_anchor
    };
    let table = Table::open(input, path, Some(columns.is_by_number()), &knows)?;
    let mut gathering = Gathering::new(anchors);
    let mut summary = ReadSummary::default();
    let layout = layout(&table, options, &mut gathering, &mut summary)?;
    let mut log = Log {
        table,
        layout,
        options,
        gathering,
        summary,
        targets: Vec::new(),
        is_target_found: false,
        last_time: (Vec::new(), 0.0),
    };
    log.read_rows()?;
    log.finish()
}

/// Finds the columns.
fn layout<R: Read>(
    table: &Table<R>,
    options: &ReadOptions,
    gathering: &mut Gathering<'_>,
    summary: &mut ReadSummary,
) -> Result<Layout, RecordingError> {
    let ReadOptions { columns, anchors, target: wanted, .. } = options;
    let mut finder = Finder::new(Kind::Log, table, columns);
    let Some(time) = finder.number(Role::Time, table)? else {
        return Err(finder.missing(&[Role::Time], table, ":UNIT"));
    };
    let target = finder.text(Role::Target, table)?;
    if wanted.is_some() && target.is_none() {
        return Err(finder.missing(&[Role::Target], table, ""));
    }
    let wide = wide_columns(&mut finder, table, options)?;
    let ranges = if wide.is_empty() {
        long_columns(&mut finder, table, anchors.as_ref())?
    } else {
        let number = |column: AnchorColumn| {
            let number = gathering.sensor(column.anchor.as_str().as_bytes());
            number
                .map(|number| (column, number))
                .map_err(|_| table.error("too many anchors", format!("expected at most {}", crate::ROBOTS_MAX)))
        };
        Ranges::Wide(wide.into_iter().map(number).collect::<Result<_, _>>()?)
    };
    (summary.ignored_columns, summary.read_as) = finder.finish(table)?;
    Ok(Layout { time, target, ranges })
}

/// The anchors' columns, if the log is a wide one.
fn wide_columns<R: Read>(
    finder: &mut Finder<'_>,
    table: &Table<R>,
    options: &ReadOptions,
) -> Result<Vec<AnchorColumn>, RecordingError> {
    let ReadOptions { columns, anchors, .. } = options;
    let is_chosen = wide::pattern(columns).is_some();
    let Some(anchors) = anchors else {
        if is_chosen {
            return Err(table.header_error("no places of the anchors", "expected --anchors FILE with them"));
        }
        return Ok(Vec::new());
    };
    // If several columns fit, ask only once the log is known not to be a wide one.
    let has = |role| finder.index(role, table).is_ok_and(|index| index.is_some());
    let has_measurement = has(Role::Range) || columns.get(Role::Bearing).is_some();
    if !is_chosen && has_measurement && has(Role::Sensor) {
        return Ok(Vec::new());
    }
    let found = wide::anchor_columns(finder, table, anchors, columns)?;
    if is_chosen && found.is_empty() {
        let names = listed(anchors.iter().map(|(name, _)| name.as_str()));
        let wrong = format!("no column has the name of an anchor ({names})");
        return Err(table.header_error(wrong, format!("expected one among the columns {}", table.listed_columns())));
    }
    Ok(found)
}

fn long_columns<R: Read>(
    finder: &mut Finder<'_>,
    table: &Table<R>,
    anchors: Option<&Anchors>,
) -> Result<Ranges, RecordingError> {
    let Some(sensor) = finder.text(Role::Sensor, table)? else {
        let hint = if anchors.is_none() {
            " (a log with a column for each anchor needs --anchors FILE)"
        } else {
            " (a log with a column for each anchor: --columns 'range=PREFIX_*:UNIT' with * for the anchor's name)"
        };
        return Err(finder.missing(&[Role::Sensor], table, hint));
    };
    let (range, bearing) = (finder.number(Role::Range, table)?, finder.number(Role::Bearing, table)?);
    if range.is_none() && bearing.is_none() {
        return Err(finder.missing(&[Role::Range], table, ":UNIT, or bearing=NAME:UNIT if it has bearings"));
    }
    let place = if anchors.is_some() {
        None
    } else {
        let (x, y) = (finder.number(Role::X, table)?, finder.number(Role::Y, table)?);
        let z = finder.number(Role::Z, table)?;
        let (Some(x), Some(y)) = (x, y) else {
            let hint = ":UNIT, or give the sensors' places by --anchors FILE (sensor_id,x_m,y_m)";
            return Err(finder.missing(&[Role::X, Role::Y], table, hint));
        };
        Some(Place { x, y, z })
    };
    let (heading, position_std) = (finder.number(Role::Heading, table)?, finder.number(Role::PositionStd, table)?);
    let heading_std = finder.number(Role::HeadingStd, table)?;
    Ok(Ranges::Long(Box::new(Long { sensor, range, bearing, place, heading, position_std, heading_std })))
}

/// A log that is being read.
struct Log<'a, R> {
    table: Table<R>,
    layout: Layout,
    options: &'a ReadOptions,
    gathering: Gathering<'a>,
    summary: ReadSummary,
    /// Names of the targets found.
    targets: Vec<String>,
    is_target_found: bool,
    /// The last stamp, as text and as a number: many rows have the same.
    last_time: (Vec<u8>, f64),
}

impl<R: Read> Log<'_, R> {
    fn read_rows(&mut self) -> Result<(), RecordingError> {
        while let Some(row) = self.table.next()? {
            let taken = match row {
                Row::Bad(complaint) => Err(RowError::Bad(complaint)),
                Row::Complete => self.take_row(),
            };
            match taken {
                Ok(()) => {}
                Err(RowError::Fatal(error)) => return Err(error),
                Err(RowError::Bad(complaint)) if self.options.strict => return Err(self.table.row_error(complaint)),
                Err(RowError::Bad(complaint)) => {
                    self.summary.bad_rows += 1;
                    if self.summary.first_bad_row.is_none() {
                        self.summary.first_bad_row = Some(self.table.row_message(&complaint));
                    }
                }
            }
        }
        Ok(())
    }

    fn take_row(&mut self) -> Result<(), RowError> {
        if !self.is_of_target() {
            self.summary.other_targets += 1;
            return Ok(());
        }
        let time_s = self.time_s()?;
        // Taken out, because the row is read through `self`.
        let ranges = std::mem::replace(&mut self.layout.ranges, Ranges::Wide(Vec::new()));
        let taken = match &ranges {
            Ranges::Long(columns) => self.take_long(time_s, columns),
            Ranges::Wide(columns) => self.take_wide(time_s, columns),
        };
        self.layout.ranges = ranges;
        taken
    }

    /// True if the row is of the requested target.
    fn is_of_target(&mut self) -> bool {
        let Some(index) = self.layout.target else { return true };
        let target = self.table.field(index);
        if let Some(wanted) = &self.options.target
            && wanted.trim().as_bytes() == target
        {
            self.is_target_found = true;
            return true;
        }
        let is_known = self.targets.iter().any(|known| known.as_bytes() == target);
        if !is_known && self.targets.len() < TARGETS_MAX {
            self.targets.push(String::from_utf8_lossy(target).into_owned());
        }
        self.options.target.is_none()
    }

    fn time_s(&mut self) -> Result<f64, RowError> {
        let Column { index, unit, is_chosen } = self.layout.time;
        if unit == Unit::Iso {
            let time_s = stamp::seconds(self.table.field(index));
            return time_s.ok_or_else(|| RowError::Bad(self.table.complaint(index, A_STAMP)));
        }
        if !self.last_time.0.is_empty() && self.last_time.0 == self.table.field(index) {
            return Ok(self.last_time.1);
        }
        let time_s = self.table.number(index, unit);
        if let Some(time_s) = time_s.filter(|time_s| time_s.abs() <= TIME_MAX_S) {
            self.last_time.0.clear();
            self.last_time.0.extend_from_slice(self.table.field(index));
            self.last_time.1 = time_s;
            return Ok(time_s);
        }
        let likely = time_s.and_then(unit_of_epoch).filter(|_| unit == Unit::Second && !is_chosen);
        if let Some(likely) = likely
            && self.gathering.len() == 0
        {
            let hint = self.hint(Role::Time, index, likely);
            let expected = format!("seconds; this looks like {} since 1970: {hint}", likely.symbol());
            return Err(RowError::Fatal(self.table.row_error(self.table.complaint(index, expected))));
        }
        let is_clock = self.table.field(index).contains(&b':');
        Err(RowError::Bad(self.table.complaint(index, if is_clock { A_STAMP } else { A_TIME })))
    }

    fn take_long(&mut self, time_s: f64, columns: &Long) -> Result<(), RowError> {
        let sensor = self.gathering.sensor(self.table.field(columns.sensor));
        let sensor = sensor.map_err(|refusal| self.fault(columns.sensor, refusal))?;
        let (position_m, height_m) = match &columns.place {
            Some(place) => {
                let height_m = self.filled(place.z).map(|z| self.coordinate_m(z)).transpose()?;
                ([self.coordinate_m(place.x)?, self.coordinate_m(place.y)?], height_m)
            }
            // Sensors without an anchor are reported together at the end.
            None => self.gathering.place(sensor).map_or(([0.0; 2], None), |place| (place.position_m, place.height_m)),
        };
        let bearing = self.filled(columns.bearing);
        // In a log of ranges alone, an empty range is a bad one.
        let range = if columns.bearing.is_some() { self.filled(columns.range) } else { columns.range };
        if let (None, None, Some(column)) = (range, bearing, columns.range.or(columns.bearing)) {
            return Err(RowError::Bad(self.table.complaint(column.index, A_MEASUREMENT)));
        }
        let range_m = range.map(|column| self.length_m(column)).transpose()?;
        let bearing_rad = bearing.map(|column| self.direction_rad(Role::Bearing, column)).transpose()?;
        let heading = self.filled(columns.heading);
        let heading_rad = heading.map(|column| self.direction_rad(Role::Heading, column)).transpose()?;
        let position_std_m = self.filled(columns.position_std).map(|column| self.length_m(column)).transpose()?;
        let heading_std = self.filled(columns.heading_std);
        let heading_std_rad = heading_std
            .map(|column| self.angle_rad(Role::HeadingStd, column, ANGLE_STDS_RAD, AN_ANGLE_STD))
            .transpose()?;
        let is_heard = range_m != Some(0.0);
        self.summary.not_heard += u64::from(!is_heard);
        let range_m = range_m.filter(|_| is_heard);
        if range_m.is_none() && bearing_rad.is_none() {
            return Ok(());
        }
        let measurement = RecordedMeasurement {
            sensor,
            position_m,
            height_m,
            range_m,
            bearing_rad,
            heading_rad,
            position_std_m,
            heading_std_rad,
        };
        self.push(time_s, measurement)
    }

    /// The column, if its field is not empty.
    fn filled(&self, column: Option<Column>) -> Option<Column> {
        column.filter(|column| !self.table.field(column.index).is_empty())
    }

    fn take_wide(&mut self, time_s: f64, columns: &[(AnchorColumn, usize)]) -> Result<(), RowError> {
        let mut first_fault = None;
        for (column, sensor) in columns {
            let Some(place) = self.gathering.place(*sensor) else { continue };
            let cell = Column { index: column.index, unit: column.unit, is_chosen: true };
            let field = self.table.field(cell.index);
            if is_nothing(field) {
                continue;
            }
            // Loggers write -1 if nothing was heard.
            let is_minus_one = field == b"-1" || field == b"-1.0";
            match self.range_m(cell) {
                Some(range_m) if range_m > 0.0 => {
                    let (position_m, height_m, range_m) = (place.position_m, place.height_m, Some(range_m));
                    let sensor = *sensor;
                    let range =
                        RecordedMeasurement { sensor, position_m, height_m, range_m, ..RecordedMeasurement::default() };
                    self.push(time_s, range)?;
                }
                None if !is_minus_one => {
                    first_fault.get_or_insert_with(|| RowError::Bad(self.table.complaint(cell.index, A_RANGE)));
                }
                _ => self.summary.not_heard += 1,
            }
        }
        first_fault.map_or(Ok(()), Err)
    }

    fn push(&mut self, time_s: f64, reading: RecordedMeasurement) -> Result<(), RowError> {
        self.gathering.push(time_s, reading).map_err(|refusal| self.fault(self.layout.time.index, refusal))
    }

    fn coordinate_m(&mut self, column: Column) -> Result<f64, RowError> {
        let value = self.table.number(column.index, column.unit).filter(|value| value.abs() <= COORDINATE_MAX_M);
        value.ok_or_else(|| RowError::Bad(self.table.complaint(column.index, A_COORDINATE)))
    }

    fn range_m(&mut self, column: Column) -> Option<f64> {
        self.table.number(column.index, column.unit).filter(|value| (0.0..=RANGE_MAX_M).contains(value))
    }

    /// A range, or the standard deviation of a place.
    fn length_m(&mut self, column: Column) -> Result<f64, RowError> {
        self.range_m(column).ok_or_else(|| RowError::Bad(self.table.complaint(column.index, A_RANGE)))
    }

    /// A bearing or a heading in (-pi, pi].
    fn direction_rad(&mut self, role: Role, column: Column) -> Result<f64, RowError> {
        self.angle_rad(role, column, ANGLES_RAD, AN_ANGLE).map(wrapped)
    }

    fn angle_rad(
        &mut self,
        role: Role,
        Column { index, unit, .. }: Column,
        allowed_rad: RangeInclusive<f64>,
        expected: &str,
    ) -> Result<f64, RowError> {
        let value = self.table.number(index, unit);
        match value {
            Some(value) if allowed_rad.contains(&value) => Ok(value),
            // Small angles in the same column would be misread, so that the file is refused.
            Some(value) if unit == Unit::Radian && allowed_rad.contains(&value.to_radians()) => {
                let hint = self.hint(role, index, Unit::Degree);
                let expected = format!("{expected}; if it is in degrees, {hint}");
                Err(RowError::Fatal(self.table.row_error(self.table.complaint(index, expected))))
            }
            _ => Err(RowError::Bad(self.table.complaint(index, expected))),
        }
    }

    fn fault(&self, index: usize, refusal: Refusal) -> RowError {
        match refusal {
            Refusal::NoName(expected) => RowError::Bad(self.table.complaint(index, expected)),
            Refusal::TooMany(expected) => RowError::Fatal(self.table.row_error(self.table.complaint(index, expected))),
            Refusal::NotInOrder(before_s) => {
                let expected = format!("a time not before the row above ({before_s}): sort the rows by time");
                RowError::Fatal(self.table.row_error(self.table.complaint(index, expected)))
            }
        }
    }

    /// The option to type if a column's unit is not the one in its name.
    fn hint(&self, role: Role, index: usize, unit: Unit) -> String {
        checks::line_to_type(&self.options.columns, role, self.table.header().get(index), index, unit)
    }

    fn finish(self) -> Result<(Recording, ReadSummary), RecordingError> {
        self.check_targets()?;
        let Self { table, layout, options, gathering, mut summary, .. } = self;
        let rows = table.rows();
        if summary.bad_rows * 2 > rows
            && let Some(first) = summary.first_bad_row
        {
            let problem = Problem::MostRowsBad { first, bad: summary.bad_rows, rows };
            return Err(RecordingError::new(table.path(), problem));
        }
        if !gathering.unplaced.is_empty() {
            let names = listed(gathering.unplaced.iter().map(crate::recording::SensorName::as_str));
            let file = options.anchors.as_ref().map(|anchors| anchors.file().display().to_string()).unwrap_or_default();
            let wrong = format!("sensors without a place, {names},");
            return Err(table.error(wrong, format!("expected a row for every sensor in {}", shown(&file))));
        }
        if gathering.len() == 0 && summary.not_heard > 0 {
            let hint = format!("expected ranges, but all {} are 0 or mean that nothing was heard", summary.not_heard);
            return Err(table.error("no range", hint));
        }
        if table.rows() == 0 {
            return Err(table.header_error("no row", "expected rows of ranges under the header"));
        }
        if gathering.len() == 0 {
            let expected = format!("1 to {} different sensors up to this last row", crate::ROBOTS_MAX);
            let complaint = Complaint { column: "sensor_id".to_owned(), expected, got: "missing".to_owned() };
            return Err(table.row_error(complaint));
        }
        summary.read_as = format!("{}; {}", table.dialect(), summary.read_as);
        summary.silent_anchors = gathering.silent_anchors();
        let (recording, repeats) = gathering.finish();
        summary.repeats = repeats;
        summary.rows = recording.readings.len() as u64;
        let (range, are_ranges_in_m) = match &layout.ranges {
            Ranges::Long(columns) => {
                let range = columns.range;
                (range.map(|range| range.index), range.is_some_and(|range| range.unit == Unit::Metre))
            }
            Ranges::Wide(columns) => (None, columns.iter().all(|(column, _)| column.unit == Unit::Metre)),
        };
        let names = table.header();
        let columns = checks::Columns {
            map: &options.columns,
            time: (layout.time.index, names.get(layout.time.index)),
            range: range.map(|index| (index, names.get(index))),
            are_ranges_in_m,
            are_placed_by_rows: options.anchors.is_none(),
            time_unit: layout.time.unit,
        };
        summary.doubts = checks::doubts(&recording, &columns);
        Ok((recording, summary))
    }

    /// A recording has one target.
    fn check_targets(&self) -> Result<(), RecordingError> {
        let Some(index) = self.layout.target else { return Ok(()) };
        let column = self.table.header().get(index).map_or("", String::as_str);
        let names = listed(self.targets.iter().map(String::as_str));
        match &self.options.target {
            None if self.targets.len() > 1 => Err(self.table.error(
                format!("several targets, {names}, in column {}", shown(column)),
                "expected one target: type --target NAME for one of them",
            )),
            Some(wanted) if !self.is_target_found => Err(self.table.error(
                format!("no target {} (--target)", quoted(wanted)),
                format!("expected one of the targets of column {}: {names}", shown(column)),
            )),
            _ => Ok(()),
        }
    }
}

/// The same angle in (-pi, pi].
fn wrapped(angle_rad: f64) -> f64 {
    if -PI < angle_rad && angle_rad <= PI {
        // To the last bit, so that a copy is the same.
        return angle_rad;
    }
    let turned_rad = angle_rad.rem_euclid(TAU);
    // Minus zero becomes zero, as in all numbers of a recording.
    if turned_rad > PI { turned_rad - TAU } else { turned_rad + 0.0 }
}

/// Texts that loggers write for a missing number.
fn is_nothing(field: &[u8]) -> bool {
    ["", "nan", "-", "null", "none", "na", "n/a", "inf"].iter().any(|word| field.eq_ignore_ascii_case(word.as_bytes()))
}
