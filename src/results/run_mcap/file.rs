//! A run's file on disk. Its name marks it as unfinished until it is finished.

use std::fs::{File, Metadata, TryLockError};
use std::io::ErrorKind;
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use mcap::McapError;
use rangehound_node::rendezvous::RunDescription;
use rangehound_node::system::bounded;
use rustix::fs::OFlags;

use super::count::{Found, look, ticks_in_summary};
use super::write::{FrameWriter, Written};
use crate::failure::Failure;
use crate::files::atomic_file::{self, with_ending};
use crate::files::layout::PARTIAL;
use crate::files::layout::SCENARIO;
use crate::files::out_folder;
use crate::results::frame::Frame;

/// Longest scenario file that is attached.
const SCENARIO_LEN_MAX: usize = 4 << 20;

/// How long to wait for the lock of a killed process, and the interval between attempts.
const LOCK_RELEASE_MAX: Duration = Duration::from_millis(500);
const POLL: Duration = Duration::from_millis(20);

/// The unfinished file.
pub struct RunFile {
    path: PathBuf,
    partial: PathBuf,
    run_id: u64,
    /// An unfinished recording of the same run by a killed recorder, set aside until the new file holds more.
    leftover: Option<PathBuf>,
    /// Ticks written.
    taken: u64,
    writer: FrameWriter<File>,
}

/// The error for a file that cannot be created.
pub fn unusable(error: anyhow::Error) -> Failure {
    // The other causes end with what to do.
    let is_of_system = error.chain().any(|cause| cause.is::<std::io::Error>());
    let expected = if is_of_system { ": expected a file that can be written" } else { "" };
    Failure::input(format!("{error:#}{expected}"))
}

/// The name of an unfinished file.
#[must_use]
pub fn partial(path: &Path) -> PathBuf {
    with_ending(path, PARTIAL)
}

/// A recording with more ticks of the run exists already.
#[derive(Debug, thiserror::Error)]
#[error("{} holds {there} ticks of the run, but the logs only {made}: it is kept: move it away to record the run again", .path.display())]
pub struct FewerTicks {
    path: PathBuf,
    there: u64,
    made: u64,
}

impl RunFile {
    /// Creates the file of a run, with the scenario file of its folder if there is one.
    ///
    /// # Errors
    /// If it cannot be created.
    pub fn begin(path: &Path, description: &RunDescription, bytes_max: u64) -> anyhow::Result<Self> {
        let scenario = bounded::read(&description.out_dir.join(SCENARIO), SCENARIO_LEN_MAX).ok();
        Self::begin_as(&partial(path), path, description, scenario.as_deref(), bytes_max)
    }

    /// Creates the file of a run with this scenario; it gets its final name when it is finished.
    ///
    /// # Errors
    /// If it cannot be created, another process is writing it, or a file with one of its names is not a recording of this run.
    pub fn begin_as(
        partial: &Path,
        path: &Path,
        description: &RunDescription,
        scenario: Option<&[u8]>,
        bytes_max: u64,
    ) -> anyhow::Result<Self> {
        let run_id = description.run_id;
        if look(path, run_id) == Found::Foreign {
            bail!("{} exists already and is no recording of this run: choose another name", path.display());
        }
        let (file, leftover) = lock(partial, run_id)?;
        let writer = FrameWriter::begin(file, description, scenario, bytes_max).map_err(|error| {
            let _ = std::fs::remove_file(partial);
            give_back(leftover.as_deref(), partial);
            named(partial, error.downcast().map_or_else(|error| error, of))
        })?;
        Ok(Self { path: path.to_owned(), partial: partial.to_owned(), run_id, leftover, taken: 0, writer })
    }

