//! The user's column options for a log.

pub(super) mod layout;
pub(super) mod names;
pub(super) mod stamp;

use crate::recording::table::unit::{Unit, UnitKind};

/// Roles of columns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    /// Time of the measurement.
    Time,
    /// The sensor that measured.
    Sensor,
    /// The range.
    Range,
    /// The sensor's x coordinate.
    X,
    /// The sensor's y coordinate.
    Y,
    /// The sensor's height.
    Z,
    /// The target that was measured.
    Target,
    /// The bearing.
    Bearing,
    /// The sensor's heading.
    Heading,
    /// Standard deviation of each coordinate of the sensor's place.
    PositionStd,
    /// Standard deviation of the sensor's heading.
    HeadingStd,
}

impl Role {
    /// Every role that a column of a log may have.
    pub(super) const ALL: [Self; 11] = [
        Self::Time,
        Self::Sensor,
        Self::Range,
        Self::X,
        Self::Y,
        Self::Z,
        Self::Target,
        Self::Bearing,
        Self::Heading,
        Self::PositionStd,
        Self::HeadingStd,
    ];

    /// The key of `--columns`.
    pub(super) fn key(self) -> &'static str {
        match self {
            Self::Time => "time",
            Self::Sensor => "sensor",
            Self::Range => "range",
            Self::X => "x",
            Self::Y => "y",
            Self::Z => "z",
            Self::Target => "target",
            Self::Bearing => "bearing",
            Self::Heading => "heading",
            Self::PositionStd => "position_std",
            Self::HeadingStd => "heading_std",
        }
    }

    /// The quantity of its numbers; `None` for a text.
    pub(super) fn measures(self) -> Option<UnitKind> {
        match self {
            Self::Time => Some(UnitKind::Time),
            Self::Range | Self::X | Self::Y | Self::Z | Self::PositionStd => Some(UnitKind::Length),
            Self::Bearing | Self::Heading | Self::HeadingStd => Some(UnitKind::Angle),
            Self::Sensor | Self::Target => None,
        }
    }

    /// True if the unit fits this role.
    pub(super) fn takes(self, unit: Unit) -> bool {
        self.measures() == Some(unit.kind())
    }
}

/// The user's column options: `time=stamp_ns:ns,sensor=anchor_id,range=dist:mm`.
///
/// Keys are `time`, `sensor`, `range`, `x`, `y`, `z` (the sensor's place), `target`, `bearing`, `heading` (the sensor's),
/// `position_std` and `heading_std`. A column is named as in the header, or by its number from 1. Units are `s`, `ms`, `us`,
/// `ns` and `iso` for time, `m`, `cm`, `mm` for lengths, `rad` and `deg` for angles.
/// In a wide log, which has a column for each anchor, `range` is all of them: `range=*:mm`, or `range=d_*:mm` where `*`
/// stands for the anchor's name.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ColumnMap {
    options: Vec<ColumnOption>,
}

/// The user's option for one column.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ColumnOption {
    pub(super) role: Role,
    pub(super) column: String,
    pub(super) unit: Option<Unit>,
}

/// Why a column option is invalid. Displays what was given and what was expected.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{got:?} is not valid: expected {expected}")]
pub struct ColumnMapError {
    pub(crate) expected: String,
    pub(crate) got: String,
}

impl ColumnMap {
    pub(super) fn get(&self, role: Role) -> Option<&ColumnOption> {
        self.options.iter().find(|option| option.role == role)
    }

    /// The column of a key, and its unit if that is given too.
    #[must_use]
    pub fn given(&self, key: &str) -> Option<(&str, Option<&'static str>)> {
        let option = self.options.iter().find(|option| option.role.key() == key)?;
        Some((&option.column, option.unit.map(Unit::symbol)))
    }

    /// True if all columns are given by number, as for a file without a header.
    pub(super) fn is_by_number(&self) -> bool {
        !self.options.is_empty() && self.options.iter().all(ColumnOption::is_by_number)
    }

    /// True if a column is given by name. Numbers do not count: a row of values may contain them.
    pub(super) fn names(&self, column: &str) -> bool {
        self.options.iter().any(|option| !option.is_by_number() && option.column.eq_ignore_ascii_case(column))
    }

