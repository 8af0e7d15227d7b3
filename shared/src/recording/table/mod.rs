//! A table from a logger or a person: finds its header, and its separator from the header and the first rows.

mod dialect;
mod lines;
pub(super) mod unit;

use std::collections::VecDeque;
use std::io::Read;
use std::path::{Path, PathBuf};

use crate::recording::error::{Complaint, Problem, RecordingError, listed, quoted, shown};
use dialect::{Fields, Numbers, Separator};
use lines::{Lines, Refused};
use unit::Unit;

/// Rows examined to find the separator.
const LOOK_AHEAD: usize = 5;

/// Comment lines that may be the header.
const COMMENTS_KEPT: usize = 32;

/// A table that is read row by row.
pub(super) struct Table<R> {
    path: PathBuf,
    lines: Lines<R>,
    pending: VecDeque<(u64, Vec<u8>)>,
    separator: Separator,
    numbers: Numbers,
    header: Vec<String>,
    header_line: u64,
    fields: Fields,
    row: u64,
    line: u64,
}

/// A row of a table.
pub(super) enum Row {
    /// The row has as many fields as the header.
    Complete,
    /// The row has more or fewer fields, or they cannot be separated.
    Bad(Complaint),
}

impl<R: Read> Table<R> {
    /// Finds the header: the first line, or a comment above it. `knows` tests for known names. If the columns are
    /// given `by_number`, the header is optional. `None` if the fields cannot be separated.
    pub(super) fn open(
        input: R,
        path: &Path,
        by_number: Option<bool>,
        knows: &dyn Fn(&str) -> bool,
    ) -> Result<Self, RecordingError> {
        let mut table = Self {
            path: path.to_owned(),
            lines: Lines::new(input),
            pending: VecDeque::new(),
            separator: Separator::Comma,
            numbers: Numbers::default(),
            header: Vec::new(),
            header_line: 1,
            fields: Fields::default(),
            row: 0,
            line: 0,
        };
        let mut comments = VecDeque::new();
        let mut separators = Separator::ALL.to_vec();
        let mut line = Vec::new();
        while table.pending.len() <= LOOK_AHEAD && table.read_line(&mut line)? {
            let number = table.lines.number();
            if let Some(comment) = dialect::comment(&line) {
                if table.pending.is_empty() {
                    comments.truncate(COMMENTS_KEPT - 1);
                    comments.push_front((number, comment.to_vec()));
                }
            } else if let [b's', b'e', b'p', b'=', byte] = line[..]
                && let Some(separator) = Separator::from_byte(byte)
                && table.pending.is_empty()
            {
                // Spreadsheets write such a line.
                separators = vec![separator];
            } else {
                table.pending.push_back((number, line.clone()));
            }
        }
        let (separator, known) =
            table.best_separator(&separators, table.pending.front().map(|(_, line)| &line[..]), knows);
        let in_comment = comments.iter().find_map(|(number, comment)| {
            let (separator, known) = table.best_separator(&separators, Some(comment), knows);
            Some((*number, comment, separator, known)).filter(|_| known >= 2)
        });
        match in_comment {
            Some((number, comment, separator, in_comment)) if in_comment > known => {
                table.separator = separator;
                (table.header_line, table.header) = (number, names_of(&Fields::of(comment, separator)));
            }
            _ => {
                table.separator = separator;
                table.take_header(known, by_number, !comments.is_empty())?;
            }
        }
        Ok(table)
    }

