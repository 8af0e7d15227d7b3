//! One range per line, m: `12.34`, or `A,12.34` with the sensor's name first.

use super::decimal::is_digits;
use super::{RadioRange, Refusal};

/// Reads a line into `ranges`.
///
/// Two numbers are a name and a range only if the name is an integer and the range has a point: `12,34` may be 12.34 with a
/// decimal comma. A third field is refused, because it is unclear which field is the range.
pub(super) fn read(line: &str, ranges: &mut Vec<RadioRange>) -> Result<bool, Refusal> {
    let (name, number) = match line.split_once(',') {
        None => ("", line.trim()),
        Some((name, number)) => (name.trim(), number.trim()),
    };
    if line.contains(',') {
        let is_ambiguous = if is_digits(name) { !number.contains('.') } else { name.parse::<f64>().is_ok() };
        if name.is_empty() || is_ambiguous || name.chars().any(char::is_control) {
            return Err(Refusal::Malformed);
        }
    }
    let range_m: f64 = number.parse().map_err(|_| Refusal::Malformed)?;
    if !range_m.is_finite() || range_m < 0.0 {
        return Err(Refusal::Malformed);
    }
    ranges.push(RadioRange { anchor: name.to_owned(), anchor_position_m: None, range_m, rssi_dbm: None });
    Ok(true)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(line: &str) -> Result<(String, f64), Refusal> {
        let mut ranges = Vec::new();
        read(line, &mut ranges)?;
        ranges.pop().map(|range| (range.anchor, range.range_m)).ok_or(Refusal::Malformed)
    }

    #[test]
    fn a_line_is_a_range_with_or_without_a_name() {
        for (line, name, range_m) in [
            ("12.34", "", 12.34),
            ("  5", "", 5.0),
            ("A,5", "A", 5.0),
            (" anchor 7 , 0.25 ", "anchor 7", 0.25),
            ("7,1.5", "7", 1.5),
            ("022E,1e1", "022E", 10.0),
        ] {
            assert_eq!(parse(line), Ok((name.to_owned(), range_m)), "{line}");
        }
    }

    #[test]
    fn ambiguous_lines_are_refused() {
        let bad = [
            "x",
            "A,",
            ",5",
            "12.34,A",
            "1 2",
            "nan",
            "inf",
            "-1",
            "1e999",
            "0x10",
            "12.34\0",
            "12\u{2212}3",
            "x,y,1e1",
            "12,34",
            "1.5,2.5",
            "A\u{1b}[0m,5",
            "A,5,52",
            "A,5,",
            "DIST,1,AN0,022E,7.94,8.03,0.00,3.44",
            "DIST,1,AN0,022E,7.94,8.03,0.00,3.44,POS,6.95,5.37,-1.97,52",
        ];
        for line in bad {
            assert!(parse(line).is_err(), "{line}");
        }
    }
}
