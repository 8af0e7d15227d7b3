//! What is wrong with a scenario, in one line.

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
    /// A value that makes no sense.
    #[error("{file}: {key}: expected {expected}, got {got}")]
    Senseless {
        /// The file.
        file: String,
        /// Dotted path of the key.
        key: String,
        /// What the key takes.
        expected: String,
        /// What stood there.
        got: String,
    },
    /// A value that says, by itself, why it makes no sense.
    #[error("{file}: {key}: {problem}")]
    Unfit {
        /// The file.
        file: String,
        /// Dotted path of the key.
        key: String,
        /// What was expected and what came.
        problem: String,
    },
    /// The recording that the scenario names is unusable.
    #[error(transparent)]
    Recording(#[from] crate::recording::RecordingError),
}
