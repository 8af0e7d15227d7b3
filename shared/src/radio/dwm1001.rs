//! The shell of a DWM1001 (PANS firmware): lines of `lec` and `les`.
//!
//! ```text
//! DIST,2,AN0,022E,7.94,8.03,0.00,3.44,AN1,15BA,0.00,8.03,0.00,6.71,POS,6.95,5.37,-1.97,52
//! 022E[7.94,8.03,0.00]=3.44 15BA[0.00,8.03,0.00]=6.71 le_us=2576 est[6.95,5.37,-1.97,52]
//! ```
//!
//! `DIST` is followed by the number of anchors and label, id, x, y, z and range (m) of each. `POS` and `est` are the
//! radio's own estimate with its quality in percent, and are optional. The shell's prompt and its echo of typed commands are
//! skipped.

use super::decimal::{Decimals, whole};
use super::{RANGE_MAX_M, RadioRange, Refusal, add};

/// Most anchors of a line.
const ANCHORS_MAX: u32 = 16;

/// The shell's prompt.
const PROMPT: &str = "dwm>";

/// Commands that the shell echoes.
const COMMANDS: [&str; 6] = ["lec", "les", "lep", "quit", "si", "reset"];

/// Starts of the shell's greeting lines.
const GREETING: [&str; 5] = ["DWM1001", "Copyright", "License", "Compiled", "Help"];

/// Reads a line into `ranges`; `false` if it is not a report.
pub(super) fn read(line: &str, ranges: &mut Vec<RadioRange>) -> Result<bool, Refusal> {
    let mut line = line.trim();
    while let Some(rest) = line.strip_prefix(PROMPT) {
        line = rest.trim_start();
    }
    if line.is_empty() || COMMANDS.contains(&line) || GREETING.iter().any(|start| line.starts_with(start)) {
        return Ok(false);
    }
    let mut decimals = Decimals::default();
    if let Some(rest) = line.strip_prefix("DIST,") {
        read_dist(rest, &mut decimals, ranges)?;
    } else if let Some(rest) = line.strip_prefix("POS,") {
        read_pos(&mut rest.split(','), &mut decimals)?;
    } else {
        read_les(line, &mut decimals, ranges)?;
    }
    Ok(true)
}

/// `2,AN0,022E,7.94,8.03,0.00,3.44,AN1,...,POS,...`
fn read_dist(text: &str, decimals: &mut Decimals, ranges: &mut Vec<RadioRange>) -> Result<(), Refusal> {
    let mut fields = text.split(',');
    let mut next = || fields.next().ok_or(Refusal::Malformed);
    let count = whole(next()?)?;
    if count > ANCHORS_MAX {
        return Err(Refusal::Malformed);
    }
    let mut last_label = None;
    for _ in 0..count {
        let label = whole(next()?.strip_prefix("AN").ok_or(Refusal::Malformed)?)?;
        if last_label.is_some_and(|last| label <= last) {
            return Err(Refusal::AnchorTwice);
        }
        last_label = Some(label);
        let id = next()?;
        let position_m = [decimals.read(next()?)?, decimals.read(next()?)?, decimals.read(next()?)?];
        take(id, position_m, decimals.read(next()?)?, ranges)?;
    }
    match fields.next() {
        None => Ok(()),
        Some("POS") => read_pos(&mut fields, decimals),
        Some(_) => Err(Refusal::Malformed),
    }
}

/// `6.95,5.37,-1.97,52`
fn read_pos<'a>(fields: &mut impl Iterator<Item = &'a str>, decimals: &mut Decimals) -> Result<(), Refusal> {
    decimals.point(fields)?;
    let quality_percent = whole(fields.next().ok_or(Refusal::Malformed)?)?;
    if quality_percent > 100 || fields.next().is_some() {
        return Err(Refusal::Malformed);
    }
    Ok(())
}

/// `022E[7.94,8.03,0.00]=3.44 ... le_us=2576 est[6.95,5.37,-1.97,52]`
fn read_les(text: &str, decimals: &mut Decimals, ranges: &mut Vec<RadioRange>) -> Result<(), Refusal> {
    let mut words = text.split_ascii_whitespace().peekable();
    while let Some(word) = words.next_if(|word| !word.starts_with("le_us=") && !word.starts_with("est[")) {
        if ranges.len() >= ANCHORS_MAX as usize {
            return Err(Refusal::Malformed);
        }
        let (id, rest) = word.split_once('[').ok_or(Refusal::Malformed)?;
        let (point, range) = rest.split_once("]=").ok_or(Refusal::Malformed)?;
        let mut parts = point.split(',');
        let position_m = decimals.point(&mut parts)?;
        if parts.next().is_some() {
            return Err(Refusal::Malformed);
        }
        take(id, position_m, decimals.read(range)?, ranges)?;
    }
    if let Some(duration) = words.next_if(|word| word.starts_with("le_us=")) {
        whole(duration.trim_start_matches("le_us="))?;
    }
    if let Some(word) = words.next() {
        let estimate = word.strip_prefix("est[").and_then(|rest| rest.strip_suffix(']')).ok_or(Refusal::Malformed)?;
        read_pos(&mut estimate.split(','), decimals)?;
    }
    if words.next().is_some() { Err(Refusal::Malformed) } else { Ok(()) }
}

