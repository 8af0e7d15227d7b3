//! Terminal output: lines of at most 80 columns, colours only on terminals that show them, and lines that do not
//! overwrite the progress bar.

use std::fmt::Display;
use std::io::{IsTerminal, Write};
use std::sync::{Mutex, PoisonError};

use anstream::{AutoStream, ColorChoice, stream::RawStream};
use anstyle::{AnsiColor, Style};
use indicatif::ProgressBar;
use log::Level;

/// Columns that output for people keeps to, where no path or message of the system is longer.
pub const WIDTH: usize = 80;

/// What the rest belongs to.
pub const TITLE: Style = Style::new().bold();

/// As it should be.
pub const GOOD: Style = AnsiColor::Green.on_default();

/// To be looked at.
pub const DOUBTFUL: Style = AnsiColor::Yellow.on_default();

/// Gone, failed, broken.
pub const BAD: Style = AnsiColor::Red.on_default().bold();

/// Columns of the labels of a report, with the space on both sides.
const LABEL: usize = 19;

/// The bar that is on the terminal, if one is.
static BAR: Mutex<Option<ProgressBar>> = Mutex::new(None);

/// A stream that takes colours out unless it ends at a terminal that shows them, and `NO_COLOR` does not forbid it.
pub fn stream<S: RawStream>(raw: S) -> AutoStream<S> {
    let choice = if is_dumb() { ColorChoice::Never } else { AutoStream::choice(&raw) };
    AutoStream::new(raw, choice)
}

/// True if standard error can be drawn over: a terminal, and one that moves its cursor.
#[must_use]
pub fn draws_on_stderr() -> bool {
    std::io::stderr().is_terminal() && !is_dumb()
}

/// The same of standard output.
#[must_use]
pub fn draws_on_stdout() -> bool {
    std::io::stdout().is_terminal() && !is_dumb()
}

fn is_dumb() -> bool {
    std::env::var_os("TERM").is_some_and(|term| term == "dumb")
}

/// Puts a bar on the terminal, or takes the one that is there away.
pub fn set_bar(bar: Option<ProgressBar>) {
    *BAR.lock().unwrap_or_else(PoisonError::into_inner) = bar;
}

/// Writes to standard error above the bar.
///
/// # Errors
/// Those of writing.
pub fn write_above_bar(text: impl Display) -> std::io::Result<()> {
    // The lock is not held while writing, which may be slow: another thread may want to end the bar.
    let bar = BAR.lock().unwrap_or_else(PoisonError::into_inner).clone();
    let write = || write!(stream(std::io::stderr().lock()), "{text}");
    match bar {
        Some(bar) => bar.suspend(write),
        None => write(),
    }
}

/// Empties the screen that standard output is, and goes to its top.
///
/// # Errors
/// Those of writing.
pub fn clear_screen() -> std::io::Result<()> {
    std::io::stdout().write_all(b"\x1b[H\x1b[2J")
}

/// Starts the log on standard error: for a person, without stamps and above the bar; for files, with stamps.
pub fn start_log() {
    let mut log = env_logger::Builder::from_env(env_logger::Env::default().default_filter_or("warn"));
    log.format_target(false);
    if draws_on_stderr() {
        log.target(env_logger::Target::Pipe(Box::new(AboveBar)));
        log.format(|out, record| {
            let (style, level) = match record.level() {
                Level::Error => (BAD, "error"),
                Level::Warn => (DOUBTFUL, "warning"),
                Level::Info => (Style::new(), "info"),
                Level::Debug | Level::Trace => (Style::new(), "debug"),
            };
            writeln!(out, "{style}{level}:{style:#} {}", record.args())
        });
    }
    log.init();
}

/// Where the log goes on a terminal.
struct AboveBar;

impl Write for AboveBar {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        write_above_bar(String::from_utf8_lossy(bytes)).map(|()| bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// A line of a report, `  label            text`, broken after commas where it gets too long.
#[must_use]
pub fn field(label: &str, text: impl Display) -> String {
    field_in(Style::new(), label, text)
}

/// The same, its label in a style.
#[must_use]
pub fn field_in(style: Style, label: &str, text: impl Display) -> String {
    labelled(style, label, |indent| wrapped(&text.to_string(), indent))
}

/// The same for sentences, broken between any two words.
#[must_use]
pub fn prose_in(style: Style, label: &str, text: impl Display) -> String {
    labelled(style, label, |indent| broken(&text.to_string(), indent, " "))
}

fn labelled(style: Style, label: &str, text: impl FnOnce(usize) -> String) -> String {
    let indent = LABEL.max(label.chars().count() + 3);
    let padding = " ".repeat(indent - 2 - label.chars().count());
    format!("  {style}{label}{style:#}{padding}{}", text(indent))
}

/// Text that begins in a column, broken after commas so that each part stays in [`WIDTH`] if it can, and goes on below its
/// beginning.
#[must_use]
pub fn wrapped(text: &str, indent: usize) -> String {
    broken(text, indent, ", ")
}

fn broken(text: &str, indent: usize, separator: &str) -> String {
    let mut out = String::new();
    let mut column = indent;
    for part in text.split_inclusive(separator) {
        let length = part.trim_end().chars().count();
        if column > indent && column + length > WIDTH {
            out.truncate(out.trim_end().len());
            out.push('\n');
            out.push_str(&" ".repeat(indent));
            column = indent;
        }
        out.push_str(part);
        column += part.chars().count();
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_lines_go_on_below_their_beginning() {
        let items: Vec<String> = (0..30).map(|number| format!("item {number}")).collect();
        let text = field("label", items.join(", "));
        assert!(text.starts_with("  label            item 0, item 1,"), "{text}");
        for line in text.lines().skip(1) {
            assert!(line.starts_with(&format!("{}item ", " ".repeat(LABEL))), "{line:?}");
        }
        assert!(text.lines().all(|line| line.len() <= WIDTH && line == line.trim_end()), "{text}");
        let words: Vec<&str> = text.split_whitespace().skip(1).collect();
        assert_eq!(words.join(" "), items.join(", "));
    }

    #[test]
    fn unbreakable_text_stays_in_one_piece() {
        let path = "x".repeat(100);
        assert_eq!(wrapped(&path, 10), path);
        assert_eq!(field("a label of its own", "b"), "  a label of its own b");
    }

    #[test]
    fn a_style_takes_no_column() {
        let text = field_in(BAD, "label", "text");
        assert_eq!(anstream::adapter::strip_str(&text).to_string(), field("label", "text"));
        assert_ne!(text, field("label", "text"));
    }

    #[test]
    fn sentences_are_broken_between_words() {
        let text = prose_in(Style::new(), "label", "one two ".repeat(30));
        assert!(text.lines().count() > 2 && text.lines().all(|line| line.len() <= WIDTH), "{text}");
    }
}
