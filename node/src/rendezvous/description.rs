//! What a run is, as its founder leaves it for all others.

use std::path::PathBuf;

use rangehound_shared::scenario::Scenario;
use rangehound_shared::sealed::{self, SealError};
use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::xxh3_64;

/// What every node of a run must know.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunDescription {
    /// Tells this run from every other, of the same name too.
    pub run_id: u64,
    /// The experiment.
    pub scenario: Scenario,
    /// The run folder, absolute: logs and report.
    pub out_dir: PathBuf,
}

impl RunDescription {
    /// A new run of this scenario.
    #[must_use]
    pub fn new(scenario: Scenario, out_dir: PathBuf) -> Self {
        let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
        let mut unique = [0; 20];
        unique[..16].copy_from_slice(&now.as_nanos().to_le_bytes());
        unique[16..].copy_from_slice(&std::process::id().to_le_bytes());
        Self { run_id: xxh3_64(&unique), scenario, out_dir }
    }

    /// The description in sealed bytes.
    ///
    /// # Errors
    /// [`SealError`], for what no build of this protocol has sealed.
    pub fn open(bytes: &[u8]) -> Result<Self, SealError> {
        let description: Self = sealed::open(bytes)?;
        if description.scenario.is_whole() { Ok(description) } else { Err(SealError::Malformed) }
    }
}
