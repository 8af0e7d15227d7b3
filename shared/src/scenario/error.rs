//! Faults of a scenario, as one line.

/// Why a scenario was refused. Displays as one line that names the file, the key and what was
/// expected there.
#[derive(Debug, thiserror::Error)]
pub enum ScenarioError {
    /// Not TOML, an unknown key, or a value of the wrong type.
    #[error("{file}:{line}: {key}: {problem}")]
    Malformed {
        /// The file.
        file: String,
        /// Line, counted from 1.
        line: usize,
        /// Dotted path of the key.
        key: String,
        /// What was found and what was expected.
        problem: String,
    },
    /// An invalid value.
    #[error("{file}: {key}: expected {expected}, got {got}")]
    Senseless {
        /// The file.
        file: String,
        /// Dotted path of the key.
        key: String,
        /// The expected value.
        expected: String,
        /// The value found.
        got: String,
    },
    /// An invalid value with its own explanation.
    #[error("{file}: {key}: {problem}")]
    Unfit {
        /// The file.
        file: String,
        /// Dotted path of the key.
        key: String,
        /// What was expected and what was given.
        problem: String,
    },
    /// The recording that the scenario names is unusable.
    #[error(transparent)]
    Recording(#[from] crate::recording::RecordingError),
}
