//! The text of a table, made as it is read.

use std::fmt::Write as _;
use std::io::Read;

use super::{BagTable, Row};

/// Bytes made at once.
const CHUNK: usize = 1 << 16;

/// Reads a table as text.
pub(super) struct Text<'a> {
    table: &'a BagTable,
    /// The next row; `None` before the header.
    next: Option<usize>,
    made: String,
    taken: usize,
}

impl<'a> Text<'a> {
    pub(super) fn of(table: &'a BagTable) -> Self {
        Self { table, next: None, made: String::new(), taken: 0 }
    }

    /// Makes the next lines.
    fn make(&mut self) {
        self.made.clear();
        self.taken = 0;
        let BagTable { rows, names, numbers, .. } = self.table;
        let mut next = self.next.unwrap_or_else(|| {
            let names = names.iter().filter(|name| !name.is_empty()).chain(numbers.iter().map(|(_, name)| name));
            self.made.push_str(&names.map(|name| field(name)).collect::<Vec<_>>().join(","));
            self.made.push('\n');
            0
        });
        while let Some(row) = rows.get(next)
            && self.made.len() < CHUNK
        {
            self.push(row);
            next += 1;
        }
        self.next = Some(next);
    }

    fn push(&mut self, row: &Row) {
        let Self { table: BagTable { sensors, targets, names, numbers, .. }, made, .. } = self;
        let (sign, time_ns) = (if row.time_ns < 0 { "-" } else { "" }, row.time_ns.unsigned_abs());
        // A write to a string cannot fail.
        let _ = write!(made, "{sign}{}.{:09}", time_ns / 1_000_000_000, time_ns % 1_000_000_000);
        let text = |texts: &[String], number: u32| field(texts.get(number as usize).map_or("", String::as_str));
        let _ = write!(made, ",{}", text(sensors, row.sensor));
        if !names[2].is_empty() {
            let _ = write!(made, ",{}", text(targets, row.target));
        }
        for (index, _) in numbers {
            let number = row.numbers[*index];
            made.push(',');
            // An infinite one is a bad field, which is counted.
            if !number.is_nan() {
                let _ = write!(made, "{number}");
            }
        }
        made.push('\n');
    }
}

impl Read for Text<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        if self.taken == self.made.len() {
            self.make();
        }
        let rest = &self.made.as_bytes()[self.taken..];
        let count = rest.len().min(buffer.len());
        buffer[..count].copy_from_slice(&rest[..count]);
        self.taken += count;
        Ok(count)
    }
}

/// A text as a field of one line.
fn field(text: &str) -> String {
    let line: String = text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    let line = line.trim();
    if line.contains(['"', ',']) { format!("\"{}\"", line.replace('"', "\"\"")) } else { line.to_owned() }
}
