//! Assigns roles to the columns of a header, from the user's options or the columns' names, never by a guess.

use std::io::Read;

use super::names::{Kind, Name};
use super::stamp;
use super::{ColumnMap, ColumnOption, Role};
use crate::recording::error::{RecordingError, listed, shown};
use crate::recording::table::Table;
use crate::recording::table::unit::{Unit, UnitKind};

/// A column to read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::recording) struct Column {
    pub(in crate::recording) index: usize,
    /// The column's unit, if it holds numbers.
    pub(in crate::recording) unit: Unit,
    /// The user gave the unit.
    pub(in crate::recording) is_chosen: bool,
}

/// Finds columns in a header, and collects questions to the user.
pub(in crate::recording) struct Finder<'a> {
    kind: Kind,
    header: Vec<String>,
    first_row: Vec<Vec<u8>>,
    map: &'a ColumnMap,
    used: Vec<bool>,
    /// Columns of unknown unit, each with the most likely unit.
    asks: Vec<ColumnOption>,
    read_as: Vec<String>,
}

impl<'a> Finder<'a> {
    pub(in crate::recording) fn new<R: Read>(kind: Kind, table: &Table<R>, map: &'a ColumnMap) -> Self {
        let header = table.header().to_vec();
        let first_row = table.first_row().map(|row| row.iter().map(<[u8]>::to_vec).collect()).unwrap_or_default();
        let used = vec![false; header.len()];
        Self { kind, header, first_row, map, used, asks: Vec::new(), read_as: Vec::new() }
    }

    /// The index of the column with a role: the user's choice, or else the column whose name fits.
    pub(in crate::recording) fn index<R: Read>(
        &self,
        role: Role,
        table: &Table<R>,
    ) -> Result<Option<usize>, RecordingError> {
        // A column number for the log does not apply to its anchors file.
        let is_of_log =
            |option: &&ColumnOption| self.kind == Kind::Anchors && role == Role::Sensor && option.is_by_number();
        if let Some(option) = self.map.get(role).filter(|option| !is_of_log(option)) {
            let found = self.chosen_index(&option.column);
            return match found {
                // An anchors file and its log often use different names for the sensor column.
                None if self.kind == Kind::Anchors && role == Role::Sensor => self.named_index(role, table),
                None => Err(table.header_error(
                    format!("--columns {option} names no column"),
                    format!("expected one of the columns {}", table.listed_columns()),
                )),
                found => Ok(found),
            };
        }
        self.named_index(role, table)
    }

    fn chosen_index(&self, column: &str) -> Option<usize> {
        let same = |name: &&String| name.as_str() == column;
        let alike = |name: &String| name.eq_ignore_ascii_case(column);
        let by_number = || column.parse::<usize>().ok().and_then(|number| number.checked_sub(1));
        let position = self.header.iter().position(|name| same(&name)).or_else(|| self.header.iter().position(alike));
        position.or_else(|| by_number().filter(|index| *index < self.header.len()))
    }

    fn named_index<R: Read>(&self, role: Role, table: &Table<R>) -> Result<Option<usize>, RecordingError> {
        let ranks: Vec<(usize, usize)> = self
            .header
            .iter()
            .enumerate()
            .filter(|(index, _)| !self.used[*index])
            .filter_map(|(index, name)| Some((self.kind.rank(role, name)?, index)))
            .collect();
        let Some(&(best, index)) = ranks.iter().min() else { return Ok(None) };
        let rivals: Vec<usize> = ranks.iter().filter(|(rank, _)| *rank == best).map(|(_, index)| *index).collect();
        if rivals.len() > 1 {
            let names = listed(rivals.iter().map(|index| self.header[*index].as_str()));
            let what = role.key();
            let option = ColumnOption { role, column: self.column_to_type(index), unit: None };
            let option = match self.unit_of(role, index) {
                Some(_) => option,
                None => ColumnOption { unit: self.likely_unit(role, index), ..option },
            };
            let hint = self.hint(&[option]);
            return Err(table.header_error(format!("several columns, {names}, that may be the {what},"), hint));
        }
        Ok(Some(index))
    }

    /// The option to type, or what to do if no option helps.
    fn hint(&self, options: &[ColumnOption]) -> String {
        if self.kind == Kind::Track {
            return "expected one of each: name the right ones time_s, x_m, y_m".to_owned();
        }
        format!("expected one: type {}, or the right one in its place", shown_line(&self.map.line_to_type(options)))
    }

    /// A column as it can stand in `--columns`.
    fn column_to_type(&self, index: usize) -> String {
        let name = &self.header[index];
        let is_plain =
            !name.is_empty() && name.len() <= 40 && !name.chars().any(|c| c.is_control() || ",='\"".contains(c));
        if is_plain { name.clone() } else { (index + 1).to_string() }
    }

    fn unit_of(&self, role: Role, index: usize) -> Option<Unit> {
        let is_stamp =
            role == Role::Time && self.first_row.get(index).is_some_and(|field| stamp::seconds(field).is_some());
        if is_stamp {
            return Some(Unit::Iso);
        }
        let unit = self.map.get(role).and_then(|option| option.unit);
        unit.or_else(|| Name::read(&self.header[index]).unit.filter(|unit| role.takes(*unit)))
    }

