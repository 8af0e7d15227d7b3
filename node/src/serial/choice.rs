//! Selects this robot's ranges from those on a port.

use std::io::{Error, ErrorKind, Result};

use rangehound_shared::radio::{Format, RadioReport};

/// Consecutive reports without the anchor that trigger a warning.
const REPORTS_WITHOUT_MAX: u32 = 20;

/// Most anchors that a message names.
const NAMES_MAX: usize = 16;

/// The radio's format, and the anchor and tag to select.
#[derive(Debug, Clone, Default)]
pub struct Radio {
    /// The format.
    pub format: Format,
    /// The anchor that measures this robot's range. Only a plain port works without it: it takes lines without a name, and those
    /// with the first name seen.
    pub anchor: Option<String>,
    /// The tag that measures this robot's range [default: the first seen].
    pub tag: Option<String>,
}

impl Radio {
    pub(super) fn choice(self) -> Result<Choice> {
        if self.format != Format::Plain && self.anchor.is_none() {
            let why = format!(
                "--anchor is missing for --format {}: expected the id of the anchor that measures this robot's range",
                self.format
            );
            return Err(Error::new(ErrorKind::InvalidInput, why));
        }
        let is_given = self.anchor.is_some();
        Ok(Choice {
            anchor: self.anchor,
            is_given,
            tag: self.tag,
            without: 0,
            heard: Vec::new(),
            has_warned: [false; 3],
        })
    }
}

/// Selects one range of a report.
#[derive(Debug)]
pub(super) struct Choice {
    anchor: Option<String>,
    is_given: bool,
    tag: Option<String>,
    without: u32,
    heard: Vec<String>,
    /// Warnings given: of a missing anchor, other names, other tags.
    has_warned: [bool; 3],
}

impl Choice {
    /// This robot's range in a report, m.
    pub(super) fn range_m(&mut self, report: &RadioReport<'_>) -> Option<f64> {
        if let Some(tag) = report.tag {
            let wanted = self.tag.get_or_insert_with(|| tag.to_owned());
            if wanted != tag {
                if !std::mem::replace(&mut self.has_warned[2], true) {
                    log::warn!("port: uses the ranges of tag {wanted}, not of {tag}: choose with --tag ID");
                }
                return None;
            }
        }
        if !self.is_given {
            return self.range_of_first_name_m(report);
        }
        let anchor = self.anchor.as_deref().unwrap_or_default();
        let found = report.ranges.iter().find(|range| range.anchor.eq_ignore_ascii_case(anchor));
        if found.is_some() {
            self.has_warned[0] = true;
        } else if !self.has_warned[0] {
            self.note_missing(report);
        }
        found.map(|range| range.range_m)
    }

    /// A plain line's range, if the line has no name or the first name seen.
    fn range_of_first_name_m(&mut self, report: &RadioReport<'_>) -> Option<f64> {
        let range = report.ranges.first()?;
        if range.anchor.is_empty() {
            return Some(range.range_m);
        }
        let first = self.anchor.get_or_insert_with(|| range.anchor.clone());
        if *first == range.anchor {
            return Some(range.range_m);
        }
        if !std::mem::replace(&mut self.has_warned[1], true) {
            log::warn!("port: uses the ranges of {first:?}, not of {:?}: choose with --anchor ID", range.anchor);
        }
        None
    }

    fn note_missing(&mut self, report: &RadioReport<'_>) {
        for range in report.ranges {
            if self.heard.len() < NAMES_MAX && !self.heard.contains(&range.anchor) {
                self.heard.push(range.anchor.clone());
            }
        }
        self.without += 1;
        if self.without == REPORTS_WITHOUT_MAX {
            self.has_warned[0] = true;
            let anchor = self.anchor.as_deref().unwrap_or_default();
            let heard = if self.heard.is_empty() { "none".to_owned() } else { self.heard.join(", ") };
            log::warn!("port: no range from anchor {anchor:?}: check --anchor; ranges come from: {heard}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rangehound_shared::radio::Parser;

    fn chosen(radio: Radio, text: &str) -> Vec<Option<f64>> {
        let mut parser = Parser::new(radio.format);
        let (mut choice, mut ranges) = (radio.choice().unwrap(), Vec::new());
        parser.push(text.as_bytes(), |report| ranges.push(choice.range_m(&report.unwrap())));
        ranges
    }

    fn radio(format: Format, anchor: &str) -> Radio {
        Radio { format, anchor: Some(anchor.to_owned()), tag: None }
    }

    #[test]
    fn the_anchors_range_is_taken_and_never_the_quality() {
        let lines = "DIST,2,AN0,022E,7.94,8.03,0.00,3.44,AN1,15BA,0.00,8.03,0.00,6.71,POS,6.95,5.37,-1.97,52\n\
                     DIST,1,AN0,022E,7.94,8.03,0.00,3.40,POS,6.95,5.37,-1.97,53\nDIST,0\n";
        assert_eq!(chosen(radio(Format::Dwm1001, "15ba"), lines), [Some(6.71), None, None]);
        assert_eq!(chosen(radio(Format::Dwm1001, "022E"), lines), [Some(3.44), Some(3.4), None]);
    }

    #[test]
    fn ranges_of_others_are_not_mixed_in() {
        assert_eq!(chosen(Radio::default(), "A,5\nB,7\n6\nA,8\n"), [Some(5.0), None, Some(6.0), Some(8.0)]);
        assert_eq!(chosen(radio(Format::Plain, "B"), "A,5\nB,7\n6\n"), [None, Some(7.0), None]);
        let line = |tag| format!("AT+RANGE=tid:{tag},mask:01,seq:1,range:(92),ancid:(3)\n");
        let lines = [line(4), line(5), line(4)].concat();
        assert_eq!(chosen(radio(Format::Mauwb, "3"), &lines), [Some(0.92), None, Some(0.92)]);
        let other = Radio { tag: Some("5".to_owned()), ..radio(Format::Mauwb, "3") };
        assert_eq!(chosen(other, &lines), [None, Some(0.92), None]);
    }

    #[test]
    fn a_radio_with_several_anchors_needs_an_anchor_id() {
        let error = Radio { format: Format::Dwm1001, ..Radio::default() }.choice().unwrap_err();
        assert!(error.to_string().contains("--anchor is missing"), "{error}");
    }
}