    /// The option to type: the current options plus `more`.
    pub(super) fn line_to_type(&self, more: &[ColumnOption]) -> String {
        let replaced = |role| more.iter().any(|option| option.role == role);
        let all = self.options.iter().filter(|option| !replaced(option.role)).chain(more);
        let words: Vec<String> = all.map(ColumnOption::to_string).collect();
        let words = words.join(",");
        // A shell does not interpret these characters.
        let is_plain = words.chars().all(|c| c.is_alphanumeric() || "=:,._-".contains(c));
        if is_plain { format!("--columns {words}") } else { format!("--columns '{words}'") }
    }
}

impl ColumnOption {
    /// True if the column is given by number.
    pub(super) fn is_by_number(&self) -> bool {
        self.column.parse::<usize>().is_ok()
    }
}

impl std::fmt::Display for ColumnOption {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}={}", self.role.key(), self.column)?;
        self.unit.map_or(Ok(()), |unit| write!(f, ":{}", unit.symbol()))
    }
}

impl std::str::FromStr for ColumnMap {
    type Err = ColumnMapError;

    fn from_str(text: &str) -> Result<Self, ColumnMapError> {
        let mut options: Vec<ColumnOption> = Vec::new();
        for word in text.split(',') {
            let refuse =
                |expected: &str| ColumnMapError { expected: expected.to_owned(), got: word.chars().take(60).collect() };
            let (key, column) =
                word.split_once('=').ok_or_else(|| refuse("KEY=COLUMN[:UNIT],... as in time=stamp:ms"))?;
            let role = Role::ALL
                .into_iter()
                .find(|role| role.key() == key.trim())
                .ok_or_else(|| refuse(&format!("one of the keys {}", Role::ALL.map(Role::key).join(", "))))?;
            let (column, unit) = match (role.measures(), column.rsplit_once(':')) {
                (None, _) | (_, None) => (column, None),
                (Some(kind), Some((column, unit))) => {
                    let known = Unit::from_word(&unit.trim().to_lowercase()).filter(|unit| role.takes(*unit));
                    let units = match kind {
                        UnitKind::Time => "s, ms, us, ns or iso",
                        UnitKind::Length => "m, cm or mm",
                        UnitKind::Angle => "rad or deg",
                    };
                    let unit = known.ok_or_else(|| refuse(&format!("one of the units {units} after the colon")))?;
                    (column, Some(unit))
                }
            };
            let column = column.trim();
            if column.is_empty() || column.len() > 200 || column.chars().any(char::is_control) {
                return Err(refuse("the name of a column after \"=\""));
            }
            if options.iter().any(|before| before.role == role) {
                return Err(refuse("each key once"));
            }
            options.push(ColumnOption { role, column: column.to_owned(), unit });
        }
        Ok(Self { options })
    }
}

impl std::fmt::Display for ColumnMap {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let words: Vec<String> = self.options.iter().map(ColumnOption::to_string).collect();
        f.write_str(&words.join(","))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_given_by_key_name_and_unit() {
        let text = "time=stamp_ns:ns,sensor=anchor:id,range=dist:mm,x=3,bearing=aoa:deg,heading_std=8:rad";
        let map: ColumnMap = text.parse().unwrap();
        assert_eq!(map.to_string(), text);
        assert_eq!(map.get(Role::Sensor).unwrap().column, "anchor:id");
        assert_eq!(map.get(Role::Range).unwrap().unit, Some(Unit::Millimetre));
        assert_eq!(map.get(Role::Bearing).unwrap().unit, Some(Unit::Degree));
        assert!(map.get(Role::Y).is_none());
    }

    #[test]
    fn an_invalid_column_text_is_refused() {
        for (text, expected) in [
            ("", "KEY=COLUMN"),
            ("time", "KEY=COLUMN"),
            ("clock=t", "keys time, sensor"),
            ("time=t:m", "units s, ms"),
            ("range=d:ft", "units m, cm or mm"),
            ("range=d:", "units m, cm or mm"),
            ("bearing=b:m", "units rad or deg"),
            ("position_std=s:deg", "units m, cm or mm"),
            ("range=:mm", "name of a column"),
            ("x=a,x=b", "each key once"),
        ] {
            let error = text.parse::<ColumnMap>().unwrap_err().to_string();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }
}
