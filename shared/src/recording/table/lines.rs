//! Lines of limited length from a text file of any length.

use std::io::{BufRead, BufReader, Error, ErrorKind, Read, Result};

/// Longest line, bytes.
const LINE_LEN_MAX: usize = 1 << 16;

/// Most lines of a file.
const LINES_MAX: u64 = 20_000_000;

/// The lines of a reader in a single pass: the reader may be a pipe.
pub(super) struct Lines<R> {
    input: BufReader<R>,
    number: u64,
}

impl<R: Read> Lines<R> {
    pub(super) fn new(input: R) -> Self {
        Self { input: BufReader::with_capacity(1 << 16, input), number: 0 }
    }

    /// Number of the last line read, from 1.
    pub(super) fn number(&self) -> u64 {
        self.number
    }

    /// Reads the next line without its end; false at the end of the file.
    pub(super) fn read(&mut self, line: &mut Vec<u8>) -> Result<bool> {
        line.clear();
        self.number += 1;
        if self.input.by_ref().take(LINE_LEN_MAX as u64 + 1).read_until(b'\n', line)? == 0 {
            return Ok(false);
        }
        if self.number == 1 {
            check_start(line)?;
        }
        if line.len() > LINE_LEN_MAX {
            return Err(refuse(format!(
                "line {} has more than {LINE_LEN_MAX} bytes: expected a shorter line: break it into several",
                self.number
            )));
        }
        if self.number > LINES_MAX {
            return Err(refuse(format!("it has more than {LINES_MAX} lines: expected fewer: split the file")));
        }
        if line.last() == Some(&b'\n') {
            line.pop();
        }
        if line.last() == Some(&b'\r') {
            line.pop();
        }
        Ok(true)
    }
}

/// Removes a byte order mark, and reports files that are not UTF-8 text.
fn check_start(line: &mut Vec<u8>) -> Result<()> {
    match line.as_slice() {
        [0xEF, 0xBB, 0xBF, ..] => {
            line.drain(..3);
            Ok(())
        }
        [0xFF, 0xFE, ..] | [0xFE, 0xFF, ..] => {
            Err(refuse("it is text in UTF-16: expected UTF-8: convert it with `iconv -f UTF-16 -t UTF-8`".to_owned()))
        }
        [0x1F, 0x8B, ..] => {
            Err(refuse("it is compressed by gzip: expected text: unpack it, or give `zcat FILE` as a pipe".to_owned()))
        }
        [0x28, 0xB5, 0x2F, 0xFD, ..] => {
            Err(refuse("it is compressed by zstd: expected text: unpack it, or give `zstdcat FILE` as a pipe".to_owned()))
        }
        [b'B', b'Z', b'h', b'1'..=b'9', 0x31, 0x41, ..] => {
            Err(refuse("it is compressed by bzip2: expected text: unpack it, or give `bzcat FILE` as a pipe".to_owned()))
        }
        [0xFD, b'7', b'z', b'X', b'Z', 0, ..] => {
            Err(refuse("it is compressed by xz: expected text: unpack it, or give `xzcat FILE` as a pipe".to_owned()))
        }
        [b'P', b'K', 3, 4, ..] => {
            Err(refuse("it is a zip archive, as spreadsheets are: expected text: unpack it, or export it as CSV".to_owned()))
        }
        _ if line.contains(&0) => Err(refuse(
            "it contains zero bytes, so it is not text, or text in UTF-16: expected UTF-8: convert UTF-16 with `iconv -f UTF-16LE -t UTF-8`"
                .to_owned(),
        )),
        [start @ .., _, _] if start.contains(&b'\r') && !start.ends_with(b"\r") => {
            Err(refuse("its lines end with CR only: expected LF at their ends: convert it with `tr '\\r' '\\n'`".to_owned()))
        }
        _ => Ok(()),
    }
}

/// Why a file's text is refused, and what was expected.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(super) struct Refused(String);

fn refuse(reason: String) -> Error {
    Error::new(ErrorKind::InvalidData, Refused(reason))
}