fn take(id: &str, position_m: [f64; 3], range_m: f64, ranges: &mut Vec<RadioRange>) -> Result<(), Refusal> {
    let is_id = id.len() == 4 && id.bytes().all(|byte| byte.is_ascii_hexdigit());
    if !is_id || range_m.is_sign_negative() || range_m > RANGE_MAX_M {
        return Err(Refusal::Malformed);
    }
    add(ranges, RadioRange { anchor: id.to_owned(), anchor_position_m: Some(position_m), range_m, rssi_dbm: None })
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEC: &str = "DIST,4,AN0,022E,7.94,8.03,0.00,3.44,AN1,15BA,0.00,0.00,0.00,8.31,AN2,1C02,7.94,0.00,0.00,5.60,\
                       AN3,0C25,0.00,8.03,0.00,6.71,POS,6.95,5.37,-1.97,52";
    const LES: &str = "022E[7.94,8.03,0.00]=3.44 15BA[0.00,0.00,0.00]=8.31 le_us=2576 est[6.95,5.37,-1.97,52]";

    fn parse(line: &str) -> Result<Vec<(String, [f64; 3], f64)>, Refusal> {
        let mut ranges = Vec::new();
        read(line, &mut ranges)?;
        Ok(ranges.into_iter().map(|range| (range.anchor, range.anchor_position_m.unwrap(), range.range_m)).collect())
    }

    #[test]
    fn lec_lines_are_read_exactly() {
        let expected = [
            ("022E", [7.94, 8.03, 0.0], 3.44),
            ("15BA", [0.0, 0.0, 0.0], 8.31),
            ("1C02", [7.94, 0.0, 0.0], 5.6),
            ("0C25", [0.0, 8.03, 0.0], 6.71),
        ]
        .map(|(id, position_m, range_m)| (id.to_owned(), position_m, range_m));
        assert_eq!(parse(LEC).unwrap(), expected);
        assert_eq!(parse(LEC.split_once(",POS").unwrap().0).unwrap(), expected);
        assert_eq!(parse(&format!("dwm> {LEC}")).unwrap(), expected);
        assert_eq!(parse("DIST,0"), Ok(vec![]));
        assert_eq!(parse("POS,6.95,5.37,-1.97,52"), Ok(vec![]));
    }

    #[test]
    fn les_lines_are_read_exactly() {
        let expected = [("022E", [7.94, 8.03, 0.0], 3.44), ("15BA", [0.0, 0.0, 0.0], 8.31)]
            .map(|(id, position_m, range_m)| (id.to_owned(), position_m, range_m));
        assert_eq!(parse(LES).unwrap(), expected);
        assert_eq!(parse(&LES.replace(" le_us=2576", "")).unwrap(), expected);
        assert_eq!(parse(LES.split_once(" le_us").unwrap().0).unwrap(), expected);
        assert_eq!(parse("le_us=2576"), Ok(vec![]));
    }

    #[test]
    fn prompts_and_echoed_commands_are_skipped() {
        for line in ["", "dwm>", "dwm> ", "dwm> lec", "dwm> dwm> les", "lec", " DWM1001 TWR Real Time Location System"]
        {
            assert_eq!(read(line, &mut Vec::new()), Ok(false), "{line}");
        }
    }

    #[test]
    fn damaged_lines_are_refused() {
        let bad = [
            "DIST,4,AN0,022E,7.94,8.03,0.00,3.44",
            "DIST,1,AN0,022E,7.94,8.03,0.00,3.44,AN1,15BA,0.00,0.00,0.00,8.31",
            "DIST,2,AN0,022E,7.94,8.03,0.00,3.44,AN0,15BA,0.00,0.00,0.00,8.31",
            "DIST,2,AN0,022E,7.94,8.03,0.00,3.44,AN1,022E,0.00,0.00,0.00,8.31",
            "DIST,4,AN0,022E,7.94,8.03,0.00,3.44,AN3,15BA,0.00,0,AN3,15BA,0.00,0.00,0.00,8.31",
            "DIST,1,AN0,022E,7.94,8.03,0.00,3.4",
            "DIST,1,AN0,022E,7.94,8.03,0.00,-3.44",
            "DIST,1,AN0,022E,7.94,8.03,0.00,3.44,52",
            "DIST,1,AN0,022E,7.94,8.03,0.00,3.44,POS,6.95,5.37,-1.97",
            "DIST,1,AN0,022E,7.94,8.03,0.00,3.44,POS,6.95,5.37,-1.97,52,1",
            "DIST,1,AN0,022E,7.94,8.03,0.00,3.44,POS,6.95,5.37,-1.97,152",
            "DIST,1,AN0,22E,7.94,8.03,0.00,3.44",
            "DIST,1,AN0,022G,7.94,8.03,0.00,3.44",
            "DIST,1,AN0,022E,7.94,8.03,3.44",
            "DIST,01,AN0,022E,7.94,8.03,0.00,3.44",
            "DIST,99999,AN0",
            "IST,1,AN0,022E,7.94,8.03,0.00,3.44",
            "DIST,1,AN0,022E,7.94,8.03,0.00,3.44DIST,1,AN0,022E,7.94,8.03,0.00,3.44",
            "022E[7.94,8.03,0.00]=3.4",
            "022E[7.94,8.03,0.00,1.00]=3.44",
            "022E[7.94,8.03,0.00]=3.44,52",
            "022E[7.94,8.03,0.00]=3.44 022e[7.94,8.03,0.00]=3.44",
            "est[6.95,5.37,-1.97,52] 022E[7.94,8.03,0.00]=3.44",
            "est[6.95,5.37,-1.97,52",
            "12.34",
            "hello",
        ];
        for line in bad {
            assert!(parse(line).is_err(), "{line}");
        }
    }
}
