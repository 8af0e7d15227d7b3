//! One type for all formats, fed with bytes as they come.

use super::lines::Lines;
use super::{Format, RadioRange, Refusal, dwm1001};

/// One line or frame of a radio.
#[derive(Debug, Clone, PartialEq)]
pub struct Report<'a> {
    /// Who measured, where the radio says it: the tag's id.
    pub tag: Option<&'a str>,
    /// The radio's own clock, in its own units.
    pub device_time: Option<u32>,
    /// What was heard, each anchor once; empty if none was.
    pub ranges: &'a [RadioRange],
}

/// What has come so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// Lines or frames that were taken.
    pub reports: u64,
    /// Ranges in them.
    pub ranges: u64,
    /// Lines or frames that were refused.
    pub refused: u64,
}

/// Reads a radio's bytes, in pieces of any size, with memory for one line or frame.
#[derive(Debug)]
pub struct Parser {
    source: Source,
    is_in_first_line: bool,
    ranges: Vec<RadioRange>,
    counts: Counts,
}

#[derive(Debug)]
enum Source {
    Text(Format, Lines),
}

impl Parser {
    /// A parser of a stream that begins where a line does, as a file.
    #[must_use]
    pub fn new(format: Format) -> Self {
        let source = Source::Text(format, Lines::default());
        Self { source, is_in_first_line: false, ranges: Vec::new(), counts: Counts::default() }
    }

    /// A parser of a stream that went on before anybody listened: the first line, which may be the end of one, is
    /// passed over.
    #[must_use]
    pub fn listening(format: Format) -> Self {
        Self { is_in_first_line: true, ..Self::new(format) }
    }

    /// What has come so far.
    #[must_use]
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Takes the next bytes, and gives each report that they end, or why it was refused.
    pub fn push(&mut self, bytes: &[u8], mut take: impl FnMut(Result<Report<'_>, Refusal>)) {
        let Self { source, ranges, counts, .. } = self;
        let Source::Text(format, lines) = source;
        lines.push(bytes, |line| {
            ranges.clear();
            match line.and_then(|line| dwm1001::read(line, ranges)) {
                Ok(false) => {}
                Ok(true) => {
                    ranges.retain(|range| range.range_m > 0.0);
                    counts.reports += 1;
                    counts.ranges += ranges.len() as u64;
                    take(Ok(Report { tag: None, device_time: None, ranges }));
                }
                Err(refusal) => {
                    counts.refused += 1;
                    take(Err(refusal));
                }
            }
            let _ = format;
        });
    }
}
