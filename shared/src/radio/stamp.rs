//! Time stamps that loggers write before each line.
//!
//! | stamp | writer |
//! |---|---|
//! | `1699999999.123 LINE` | `ts %.s`, most scripts |
//! | `1699999999123 LINE` | scripts, by ms, us or ns since 1970 |
//! | `2023-11-14T22:13:19.123Z LINE`, `2023-11-14 22:13:19,123 LINE` | loggers |
//! | `[12:01:02.345] LINE`, `12:01:02.345 -> LINE` | terminals |
//!
//! A stamp may stand in brackets, and a comma, semicolon, colon or arrow may follow it.

use std::str::FromStr;

use jiff::civil::Date;
use jiff::tz::TimeZone;

/// The unit of stamps that are plain numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StampUnit {
    /// Seconds.
    Seconds,
    /// Milliseconds.
    Milliseconds,
    /// Microseconds.
    Microseconds,
    /// Nanoseconds.
    Nanoseconds,
}

impl StampUnit {
    /// Its length, s.
    #[must_use]
    pub const fn seconds(self) -> f64 {
        match self {
            Self::Seconds => 1.0,
            Self::Milliseconds => 1e-3,
            Self::Microseconds => 1e-6,
            Self::Nanoseconds => 1e-9,
        }
    }
}

impl FromStr for StampUnit {
    type Err = UnknownUnit;

    fn from_str(text: &str) -> Result<Self, UnknownUnit> {
        match text {
            "s" => Ok(Self::Seconds),
            "ms" => Ok(Self::Milliseconds),
            "us" => Ok(Self::Microseconds),
            "ns" => Ok(Self::Nanoseconds),
            _ => Err(UnknownUnit),
        }
    }
}

/// The name of no unit of time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("expected s, ms, us or ns")]
pub struct UnknownUnit;

/// The stamp of a line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Stamp {
    /// A number of unknown unit.
    Number { value: f64, has_fraction: bool },
    /// A date and time, s since 1970.
    Date(f64),
    /// A time of an unknown day, s since midnight.
    Clock(f64),
}

/// Length of a day, s.
pub(super) const DAY_S: f64 = 86_400.0;

/// Splits a line into its stamp and the rest. A comma separates the two only if `commas` is set: a
/// plain line has its own comma.
pub(super) fn split(line: &str, commas: bool) -> Option<(Stamp, &str)> {
    let line = line.trim_start();
    let (stamp, rest) = match line.strip_prefix('[') {
        Some(inner) => {
            let (inner, rest) = inner.split_once(']')?;
            let (stamp, after) = read(inner.trim())?;
            // Some loggers also write the time since the previous line.
            if !after.is_empty() && !after.starts_with(' ') {
                return None;
            }
            (stamp, rest)
        }
        None => {
            let (stamp, rest) = read(line)?;
            // A clock time that continues with a digit after a colon is invalid.
            let is_colon = rest.strip_prefix(':').is_some_and(|rest| !rest.starts_with(|c: char| c.is_ascii_digit()));
            let is_parted = is_colon
                || rest.starts_with([' ', '\t', '|'])
                || rest.starts_with("->")
                || (commas && rest.starts_with([',', ';']));
            if !is_parted {
                return None;
            }
            (stamp, rest)
        }
    };
    let rest = rest.trim_start();
    let mut marks = ["->", ":", "|"].iter().chain(if commas { &[",", ";"][..] } else { &[] });
    let rest = marks.find_map(|mark| rest.strip_prefix(mark)).unwrap_or(rest).trim_start();
    (!rest.is_empty()).then_some((stamp, rest))
}

/// Reads the stamp at the start of a text.
fn read(text: &str) -> Option<(Stamp, &str)> {
    date(text).or_else(|| clock(text).map(|(time_s, rest)| (Stamp::Clock(time_s), rest))).or_else(|| number(text))
}

fn number(text: &str) -> Option<(Stamp, &str)> {
    let (whole, mut rest) = digits(text, 1..=20)?;
    let mut number_len = whole.len();
    if let Some(after) = rest.strip_prefix('.') {
        let (fraction, after) = digits(after, 1..=12)?;
        number_len += 1 + fraction.len();
        rest = after;
    }
    let value = text[..number_len].parse().ok()?;
    Some((Stamp::Number { value, has_fraction: number_len > whole.len() }, rest))
}

/// `2023-11-14T22:13:19.123+01:00`. Without a zone it counts as UTC, because only differences matter.
fn date(text: &str) -> Option<(Stamp, &str)> {
    let (year, rest) = digits(text, 4..=4)?;
    let (month, rest) = digits(rest.strip_prefix('-')?, 2..=2)?;
    let (day, rest) = digits(rest.strip_prefix('-')?, 2..=2)?;
    let date = Date::new(year.parse().ok()?, month.parse().ok()?, day.parse().ok()?).ok()?;
    let midnight_s = date.to_zoned(TimeZone::UTC).ok()?.timestamp().as_second() as f64;
    let (time_s, rest) = clock(rest.strip_prefix(['T', 't', ' '])?)?;
    let (offset_s, rest) = zone(rest)?;
    Some((Stamp::Date(midnight_s + time_s - offset_s), rest))
}

