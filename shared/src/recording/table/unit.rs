//! Units of a log's columns.

/// The unit of a column. Numbers are converted to seconds or metres.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::recording) enum Unit {
    /// s
    Second,
    /// ms
    Millisecond,
    /// us
    Microsecond,
    /// ns
    Nanosecond,
    /// Date and time of day by ISO 8601.
    Iso,
    /// m
    Metre,
    /// cm
    Centimetre,
    /// mm
    Millimetre,
}

impl Unit {
    /// The unit for a word in lower case.
    pub(in crate::recording) fn from_word(word: &str) -> Option<Self> {
        Some(match word {
            "s" | "sec" | "secs" | "second" | "seconds" => Self::Second,
            "ms" | "msec" | "msecs" | "millis" | "millisecond" | "milliseconds" => Self::Millisecond,
            "us" | "\u{b5}s" | "\u{3bc}s" | "usec" | "usecs" | "micros" | "microsecond" | "microseconds" => {
                Self::Microsecond
            }
            "ns" | "nsec" | "nsecs" | "nanos" | "nanosecond" | "nanoseconds" => Self::Nanosecond,
            "iso" | "iso8601" => Self::Iso,
            "m" | "meter" | "meters" | "metre" | "metres" => Self::Metre,
            "cm" | "centimeter" | "centimeters" | "centimetre" | "centimetres" => Self::Centimetre,
            "mm" | "millimeter" | "millimeters" | "millimetre" | "millimetres" => Self::Millimetre,
            _ => return None,
        })
    }

    pub(in crate::recording) fn is_of_time(self) -> bool {
        !matches!(self, Self::Metre | Self::Centimetre | Self::Millimetre)
    }

    /// The power of ten from this unit to seconds or metres.
    pub(in crate::recording) fn power_of_ten(self) -> i32 {
        match self {
            Self::Second | Self::Iso | Self::Metre => 0,
            Self::Centimetre => -2,
            Self::Millisecond | Self::Millimetre => -3,
            Self::Microsecond => -6,
            Self::Nanosecond => -9,
        }
    }

    /// As in `--columns`.
    pub(in crate::recording) fn symbol(self) -> &'static str {
        match self {
            Self::Second => "s",
            Self::Millisecond => "ms",
            Self::Microsecond => "us",
            Self::Nanosecond => "ns",
            Self::Iso => "iso",
            Self::Metre => "m",
            Self::Centimetre => "cm",
            Self::Millimetre => "mm",
        }
    }
}
