//! A log of a radio's port as rows of time, anchor and range.
//!
//! A text log has a time stamp before each line, or the user gives the radio's report rate. A LinkTrack log has
//! the radio's own time. A log is read once from its start; memory holds one line and the rows.

use std::io::BufRead;

use super::lines::Lines;
use super::linktrack::Frames;
use super::parser::Text;
use super::stamp::{DAY_S, Stamp, split};
use super::{Format, LogRow, RadioRange, Refusal, StampUnit};

/// Most rows, as in any recording.
const ROWS_MAX: usize = 10_000_000;

/// Consecutive reports that go back in time and count as a clock that was set or restarted.
const BACK_MAX: u32 = 8;

/// Numbers from here on are milliseconds, microseconds or nanoseconds since 1970: as seconds they are beyond the year 5000.
const SINCE_1970: [(f64, StampUnit); 3] =
    [(1e17, StampUnit::Nanoseconds), (1e14, StampUnit::Microseconds), (1e11, StampUnit::Milliseconds)];

/// One report in this many may name another tag: it counts as damaged.
const OTHER_TAGS_MAX: u64 = 100;

/// Longest usual gap between two frames of a LinkTrack whose clock counts milliseconds, s.
const FRAME_GAP_MAX_S: f64 = 3.0;

/// How a log is read.
#[derive(Debug, Clone, Default)]
pub struct LogOptions {
    /// Reports per second of a log without time stamps.
    pub rate_hz: Option<f64>,
    /// Unit of integer time stamps, or of a LinkTrack's clock [default: ms].
    pub stamp_unit: Option<StampUnit>,
    /// The tag to read from a log of several tags: the target (`--target`).
    pub tag: Option<String>,
}

/// Statistics of a log besides its rows.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct LogSummary {
    /// Accepted lines or frames.
    pub reports: u64,
    /// Ranges in the accepted lines or frames.
    pub rows: u64,
    /// Refused lines or frames: damaged, interleaved, without a stamp.
    pub refused: u64,
    /// The first refusal: its number among all lines or frames, from 1, and the reason.
    pub first_refused: Option<(u64, Refusal)>,
    /// Reports left out because their time is before the previous report's.
    pub back_in_time: u64,
    /// Reports left out because they are of other tags.
    pub other_tags: u64,
}

/// Why a log gives no rows. Displays as one line without the file's name.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// The log could not be read.
    #[error("cannot read: {0}")]
    Unreadable(#[from] std::io::Error),
    /// The log has no reports.
    #[error("no report ({refused} lines or frames refused): expected {}; check --format {format}", .format.sample())]
    NoRanges {
        /// The format that it was read as.
        format: Format,
        /// Refused lines or frames.
        refused: u64,
    },
    /// The log has no times, and no rate is given.
    #[error(
        "no time stamp: expected one before each line (1699999999.123 DIST,... or 2023-11-14T22:13:19.123Z DIST,...), \
         or the reports per second, --rate HZ"
    )]
    NoTime,
    /// The log has times, and a rate is given too.
    #[error("--rate is given, but there are time stamps: leave out --rate")]
    TwoTimes,
    /// The rate is invalid.
    #[error("--rate is {0}: expected a number from 0.001 to 100000 Hz")]
    Rate(f64),
    /// The unit of the time stamps is unknown.
    #[error("unknown unit of the time stamps, the first of which is {0}: give it, --stamp-unit s, ms, us or ns")]
    StampUnit(f64),
    /// The LinkTrack's clock does not seem to count milliseconds.
    #[error(
        "unlikely unit of the radio's clock (ms would put the frames {0:.1} s apart): type --stamp-unit us, or \
         --stamp-unit ms if that is right"
    )]
    DeviceUnit(f64),
    /// The clock went back and stayed there.
    #[error(
        "the time goes back by {by_s:.3} s at line or frame {at} and stays there: split the log where the clock was set \
         or the radio restarted"
    )]
    BackInTime {
        /// Where, counted from 1.
        at: u64,
        /// By how much, s.
        by_s: f64,
    },
    /// Ranges to more than one target.
    #[error("ranges of several tags: choose one of {} by --target ID", .0.join(", "))]
    Tags(Vec<String>),
    /// The requested tag is not in the log.
    #[error("no tag {wanted} (--target): expected {}", if .found.is_empty() { "tag ids".to_owned() } else { format!("one of {}", .found.join(", ")) })]
    NoSuchTag {
        /// The requested tag.
        wanted: String,
        /// The tags in the log.
        found: Vec<String>,
    },
    /// The log is too long.
    #[error("too many ranges: expected at most {ROWS_MAX}")]
    TooLong,
}

