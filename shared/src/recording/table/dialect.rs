//! The dialect of a table: column separator, decimal mark and comments.

use super::unit::Unit;

/// The separator between two fields of a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Separator {
    Tab,
    Semicolon,
    Comma,
    /// Any number of blanks and tabs.
    Blanks,
}

impl Separator {
    /// All separators; those least likely to occur in a name come first.
    pub(super) const ALL: [Self; 4] = [Self::Tab, Self::Semicolon, Self::Comma, Self::Blanks];

    pub(super) fn from_byte(byte: u8) -> Option<Self> {
        match byte {
            b'\t' => Some(Self::Tab),
            b';' => Some(Self::Semicolon),
            b',' => Some(Self::Comma),
            b' ' => Some(Self::Blanks),
            _ => None,
        }
    }

    pub(super) fn plural(self) -> &'static str {
        match self {
            Self::Tab => "tabs",
            Self::Semicolon => "semicolons",
            Self::Comma => "commas",
            Self::Blanks => "blanks",
        }
    }

    fn is(self, byte: u8) -> bool {
        match self {
            Self::Tab => byte == b'\t',
            Self::Semicolon => byte == b';',
            Self::Comma => byte == b',',
            Self::Blanks => is_blank(byte),
        }
    }

    /// A blank outside of fields that does not end one.
    fn pads(self, byte: u8) -> bool {
        is_blank(byte) && !self.is(byte)
    }
}

pub(super) fn is_blank(byte: u8) -> bool {
    byte == b' ' || byte == b'\t'
}

/// True if a line has no content.
pub(super) fn is_empty(line: &[u8]) -> bool {
    line.iter().all(|byte| byte.is_ascii_whitespace())
}

/// The text of a comment line, which starts with `#`, `%` or `//`.
pub(super) fn comment(line: &[u8]) -> Option<&[u8]> {
    let line = line.trim_ascii_start();
    let text = line.strip_prefix(b"//").or_else(|| line.strip_prefix(b"%")).or_else(|| line.strip_prefix(b"#"))?;
    Some(text.trim_ascii())
}

/// The fields of one row.
#[derive(Debug, Default)]
pub(in crate::recording) struct Fields {
    /// The row. Quoted fields are stored without their quotes.
    pub(super) line: Vec<u8>,
    spans: Vec<(usize, usize)>,
}

impl Fields {
    /// The fields of a line; none if they cannot be separated.
    pub(super) fn of(line: &[u8], separator: Separator) -> Self {
        let mut fields = Self { line: line.to_vec(), spans: Vec::new() };
        if !fields.split(separator) {
            fields.spans.clear();
        }
        fields
    }

    pub(super) fn len(&self) -> usize {
        self.spans.len()
    }

    /// A field; empty past the end.
    pub(super) fn get(&self, index: usize) -> &[u8] {
        self.spans.get(index).map_or(&[], |&(start, end)| &self.line[start..end])
    }

    pub(in crate::recording) fn iter(&self) -> impl Iterator<Item = &[u8]> {
        self.spans.iter().map(|&(start, end)| &self.line[start..end])
    }

    pub(super) fn truncate(&mut self, len: usize) {
        self.spans.truncate(len);
    }

    /// Finds the fields of the row; false if quotes do not close, or close within a field.
    pub(super) fn split(&mut self, separator: Separator) -> bool {
        let Self { line, spans } = self;
        spans.clear();
        let mut at = 0;
        loop {
            while at < line.len() && (separator.pads(line[at]) || separator == Separator::Blanks && is_blank(line[at]))
            {
                at += 1;
            }
            if separator == Separator::Blanks && at == line.len() {
                return true;
            }
            let start = at;
            if line.get(at) == Some(&b'"') {
                let Some((end, next)) = unquote(line, at) else { return false };
                spans.push((start, end));
                at = next;
                while at < line.len() && separator.pads(line[at]) {
                    at += 1;
                }
                if at < line.len() && !separator.is(line[at]) {
                    return false;
                }
            } else {
                while at < line.len() && !separator.is(line[at]) {
                    at += 1;
                }
                let mut end = at;
                while end > start && is_blank(line[end - 1]) {
                    end -= 1;
                }
                spans.push((start, end));
            }
            if at == line.len() {
                return true;
            }
            at += 1;
        }
    }
}

/// Removes the quotes of a field in place; returns its end and where the row continues.
fn unquote(line: &mut [u8], start: usize) -> Option<(usize, usize)> {
    let (mut from, mut to) = (start + 1, start);
    loop {
        let byte = *line.get(from)?;
        from += 1;
        if byte == b'"' {
            if line.get(from) != Some(&b'"') {
                return Some((to, from));
            }
            from += 1;
        }
        line[to] = byte;
        to += 1;
    }
}

/// Reads numbers with decimal points or decimal commas, whichever occurs first in the file.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Numbers {
    mark: Option<u8>,
}

impl Numbers {
    /// Longest number, bytes: the shortest decimals of the smallest number have 326.
    const LEN_MAX: usize = 400;

    pub(super) fn has_decimal_commas(self) -> bool {
        self.mark == Some(b',')
    }

