//! Splits a stream that arrives in pieces into lines; an overlong line is dropped.

use super::Refusal;

/// Longest line, bytes, without its end: sixteen anchors with all optional fields.
pub const LINE_LEN_MAX: usize = 1024;

/// Splits a stream into lines, which end with CR, LF or both. Skips blank lines.
#[derive(Debug, Default)]
pub(super) struct Lines {
    line: Vec<u8>,
    is_too_long: bool,
}

impl Lines {
    /// Takes the next bytes and passes on each line that they complete, without its end.
    pub(super) fn push(&mut self, mut bytes: &[u8], mut take: impl FnMut(Result<&str, Refusal>)) {
        while let Some(at) = bytes.iter().position(|byte| matches!(byte, b'\n' | b'\r')) {
            self.keep(&bytes[..at]);
            bytes = &bytes[at + 1..];
            if self.is_too_long {
                take(Err(Refusal::TooLong));
            } else if !self.line.trim_ascii().is_empty() {
                take(str::from_utf8(&self.line).map_err(|_| Refusal::NotText));
            }
            self.clear();
        }
        self.keep(bytes);
    }

    /// True if an unfinished line remains.
    pub(super) fn has_rest(&self) -> bool {
        self.is_too_long || !self.line.trim_ascii().is_empty()
    }

    fn keep(&mut self, bytes: &[u8]) {
        if self.line.len() + bytes.len() > LINE_LEN_MAX {
            self.is_too_long = true;
            self.line.clear();
        }
        if !self.is_too_long {
            self.line.extend_from_slice(bytes);
        }
    }

    fn clear(&mut self) {
        self.line.clear();
        self.is_too_long = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lines(chunks: &[&[u8]]) -> (Vec<Result<String, Refusal>>, bool) {
        let (mut lines, mut all) = (Lines::default(), Vec::new());
        for chunk in chunks {
            lines.push(chunk, |line| all.push(line.map(str::to_owned)));
        }
        assert!(lines.line.capacity() <= 2 * LINE_LEN_MAX);
        (all, lines.has_rest())
    }

    #[test]
    fn lines_are_the_same_however_they_come() {
        let text = b"one\r\ntwo\n\n \r\nthr\xffee\rfour";
        let expected = vec![Ok("one".to_owned()), Ok("two".to_owned()), Err(Refusal::NotText)];
        assert_eq!(lines(&[text]), (expected.clone(), true));
        assert_eq!(lines(&text.chunks(1).collect::<Vec<_>>()), (expected, true));
    }

    #[test]
    fn a_line_of_maximum_length_is_complete_and_a_longer_one_is_refused_once() {
        let long = [b'x'; LINE_LEN_MAX + 1];
        assert_eq!(lines(&[&long[1..], b"\n"]).0, [Ok("x".repeat(LINE_LEN_MAX))]);
        assert_eq!(lines(&[&long, &long, b"\nnext\n"]).0, [Err(Refusal::TooLong), Ok("next".to_owned())]);
        assert!(lines(&[&long]).1);
    }
}
