//! One parser type for all formats; it takes bytes in pieces of any size.

use super::lines::Lines;
use super::linktrack::Frames;
use super::{Format, RadioRange, Refusal, dwm1001, mauwb, plain};

/// One line or frame of a radio.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RadioReport<'a> {
    /// The tag that measured, if the radio prints tag ids.
    pub tag: Option<&'a str>,
    /// The radio's own clock, in its own units.
    pub device_time: Option<u32>,
    /// The heard anchors, each once; empty if none was heard.
    pub ranges: &'a [RadioRange],
}

/// Counts since the start of the stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// Accepted lines or frames.
    pub reports: u64,
    /// Ranges in the accepted lines or frames.
    pub ranges: u64,
    /// Refused lines or frames.
    pub refused: u64,
}

/// Reads a radio's bytes, in pieces of any size; buffers one line or frame.
#[derive(Debug)]
pub struct Parser {
    source: Source,
    counts: Counts,
}

#[derive(Debug)]
enum Source {
    Text { lines: Lines, text: Text, is_first_cut: bool },
    Frames { frames: Frames, ranges: Vec<RadioRange>, tag: String },
}

impl Parser {
    /// A parser of a stream that is already running: its first line may be incomplete and is
    /// skipped. Frames need no such rule.
    #[must_use]
    pub fn listening(format: Format) -> Self {
        Self::begun(format, true)
    }

    /// A parser of a stream that starts at the start of a line.
    #[must_use]
    pub fn new(format: Format) -> Self {
        Self::begun(format, false)
    }

    fn begun(format: Format, is_first_cut: bool) -> Self {
        let source = match format {
            Format::Linktrack => Source::Frames { frames: Frames::default(), ranges: Vec::new(), tag: String::new() },
            Format::Plain | Format::Dwm1001 | Format::Mauwb => {
                Source::Text { lines: Lines::default(), text: Text::new(format), is_first_cut }
            }
        };
        Self { source, counts: Counts::default() }
    }

    /// Counts since the start of the stream.
    #[must_use]
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Takes the next bytes, and passes on each completed report, or the reason of its refusal.
    pub fn push(&mut self, bytes: &[u8], mut take: impl FnMut(Result<RadioReport<'_>, Refusal>)) {
        let counts = &mut self.counts;
        let mut take = |report: Result<RadioReport<'_>, Refusal>| {
            match &report {
                Ok(report) => {
                    counts.reports += 1;
                    counts.ranges += report.ranges.len() as u64;
                }
                Err(_) => counts.refused += 1,
            }
            take(report);
        };
        match &mut self.source {
            Source::Text { lines, text, is_first_cut } => {
                let rest = if *is_first_cut { after_first_line(bytes) } else { Some(bytes) };
                let Some(rest) = rest else { return };
                *is_first_cut = false;
                lines.push(rest, |line| match line.and_then(|line| text.read(line)) {
                    Ok(None) => {}
                    Ok(Some(report)) => take(Ok(report)),
                    Err(refusal) => take(Err(refusal)),
                });
            }
            Source::Frames { frames, ranges, tag } => frames.push(bytes, ranges, |head, ranges| {
                take(head.map(|head| {
                    ranges.retain(|range| range.range_m > 0.0);
                    tag.clear();
                    tag.push_str(&head.id.to_string());
                    RadioReport { tag: Some(tag), device_time: Some(head.local_time), ranges }
                }));
            }),
        }
    }

    /// Ends the stream: an unfinished line or frame is refused.
    pub fn finish(&mut self) -> Result<(), Refusal> {
        let has_rest = match &self.source {
            Source::Text { lines, .. } => lines.has_rest(),
            Source::Frames { frames, .. } => frames.has_rest(),
        };
        if has_rest {
            self.counts.refused += 1;
            return Err(Refusal::Cut);
        }
        Ok(())
    }
}

fn after_first_line(bytes: &[u8]) -> Option<&[u8]> {
    let end = bytes.iter().position(|byte| *byte == b'\n')?;
    Some(&bytes[end + 1..])
}

/// Reads the lines of a format of text.
#[derive(Debug)]
pub(super) struct Text {
    format: Format,
    memory: mauwb::Memory,
    tag: String,
    ranges: Vec<RadioRange>,
}

impl Text {
    pub(super) fn new(format: Format) -> Self {
        Self { format, memory: mauwb::Memory::default(), tag: String::new(), ranges: Vec::new() }
    }

    /// Reads a line; `None` if it is not a report.
    pub(super) fn read(&mut self, line: &str) -> Result<Option<RadioReport<'_>>, Refusal> {
        let Self { format, memory, tag, ranges } = self;
        ranges.clear();
        tag.clear();
        let is_report = match format {
            Format::Plain => plain::read(line, ranges),
            Format::Dwm1001 => dwm1001::read(line, ranges),
            Format::Mauwb => mauwb::read(line, memory, tag, ranges),
            // A binary format has no lines.
            Format::Linktrack => Err(Refusal::Malformed),
        }?;
        ranges.retain(|range| range.range_m > 0.0);
        let tag = (*format == Format::Mauwb).then_some(tag.as_str());
        Ok(is_report.then_some(RadioReport { tag, device_time: None, ranges }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ranges(parser: &mut Parser, text: &[u8]) -> Vec<Option<Vec<f64>>> {
        let mut all = Vec::new();
        // Few bytes at a time, as from a port.
        for chunk in text.chunks(3) {
            parser.push(chunk, |report| {
                all.push(report.ok().map(|report| report.ranges.iter().map(|range| range.range_m).collect()));
            });
        }
        all
    }

    #[test]
    fn the_first_line_may_be_half_a_line() {
        for (text, expected) in [(&b"34\n12.35\r\n"[..], vec![Some(vec![12.35])]), (b"34", vec![]), (b"", vec![])] {
            assert_eq!(ranges(&mut Parser::listening(Format::Plain), text), expected);
        }
        assert_eq!(ranges(&mut Parser::new(Format::Plain), b"34\n"), [Some(vec![34.0])]);
    }

    #[test]
    fn an_unheard_anchor_gives_no_range() {
        let mut parser = Parser::new(Format::Plain);
        assert_eq!(ranges(&mut parser, b"0\n0.00\nA,1\nx\n12."), [Some(vec![]), Some(vec![]), Some(vec![1.0]), None]);
        assert_eq!(parser.finish(), Err(Refusal::Cut));
        assert_eq!(parser.counts(), Counts { reports: 3, ranges: 1, refused: 2 });
    }

    #[test]
    fn a_line_without_end_takes_no_memory() {
        let mut parser = Parser::listening(Format::Dwm1001);
        for _ in 0..10_000 {
            parser.push(&[b'1'; 4096], |_| panic!("no line"));
        }
        parser.push(b"\nDIST,0\n", |report| assert_eq!(report.unwrap().ranges, []));
    }
}
