//! Names of runs.

use std::str::FromStr;

/// Longest run name: the names of the sockets in the run's folder must stay under 108 bytes.
const NAME_LEN_MAX: usize = 24;

/// A run's name: 1 to 24 of `a-z`, `A-Z`, `0-9`, `-`, `_`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RunName(String);

/// The text is not a valid [`RunName`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("expected {}", self.expected())]
pub struct RunNameError;

impl RunNameError {
    /// Description of a valid name.
    #[must_use]
    pub fn expected(self) -> &'static str {
        "a name of 1 to 24 letters, digits, '-' or '_'"
    }
}

impl FromStr for RunName {
    type Err = RunNameError;

    fn from_str(text: &str) -> Result<Self, RunNameError> {
        let allowed = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        if (1..=NAME_LEN_MAX).contains(&text.len()) && text.chars().all(allowed) {
            Ok(Self(text.to_owned()))
        } else {
            Err(RunNameError)
        }
    }
}

impl std::fmt::Display for RunName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.fmt(f)
    }
}
