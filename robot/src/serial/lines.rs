//! Ranges as lines of text, from whoever writes them: nothing is kept of a line but its beginning.

use std::io::{BufRead, Read, Result};

/// Longest line, bytes, its end included: a label of any sense and a number.
pub const LINE_LEN_MAX: usize = 128;

/// Gives the range of each line to `take`, in m, `None` for a malformed line, until the stream ends. Blank lines are
/// passed over; so is the first line, which may have begun before anybody listened.
///
/// # Errors
/// If the stream cannot be read.
pub fn read_ranges(mut stream: impl BufRead, mut take: impl FnMut(Option<f64>)) -> Result<()> {
    let mut line = Vec::with_capacity(LINE_LEN_MAX);
    stream.skip_until(b'\n')?;
    loop {
        line.clear();
        stream.by_ref().take(LINE_LEN_MAX as u64).read_until(b'\n', &mut line)?;
        match line.last() {
            None => return Ok(()),
            Some(b'\n') if line.trim_ascii().is_empty() => {}
            Some(b'\n') => take(range_m(&line)),
            // Too long, or cut off by the end of the stream. Told at once: it may have no end.
            Some(_) => {
                take(None);
                stream.skip_until(b'\n')?;
            }
        }
    }
}

/// The range that a line says; a negative one is a radio's word for none.
fn range_m(line: &[u8]) -> Option<f64> {
    let text = str::from_utf8(line).ok()?;
    let number = text.rsplit(',').next()?.trim();
    number.parse().ok().filter(|range_m| (0.0..f64::INFINITY).contains(range_m))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{BufReader, repeat};

    fn ranges(text: &[u8]) -> Vec<Option<f64>> {
        let mut ranges = Vec::new();
        // Few bytes at a time, as they come from a port.
        read_ranges(BufReader::with_capacity(3, text), |range_m| ranges.push(range_m)).unwrap();
        ranges
    }

    #[test]
    fn a_line_is_a_range_with_or_without_a_label() {
        let text = b"first\n12.34\nA,5\r\n\n  \r\n anchor 7 , 0.25 \nx,y,1e1\n";
        assert_eq!(ranges(text), [Some(12.34), Some(5.0), Some(0.25), Some(10.0)]);
    }

    #[test]
    fn the_first_line_may_be_half_a_line() {
        assert_eq!(ranges(b"34\n12.35\n"), [Some(12.35)]);
        assert_eq!(ranges(b"34"), []);
        assert_eq!(ranges(b""), []);
    }

    #[test]
    fn what_is_no_range_is_malformed() {
        for line in ["x", "A,", "12.34,A", "1 2", "nan", "inf", "-1", "1e999", "0x10", "12.34\0", "12\u{2212}3"] {
            assert_eq!(ranges(format!("\n{line}\n1\n").as_bytes()), [None, Some(1.0)], "{line}");
        }
        assert_eq!(ranges(b"\n\xff\xfe1\n1\n"), [None, Some(1.0)]);
    }

    #[test]
    fn half_a_line_at_the_end_is_no_range() {
        assert_eq!(ranges(b"\n12.34\n12."), [Some(12.34), None]);
    }

    #[test]
    fn a_line_as_long_as_it_may_be_is_read_and_a_longer_one_passed_over() {
        let line = |len: usize| format!("\n{}1\n2\n", " ".repeat(len - 2));
        assert_eq!(ranges(line(LINE_LEN_MAX).as_bytes()), [Some(1.0), Some(2.0)]);
        assert_eq!(ranges(line(LINE_LEN_MAX + 1).as_bytes()), [None, Some(2.0)]);
    }

    #[test]
    fn a_line_without_end_takes_no_memory() {
        let mut taken = Vec::new();
        let endless = b"\n".chain(repeat(b'1').take(1 << 26));
        read_ranges(BufReader::new(endless), |range_m| taken.push(range_m)).unwrap();
        assert_eq!(taken, [None]);
    }
}
