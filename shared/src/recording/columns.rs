//! Which column of a log is what.

/// What the user says of a log's columns: `time=stamp_ns:ns,sensor=anchor_id,range=dist:mm`.
///
/// Keys are `time`, `sensor`, `range`, `x`, `y`, `z` (the sensor's place) and `target`. A column is named as in the
/// header, or by its number from 1. Units are `s`, `ms`, `us`, `ns` and `iso` for time, `m`, `cm`, `mm` for lengths.
/// In a wide log `range` names all anchors' columns at once: `range=*:mm`, or `range=d_*:mm` with `*` for the anchor.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ColumnMap {}

/// Why a text says nothing of columns.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct ColumnMapError(String);

impl std::str::FromStr for ColumnMap {
    type Err = ColumnMapError;

    fn from_str(_text: &str) -> Result<Self, ColumnMapError> {
        Ok(Self {})
    }
}
