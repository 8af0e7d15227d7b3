//! Why a log was refused.

use std::path::{Path, PathBuf};

/// Why a recording, an anchors file or a true track was refused. Displays as one line with file, row, column, what was
/// expected and, if known, what to do.
#[derive(Debug, thiserror::Error)]
#[error("{}: {problem}", .file.display())]
pub struct RecordingError {
    /// The file.
    pub file: PathBuf,
    /// The fault.
    pub problem: Box<Problem>,
}

/// A fault of a log.
#[derive(Debug, thiserror::Error)]
pub enum Problem {
    /// The file could not be opened or read.
    #[error("expected a table that can be read: {0}")]
    Unreadable(String),
    /// The roles of the header's columns are unclear.
    #[error("row 0 (line {line}, the header): {text}")]
    Header {
        /// The line of the file, counted from 1.
        line: u64,
        /// What was expected, and what to do.
        text: String,
    },
    /// A row is wrong.
    #[error("row {row} (line {line}): {complaint}")]
    Row {
        /// The data row, counted from 1.
        row: u64,
        /// The line of the file, counted from 1.
        line: u64,
        /// The fault of the row.
        complaint: Complaint,
    },
    /// So many rows are faulty that the file itself is.
    #[error("{first}; {bad} of {rows} rows are bad")]
    MostRowsBad {
        /// The first faulty row.
        first: String,
        /// Number of faulty rows.
        bad: u64,
        /// Number of rows.
        rows: u64,
    },
    /// A fault of the file itself.
    #[error("{0}")]
    File(String),
}

/// A fault of a row's field.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{column}: expected {expected}, got {got}")]
pub struct Complaint {
    /// The column's name.
    pub column: String,
    /// The expected value.
    pub expected: String,
    /// The value found.
    pub got: String,
}

impl Complaint {
    pub(super) fn new(column: &str, expected: impl Into<String>, got: &[u8]) -> Self {
        Self { column: shown(column), expected: expected.into(), got: quoted(&String::from_utf8_lossy(got)) }
    }
}

impl RecordingError {
    pub(super) fn new(file: &Path, problem: Problem) -> Self {
        Self { file: file.to_owned(), problem: Box::new(problem) }
    }

    /// The file cannot be opened or read.
    #[must_use]
    pub fn unreadable(file: &Path, error: &std::io::Error) -> Self {
        Self::new(file, Problem::Unreadable(error.to_string()))
    }

    pub(super) fn whole(file: &Path, text: impl Into<String>) -> Self {
        Self::new(file, Problem::File(text.into()))
    }
}

/// A text from a file, short and on one line: a damaged file may contain anything.
pub(super) fn shown(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).take(40).collect()
}

/// A text from a file in quotes, short and on one line.
pub(super) fn quoted(text: &str) -> String {
    let short: String = text.chars().take(40).collect();
    // Escapes may turn one character into ten.
    format!("{short:?}").chars().take(100).collect()
}

/// The first of several texts, in quotes.
pub(super) fn listed<'a>(texts: impl IntoIterator<Item = &'a str>) -> String {
    const SHOWN: usize = 8;
    let mut texts = texts.into_iter();
    let mut list: Vec<String> = texts.by_ref().take(SHOWN).map(|text| format!("\"{}\"", shorter(text))).collect();
    let more = texts.count();
    if more > 0 {
        list.push(format!("{more} more"));
    }
    list.join(", ")
}

fn shorter(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).take(24).collect()
}
