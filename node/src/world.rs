//! The simulator's world: simulated, or played back from the run folder's copy of a recording.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rangehound_shared::recording::{ReadOptions, Recording, RecordingError};
use rangehound_shared::scenario::{COPY, RecordedRanges, Scenario};
use rangehound_sim::World;

/// Why a recording cannot be played.
#[derive(Debug, thiserror::Error)]
pub enum PlaybackError {
    /// The run folder's copy cannot be read.
    #[error("the run's own copy of its recording cannot be read: {0}")]
    Unreadable(#[from] RecordingError),
    /// The run folder's copy differs from what was read when the run began.
    #[error(
        "{} has changed since the run began: expected the copy that the run made of its recording: start a new run",
        .0.display()
    )]
    Changed(PathBuf),
}

/// The world of a scenario at tick 0. If this process has not read the recording itself, it reads the copy in the run
/// folder.
///
/// # Errors
/// [`PlaybackError`] if that copy cannot be read or has changed.
pub fn world_of(scenario: &Scenario, run_folder: &Path) -> Result<Box<dyn World>, PlaybackError> {
    rangehound_sim::world_of(scenario, |ranges| read_copy(ranges, &run_folder.join(COPY)))
}

fn read_copy(ranges: &RecordedRanges, path: &Path) -> Result<Arc<Recording>, PlaybackError> {
    let file = File::open(path).map_err(|error| RecordingError::unreadable(path, &error))?;
    let (recording, _) = Recording::parse(file, path, &ReadOptions::default())?;
    if recording.digest() != ranges.digest {
        return Err(PlaybackError::Changed(path.to_owned()));
    }
    Ok(Arc::new(recording))
}
