//! Failures of commands: one line and an exit code.

use std::fmt::Write as _;
use std::io::{ErrorKind, Write};
use std::process::ExitCode;

use rangehound_node::system::limits;
use serde::Serialize;

use crate::terminal::{self, BAD};

/// Longest error message, bytes: the text that it quotes may be as long as a file.
const MESSAGE_BYTES_MAX: usize = 400;

/// Why a command failed.
#[derive(Debug)]
pub enum Failure {
    /// Bad usage or bad input: exit code 2.
    Input(String),
    /// Bad input that has already been reported, line by line: exit code 2.
    ReportedInput,
    /// Failed while running: exit code 1.
    Running(anyhow::Error),
}

impl Failure {
    /// A failure because of the user's input.
    pub fn input(problem: impl std::fmt::Display) -> Self {
        Self::Input(problem.to_string())
    }

    /// Reports to the user in one line, and returns the exit code.
    #[must_use]
    pub fn report(&self) -> ExitCode {
        match self {
            Self::Input(problem) => {
                complain(problem);
                ExitCode::from(2)
            }
            Self::ReportedInput => ExitCode::from(2),
            Self::Running(error) => {
                complain(&with_causes(error));
                ExitCode::from(1)
            }
        }
    }
}

fn complain(problem: &str) {
    print_stderr(format_args!("{BAD}rangehound:{BAD:#} {}", one_short_line(problem)));
}

/// Reports a problem at a place on standard error, in one line. A long problem is cut, but its place is always there.
pub fn complain_at(problem: &str, place: &str) {
    print_stderr(format_args!("{BAD}rangehound:{BAD:#} {}", located(one_short_line(problem), one_short_line(place))));
}

/// The message of an error that does not know its place, with the place between what is wrong and what was expected.
#[must_use]
pub fn located(error: impl std::fmt::Display, place: impl std::fmt::Display) -> String {
    let message = error.to_string();
    match message.split_once(": ") {
        Some((wrong, expected)) => format!("{wrong} in {place}: {expected}"),
        None => format!("{message} in {place}"),
    }
}

/// An error with its causes, each once: many errors quote their cause themselves. If a limit of the system was reached,
/// it is named.
#[must_use]
pub fn with_causes(error: &anyhow::Error) -> String {
    let mut message = error.to_string();
    for cause in error.chain().skip(1).map(ToString::to_string) {
        if !message.contains(&cause) {
            let _ = write!(message, ": {cause}");
        }
    }
    let refusal = error.chain().find_map(|cause| limits::explain(cause.downcast_ref()?));
    if let Some(limit) = refusal {
        let _ = write!(message, ": {limit}");
    }
    message
}

/// The message on one line of limited length, whatever it quotes.
#[must_use]
pub fn one_short_line(problem: &str) -> String {
    let mut short = String::new();
    for character in problem.chars() {
        if short.len() >= MESSAGE_BYTES_MAX {
            short.push_str("...");
            break;
        }
        if character.is_control() { short.extend(character.escape_default()) } else { short.push(character) }
    }
    short
}

/// Writes a line to standard error. If that is closed, the line is dropped: `eprintln!` would panic.
pub fn print_stderr(line: impl std::fmt::Display) {
    let _ = terminal::write_above_bar(format_args!("{line}\n"));
}

/// Prints to standard output. A closed pipe is not a failure. Unlike `println!`, it never panics.
///
/// # Errors
/// [`Failure::Running`], such as a full disk's.
pub fn print(text: impl std::fmt::Display) -> Result<(), Failure> {
    print_if_read(text).map(drop)
}

/// The same; false if the reader has closed the pipe.
///
/// # Errors
/// As [`print()`].
pub fn print_if_read(text: impl std::fmt::Display) -> Result<bool, Failure> {
    let mut out = terminal::stream(std::io::stdout().lock());
    match write!(out, "{text}").and_then(|()| out.flush()) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(false),
        Err(error) => Err(anyhow::Error::new(error).context("cannot write to standard output").into()),
    }
}

/// Prints a value as one line of JSON.
///
/// # Errors
/// [`Failure::Running`], as [`print()`].
pub fn print_json(value: &impl Serialize) -> Result<(), Failure> {
    print(serde_json::to_string(value)? + "\n")
}

impl<E: Into<anyhow::Error>> From<E> for Failure {
    fn from(error: E) -> Self {
        Self::Running(error.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quoted_cause_is_not_repeated() {
        let cause = || std::io::Error::other("no room");
        assert_eq!(with_causes(&anyhow::Error::new(cause()).context("a: no room")), "a: no room");
        assert_eq!(with_causes(&anyhow::Error::new(cause()).context("a")), "a: no room");
    }

    #[test]
    fn a_complaint_is_one_line_whatever_it_quotes() {
        let line = one_short_line(&format!("a\nb\u{1b}[2J{}", "x".repeat(100_000)));
        assert!(line.starts_with("a\\nb\\u{1b}[2Jxx") && line.len() < 500, "{line}");
    }
}
