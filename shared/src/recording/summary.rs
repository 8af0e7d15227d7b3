//! The reader's findings in a recording.

use serde::{Deserialize, Serialize};

use super::SensorName;

/// A reader's findings besides the measurements.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct ReadSummary {
    /// Measurements in the recording: each has a range, a bearing or both.
    pub rows: u64,
    /// Unusable rows: empty, with a text instead of a number, or with a negative range or standard deviation.
    pub bad_rows: u64,
    /// The first fault: its line, its column, and the value found.
    pub first_bad_row: Option<String>,
    /// Rows equal to an earlier one in all that was read. They add no information and are left out.
    pub repeats: u64,
    /// Ranges of exactly 0 (in a wide log also -1), which loggers write if nothing was heard. They are left out.
    pub not_heard: u64,
    /// Rows of other targets than the requested one.
    pub other_targets: u64,
    /// Columns that were not read.
    pub ignored_columns: Vec<String>,
    /// Anchors of the anchors file without a measurement in the log.
    pub silent_anchors: Vec<SensorName>,
    /// How the file was read, in one line: separator, decimal mark, columns and their units.
    pub read_as: String,
    /// Reasons to doubt the interpretation of the file.
    pub doubts: Vec<Doubt>,
}

/// A reason to distrust a recording that could be read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Doubt {
    /// Kind of the reason.
    pub kind: DoubtKind,
    /// A sentence for the user: the finding, its likely cause, and the option to type in that case.
    pub text: String,
}

/// Kinds of reasons to distrust a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DoubtKind {
    /// Ranges are far longer than the sensors' distances allow: they are in another unit.
    RangesFarBeyondSensors,
    /// Ranges are far shorter than the sensors' distances allow: positions or ranges are in another unit.
    RangesFarBelowSensors,
    /// Stamps have steps so large that they are in another unit.
    TimesInAnotherUnit,
}

impl ReadSummary {
    /// Messages for the user, one line for each fact; empty if every row was read.
    #[must_use]
    pub fn lines(&self) -> Vec<String> {
        let mut lines = Vec::new();
        if self.bad_rows > 0 {
            let first = self.first_bad_row.as_deref().unwrap_or("unknown");
            lines.push(format!("{} skipped, the first: {first}", count(self.bad_rows, "bad row")));
        }
        if self.repeats > 0 {
            lines.push(format!("{} dropped: equal to an earlier row", count(self.repeats, "repeated row")));
        }
        if self.not_heard > 0 {
            lines.push(format!("{} with range 0 left out (no measurement)", count(self.not_heard, "row")));
        }
        if self.other_targets > 0 {
            lines.push(format!("{} of other targets left out", count(self.other_targets, "row")));
        }
        if !self.ignored_columns.is_empty() {
            lines.push(format!("columns not read: {}", self.ignored_columns.join(", ")));
        }
        if !self.silent_anchors.is_empty() {
            let names: Vec<&str> = self.silent_anchors.iter().map(SensorName::as_str).collect();
            lines.push(format!("anchors without a range: {}", names.join(", ")));
        }
        lines.extend(self.doubts.iter().map(|doubt| doubt.text.clone()));
        lines
    }
}

fn count(count: u64, what: &str) -> String {
    format!("{count} {what}{}", if count == 1 { "" } else { "s" })
}
