//! `plan`: one step per JSON line, so that programs of any language can use the planners.
//!
//! [`mod@line`] is the pure part: a line in, a line out. This module reads and writes. Output line `n` answers the `n`-th
//! input line that is not blank.

pub mod line;
pub mod schema;

use std::fs::File;
use std::io::{self, BufRead, BufReader, BufWriter, ErrorKind, Read, Write};
use std::path::Path;

use rangehound_shared::scenario::{PlannerTable, defaults};

use crate::failure::{self, Failure};
use crate::run::experiment::Flag;
use line::LineSolver;

/// Longest accepted line, bytes: some 300 000 robots.
const LINE_BYTES_MAX: usize = 16 << 20;

/// Bytes read or written at once.
const CHUNK_BYTES: usize = 1 << 16;

/// `rangehound plan`: answers the lines of a file, or of standard input. `flags` are the keys of the table that flags set.
///
/// # Errors
/// [`Failure`].
pub fn plan(table: PlannerTable, flags: &[Flag], seed: Option<u64>, file: Option<&Path>) -> Result<(), Failure> {
    let solver = LineSolver::new(table, seed.unwrap_or(defaults::SEED));
    let mut solver = solver.map_err(|error| Failure::input(error.by_flag(flags)))?;
    let (name, input): (String, Box<dyn Read>) = match file {
        Some(path) if path != Path::new("-") => {
            let name = path.display().to_string();
            let file = File::open(path).map_err(|error| unreadable(&name, &error))?;
            (name, Box::new(file))
        }
        _ => ("standard input".to_owned(), Box::new(io::stdin().lock())),
    };
    let complain = |number: u64, problem: &str| {
        // If standard error is closed, the line's answer still has the error.
        failure::complain_at(problem, &format!("{name}, line {number}"));
    };
    match serve(&mut solver, input, io::stdout().lock(), LINE_BYTES_MAX, complain) {
        Ok(0) => Ok(()),
        Ok(_) => Err(Failure::ReportedInput),
        Err(Stopped::Reading(error)) => Err(unreadable(&name, &error)),
        // The reader has closed the pipe.
        Err(Stopped::Writing(error)) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        Err(Stopped::Writing(error)) => {
            Err(anyhow::Error::new(error).context("cannot write to standard output").into())
        }
    }
}

fn unreadable(name: &str, error: &io::Error) -> Failure {
    Failure::input(format!("cannot read {name}: {error}: expected a file of JSON lines"))
}

/// Why reading or writing stopped.
#[derive(Debug)]
enum Stopped {
    Reading(io::Error),
    Writing(io::Error),
}