/// Reads a complete log.
///
/// # Errors
/// [`LogError`], if the log has no ranges of one target at known times.
pub fn read_log(
    format: Format,
    input: impl BufRead,
    options: &LogOptions,
) -> Result<(Vec<LogRow>, LogSummary), LogError> {
    let mut rows = Vec::new();
    let summary = for_each_row(format, input, options, |row| rows.push(row))?;
    Ok((rows, summary))
}

/// Reads a log row by row, in order of time. After an error, discard the rows passed on before.
///
/// # Errors
/// As [`read_log`].
pub fn for_each_row(
    format: Format,
    mut input: impl BufRead,
    options: &LogOptions,
    take: impl FnMut(LogRow),
) -> Result<LogSummary, LogError> {
    if let Some(rate_hz) = options.rate_hz
        && !(0.001..=100_000.0).contains(&rate_hz)
    {
        return Err(LogError::Rate(rate_hz));
    }
    let mut log = Log::new(format, options, take);
    let mut source = match format {
        Format::Linktrack => Source::Frames(Frames::default(), Vec::new()),
        _ => Source::Lines(Lines::default(), Text::new(format)),
    };
    loop {
        let bytes = input.fill_buf()?;
        if bytes.is_empty() {
            break;
        }
        let len = bytes.len();
        let mut outcome = Ok(());
        let mut keep_first = |result: Result<(), LogError>| {
            if outcome.is_ok() {
                outcome = result;
            }
        };
        match &mut source {
            Source::Frames(frames, ranges) => frames.push(bytes, ranges, |head, ranges| {
                keep_first(match head {
                    Ok(head) => log.frame(head.id, head.local_time, ranges),
                    Err(refusal) => log.refuse(refusal),
                });
            }),
            Source::Lines(lines, text) => lines.push(bytes, |line| {
                keep_first(match line {
                    Ok(line) => log.line(line, text),
                    Err(refusal) => log.refuse(refusal),
                });
            }),
        }
        outcome?;
        input.consume(len);
    }
    let has_rest = match &source {
        Source::Frames(frames, _) => frames.has_rest(),
        Source::Lines(lines, _) => lines.has_rest(),
    };
    if has_rest {
        log.refuse(Refusal::Cut)?;
    }
    log.finish()
}

enum Source {
    Frames(Frames, Vec<RadioRange>),
    Lines(Lines, Text),
}

struct Log<'a, F> {
    format: Format,
    options: &'a LogOptions,
    take: F,
    summary: LogSummary,
    clock: Clock,
    /// The first tag, whose ranges are read unless another is requested, and a few others for messages.
    tags: Vec<String>,
    /// Reports without a time.
    unstamped: u64,
}

/// The state of the log's clock.
#[derive(Default)]
struct Clock {
    unit: Option<StampUnit>,
    kind: Option<std::mem::Discriminant<Stamp>>,
    last_s: Option<f64>,
    days: f64,
    back: u32,
    wraps: u32,
    last_ticks: u32,
    /// Sum of the gaps between the first frames, s, and their number.
    gaps: (f64, u32),
}

impl<'a, F: FnMut(LogRow)> Log<'a, F> {
    fn new(format: Format, options: &'a LogOptions, take: F) -> Self {
        let summary = LogSummary::default();
        Self { format, options, take, summary, clock: Clock::default(), tags: Vec::new(), unstamped: 0 }
    }

    fn number(&self) -> u64 {
        self.summary.reports + self.summary.refused + self.summary.other_tags + self.summary.back_in_time
    }

    fn refuse(&mut self, refusal: Refusal) -> Result<(), LogError> {
        self.summary.refused += 1;
        let number = self.number();
        self.summary.first_refused.get_or_insert((number, refusal));
        Ok(())
    }

