//! What was read of a recording, and what was not.

/// Counts of a recording's rows.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ReadSummary {
    /// Rows whose range is in the recording.
    pub rows: u64,
}