    /// Takes the first line as the header, unless the file has none.
    fn take_header(&mut self, known: usize, by_number: Option<bool>, has_comments: bool) -> Result<(), RecordingError> {
        let Some((number, line)) = self.pending.pop_front() else {
            return Err(if has_comments {
                self.error("only comments", "expected a header that names the columns")
            } else {
                RecordingError::new(&self.path, Problem::Empty)
            });
        };
        (self.header_line, self.line) = (number, number);
        let fields = Fields::of(&line, self.separator);
        if known == 0
            && let Some(format) = radio_of(&line)
        {
            let hint = format!(
                "expected a header that names the columns; for a log of a radio's port, type --format {format}"
            );
            return Err(self.header_error("a line of a radio", hint));
        }
        let is_data =
            known == 0 && (0..fields.len()).any(|index| self.numbers.read(fields.get(index), Unit::Metre).is_some());
        self.numbers = Numbers::default();
        if !is_data {
            self.header = names_of(&fields);
        } else if by_number == Some(true) {
            self.header = (1..=fields.len()).map(|number| number.to_string()).collect();
            self.pending.push_front((number, line));
        } else {
            let or = match by_number {
                Some(_) => "; or give the columns by number, as in --columns time=1:s,sensor=2,range=3:m",
                None => "",
            };
            let values = format!("values instead of names, {},", quoted(&String::from_utf8_lossy(&line)));
            return Err(self.header_error(values, format!("expected a header that names the columns{or}")));
        }
        Ok(())
    }

    /// The separator that gives the header the most known names, and then most often rows of the header's length;
    /// and the number of known names.
    fn best_separator(
        &self,
        separators: &[Separator],
        header: Option<&[u8]>,
        knows: &dyn Fn(&str) -> bool,
    ) -> (Separator, usize) {
        let mut best = (Separator::Comma, (0, 0, false));
        for &separator in separators {
            let names = names_of(&Fields::of(header.unwrap_or_default(), separator));
            let known = names.iter().filter(|name| knows(name)).count();
            let fits = |(_, line): &&(u64, Vec<u8>)| Fields::of(line, separator).len() == names.len();
            let score = (known, self.pending.iter().filter(fits).count(), names.len() > 1);
            if score > best.1 || best.1 == (0, 0, false) {
                best = (separator, score);
            }
        }
        (best.0, best.1.0)
    }

    /// Reads the next line that is not empty.
    fn read_line(&mut self, line: &mut Vec<u8>) -> Result<bool, RecordingError> {
        loop {
            let is_read = self.lines.read(line).map_err(|error| match error.get_ref() {
                Some(refused) if refused.is::<Refused>() => {
                    RecordingError::new(&self.path, Problem::Unreadable(refused.to_string()))
                }
                _ => RecordingError::unreadable(&self.path, &error),
            })?;
            if !is_read {
                return Ok(false);
            }
            if !dialect::is_empty(line) {
                return Ok(true);
            }
        }
    }

    /// Reads the next row; `None` at the end.
    ///
    /// # Errors
    /// If a row has more fields than the header, columns have shifted and their roles are unknown.
    pub(super) fn next(&mut self) -> Result<Option<Row>, RecordingError> {
        loop {
            if let Some((number, line)) = self.pending.pop_front() {
                (self.line, self.fields.line) = (number, line);
            } else {
                let mut line = std::mem::take(&mut self.fields.line);
                if !self.read_line(&mut line)? {
                    return Ok(None);
                }
                (self.line, self.fields.line) = (self.lines.number(), line);
            }
            if dialect::comment(&self.fields.line).is_none() {
                break;
            }
        }
        self.row += 1;
        if !self.fields.split(self.separator) {
            let expected = "fields with a quote at both ends or at none";
            return Ok(Some(Row::Bad(Complaint::new("the row", expected, &self.fields.line))));
        }
        let (count, width) = (self.fields.len(), self.header.len());
        if count > width {
            if (width..count).any(|index| !self.fields.get(index).is_empty()) {
                return Err(self.surplus());
            }
            self.fields.truncate(width);
        }
        if count < width {
            let column = &self.header[count];
            let expected = format!("{width} fields as in the header");
            let got = format!("missing, the row has {count} fields,");
            return Ok(Some(Row::Bad(Complaint { column: shown(column), expected, got })));
        }
        Ok(Some(Row::Complete))
    }

