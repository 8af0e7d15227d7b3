//! A run's file on disk: under a name that says that it is not finished, until it is.

use std::fs::File;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use anyhow::Context;
use mcap::McapError;
use rangehound_shared::bounded;
use rangehound_shared::rendezvous::RunDescription;

use super::SCENARIO;
use super::write::{FrameWriter, Written};
use crate::failure::Failure;
use crate::frame::Frame;
use crate::whole_file::{PARTIAL, with_ending};

/// Longest scenario file that is put in.
const SCENARIO_LEN_MAX: usize = 4 << 20;

/// The file in the making.
pub struct RunFile {
    path: PathBuf,
    partial: PathBuf,
    inode: u64,
    writer: FrameWriter<File>,
}

/// What the user must mend if a file cannot be made.
pub fn unusable(error: anyhow::Error) -> Failure {
    Failure::input(format!("expected a file that can be written: {error:#}"))
}

/// The name of a file that is not finished.
#[must_use]
pub fn partial(path: &Path) -> PathBuf {
    with_ending(path, PARTIAL)
}

impl RunFile {
    /// Begins the file of a run, with the scenario file of its folder if there is one.
    ///
    /// # Errors
    /// If it cannot be made.
    pub fn begin(path: &Path, description: &RunDescription, bytes_max: u64) -> anyhow::Result<Self> {
        let scenario = bounded::read(&description.out_dir.join(SCENARIO), SCENARIO_LEN_MAX).ok();
        Self::begin_as(&partial(path), path, description, scenario.as_deref(), bytes_max)
    }

    /// Begins the file of a run under this name until it is finished, with this scenario.
    ///
    /// # Errors
    /// If it cannot be made.
    pub fn begin_as(
        partial: &Path,
        path: &Path,
        description: &RunDescription,
        scenario: Option<&[u8]>,
        bytes_max: u64,
    ) -> anyhow::Result<Self> {
        // A forerunner that still writes keeps its file, but not the name: whoever comes last has that.
        let _ = std::fs::remove_file(partial);
        let file = File::create_new(partial).with_context(|| partial.display().to_string())?;
        let inode = file.metadata()?.ino();
        let writer = FrameWriter::begin(file, description, scenario, bytes_max).map_err(|error| {
            let _ = std::fs::remove_file(partial);
            named(partial, error.downcast().map_or_else(|error| error, of))
        })?;
        Ok(Self { path: path.to_owned(), partial: partial.to_owned(), inode, writer })
    }

    /// Writes a frame.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn write(&mut self, frame: &Frame) -> anyhow::Result<Written> {
        self.writer.write(frame).map_err(|error| named(&self.partial, of(error)))
    }

    /// Ends the chunk in the making if it is a second old.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn flush_if_due(&mut self) -> anyhow::Result<()> {
        self.writer.flush_if_due().map_err(|error| named(&self.partial, of(error)))
    }

    /// Writes index and summary, and gives the file its name.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn finish(self) -> anyhow::Result<()> {
        let Self { path, partial, inode, writer } = self;
        writer.finish().map_err(|error| named(&partial, of(error)))?;
        if std::fs::metadata(&partial).is_ok_and(|metadata| metadata.ino() == inode) {
            std::fs::rename(&partial, &path).with_context(|| path.display().to_string())?;
        }
        Ok(())
    }

    /// Takes the file away: there is nothing in it.
    pub fn discard(self) {
        drop(self.writer);
        let _ = std::fs::remove_file(&self.partial);
    }
}

/// What lies behind the library's word: it says that there was an error of the system, and not which.
fn of(error: McapError) -> anyhow::Error {
    match error {
        McapError::Io(error) => error.into(),
        other => other.into(),
    }
}

fn named(path: &Path, error: anyhow::Error) -> anyhow::Error {
    anyhow::anyhow!("{}: {error}", path.display())
}