/// `22:13:19.123`
fn clock(text: &str) -> Option<(f64, &str)> {
    let (hours, rest) = digits(text, 2..=2)?;
    let (minutes, rest) = digits(rest.strip_prefix(':')?, 2..=2)?;
    let (seconds, mut rest) = digits(rest.strip_prefix(':')?, 2..=2)?;
    let (hours, minutes, seconds): (u32, u32, u32) =
        (hours.parse().ok()?, minutes.parse().ok()?, seconds.parse().ok()?);
    if hours > 23 || minutes > 59 || seconds > 60 {
        return None;
    }
    let mut time_s = f64::from(hours * 3600 + minutes * 60 + seconds);
    if let Some((fraction, after)) = rest.strip_prefix(['.', ',']).and_then(|after| digits(after, 1..=9)) {
        time_s += format!("0.{fraction}").parse::<f64>().ok()?;
        rest = after;
    }
    Some((time_s, rest))
}

/// `Z`, `+01:00`, `-0800` or nothing: seconds east of Greenwich.
fn zone(text: &str) -> Option<(f64, &str)> {
    if let Some(rest) = text.strip_prefix(['Z', 'z']) {
        return Some((0.0, rest));
    }
    let Some(rest) = text.strip_prefix(['+', '-']) else { return Some((0.0, text)) };
    if rest.starts_with('>') {
        return Some((0.0, text));
    }
    let (hours, rest) = digits(rest, 2..=2)?;
    let (minutes, rest) = digits(rest.strip_prefix(':').unwrap_or(rest), 2..=2)?;
    let offset_s = f64::from(hours.parse::<u32>().ok()? * 3600 + minutes.parse::<u32>().ok()? * 60);
    Some((if text.starts_with('-') { -offset_s } else { offset_s }, rest))
}

/// Splits off the digits at the start of a text.
fn digits(text: &str, lens: std::ops::RangeInclusive<usize>) -> Option<(&str, &str)> {
    let len = text.bytes().take_while(u8::is_ascii_digit).count();
    lens.contains(&len).then(|| text.split_at(len))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_as_loggers_write_them() {
        let seconds = |value| Stamp::Number { value, has_fraction: true };
        for (line, stamp) in [
            ("1699999999.123 DIST,0", seconds(1_699_999_999.123)),
            ("1699999999.123,DIST,0", seconds(1_699_999_999.123)),
            ("1699999999.123;DIST,0", seconds(1_699_999_999.123)),
            ("1699999999.123: DIST,0", seconds(1_699_999_999.123)),
            ("[1.5 0.25] DIST,0", seconds(1.5)),
            ("1699999999123\tDIST,0", Stamp::Number { value: 1_699_999_999_123.0, has_fraction: false }),
            ("2023-11-14T22:13:19.123Z DIST,0", Stamp::Date(1_699_999_999.123)),
            ("2023-11-14T23:13:19.123+01:00 DIST,0", Stamp::Date(1_699_999_999.123)),
            ("2023-11-14 22:13:19,123 DIST,0", Stamp::Date(1_699_999_999.123)),
            ("[2023-11-14 22:13:19.123] DIST,0", Stamp::Date(1_699_999_999.123)),
            ("[12:01:02.345] DIST,0", Stamp::Clock(43_262.345)),
            ("12:01:02.345 -> DIST,0", Stamp::Clock(43_262.345)),
        ] {
            assert_eq!(split(line, true), Some((stamp, "DIST,0")), "{line}");
        }
        assert_eq!(split("1970-01-01T00:00:00 x", true), Some((Stamp::Date(0.0), "x")));
        assert_eq!(split("2024-02-29T00:00:00 x", true), Some((Stamp::Date(19_782.0 * DAY_S), "x")));
        assert_eq!(split("2023-02-29T00:00:00 x", true), None);
    }

    #[test]
    fn radio_output_is_not_taken_for_a_stamp() {
        for line in
            ["DIST,0", "022E[7.94,8.03,0.00]=3.44", "15BA[0.00,0.00,0.00]=8.31", "1200[7.94,8.03,0.00]=3.44", "12.34"]
        {
            assert_eq!(split(line, true), None, "{line}");
        }
        for line in ["7,12.34", "1699999999.123,12.34"] {
            assert_eq!(split(line, false), None, "{line}");
        }
        assert_eq!(split("0.5 7,12.34", false).unwrap().1, "7,12.34");
        for line in ["[", "[]", "[1.5", "2023-13-14T22:13:19 x", "99:00:00 x", "1.", "123456789012345678901 x", ""] {
            assert_eq!(split(line, true), None, "{line}");
        }
    }
}