/// Answers all lines, and returns the number of refused ones; `complain` is called for each of them.
///
/// Answers are flushed before each read that may wait, so that a program that writes one line gets its answer. A line
/// longer than `line_bytes_max` is dropped and refused.
fn serve(
    solver: &mut LineSolver,
    input: impl Read,
    output: impl Write,
    line_bytes_max: usize,
    mut complain: impl FnMut(u64, &str),
) -> Result<u64, Stopped> {
    let mut input = BufReader::with_capacity(CHUNK_BYTES, input);
    let mut output = BufWriter::with_capacity(CHUNK_BYTES, output);
    let (mut line, mut is_too_long) = (Vec::new(), false);
    let mut answer = Vec::new();
    let (mut number, mut refused) = (1, 0);
    loop {
        if input.buffer().is_empty() {
            output.flush().map_err(Stopped::Writing)?;
        }
        let chunk = match input.fill_buf() {
            Ok(chunk) => chunk,
            Err(error) if error.kind() == ErrorKind::Interrupted => continue,
            Err(error) => return Err(Stopped::Reading(error)),
        };
        let is_end = chunk.is_empty();
        let newline = chunk.iter().position(|byte| *byte == b'\n');
        let part = &chunk[..newline.unwrap_or(chunk.len())];
        if line.len() + part.len() > line_bytes_max {
            is_too_long = true;
            line.clear();
        } else if !is_too_long {
            line.extend_from_slice(part);
        }
        let taken = part.len() + usize::from(newline.is_some());
        input.consume(taken);
        if newline.is_none() && !is_end {
            continue;
        }
        answer.clear();
        let problem = if is_too_long {
            let problem = format!("the line is too long: expected at most {line_bytes_max} bytes");
            line::refuse(number, &problem, &mut answer);
            Some(problem)
        } else if line.trim_ascii().is_empty() {
            None
        } else {
            solver.answer(number, &line, &mut answer)
        };
        if let Some(problem) = problem {
            refused += 1;
            complain(number, &problem);
        }
        output.write_all(&answer).map_err(Stopped::Writing)?;
        if is_end {
            output.flush().map_err(Stopped::Writing)?;
            return Ok(refused);
        }
        line.clear();
        is_too_long = false;
        number += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const GOOD: &str =
        r#"{"prior_position_covariance":[[4,0.5],[0.5,2]],"target":[0,0],"time_step_s":0.1,"robots":[]}"#;

    /// The answers, and the numbers of the refused lines.
    fn served(input: impl Read, line_bytes_max: usize) -> (Vec<String>, Vec<u64>) {
        let mut solver = LineSolver::new(PlannerTable::default(), 1).unwrap();
        let (mut output, mut complaints) = (Vec::new(), Vec::new());
        let refused = serve(&mut solver, input, &mut output, line_bytes_max, |number, _| complaints.push(number));
        assert_eq!(refused.unwrap(), complaints.len() as u64);
        let output = String::from_utf8(output).unwrap();
        assert!(output.is_empty() || output.ends_with('\n'));
        (output.lines().map(str::to_owned).collect(), complaints)
    }

    /// Gives a few bytes at a time, as a slow pipe does.
    struct Dripping<'a>(&'a [u8], usize);

    impl Read for Dripping<'_> {
        fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
            let count = self.1.min(buffer.len()).min(self.0.len());
            buffer[..count].copy_from_slice(&self.0[..count]);
            self.0 = &self.0[count..];
            Ok(count)
        }
    }

    #[test]
    fn a_line_over_the_limit_is_refused_and_the_next_is_read() {
        let long = format!("{GOOD}{}", " ".repeat(200_000));
        let text = format!("{GOOD}\n{long}\n{GOOD}\n\n{long}");
        for step in [1, 7, usize::MAX] {
            let (answers, complaints) = served(Dripping(text.as_bytes(), step), GOOD.len());
            assert_eq!(complaints, [2, 5]);
            let kinds: Vec<bool> = answers.iter().map(|answer| answer.contains("\"error\"")).collect();
            assert_eq!(kinds, [false, true, false, true]);
        }
    }

    #[test]
    fn line_ends_of_any_kind_and_none_at_the_end() {
        let text = format!("\r\n{GOOD}\r\n \t\n{GOOD}");
        let (answers, complaints) = served(text.as_bytes(), LINE_BYTES_MAX);
        assert_eq!((answers.len(), complaints.len()), (2, 0));
        assert_eq!(served(&b""[..], LINE_BYTES_MAX), (Vec::new(), Vec::new()));
    }

    proptest! {
        /// Lines may arrive in any pieces: each line that is not blank gets one answer.
        #[test]
        fn every_line_that_is_not_blank_has_one_answer(
            lines in proptest::collection::vec(prop_oneof![
                proptest::collection::vec(any::<u8>(), 0..40), Just(GOOD.as_bytes().to_vec()), Just(vec![b' '; 3]),
            ], 0..8),
            step in 1..50_usize,
        ) {
            let text = lines.join(&b'\n');
            let expected = text.split(|byte| *byte == b'\n').filter(|line| !line.trim_ascii().is_empty()).count();
            prop_assert_eq!(served(Dripping(&text, step), LINE_BYTES_MAX).0.len(), expected);
        }
    }
}
