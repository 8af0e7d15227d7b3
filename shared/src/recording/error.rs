//! Why a log was refused.

use std::fmt::Display;
use std::path::{Path, PathBuf};

/// Why a recording, an anchors file or a true track was refused. Displays as one line: what is wrong, in which file and
/// row, and what was expected.
#[derive(Debug, thiserror::Error)]
#[error("{}", .problem.in_file(.file))]
pub struct RecordingError {
    /// The file.
    pub file: PathBuf,
    /// The fault.
    pub problem: Box<Problem>,
}

/// A fault of a log.
#[derive(Debug)]
pub enum Problem {
    /// The file could not be opened or read: why, and what was expected.
    Unreadable(String),
    /// The roles of the header's columns are unclear.
    Header {
        /// The line of the file, counted from 1.
        line: u64,
        /// The problem.
        wrong: String,
        /// The expected contents, and the remedy.
        hint: String,
    },
    /// A row is wrong.
    Row {
        /// The data row, counted from 1.
        row: u64,
        /// The line of the file, counted from 1.
        line: u64,
        /// The fault of the row.
        complaint: Complaint,
    },
    /// A report of a radio's log cannot be used.
    Report(Complaint),
    /// So many rows are faulty that the file itself is.
    MostRowsBad {
        /// The first faulty row.
        first: String,
        /// Number of faulty rows.
        bad: u64,
        /// Number of rows.
        rows: u64,
    },
    /// The file has no line.
    Empty,
    /// A fault of the file itself.
    File {
        /// The problem.
        wrong: String,
        /// The expected contents, and the remedy.
        hint: String,
    },
}

impl Problem {
    pub(super) fn unreadable(error: &std::io::Error) -> Self {
        let is_missing = error.kind() == std::io::ErrorKind::NotFound;
        Self::Unreadable(format!(
            "{error}: {}",
            if is_missing { "expected the path of a file" } else { "expected a table" }
        ))
    }

    /// The message for a file.
    fn in_file(&self, file: &Path) -> String {
        let file = file.display();
        match self {
            Self::Unreadable(reason) => format!("cannot read {file}: {reason}"),
            Self::Header { line, wrong, hint } => format!("{wrong} in {file}, row 0 (line {line}, the header): {hint}"),
            Self::Row { row, line, complaint } => complaint.at(format_args!("{file}, row {row} (line {line})")),
            Self::Report(complaint) => complaint.at(file),
            Self::MostRowsBad { first, bad, rows } => {
                format!(
                    "{bad} of {rows} rows are bad in {file}: expected mostly valid rows; the first bad one: {first}"
                )
            }
            Self::Empty => format!("{file} is empty: expected a header that names the columns"),
            Self::File { wrong, hint } => format!("{wrong} in {file}: {hint}"),
        }
    }
}

/// A fault of a row's field.
#[derive(Debug, Clone, PartialEq, Eq)]
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

    /// The message for a field at this place.
    pub(super) fn at(&self, place: impl Display) -> String {
        let Self { column, expected, got } = self;
        format!("{column} is {got} in {place}: expected {expected}")
    }
}

impl RecordingError {
    pub(super) fn new(file: &Path, problem: Problem) -> Self {
        Self { file: file.to_owned(), problem: Box::new(problem) }
    }

    /// The file cannot be opened or read.
    #[must_use]
    pub fn unreadable(file: &Path, error: &std::io::Error) -> Self {
        Self::new(file, Problem::unreadable(error))
    }

    /// A fault of the file itself: what is wrong, and what was expected.
    #[must_use]
    pub fn of_file(file: &Path, wrong: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::new(file, Problem::File { wrong: wrong.into(), hint: hint.into() })
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
