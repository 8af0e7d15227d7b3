//! The output of a MaUWB for each round of ranging.
//!
//! ```text
//! AT+RANGE=tid:0,mask:01,seq:65,range:(92,0,0,0,0,0,0,0),ancid:(0,-1,-1,-1,-1,-1,-1,-1)
//! AT+RANGE=tid:1,mask:04,seq:63,range:(0,0,30,0,0,0,0,0),rssi:(0.00,0.00,-77.93,0.00,0.00,0.00,0.00,0.00)
//! ```
//!
//! Ranges are in cm, 0 for an anchor that was not heard. `ancid` gives the anchors' ids, -1 for none; firmware without `ancid`
//! lists the anchors in order, from 0. Some versions print blanks after commas and colons, some print both `rssi` and `ancid`.

use super::decimal::whole;
use super::{RANGE_MAX_M, RadioRange, Refusal, add};

/// State of the parser between lines.
#[derive(Debug, Default, Clone, Copy)]
pub(super) struct Memory {
    /// This radio prints anchor ids: a line without them is truncated, and its ranges have no known anchor.
    has_ids: bool,
}

const START: &str = "AT+RANGE=";

/// Most anchors of a line.
const SLOTS_MAX: usize = 16;

/// Reads a line into `ranges` and the tag's id into `tag`; `false` if it is not a report.
pub(super) fn read(
    line: &str,
    memory: &mut Memory,
    tag: &mut String,
    ranges: &mut Vec<RadioRange>,
) -> Result<bool, Refusal> {
    let line = line.trim();
    let Some(rest) = line.strip_prefix(START) else {
        // `OK`, `AT+VERSION?` and other answers.
        let is_talk = line == "OK" || (line.starts_with("AT+") && !line.contains("range") && !line.contains("RANGE"));
        return if is_talk { Ok(false) } else { Err(Refusal::Malformed) };
    };
    let mut fields = Fields { rest };
    let tid = fields.value("tid")?;
    whole(tid)?;
    let mask = fields.value("mask")?;
    if mask.is_empty() || mask.len() > 8 || !mask.bytes().all(|byte| byte.is_ascii_hexdigit()) {
        return Err(Refusal::Malformed);
    }
    whole(fields.value("seq")?)?;
    let ranges_cm = fields.list("range")?.ok_or(Refusal::Malformed)?;
    let rssi = fields.list("rssi")?;
    let ids = fields.list("ancid")?;
    let has_all = ids.is_some() || (rssi.is_some() && !memory.has_ids);
    if !has_all || !fields.rest.is_empty() {
        return Err(Refusal::Malformed);
    }

    let count = ranges_cm.split(',').count();
    let is_as_long = |list: Option<&str>| list.is_none_or(|list| list.split(',').count() == count);
    if count > SLOTS_MAX || !is_as_long(rssi) || !is_as_long(ids) {
        return Err(Refusal::Malformed);
    }
    let mut rssi_items = rssi.map(|list| list.split(','));
    let mut id_items = ids.map(|list| list.split(','));
    for (slot, range_cm) in ranges_cm.split(',').enumerate() {
        let range_m = f64::from(whole(range_cm.trim())?) / 100.0;
        let rssi_dbm = rssi_items.as_mut().and_then(Iterator::next).map(signed).transpose()?;
        let anchor = match id_items.as_mut().and_then(Iterator::next).map(str::trim) {
            None => slot.to_string(),
            Some("-1") => continue,
            Some(id) => whole(id)?.to_string(),
        };
        if range_m > RANGE_MAX_M {
            return Err(Refusal::Malformed);
        }
        add(ranges, RadioRange { anchor, anchor_position_m: None, range_m, rssi_dbm })?;
    }
    memory.has_ids |= ids.is_some();
    tag.push_str(tid);
    Ok(true)
}

/// The named fields of a line, in their order.
struct Fields<'a> {
    rest: &'a str,
}

impl<'a> Fields<'a> {
    /// Reads the required field `name:value,`.
    fn value(&mut self, name: &str) -> Result<&'a str, Refusal> {
        let rest = self.after(name).ok_or(Refusal::Malformed)?;
        let (value, rest) = rest.split_once(',').ok_or(Refusal::Malformed)?;
        self.rest = rest.trim_start();
        Ok(value.trim_end())
    }

    /// The text in the brackets of `name:(...)`, if that field comes next.
    fn list(&mut self, name: &str) -> Result<Option<&'a str>, Refusal> {
        let Some(rest) = self.after(name) else { return Ok(None) };
        let (list, rest) = rest.strip_prefix('(').and_then(|rest| rest.split_once(')')).ok_or(Refusal::Malformed)?;
        let rest = rest.trim_start();
        self.rest = match rest.strip_prefix(',') {
            // A comma must be followed by another field.
            Some(next) if !next.trim_start().is_empty() => next.trim_start(),
            None if rest.is_empty() => rest,
            _ => return Err(Refusal::Malformed),
        };
        Ok(Some(list))
    }

    fn after(&self, name: &str) -> Option<&'a str> {
        Some(self.rest.strip_prefix(name)?.trim_start().strip_prefix(':')?.trim_start())
    }
}