    fn line(&mut self, line: &str, text: &mut Text) -> Result<(), LogError> {
        let (stamp, rest) = match split(line, self.format != Format::Plain) {
            Some((stamp, rest)) => (Some(stamp), rest),
            None => (None, line),
        };
        let report = match text.read(rest) {
            Ok(Some(report)) => report,
            Ok(None) => return Ok(()),
            Err(refusal) => return self.refuse(refusal),
        };
        let time_s = match (stamp, self.options.rate_hz) {
            (Some(_), Some(_)) => return Err(LogError::TwoTimes),
            (Some(stamp), None) => self.clock.stamped_s(stamp, self.options.stamp_unit)?,
            (None, Some(rate_hz)) => Some(self.number() as f64 / rate_hz),
            (None, None) => {
                self.unstamped += 1;
                None
            }
        };
        match time_s {
            Some(time_s) => self.report(time_s, report.tag, report.ranges),
            None => self.refuse(Refusal::Malformed),
        }
    }

    fn frame(&mut self, id: u8, ticks: u32, ranges: &mut Vec<RadioRange>) -> Result<(), LogError> {
        if self.options.rate_hz.is_some() {
            return Err(LogError::TwoTimes);
        }
        ranges.retain(|range| range.range_m > 0.0);
        let unit = self.options.stamp_unit.unwrap_or(StampUnit::Milliseconds);
        let time_s = self.clock.ticked_s(ticks, unit);
        self.report(time_s, Some(&id.to_string()), ranges)
    }

    fn report(&mut self, time_s: f64, tag: Option<&str>, ranges: &[RadioRange]) -> Result<(), LogError> {
        if let Some(tag) = tag {
            if self.tags.len() < 16 && !self.tags.iter().any(|known| known == tag) {
                self.tags.push(tag.to_owned());
            }
            let wanted = self.options.tag.as_ref().or(self.tags.first());
            if wanted.is_some_and(|wanted| wanted != tag) {
                self.summary.other_tags += 1;
                return Ok(());
            }
        }
        let by_s = self.clock.last_s.map_or(0.0, |last_s| last_s - time_s);
        if by_s > 0.0 {
            self.summary.back_in_time += 1;
            self.clock.back += 1;
            let at = self.number();
            return if self.clock.back < BACK_MAX { Ok(()) } else { Err(LogError::BackInTime { at, by_s }) };
        }
        self.clock.back = 0;
        self.clock.last_s = Some(time_s);
        self.clock.note_gap(-by_s);
        self.summary.reports += 1;
        self.summary.rows += ranges.len() as u64;
        if self.summary.rows > ROWS_MAX as u64 {
            return Err(LogError::TooLong);
        }
        for RadioRange { anchor, anchor_position_m, range_m, .. } in ranges {
            let (anchor, position_m, range_m) = (anchor.clone(), *anchor_position_m, *range_m);
            (self.take)(LogRow { time_s, anchor, position_m, range_m });
        }
        Ok(())
    }

    fn finish(self) -> Result<LogSummary, LogError> {
        let Self { summary, options, mut tags, .. } = self;
        if summary.reports == 0 && self.unstamped > 0 {
            return Err(LogError::NoTime);
        }
        if let Some(wanted) = &options.tag {
            if summary.reports == 0 && !tags.contains(wanted) {
                return Err(LogError::NoSuchTag { wanted: wanted.clone(), found: tags });
            }
        } else if summary.other_tags > summary.reports / OTHER_TAGS_MAX {
            tags.sort_by_key(|tag| (tag.len(), tag.clone()));
            return Err(LogError::Tags(tags));
        }
        if summary.rows == 0 {
            return Err(LogError::NoRanges { format: self.format, refused: summary.refused });
        }
        let (sum_s, count) = self.clock.gaps;
        let gap_s = sum_s / f64::from(count.max(1));
        if self.format == Format::Linktrack && options.stamp_unit.is_none() && gap_s > FRAME_GAP_MAX_S {
            return Err(LogError::DeviceUnit(gap_s));
        }
        Ok(summary)
    }
}

impl Clock {
    /// The time of a stamp, s; `None` if its kind differs from the first stamp's.
    fn stamped_s(&mut self, stamp: Stamp, unit: Option<StampUnit>) -> Result<Option<f64>, LogError> {
        let kind = std::mem::discriminant(&stamp);
        if *self.kind.get_or_insert(kind) != kind {
            return Ok(None);
        }
        Ok(Some(match stamp {
            Stamp::Date(time_s) => time_s,
            Stamp::Number { value, has_fraction } => {
                if self.unit.is_none() {
                    self.unit = Some(unit.or_else(|| unit_of(value, has_fraction)).ok_or(LogError::StampUnit(value))?);
                }
                value * self.unit.map_or(1.0, StampUnit::seconds)
            }
            Stamp::Clock(time_s) => {
                // A clock that goes back by most of a day has passed midnight.
                if self.last_s.is_some_and(|last_s| last_s - (self.days + time_s) > DAY_S / 2.0) {
                    self.days += DAY_S;
                }
                self.days + time_s
            }
        }))
    }