    fn likely_unit(&self, role: Role, index: usize) -> Option<Unit> {
        match role.measures()? {
            UnitKind::Time => {
                let field = self.first_row.get(index).map_or(&[][..], Vec::as_slice);
                let stamp = std::str::from_utf8(field).ok().and_then(|text| text.parse().ok()).unwrap_or(0.0);
                Some(unit_of_epoch(stamp).unwrap_or(Unit::Second))
            }
            UnitKind::Length => Some(Unit::Metre),
            UnitKind::Angle => Some(Unit::Radian),
        }
    }

    /// A column of text.
    pub(in crate::recording) fn text<R: Read>(
        &mut self,
        role: Role,
        table: &Table<R>,
    ) -> Result<Option<usize>, RecordingError> {
        let index = self.index(role, table)?;
        if let Some(index) = index {
            self.take(role, index, None);
        }
        Ok(index)
    }

    /// A column of numbers. If its unit is unknown, [`Self::finish`] asks for it.
    pub(in crate::recording) fn number<R: Read>(
        &mut self,
        role: Role,
        table: &Table<R>,
    ) -> Result<Option<Column>, RecordingError> {
        let Some(index) = self.index(role, table)? else { return Ok(None) };
        let unit = self.unit_of(role, index);
        self.take(role, index, unit);
        if unit.is_none() {
            let unit = self.likely_unit(role, index);
            self.asks.push(ColumnOption { role, column: self.column_to_type(index), unit });
        }
        let is_chosen = self.map.get(role).is_some_and(|option| option.unit.is_some());
        Ok(Some(Column { index, unit: unit.unwrap_or(Unit::Metre), is_chosen }))
    }

    /// Marks a column as read.
    pub(in crate::recording) fn take(&mut self, role: Role, index: usize, unit: Option<Unit>) {
        self.used[index] = true;
        let unit = unit.map(|unit| format!(" in {}", unit.symbol())).unwrap_or_default();
        self.read_as.push(format!("{} \"{}\"{unit}", role.key(), shown(&self.header[index])));
    }

    /// Asks for an unknown unit.
    pub(in crate::recording) fn ask(&mut self, option: ColumnOption) {
        self.asks.push(option);
    }

    pub(in crate::recording) fn header(&self) -> &[String] {
        &self.header
    }

    pub(in crate::recording) fn is_used(&self, index: usize) -> bool {
        self.used[index]
    }

    /// Refuses a table that lacks a required column.
    pub(in crate::recording) fn missing<R: Read>(
        &self,
        roles: &[Role],
        table: &Table<R>,
        hint: &str,
    ) -> RecordingError {
        let own: Vec<&str> = roles.iter().map(|role| self.kind.own_name(*role)).collect();
        let options: Vec<String> = roles.iter().map(|role| format!("{}=NAME", role.key())).collect();
        let other = if self.kind == Kind::Track {
            String::new()
        } else {
            format!("; if one of them is meant, type --columns {}{hint}", options.join(","))
        };
        let (columns, it) = if own.len() > 1 { ("columns", "them") } else { ("column", "it") };
        let wrong = format!("missing {columns} {}", own.join(" and "));
        table.header_error(wrong, format!("expected {it} among the columns {}{other}", table.listed_columns()))
    }

    /// The unused columns, and how the others are read.
    ///
    /// # Errors
    /// The error has the option to type if units are unknown.
    pub(in crate::recording) fn finish<R: Read>(
        self,
        table: &Table<R>,
    ) -> Result<(Vec<String>, String), RecordingError> {
        if !self.asks.is_empty() {
            let columns = listed(self.asks.iter().map(|option| option.column.as_str()));
            let of = if self.asks.len() > 1 { "units of the columns" } else { "unit of the column" };
            let units: Vec<&str> = UnitKind::ALL
                .into_iter()
                .filter(|kind| self.asks.iter().any(|option| option.role.measures() == Some(*kind)))
                .map(|kind| match kind {
                    UnitKind::Time => "s, ms, us, ns",
                    UnitKind::Length => "m, cm, mm",
                    UnitKind::Angle => "rad, deg",
                })
                .collect();
            let units = units.join("; ");
            let hint = if self.kind == Kind::Track {
                "expected a unit in each name, as in time_s, x_m, y_m".to_owned()
            } else {
                format!("expected units: type {}", shown_line(&self.map.line_to_type(&self.asks)))
            };
            return Err(
                table.header_error(format!("unknown {of} {columns}"), format!("{hint} with the right one of {units}"))
            );
        }
        let ignored = self.header.iter().zip(&self.used).filter(|(_, used)| !**used);
        let ignored = ignored.map(|(name, _)| if name.is_empty() { "(no name)".to_owned() } else { shown(name) });
        Ok((ignored.take(100).collect(), self.read_as.join(", ")))
    }
}

/// Limits a message's length: a truncated option is useless, but the message must end somewhere.
fn shown_line(line: &str) -> String {
    line.chars().filter(|c| !c.is_control()).take(250).collect()
}

/// The unit in which a stamp, as a time since 1970, falls into this century or the last.
pub(in crate::recording) fn unit_of_epoch(stamp: f64) -> Option<Unit> {
    match stamp.abs() {
        1e8..1e11 => Some(Unit::Second),
        1e11..1e14 => Some(Unit::Millisecond),
        1e14..1e17 => Some(Unit::Microsecond),
        1e17..1e20 => Some(Unit::Nanosecond),
        _ => None,
    }
}