/// A signal strength, with optional sign and point.
fn signed(text: &str) -> Result<f64, Refusal> {
    let text = text.trim();
    let is_number = text.trim_start_matches('-').bytes().all(|byte| byte.is_ascii_digit() || byte == b'.');
    if !is_number || text.len() > 10 {
        return Err(Refusal::Malformed);
    }
    text.parse().map_err(|_| Refusal::Malformed)
}

#[cfg(test)]
mod tests {
    use super::*;

    const NEW: &str = "AT+RANGE=tid:0,mask:01,seq:65,range:(92,0,0,0,0,0,0,0),ancid:(0,-1,-1,-1,-1,-1,-1,-1)";
    const OLD: &str =
        "AT+RANGE=tid:1,mask:04,seq:63,range:(0,0,30,0,0,0,0,0),rssi:(0.00,0.00,-77.93,0.00,0.00,0.00,0.00,0.00)";

    fn parse_after(memory: &mut Memory, line: &str) -> Result<(String, Vec<(String, f64)>), Refusal> {
        let (mut tag, mut ranges) = (String::new(), Vec::new());
        read(line, memory, &mut tag, &mut ranges)?;
        let heard = ranges.into_iter().filter(|range| range.range_m > 0.0);
        Ok((tag, heard.map(|range| (range.anchor, range.range_m)).collect()))
    }

    fn parse(line: &str) -> Result<(String, Vec<(String, f64)>), Refusal> {
        parse_after(&mut Memory::default(), line)
    }

    fn report(tag: &str, ranges: &[(&str, f64)]) -> (String, Vec<(String, f64)>) {
        (tag.to_owned(), ranges.iter().map(|(anchor, range_m)| ((*anchor).to_owned(), *range_m)).collect())
    }

    #[test]
    fn lines_of_each_firmware_are_read_exactly() {
        assert_eq!(parse(NEW).unwrap(), report("0", &[("0", 0.92)]));
        assert_eq!(parse(OLD).unwrap(), report("1", &[("2", 0.3)]));
        let blanks = "AT+RANGE=tid: 3, mask: 0F, seq: 7, range: (232, 401, 518, 0), rssi: (-70.1, -71, -72, 0), ancid: (4, 9, 12, -1)";
        assert_eq!(parse(blanks).unwrap(), report("3", &[("4", 2.32), ("9", 4.01), ("12", 5.18)]));
        let nobody = "AT+RANGE=tid:0,mask:00,seq:66,range:(0,0),ancid:(-1,-1)";
        assert_eq!(parse(nobody).unwrap(), report("0", &[]));
        // The range of a slot without an anchor is dropped.
        assert_eq!(
            parse("AT+RANGE=tid:0,mask:01,seq:1,range:(5,6),ancid:(-1,1)").unwrap(),
            report("0", &[("1", 0.06)])
        );
        assert_eq!(read("OK", &mut Memory::default(), &mut String::new(), &mut Vec::new()), Ok(false));
    }

    #[test]
    fn damaged_lines_are_refused() {
        let bad = [
            "AT+RANGE=tid:0,mask:01,seq:65,range:(92,0),ancid:(0,-1,-1)",
            "AT+RANGE=tid:0,mask:01,seq:65,range:(92,0)",
            "AT+RANGE=tid:0,mask:01,seq:65,range:(92,0),",
            "AT+RANGE=tid:0,mask:01,seq:65,range:(92,0),ancid:(0,0)",
            "AT+RANGE=tid:0,mask:01,seq:65,range:(92,-3),ancid:(0,1)",
            "AT+RANGE=tid:0,mask:01,seq:65,range:(92,),ancid:(0,1)",
            "AT+RANGE=tid:0,mask:01,seq:65,range:(9 2,0),ancid:(0,1)",
            "AT+RANGE=tid:0,mask:01,seq:65,range:(92,AT+RANGE=tid:0,mask:01,seq:66,range:(92,0),ancid:(0,-1)",
            "AT+RANGE=tid:0,mask:01,seq:65,range:(92,0),ancid:(0,-1)AT+RANGE=tid:0",
            "AT+RANGE=tid:0,mask:01,seq:65,range:(92,0),ancid:(0,-1),kx:1",
            "AT+RANGE=tid:0,mask:0G,seq:65,range:(92,0),ancid:(0,-1)",
            "AT+RANGE=tid:0,seq:65,range:(92,0),ancid:(0,-1)",
            "AT+RANGE=tid:0,mask:01,seq:65,range:(9999999),ancid:(0)",
            "RANGE=tid:0,mask:01,seq:65,range:(92,0),ancid:(0,-1)",
            "92",
        ];
        for line in bad {
            assert!(parse(line).is_err(), "{line}");
        }
    }

    #[test]
    fn a_line_that_lost_its_ids_is_not_taken_for_an_older_radios() {
        let mut memory = Memory::default();
        let whole = "AT+RANGE=tid:0,mask:03,seq:65,range:(92,93),rssi:(-70.00,-71.00),ancid:(5,7)";
        assert_eq!(parse_after(&mut memory, whole).unwrap().1.len(), 2);
        assert_eq!(parse_after(&mut memory, whole.split_once(",ancid").unwrap().0), Err(Refusal::Malformed));
    }
}