    /// The time of a 32-bit counter, s.
    fn ticked_s(&mut self, ticks: u32, unit: StampUnit) -> f64 {
        const QUARTER: u32 = 1 << 30;
        if self.last_ticks >= 3 * QUARTER && ticks < QUARTER {
            self.wraps += 1;
        }
        self.last_ticks = ticks;
        (f64::from(self.wraps) * 4_294_967_296.0 + f64::from(ticks)) * unit.seconds()
    }

    fn note_gap(&mut self, gap_s: f64) {
        if gap_s > 0.0 && self.gaps.1 < 50 {
            self.gaps = (self.gaps.0 + gap_s, self.gaps.1 + 1);
        }
    }
}

/// The unit of a number, if it can be inferred: numbers with a fraction are seconds, the largest count from 1970.
fn unit_of(value: f64, has_fraction: bool) -> Option<StampUnit> {
    let large = SINCE_1970.iter().find(|(least, _)| value >= *least).map(|(_, unit)| *unit);
    large.or(has_fraction.then_some(StampUnit::Seconds))
}

#[cfg(test)]
mod tests {
    use super::super::linktrack::frame;
    use super::*;

    const LEC: &str = "DIST,2,AN0,022E,7.94,8.03,0.00,3.44,AN1,15BA,0.00,8.03,0.00,6.71,POS,6.95,5.37,-1.97,52";

    fn read(format: Format, bytes: &[u8], options: &LogOptions) -> Result<(Vec<LogRow>, LogSummary), LogError> {
        read_log(format, std::io::BufReader::with_capacity(7, bytes), options)
    }

    fn times_s(rows: &[LogRow]) -> Vec<f64> {
        rows.iter().map(|row| row.time_s).collect()
    }

    fn complaint(format: Format, bytes: &[u8], options: &LogOptions) -> String {
        read(format, bytes, options).unwrap_err().to_string()
    }

    #[test]
    fn a_stamped_log_is_read_and_its_damaged_lines_counted() {
        let text =
            format!("dwm> lec\r\n100.5 {LEC}\r\n100.6 DIST,2,AN0,022E,7.9\r\n{LEC}\r\n100.7 {LEC}\r\n100.8 DIST,1");
        let (rows, summary) = read(Format::Dwm1001, text.as_bytes(), &LogOptions::default()).unwrap();
        assert_eq!(times_s(&rows), [100.5, 100.5, 100.7, 100.7]);
        let first =
            LogRow { time_s: 100.5, anchor: "022E".to_owned(), position_m: Some([7.94, 8.03, 0.0]), range_m: 3.44 };
        assert_eq!(rows[0], first);
        assert_eq!((summary.reports, summary.rows, summary.refused), (2, 4, 3));
        assert_eq!(summary.first_refused, Some((2, Refusal::Malformed)));
    }

    #[test]
    fn every_kind_of_stamp_gives_the_same_differences() {
        for stamps in [
            ["1699999999.123 ", "1699999999.223 "],
            ["1699999999123 ", "1699999999223 "],
            ["1699999999123456,", "1699999999223456,"],
            ["2023-11-14T22:13:19.123Z ", "2023-11-14T22:13:19.223Z "],
            ["[12:01:02.345] ", "[12:01:02.445] "],
            ["[23:59:59.950] ", "[00:00:00.050] "],
        ] {
            let text = stamps.map(|stamp| format!("{stamp}{LEC}\n")).concat();
            let (rows, _) = read(Format::Dwm1001, text.as_bytes(), &LogOptions::default()).unwrap();
            assert!((rows[2].time_s - rows[0].time_s - 0.1).abs() < 1e-5, "{stamps:?}: {:?}", times_s(&rows));
        }
    }

    #[test]
    fn a_log_without_times_needs_a_rate() {
        let text = format!("{LEC}\nDIST,1,AN\n{LEC}\n");
        let options = LogOptions::default();
        assert!(complaint(Format::Dwm1001, text.as_bytes(), &options).contains("--rate HZ"));
        let options = LogOptions { rate_hz: Some(10.0), ..options };
        assert_eq!(times_s(&read(Format::Dwm1001, text.as_bytes(), &options).unwrap().0), [0.0, 0.0, 0.2, 0.2]);
        let stamped = format!("1.5 {LEC}\n");
        assert!(complaint(Format::Dwm1001, stamped.as_bytes(), &options).contains("leave out --rate"));
        let options = LogOptions { rate_hz: Some(f64::NAN), ..options };
        assert!(complaint(Format::Dwm1001, text.as_bytes(), &options).contains("--rate is NaN: expected"));
    }