    fn surplus(&self) -> RecordingError {
        let (count, width) = (self.fields.len(), self.header.len());
        let is_number = |field: &&[u8]| Numbers::default().read(field, Unit::Metre).is_some();
        let texts = count - self.fields.iter().filter(is_number).count();
        let cause = if self.separator == Separator::Comma && texts <= 1 {
            "probably decimal commas in a file whose columns are separated by commas: write decimal points, or separate \
             the columns by semicolons"
        } else {
            "the columns have shifted: put fields that contain a separator in quotes, and name every column in the header"
        };
        let complaint = Complaint {
            column: "the row".to_owned(),
            expected: format!("{width} fields as in the header; {cause}"),
            got: format!("{count} fields long"),
        };
        self.row_error(complaint)
    }

    /// Path of the file.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// The names of the columns.
    pub(super) fn header(&self) -> &[String] {
        &self.header
    }

    /// The first row, before it is read.
    pub(super) fn first_row(&self) -> Option<Fields> {
        self.pending.front().map(|(_, line)| Fields::of(line, self.separator))
    }

    /// A field of the last row read.
    pub(super) fn field(&self, index: usize) -> &[u8] {
        self.fields.get(index)
    }

    /// A number of the last row read, in seconds, metres or radians.
    pub(super) fn number(&mut self, index: usize, unit: Unit) -> Option<f64> {
        self.numbers.read(self.fields.get(index), unit)
    }

    /// Number of rows read.
    pub(super) fn rows(&self) -> u64 {
        self.row
    }

    /// Column separator and decimal mark, for display.
    pub(super) fn dialect(&self) -> String {
        let commas = if self.numbers.has_decimal_commas() { ", decimal commas" } else { "" };
        format!("separated by {}{commas}", self.separator.plural())
    }

    /// A complaint about a field of the last row read.
    pub(super) fn complaint(&self, index: usize, expected: impl Into<String>) -> Complaint {
        let (field, mut expected) = (self.field(index), expected.into());
        if field.contains(&b'.') && field.contains(&b',') {
            expected.push_str(" without thousands separators");
        } else if self.numbers.is_other_mark(field) {
            expected.push_str(" with the decimal mark of the rows above");
        }
        match self.header.get(index) {
            Some(name) if !name.is_empty() => Complaint::new(name, expected, field),
            _ => Complaint::new(&format!("column {}", index + 1), expected, field),
        }
    }

    /// Refuses the file because of the last row read.
    pub(super) fn row_error(&self, complaint: Complaint) -> RecordingError {
        RecordingError::new(&self.path, Problem::Row { row: self.row, line: self.line, complaint })
    }

    /// The message for the last row read, without the file's name.
    pub(super) fn row_message(&self, complaint: &Complaint) -> String {
        complaint.at(format_args!("row {} (line {})", self.row, self.line))
    }

    /// Refuses the file because of its header.
    pub(super) fn header_error(&self, wrong: impl Into<String>, hint: impl Into<String>) -> RecordingError {
        let (line, wrong, hint) = (self.header_line, wrong.into(), hint.into());
        RecordingError::new(&self.path, Problem::Header { line, wrong, hint })
    }

    /// Refuses the file for a fault without a row.
    pub(super) fn error(&self, wrong: impl Into<String>, hint: impl Into<String>) -> RecordingError {
        RecordingError::of_file(&self.path, wrong, hint)
    }

    /// The columns of the file, for display.
    pub(super) fn listed_columns(&self) -> String {
        listed(self.header.iter().map(String::as_str))
    }
}

/// The radio format that a line resembles.
fn radio_of(line: &[u8]) -> Option<&'static str> {
    let has = |word: &[u8]| line.windows(word.len()).any(|window| window == word);
    if has(b"DIST,") || has(b"]=") {
        Some("dwm1001")
    } else if has(b"AT+RANGE") {
        Some("mauwb")
    } else {
        has(b"\x55\x05").then_some("linktrack")
    }
}

/// The names of a header. A separator at its end adds no name.
fn names_of(fields: &Fields) -> Vec<String> {
    let mut names: Vec<String> = fields.iter().map(|field| String::from_utf8_lossy(field).into_owned()).collect();
    while names.len() > 1 && names.last().is_some_and(String::is_empty) {
        names.pop();
    }
    names
}
