//! What was read of a recording, and what was not.

use serde::{Deserialize, Serialize};

use super::SensorName;

/// What a reader found in a recording beside its ranges.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct ReadSummary {
    /// Ranges in the recording.
    pub rows: u64,
    /// Rows that could not be used: empty, without a number where one belongs, with a negative range.
    pub bad_rows: u64,
    /// What was wrong with the first of them: its line, its column, what stood there.
    pub first_bad_row: Option<String>,
    /// Rows equal to an earlier one in stamp, sensor, position and range. They say nothing new and are left out.
    pub repeats: u64,
    /// Ranges of exactly 0 (in a wide log also -1), which loggers write where nothing was heard. They are left out.
    pub not_heard: u64,
    /// Rows of other targets than the one that was asked for.
    pub other_targets: u64,
    /// Columns that were not read.
    pub ignored_columns: Vec<String>,
    /// Anchors of the anchors file of which the log has no range.
    pub silent_anchors: Vec<SensorName>,
    /// How the file was read, in one line: separator, decimal mark, columns and their units.
    pub read_as: String,
    /// Why the file may say something else than it seems to.
    pub doubts: Vec<Doubt>,
}

/// A reason to distrust a recording that could be read.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Doubt {
    /// What kind of reason it is.
    pub kind: DoubtKind,
    /// A sentence for the user: what was found, what it is likely to mean, what to type if so.
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
    /// Stamps step by so much that they are in another unit.
    TimesInAnotherUnit,
}

impl ReadSummary {
    /// What the user should know, a line for each fact; empty where every row was read.
    #[must_use]
    pub fn lines(&self) -> Vec<String> {
        let mut lines = Vec::new();
        if self.bad_rows > 0 {
            let first = self.first_bad_row.as_deref().unwrap_or("unknown");
            lines.push(format!("{} passed over, the first: {first}", count(self.bad_rows, "bad row")));
        }
        if self.repeats > 0 {
            lines.push(format!("{} dropped: equal to an earlier row", count(self.repeats, "repeated row")));
        }
        if self.not_heard > 0 {
            lines.push(format!("{} of 0 left out: nothing was heard", count(self.not_heard, "range")));
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