    /// True if a field has the other decimal mark than the file.
    pub(super) fn is_other_mark(self, field: &[u8]) -> bool {
        self.mark.is_some_and(|mark| field.contains(if mark == b',' { &b'.' } else { &b',' }))
    }

    /// A number in seconds, metres or radians. A decimal unit shifts the decimals, so that 2957 mm are 2.957 m to the last
    /// bit.
    pub(super) fn read(&mut self, field: &[u8], unit: Unit) -> Option<f64> {
        let mut mark = None;
        let mut has_exponent = false;
        for &byte in field {
            match byte {
                b'.' | b',' => mark = Some(byte),
                b'e' | b'E' => has_exponent = true,
                _ => {}
            }
        }
        if mark.is_some() && self.mark.is_some() && self.mark != mark {
            return None;
        }
        let value = parse(field, mark == Some(b','), has_exponent, unit.power_of_ten())?;
        // A text that is not a number does not determine the decimal mark.
        self.mark = self.mark.or(mark);
        Some(if unit == Unit::Degree { value.to_radians() } else { value })
    }
}

fn parse(field: &[u8], has_comma: bool, has_exponent: bool, shift: i32) -> Option<f64> {
    if !has_comma && shift == 0 {
        return finite(std::str::from_utf8(field).ok()?.parse().ok()?);
    }
    let mut text = [0_u8; Numbers::LEN_MAX];
    let room = text.get_mut(..field.len())?;
    room.copy_from_slice(field);
    if has_comma {
        *room.iter_mut().find(|byte| **byte == b',')? = b'.';
    }
    if shift == 0 {
        return finite(std::str::from_utf8(room).ok()?.parse().ok()?);
    }
    if has_exponent {
        let value: f64 = std::str::from_utf8(room).ok()?.parse().ok()?;
        return finite(value / 10_f64.powi(-shift));
    }
    let exponent: &[u8] = match shift {
        -2 => b"e-2",
        -3 => b"e-3",
        -6 => b"e-6",
        _ => b"e-9",
    };
    let end = field.len() + exponent.len();
    text.get_mut(field.len()..end)?.copy_from_slice(exponent);
    finite(std::str::from_utf8(&text[..end]).ok()?.parse().ok()?)
}

/// Minus zero becomes zero: equal numbers must be equal to the last bit.
fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value + 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn split(line: &str, separator: Separator) -> Option<Vec<String>> {
        let mut fields = Fields { line: line.into(), ..Fields::default() };
        fields.split(separator).then(|| fields.iter().map(|field| String::from_utf8_lossy(field).into()).collect())
    }

    #[test]
    fn rows_are_split_at_their_separator() {
        assert_eq!(split("1, 2 ,,3", Separator::Comma).unwrap(), ["1", "2", "", "3"]);
        assert_eq!(split("1;2;", Separator::Semicolon).unwrap(), ["1", "2", ""]);
        assert_eq!(split("1\t\t 2", Separator::Tab).unwrap(), ["1", "", "2"]);
        assert_eq!(split("  1 \t2   3 ", Separator::Blanks).unwrap(), ["1", "2", "3"]);
        assert_eq!(split(r#""a ""b"", c" , "2,5""#, Separator::Comma).unwrap(), [r#"a "b", c"#, "2,5"]);
        assert_eq!(split(r#""a b" c"#, Separator::Blanks).unwrap(), ["a b", "c"]);
        assert_eq!(split("", Separator::Comma).unwrap(), [""]);
        for line in [r#""a"#, r#""a"b,1"#, r#"1,""#] {
            assert_eq!(split(line, Separator::Comma), None, "{line}");
        }
    }

    #[test]
    fn a_unit_shifts_decimals_without_loss() {
        let read = |text: &str, unit| Numbers::default().read(text.as_bytes(), unit);
        assert_eq!(read("2957", Unit::Millimetre), Some(2.957));
        assert_eq!(read("295,7", Unit::Centimetre), Some(2.957));
        assert_eq!(read("1700000000123456789", Unit::Nanosecond), Some(1_700_000_000.123_456_8));
        assert_eq!(read("1.5e3", Unit::Millisecond), Some(1.5));
        assert_eq!(read("-0", Unit::Metre).map(f64::to_bits), Some(0));
        assert_eq!(read("180", Unit::Degree), Some(std::f64::consts::PI));
        for text in ["", "1,234.5", "1,2,3", "NaN", "inf", "1e999", "x", "0x1", "\u{661}"] {
            assert_eq!(read(text, Unit::Metre), None, "{text}");
            assert_eq!(read(text, Unit::Millimetre), None, "{text}");
        }
    }

    #[test]
    fn a_file_has_one_decimal_mark() {
        let mut numbers = Numbers::default();
        assert_eq!(numbers.read(b"7", Unit::Metre), Some(7.0));
        assert_eq!(numbers.read(b"n.a.", Unit::Metre), None);
        assert_eq!(numbers.read(b"2,5", Unit::Metre), Some(2.5));
        assert_eq!(numbers.read(b"2.5", Unit::Metre), None);
        assert!(numbers.has_decimal_commas());
    }
}
