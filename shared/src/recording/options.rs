//! How a recording is to be read.

use super::anchors::Anchors;
use super::columns::ColumnMap;
use super::port::PortLog;

/// What the user says of a recording's form. The default finds everything in the file itself.
///
/// The run folder's copy, which [`Recording::write_csv`](super::Recording::write_csv) writes, is read by the default.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ReadOptions {
    /// Refuse the file at its first bad row, rather than pass the row over and count it (`--strict`).
    pub strict: bool,
    /// Which column is what, and in which unit (`--columns`).
    pub columns: ColumnMap,
    /// Where the sensors stand, for logs that do not say (`--anchors`). They go before positions in the log itself.
    pub anchors: Option<Anchors>,
    /// The one target to read, of a log of several (`--target`).
    pub target: Option<String>,
    /// The log is one of a radio's port rather than a table (`--format`).
    pub port: Option<PortLog>,
}