    /// Writes a frame.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn write(&mut self, frame: &Frame) -> anyhow::Result<Written> {
        let written = self.writer.write(frame).map_err(|error| named(&self.partial, of(error)))?;
        self.taken += u64::from(written == Written::Taken);
        Ok(written)
    }

    /// Ends the current chunk if it is a second old.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn flush_if_due(&mut self) -> anyhow::Result<()> {
        self.writer.flush_if_due().map_err(|error| named(&self.partial, of(error)))
    }

    /// Writes index and summary, then gives the file its final name unless a recording with more ticks has that name.
    ///
    /// # Errors
    /// [`FewerTicks`]; also if the system refuses, or the file does not hold all that was written to it.
    pub fn finish(self) -> anyhow::Result<()> {
        let Self { path, partial, run_id, leftover, taken, writer } = self;
        let file = writer.finish().map_err(|error| named(&partial, of(error)))?;
        if !is_named(&file, &partial) {
            bail!("{} was renamed or removed by another process: record the run again", partial.display());
        }
        match ticks_in_summary(&file) {
            Some(ticks) if ticks == taken => {}
            ticks => bail!(
                "{} holds {} ticks, but {taken} were written: record the run again",
                partial.display(),
                ticks.unwrap_or(0)
            ),
        }
        let rename = match look(&path, run_id) {
            Found::Same(there) if there > taken => {
                let _ = std::fs::remove_file(&partial);
                give_back(leftover.as_deref(), &partial);
                return Err(FewerTicks { path, there, made: taken }.into());
            }
            Found::Same(_) => |from: &Path, to: &Path| std::fs::rename(from, to),
            Found::Nothing | Found::Foreign => atomic_file::rename_to_free,
        };
        out_folder::note_finished(&path, &file)
            .and_then(|()| rename(&partial, &path))
            .with_context(|| unwritable(&path))?;
        let is_fuller = |leftover: &Path| {
            let len = |file: std::io::Result<Metadata>| file.map_or(0, |file| file.len());
            // The length alone usually shows this, without reading the file.
            len(std::fs::metadata(leftover)) > len(file.metadata())
                && matches!(look(leftover, run_id), Found::Same(ticks) if ticks > taken)
        };
        match leftover {
            Some(leftover) if is_fuller(&leftover) => {
                give_back(Some(&leftover), &partial);
                log::warn!("{} holds more ticks than {}: both are kept", partial.display(), path.display());
            }
            Some(leftover) => drop(std::fs::remove_file(leftover)),
            None => {}
        }
        Ok(())
    }

    /// Removes the file, which holds no tick.
    pub fn discard(self) {
        drop(self.writer);
        let _ = std::fs::remove_file(&self.partial);
        give_back(self.leftover.as_deref(), &self.partial);
    }
}

/// Creates the file under its unfinished name and locks it, so that only one process writes it. An unfinished recording
/// of the same run by a killed process is set aside; its name is returned.
fn lock(partial: &Path, run_id: u64) -> anyhow::Result<(File, Option<PathBuf>)> {
    let named = || unwritable(partial);
    let path = partial.display();
    let began = Instant::now();
    loop {
        let opened = File::options().read(true).write(true).create_new(true).open(partial);
        let (file, is_new) = match opened {
            Ok(file) => (file, true),
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {
                let flags = OFlags::NOFOLLOW.bits().cast_signed();
                match File::options().read(true).write(true).custom_flags(flags).open(partial) {
                    Ok(file) => (file, false),
                    Err(error) if error.kind() == ErrorKind::NotFound => continue,
                    Err(error) => return Err(error).with_context(named),
                }
            }
            Err(error) => return Err(error).with_context(named),
        };
        match file.try_lock() {
            Err(TryLockError::WouldBlock) if began.elapsed() < LOCK_RELEASE_MAX => {
                std::thread::sleep(POLL);
                continue;
            }
            Err(TryLockError::WouldBlock) => {
                bail!("another process is writing {path}: wait for its end, or choose another name with --out");
            }
            // On a file system without locks, recording works all the same.
            Ok(()) | Err(TryLockError::Error(_)) => {}
        }
        if !is_named(&file, partial) {
            continue;
        }
        if is_new || file.metadata().with_context(named)?.len() == 0 {
            out_folder::note_growing(partial).with_context(named)?;
            return Ok((file, None));
        }
        if !matches!(look(partial, run_id), Found::Same(_)) && !out_folder::is_ours(partial) {
            bail!("{path} exists already and is no recording of this run: move it away");
        }
        let aside = with_ending(partial.with_extension("").as_path(), &format!(".{}{PARTIAL}", std::process::id()));
        atomic_file::rename_to_free(partial, &aside).with_context(named)?;
        out_folder::note_growing(&aside).with_context(named)?;
        let made = File::options().read(true).write(true).create_new(true).open(partial).with_context(named)?;
        // The new file is locked before the old lock is released.
        let locked = made.try_lock();
        if matches!(locked, Err(TryLockError::WouldBlock)) {
            bail!("another process is writing {path}: wait for its end");
        }
        out_folder::note_growing(partial).with_context(named)?;
        return Ok((made, Some(aside)));
    }
}

/// Restores the name of a recording that was set aside.
fn give_back(leftover: Option<&Path>, partial: &Path) {
    if let Some(leftover) = leftover {
        let _ = atomic_file::rename_to_free(leftover, partial).and_then(|()| out_folder::note_growing(partial));
    }
}

fn is_named(file: &File, path: &Path) -> bool {
    let identity = |file: std::io::Result<Metadata>| file.map(|file| (file.dev(), file.ino())).ok();
    let of_file = identity(file.metadata());
    of_file.is_some() && of_file == identity(path.symlink_metadata())
}

/// The cause of an error: the library reports that the system failed, but not how.
fn of(error: McapError) -> anyhow::Error {
    match error {
        McapError::Io(error) => error.into(),
        other => other.into(),
    }
}

fn unwritable(path: &Path) -> String {
    format!("cannot write {}", path.display())
}

fn named(path: &Path, error: anyhow::Error) -> anyhow::Error {
    error.context(unwritable(path))
}
