//! Faults of a scenario, as one line.

/// Why a scenario was refused. Displays as one line: what is wrong, in which key and file, and what was expected there.
#[derive(Debug, thiserror::Error)]
pub enum ScenarioError {
    /// Not TOML.
    #[error("{problem} in {file}:{line}: expected {expected}")]
    NotToml {
        /// The file.
        file: String,
        /// Line, counted from 1.
        line: usize,
        /// The problem.
        problem: String,
        /// The expected text.
        expected: String,
    },
    /// An unknown key, or a value of the wrong type.
    #[error("{problem} in {file}:{line}, key {key}: expected {expected}")]
    WrongKey {
        /// The file.
        file: String,
        /// Line, counted from 1.
        line: usize,
        /// Dotted path of the key.
        key: String,
        /// The problem.
        problem: String,
        /// The expected key or value.
        expected: String,
    },
    /// An invalid value.
    #[error("{key} is {got} in {file}: expected {expected}")]
    WrongValue {
        /// The file.
        file: String,
        /// Dotted path of the key.
        key: String,
        /// The expected value.
        expected: String,
        /// The value found.
        got: String,
    },
    /// The same, of a value that a flag gave.
    #[error("{flag} is {got}: expected {expected}")]
    WrongFlag {
        /// The flag.
        flag: String,
        /// The expected value.
        expected: String,
        /// The value found.
        got: String,
    },
    /// The recording that the scenario names is unusable.
    #[error(transparent)]
    Recording(#[from] crate::recording::RecordingError),
}

impl ScenarioError {
    /// The same, but with the flag in place of the key if the user typed the value as a flag. `flags` are the keys that the
    /// command line gave, each with its flag.
    #[must_use]
    pub fn by_flag(self, flags: &[(&str, &str)]) -> Self {
        match self {
            Self::WrongValue { file, key, expected, got } => {
                match flags.iter().find(|(of_flag, _)| is_of(&key, of_flag)) {
                    Some((_, flag)) => Self::WrongFlag { flag: (*flag).to_owned(), expected, got },
                    None => Self::WrongValue { file, key, expected, got },
                }
            }
            other => other,
        }
    }
}

/// Whether `key` is the key of a flag; `list[].field` stands for that field of each entry of a list.
fn is_of(key: &str, of_flag: &str) -> bool {
    let Some((list, field)) = of_flag.split_once("[]") else { return key == of_flag };
    let entry = key.strip_prefix(list).and_then(|rest| rest.strip_prefix('['));
    entry.and_then(|rest| rest.split_once(']')).is_some_and(|(_, of_entry)| of_entry == field)
}
