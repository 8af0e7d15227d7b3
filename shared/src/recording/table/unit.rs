//! Units of a log's columns.

/// The unit of a column. Numbers are converted to seconds, metres or radians.
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
    /// rad
    Radian,
    /// Degrees.
    Degree,
}

/// The quantity that a unit measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::recording) enum UnitKind {
    Time,
    Length,
    Angle,
}

impl UnitKind {
    pub(in crate::recording) const ALL: [Self; 3] = [Self::Time, Self::Length, Self::Angle];
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
            "rad" | "rads" | "radian" | "radians" => Self::Radian,
            "deg" | "degs" | "degree" | "degrees" | "\u{b0}" => Self::Degree,
            _ => return None,
        })
    }

    pub(in crate::recording) fn kind(self) -> UnitKind {
        match self {
            Self::Second | Self::Millisecond | Self::Microsecond | Self::Nanosecond | Self::Iso => UnitKind::Time,
            Self::Metre | Self::Centimetre | Self::Millimetre => UnitKind::Length,
            Self::Radian | Self::Degree => UnitKind::Angle,
        }
    }

    /// The power of ten from this unit to seconds, metres, or its own kind of angle.
    pub(in crate::recording) fn power_of_ten(self) -> i32 {
        match self {
            Self::Second | Self::Iso | Self::Metre | Self::Radian | Self::Degree => 0,
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
            Self::Radian => "rad",
            Self::Degree => "deg",
        }
    }
}