    #[test]
    fn a_unit_that_cannot_be_told_is_asked_for() {
        let text = b"1000 7,5.5\n1100 7,5.6\n";
        assert!(complaint(Format::Plain, text, &LogOptions::default()).contains("--stamp-unit"));
        let options = LogOptions { stamp_unit: Some(StampUnit::Milliseconds), ..LogOptions::default() };
        assert_eq!(times_s(&read(Format::Plain, text, &options).unwrap().0), [1.0, 1.1]);
    }

    #[test]
    fn a_log_of_something_else_is_refused() {
        let none = complaint(Format::Mauwb, b"1.5 hello\n", &LogOptions::default());
        assert!(none.contains("expected lines like AT+RANGE") && none.contains("1 lines or frames refused"), "{none}");
        assert!(complaint(Format::Linktrack, b"", &LogOptions::default()).contains("55 05"));
    }

    #[test]
    fn ranges_of_two_tags_are_not_mixed() {
        let line =
            |tag: u32, cm: u32| format!("{cm}.5 AT+RANGE=tid:{tag},mask:01,seq:65,range:({cm},0),ancid:(3,-1)\n");
        let text = [line(0, 92), line(1, 93), line(0, 94)].concat();
        assert!(
            complaint(Format::Mauwb, text.as_bytes(), &LogOptions::default())
                .contains("several tags: choose one of 0, 1")
        );
        let tag = |tag: &str| LogOptions { tag: Some(tag.to_owned()), ..LogOptions::default() };
        let (rows, summary) = read(Format::Mauwb, text.as_bytes(), &tag("1")).unwrap();
        assert_eq!((rows.len(), rows[0].range_m, rows[0].anchor.as_str(), summary.other_tags), (1, 0.93, "3", 2));
        assert!(
            complaint(Format::Mauwb, text.as_bytes(), &tag("7")).contains("no tag 7 (--target): expected one of 0, 1")
        );
        // One report in two hundred is damage, not a second tag.
        let text: String = (0..200).map(|number| line(if number == 100 { 8 } else { 0 }, 1000 + number)).collect();
        let (rows, summary) = read(Format::Mauwb, text.as_bytes(), &LogOptions::default()).unwrap();
        assert_eq!((rows.len(), summary.other_tags), (199, 1));
    }

    #[test]
    fn a_linktrack_has_its_own_time_over_the_end_of_its_counter() {
        let bytes = [u32::MAX - 99, 0, 100].map(|time| frame(5, time, &[(3, 1000), (4, 0)])).concat();
        let (rows, _) = read(Format::Linktrack, &bytes, &LogOptions::default()).unwrap();
        assert_eq!(rows.len(), 3, "{rows:?}");
        assert!((rows[2].time_s - rows[0].time_s - 0.2).abs() < 1e-6);
        let bytes = [0, 20_000, 40_000].map(|time| frame(5, time, &[(3, 1000)])).concat();
        assert!(complaint(Format::Linktrack, &bytes, &LogOptions::default()).contains("--stamp-unit us"));
        let options = LogOptions { stamp_unit: Some(StampUnit::Microseconds), ..LogOptions::default() };
        assert_eq!(times_s(&read(Format::Linktrack, &bytes, &options).unwrap().0), [0.0, 0.02, 0.04]);
    }

    #[test]
    fn a_clock_that_goes_back_ends_the_log_but_one_report_does_not() {
        let at = |times: &[u32]| times.iter().flat_map(|time| frame(5, *time, &[(3, 1000)])).collect::<Vec<_>>();
        let (rows, summary) = read(Format::Linktrack, &at(&[100, 200, 150, 300]), &LogOptions::default()).unwrap();
        assert_eq!((rows.len(), summary.back_in_time), (3, 1));
        let restarted = at(&[9000, 9100, 0, 100, 200, 300, 400, 500, 600, 700, 800]);
        assert!(complaint(Format::Linktrack, &restarted, &LogOptions::default()).contains("the time goes back by"));
    }
}
