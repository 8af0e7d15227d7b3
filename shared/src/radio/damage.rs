//! Damaged lines: a line is read as the radio measured it, or refused.

use proptest::prelude::*;

use super::parser::Text;
use super::{Format, Refusal};

const LEC: [&str; 2] = [
    "DIST,3,AN0,022E,7.94,8.03,0.00,3.44,AN1,15BA,0.00,8.03,0.00,16.71,AN2,0C25,0.00,0.00,2.50,8.31,POS,6.95,5.37,-1.97,52",
    "DIST,3,AN0,022E,7.94,8.03,0.00,3.61,AN1,15BA,0.00,8.03,0.00,16.55,AN2,0C25,0.00,0.00,2.50,8.12,POS,6.80,5.30,-1.90,99",
];
const LES: [&str; 2] = [
    "022E[7.94,8.03,0.00]=3.44 15BA[0.00,8.03,0.00]=16.71 le_us=2576 est[6.95,5.37,-1.97,52]",
    "022E[7.94,8.03,0.00]=3.61 15BA[0.00,8.03,0.00]=16.55 le_us=2580 est[6.80,5.30,-1.90,99]",
];
const MAUWB: [&str; 2] = [
    "AT+RANGE=tid:0,mask:07,seq:65,range:(92,1201,415,0),rssi:(-70.11,-71.20,-69.00,0.00),ancid:(5,7,11,-1)",
    "AT+RANGE=tid:0,mask:07,seq:66,range:(95,1190,430,0),rssi:(-70.15,-71.00,-69.50,0.00),ancid:(5,7,11,-1)",
];
const VALID: [(Format, [&str; 2]); 3] = [(Format::Dwm1001, LEC), (Format::Dwm1001, LES), (Format::Mauwb, MAUWB)];

/// Anchor, its position and its range, as parsed from a valid line.
type Reading = (String, Option<[u64; 3]>, u64);

fn read(format: Format, line: &str) -> Result<Vec<Reading>, Refusal> {
    let mut text = Text::new(format);
    let valid = VALID.iter().find(|(known, _)| *known == format).map_or("", |(_, lines)| lines[0]);
    assert!(text.read(valid).is_ok_and(|report| report.is_some()));
    let report = text.read(line)?;
    Ok(report.map_or(Vec::new(), |report| {
        let reading = |range: &super::RadioRange| {
            (range.anchor.clone(), range.anchor_position_m.map(|at| at.map(f64::to_bits)), range.range_m.to_bits())
        };
        report.ranges.iter().map(reading).collect()
    }))
}

/// True if everything read from a line was sent.
fn is_true(format: Format, sent: &[&str], line: &str) -> bool {
    let sent: Vec<Reading> = sent.iter().flat_map(|line| read(format, line).unwrap()).collect();
    read(format, line).map_or(true, |taken| taken.iter().all(|reading| sent.contains(reading)))
}

#[test]
fn a_line_that_is_cut_anywhere_is_refused_or_true() {
    for (format, lines) in VALID {
        let line = lines[0];
        assert!(read(format, line).unwrap().len() >= 2);
        for at in 0..line.len() {
            assert!(is_true(format, &lines, &line[..at]), "{}", &line[..at]);
            assert!(is_true(format, &lines, &line[at..]), "{}", &line[at..]);
            // The line end was lost: the start of the next line follows directly.
            let glued = format!("{}{}", &line[..at], lines[1]);
            assert!(is_true(format, &lines, &glued), "{glued}");
        }
    }
}

#[test]
fn no_line_is_true_as_another_format() {
    for (format, lines) in VALID {
        for other in Format::ALL.into_iter().filter(|other| *other != format && *other != Format::Linktrack) {
            let mut text = Text::new(other);
            assert!(text.read(lines[0]).is_err(), "{other}: {}", lines[0]);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2_000))]

    /// Fields are lost, doubled, or mixed from two lines.
    #[test]
    fn lines_that_are_interleaved_or_have_gaps_are_refused_or_true(
        which in 0..VALID.len(), cuts in proptest::collection::vec((any::<prop::sample::Index>(), any::<bool>()), 1..6),
    ) {
        let (format, lines) = VALID[which];
        let fields = lines.map(|line| line.split_inclusive([',', ' ']).collect::<Vec<_>>());
        let (mut mixed, mut from) = (String::new(), [0; 2]);
        for (to, is_second) in cuts {
            let line = usize::from(is_second);
            let to = to.index(fields[line].len() + 1);
            let piece = from[line].min(to)..to.max(from[line]);
            mixed.extend(fields[line][piece].iter().copied());
            from[line] = to;
        }
        // The comma stays at the end: without it, a doubled field looks like a normal range.
        prop_assert!(is_true(format, &lines, &mixed), "{mixed}");
    }
}
