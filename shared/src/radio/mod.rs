//! Strict readers of ranging radios' output: a line or frame is accepted completely, or refused and counted, never misread.
//!
//! | format | radio | one report |
//! |---|---|---|
//! | [`Format::Plain`] | any | a line `12.34` or `A,12.34`, m |
//! | [`Format::Dwm1001`] | Qorvo DWM1001, its shell's `lec` or `les` | a line with several anchors, their positions and ranges, m |
//! | [`Format::Linktrack`] | Nooploop LinkTrack, `NodeFrame3` | a binary frame with several nodes, mm |
//! | [`Format::Mauwb`] | Makerfabs MaUWB, `AT+RANGE=` | a line with up to 16 anchors, cm |
//!
//! [`Parser`] reads bytes from a port, [`log`] a complete log of a port. These radios report an anchor that was not heard as a
//! range of 0; such ranges are left out.

#[cfg(test)]
mod damage;
mod decimal;
mod dwm1001;
mod lines;
mod linktrack;
pub mod log;
mod mauwb;
mod parser;
mod plain;
mod stamp;

use std::fmt;
use std::str::FromStr;

pub use lines::LINE_LEN_MAX;
pub use parser::{Counts, Parser, RadioReport};
pub use stamp::{StampUnit, UnknownUnit};

/// Largest range that one of these radios can report, m; an `int24` of mm ends at 8388 m.
const RANGE_MAX_M: f64 = 10_000.0;

/// The output format of a radio.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Format {
    /// One range per line, with or without the sensor's name before it.
    #[default]
    Plain,
    /// The shell of a DWM1001, `lec` or `les`.
    Dwm1001,
    /// `NodeFrame3` of a LinkTrack.
    Linktrack,
    /// `AT+RANGE=` of a MaUWB.
    Mauwb,
}

impl Format {
    /// Every format.
    pub const ALL: [Self; 4] = [Self::Plain, Self::Dwm1001, Self::Linktrack, Self::Mauwb];

    /// Its name on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Plain => "plain",
            Self::Dwm1001 => "dwm1001",
            Self::Linktrack => "linktrack",
            Self::Mauwb => "mauwb",
        }
    }

    /// A sample report of this format, for messages.
    #[must_use]
    pub const fn sample(self) -> &'static str {
        match self {
            Self::Plain => "lines like 12.34 or A,12.34",
            Self::Dwm1001 => "lines like DIST,1,AN0,022E,7.94,8.03,0.00,3.44 or 022E[7.94,8.03,0.00]=3.44",
            Self::Linktrack => "NodeFrame3 frames, which begin with 55 05",
            Self::Mauwb => "lines like AT+RANGE=tid:0,mask:01,seq:65,range:(92,0),ancid:(0,-1)",
        }
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Format {
    type Err = UnknownFormat;

    fn from_str(text: &str) -> Result<Self, UnknownFormat> {
        Self::ALL.into_iter().find(|format| format.name() == text).ok_or(UnknownFormat)
    }
}

/// The text is not the name of a format.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("expected plain, dwm1001, linktrack or mauwb")]
pub struct UnknownFormat;

/// One range of a report.
#[derive(Debug, Clone, PartialEq)]
pub struct RadioRange {
    /// The anchor's id as the radio prints it; empty for a plain line without a name.
    pub anchor: String,
    /// The anchor's position as the radio prints it, m.
    pub anchor_position_m: Option<[f64; 3]>,
    /// The range, m, greater than 0.
    pub range_m: f64,
    /// Signal strength, dBm.
    pub rssi_dbm: Option<f64>,
}

/// One range of a log.
#[derive(Debug, Clone, PartialEq)]
pub struct LogRow {
    /// Time, s, on the log's own clock.
    pub time_s: f64,
    /// The anchor's id as the radio prints it.
    pub anchor: String,
    /// The anchor's position as the radio prints it, m.
    pub position_m: Option<[f64; 3]>,
    /// The range, m.
    pub range_m: f64,
}

/// Why a line or frame was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// It is longer than any report.
    #[error("too long")]
    TooLong,
    /// It is not text.
    #[error("not text")]
    NotText,
    /// The stream ended within it.
    #[error("cut off by the end of the stream")]
    Cut,
    /// It does not follow the format.
    #[error("not in the format")]
    Malformed,
    /// It names an anchor twice.
    #[error("damaged, it names an anchor twice")]
    AnchorTwice,
    /// Its checksum is wrong.
    #[error("damaged, its checksum is wrong")]
    Checksum,
}

/// Adds a range, unless the anchor was not heard.
fn add(ranges: &mut Vec<RadioRange>, range: RadioRange) -> Result<(), Refusal> {
    if ranges.iter().any(|known| known.anchor.eq_ignore_ascii_case(&range.anchor)) {
        return Err(Refusal::AnchorTwice);
    }
    ranges.push(range);
    Ok(())
}
