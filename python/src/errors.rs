//! Exceptions: the one line that the program would print.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use pyo3::create_exception;
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use rangehound::failure::{Failure, one_short_line, with_causes};
use rangehound::files::bytes_read::BytesRead;
use rangehound::results::report::Truth;

create_exception!(
    rangehound,
    InputError,
    PyValueError,
    "Input that the user must mend: what is wrong, and what was expected."
);
create_exception!(rangehound, RunError, PyRuntimeError, "A failure while running.");

/// The exception for invalid input.
pub(crate) fn input(problem: impl ToString) -> PyErr {
    InputError::new_err(one_short_line(&problem.to_string()))
}

/// The exception for a failure. One that Python raised in the course of it is raised again as it was.
pub(crate) fn failed(failure: impl Into<Failure>) -> PyErr {
    match failure.into() {
        Failure::Running(error) => match error.downcast::<PyErr>() {
            Ok(raised) => raised,
            Err(error) => RunError::new_err(one_short_line(&with_causes(&error))),
        },
        Failure::Input(problem) => input(problem),
        Failure::ReportedInput => input("invalid input"),
    }
}

/// How long a call works until Python can act on signals.
const POLL_INTERVAL: Duration = Duration::from_millis(5);

/// Reads in a thread, so that Python can act on signals meanwhile, and show `progress`, a function of the bytes that have been read and of
/// all. After a signal, or an exception of `progress`, nobody waits for the thread.
pub(crate) fn interruptible<T: Send + 'static>(
    py: Python<'_>,
    progress: Option<&Py<PyAny>>,
    work: impl FnOnce(&BytesRead) -> PyResult<T> + Send + 'static,
) -> PyResult<T> {
    let bytes = BytesRead::default();
    let of_work = bytes.clone();
    let work = move || work(&of_work);
    let mut shown = [0; 2];
    let mut show = || -> PyResult<()> {
        let now = bytes.get();
        match progress.filter(|_| now != shown) {
            Some(progress) => progress.call1(py, (now[0], now[1])).map(drop)?,
            None => return Ok(()),
        }
        shown = now;
        Ok(())
    };
    let worker = std::thread::Builder::new().name("reader".to_owned()).spawn(work);
    let worker = worker.map_err(|error| failed(anyhow::Error::from(error)))?;
    while !worker.is_finished() {
        py.detach(|| std::thread::sleep(POLL_INTERVAL));
        py.check_signals()?;
        show()?;
    }
    let read = worker.join().map_err(|_| failed(anyhow::anyhow!("the reader panicked: please report this")))?;
    let read = read?;
    let [_, all] = bytes.get();
    // A reader may stop before an index that it does not need.
    if let Some(progress) = progress.filter(|_| all > 0 && shown != [all, all]) {
        progress.call1(py, (all, all))?;
    }
    Ok(read)
}

/// Reads a track of the truth, if one is named, in the way of [`interruptible`].
pub(crate) fn read_truth(py: Python<'_>, path: Option<PathBuf>) -> PyResult<Option<Truth>> {
    path.map(|path| interruptible(py, None, move |_| Truth::read(&path).map_err(failed))).transpose()
}

/// The first exception of a Python function that Rust has called where no error can be returned.
#[derive(Debug, Clone, Default)]
pub(crate) struct Raised(Arc<Mutex<Option<PyErr>>>);

impl Raised {
    /// Stores an exception, unless there is one.
    pub(crate) fn set(&self, error: PyErr) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
    }

    /// True if a function has raised an exception: it is not called again.
    pub(crate) fn is_set(&self) -> bool {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).is_some()
    }

    /// The exception as an error.
    pub(crate) fn check(&self) -> PyResult<()> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take().map_or(Ok(()), Err)
    }
}
