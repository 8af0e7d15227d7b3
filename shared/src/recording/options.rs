//! Options for reading a recording.

use super::anchors::Anchors;
use super::columns::ColumnMap;
use super::port::PortLog;

/// The user's options for a recording. By default everything is found in the file itself.
///
/// The default reads the run folder's copy, which [`Recording::write_csv`](super::Recording::write_csv) writes.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ReadOptions {
    /// Refuse the file at its first faulty row, instead of skipping and counting such rows (`--strict`).
    pub strict: bool,
    /// Role and unit of each column (`--columns`).
    pub columns: ColumnMap,
    /// Places of the sensors, for logs without them (`--anchors`). They take precedence over positions in the log.
    pub anchors: Option<Anchors>,
    /// The target to read, if a log has several (`--target`).
    pub target: Option<String>,
    /// The file is a log of a radio's port, not a table (`--format`).
    pub port: Option<PortLog>,
}
