//! How a command ends when it does not end well: one line and an exit code.

use std::process::ExitCode;

/// Why a command failed.
#[derive(Debug)]
pub enum Failure {
    /// Bad usage or bad input: exit code 2.
    Input(String),
    /// Bad input that has been told already, line by line: exit code 2.
    ToldInput,
    /// Failed while running: exit code 1.
    Running(anyhow::Error),
}

impl Failure {
    /// A failure of what the user gave.
    pub fn input(problem: impl std::fmt::Display) -> Self {
        Self::Input(problem.to_string())
    }

    /// Tells the user, in one line, and gives the exit code.
    #[must_use]
    pub fn report(&self) -> ExitCode {
        match self {
            Self::Input(problem) => {
                eprintln!("rangehound: {problem}");
                ExitCode::from(2)
            }
            Self::ToldInput => ExitCode::from(2),
            Self::Running(error) => {
                eprintln!("rangehound: {error:#}");
                ExitCode::from(1)
            }
        }
    }
}

impl<E: Into<anyhow::Error>> From<E> for Failure {
    fn from(error: E) -> Self {
        Self::Running(error.into())
    }
}
