//! The per-tick logs of fusion and the simulator in the run folder.

use std::path::{Path, PathBuf};

use rangehound_shared::record::{FusionRecord, WorldRecord};

use crate::rendezvous::RunDescription;
use crate::tick_log::{TickLogError, TickLogReader, TickLogWriter};

/// Fusion's log in a run folder.
pub const ESTIMATES: &str = "estimate.ticks";

/// The simulator's log in a run folder.
pub const WORLDS: &str = "world.ticks";

/// Path of fusion's log.
#[must_use]
pub fn estimates_path(out_dir: &Path) -> PathBuf {
    out_dir.join(ESTIMATES)
}

/// Path of the simulator's log.
#[must_use]
pub fn worlds_path(out_dir: &Path) -> PathBuf {
    out_dir.join(WORLDS)
}

/// Opens fusion's log for writing.
///
/// # Errors
/// If the file cannot be opened.
pub fn write_estimates(run: &RunDescription) -> Result<TickLogWriter<FusionRecord>, TickLogError> {
    TickLogWriter::open(&estimates_path(&run.out_dir), run.run_id, FusionRecord::of(&run.scenario))
}

/// Opens fusion's log for reading.
///
/// # Errors
/// If the file cannot be read.
pub fn read_estimates(run: &RunDescription) -> Result<TickLogReader<FusionRecord>, TickLogError> {
    TickLogReader::open(&estimates_path(&run.out_dir), run.run_id, FusionRecord::of(&run.scenario))
}

/// Opens the simulator's log for writing.
///
/// # Errors
/// If the file cannot be opened.
pub fn write_worlds(run: &RunDescription) -> Result<TickLogWriter<WorldRecord>, TickLogError> {
    TickLogWriter::open(&worlds_path(&run.out_dir), run.run_id, WorldRecord::of(&run.scenario))
}

/// Opens the simulator's log for reading.
///
/// # Errors
/// If the file cannot be read.
pub fn read_worlds(run: &RunDescription) -> Result<TickLogReader<WorldRecord>, TickLogError> {
    TickLogReader::open(&worlds_path(&run.out_dir), run.run_id, WorldRecord::of(&run.scenario))
}
