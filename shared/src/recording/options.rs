//! How a recording is to be read.

/// What the user says of a recording's form. The default is a CSV with our own columns.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ReadOptions {
    /// Refuse the file at its first bad row, rather than pass the row over and count it.
    pub strict: bool,
}
