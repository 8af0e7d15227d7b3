//! Terminal output: lines of at most 80 columns, colours only on terminals that show them, and lines that do not
//! overwrite the progress bar.

use std::fmt::Display;
use std::io::{IsTerminal, Write};
use std::sync::{Mutex, PoisonError};

use anstream::{AutoStream, ColorChoice, stream::RawStream};
use anstyle::{AnsiColor, Style};
use indicatif::ProgressBar;
use log::Level;

/// Columns of output for people; only paths and messages of the system may be longer.
pub const WIDTH: usize = 80;

/// A title.
pub const TITLE: Style = Style::new().bold();

/// A good state.
pub const GOOD: Style = AnsiColor::Green.on_default();

/// A state that needs attention.
pub const DOUBTFUL: Style = AnsiColor::Yellow.on_default();

/// A failure.
pub const BAD: Style = AnsiColor::Red.on_default().bold();

/// Columns of the labels of a report, with the space on both sides.
const LABEL: usize = 19;

/// The progress bar on the terminal, if there is one.
static BAR: Mutex<Option<ProgressBar>> = Mutex::new(None);

/// A stream that removes colours, unless it goes to a terminal that shows them and `NO_COLOR` is not set.
pub fn stream<S: RawStream>(raw: S) -> AutoStream<S> {
    let choice = if is_dumb() { ColorChoice::Never } else { AutoStream::choice(&raw) };
    AutoStream::new(raw, choice)
}

/// True if standard error is a terminal that can move its cursor.
#[must_use]
pub fn draws_on_stderr() -> bool {
    std::io::stderr().is_terminal() && !is_dumb()
}

/// True if standard output is such a terminal.
#[must_use]
pub fn draws_on_stdout() -> bool {
    std::io::stdout().is_terminal() && !is_dumb()
}

fn is_dumb() -> bool {
    std::env::var_os("TERM").is_some_and(|term| term == "dumb")
}

/// Sets the progress bar that is on the terminal, or none.
pub fn set_bar(bar: Option<ProgressBar>) {
    *BAR.lock().unwrap_or_else(PoisonError::into_inner) = bar;
}

/// Writes to standard error above the progress bar.
///
/// # Errors
/// If writing fails.
pub fn write_above_bar(text: impl Display) -> std::io::Result<()> {
    // Writing may be slow, so the lock is released first: another thread may need to remove the bar.
    let bar = BAR.lock().unwrap_or_else(PoisonError::into_inner).clone();
    let write = || write!(stream(std::io::stderr().lock()), "{text}");
    match bar {
        Some(bar) => bar.suspend(write),
        None => write(),
    }
}

/// Clears the terminal of standard output and moves the cursor to its top.
///
/// # Errors
/// If writing fails.
pub fn clear_screen() -> std::io::Result<()> {
    std::io::stdout().write_all(b"\x1b[H\x1b[2J")
}

/// Starts the log on standard error: without time stamps and above the bar on a terminal, with time stamps elsewhere.
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

/// The destination of the log on a terminal.
struct AboveBar;

impl Write for AboveBar {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        write_above_bar(String::from_utf8_lossy(bytes)).map(|()| bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// A number of things: `1 run`, `2 runs`.
#[must_use]
pub fn counted(count: impl Display, what: &str) -> String {
    let count = count.to_string();
    let s = if count == "1" { "" } else { "s" };
    format!("{count} {what}{s}")
}

/// A line of a report, `  label            text`, broken after commas if it is too long.
#[must_use]
pub fn field(label: &str, text: impl Display) -> String {
    field_in(Style::new(), label, text)
}

/// As [`field`], with the label in a style.
#[must_use]
pub fn field_in(style: Style, label: &str, text: impl Display) -> String {
    labelled(style, label, |indent| wrapped(&text.to_string(), indent))
}

/// As [`field_in`] for sentences, broken between words.
#[must_use]
pub fn prose_in(style: Style, label: &str, text: impl Display) -> String {
    labelled(style, label, |indent| broken(&text.to_string(), indent, " "))
}

fn labelled(style: Style, label: &str, text: impl FnOnce(usize) -> String) -> String {
    let indent = LABEL.max(label.chars().count() + 3);
    let padding = " ".repeat(indent - 2 - label.chars().count());
    format!("  {style}{label}{style:#}{padding}{}", text(indent))
}

/// Text that begins in a column, broken after commas so that each line fits in [`WIDTH`] if possible. Further lines are
/// indented to the same column.
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
    fn one_thing_is_counted_in_the_singular() {
        assert_eq!([0, 1, 2].map(|count| counted(count, "run")), ["0 runs", "1 run", "2 runs"]);
    }

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
