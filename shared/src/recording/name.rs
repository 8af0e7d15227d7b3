//! Names of sensors in recordings.

use std::cmp::Ordering;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

/// Longest name, bytes: a UUID, a MAC address, or a topic of a bag.
const LEN_MAX: usize = 64;

/// The name of a sensor: any text of one line, kept as in the file.
///
/// Names sort naturally: integers first, by value, then all others by their text. A sensor's position in
/// this order is its robot's id in the run.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct SensorName(Arc<str>);

/// The text is not a valid name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a name of 1 to {LEN_MAX} bytes without control characters")]
pub struct SensorNameError;

impl SensorName {
    /// The name as text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }

    fn number(&self) -> Option<u64> {
        self.0.parse().ok()
    }
}

impl std::str::FromStr for SensorName {
    type Err = SensorNameError;

    fn from_str(text: &str) -> Result<Self, SensorNameError> {
        let text = text.trim();
        let is_name = (1..=LEN_MAX).contains(&text.len()) && !text.chars().any(char::is_control);
        if is_name { Ok(Self(text.into())) } else { Err(SensorNameError) }
    }
}

impl std::fmt::Display for SensorName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(&self.0)
    }
}

impl Ord for SensorName {
    fn cmp(&self, other: &Self) -> Ordering {
        let by_number = match (self.number(), other.number()) {
            (Some(one), Some(two)) => one.cmp(&two),
            (Some(_), None) => Ordering::Less,
            (None, Some(_)) => Ordering::Greater,
            (None, None) => Ordering::Equal,
        };
        by_number.then_with(|| self.0.cmp(&other.0))
    }
}

impl PartialOrd for SensorName {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Serialize for SensorName {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.0)
    }
}

/// A scenario may write a name as text or as an integer.
impl<'de> Deserialize<'de> for SensorName {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged, expecting = "expected a sensor's name: text or a whole number")]
        enum Written {
            Number(u64),
            Text(String),
        }
        let text = match Written::deserialize(deserializer)? {
            Written::Number(number) => number.to_string(),
            Written::Text(text) => text,
        };
        text.parse().map_err(serde::de::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_order_as_people_count() {
        let mut names: Vec<SensorName> =
            ["b", "10", "anchor-3", "9", "a"].iter().map(|text| text.parse().unwrap()).collect();
        names.sort();
        assert_eq!(names.iter().map(SensorName::as_str).collect::<Vec<_>>(), ["9", "10", "a", "anchor-3", "b"]);
    }

    #[test]
    fn a_name_is_one_short_line() {
        assert_eq!(" 5C:F3:70:8B:12:AE ".parse::<SensorName>().unwrap().as_str(), "5C:F3:70:8B:12:AE");
        for text in ["", "  ", "a\nb", "\u{1b}[31m", &"x".repeat(65)] {
            assert_eq!(text.parse::<SensorName>(), Err(SensorNameError), "{text:?}");
        }
    }
}
