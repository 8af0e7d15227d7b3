//! Two places that a node's state is written to in turns, pure: the newest whole one counts.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::sealed::{self, SealError};

/// Bytes before the sealed state: its length.
pub const LEN_BYTES: usize = 4;

/// What a slot holds.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Slot<T> {
    run_id: u64,
    /// Counts the states that were written, from 1.
    pub sequence: u64,
    /// The state.
    pub state: T,
}

/// Why no state can be used although something was written.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unusable {
    /// It is another run's.
    #[error("of another run")]
    OtherRun,
    /// It is not whole, or of another build or kind.
    #[error(transparent)]
    Sealed(#[from] SealError),
}

/// What is written to the slots: which of the two is next, and its bytes.
#[derive(Debug, Default)]
pub struct Turns {
    run_id: u64,
    sequence: u64,
    bytes: Vec<u8>,
}

impl Turns {
    /// The turns of a run after the state of this number; 0 if there is none.
    #[must_use]
    pub fn after(run_id: u64, sequence: u64) -> Self {
        Self { run_id, sequence, bytes: Vec::new() }
    }

    /// Makes the bytes of the next state: [`Self::bytes`]. Allocates nothing once it has made as many.
    ///
    /// # Errors
    /// [`SealError`] if it cannot be encoded, or is too large for any reader.
    pub fn encode(&mut self, state: &impl Serialize) -> Result<(), SealError> {
        let Self { run_id, sequence, bytes } = self;
        bytes.clear();
        bytes.extend([0; LEN_BYTES]);
        sealed::seal_into(&Slot { run_id: *run_id, sequence: *sequence + 1, state }, bytes)?;
        let len = (bytes.len() - LEN_BYTES) as u32;
        bytes[..LEN_BYTES].copy_from_slice(&len.to_le_bytes());
        Ok(())
    }

    /// What [`Self::encode`] made.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// The slot that the next state is written to: not the one that has the newest.
    #[must_use]
    pub fn next_slot(&self) -> usize {
        slot_of(self.sequence + 1)
    }

    /// The slot that has the newest state, if there is one.
    #[must_use]
    pub fn newest_slot(&self) -> usize {
        slot_of(self.sequence)
    }

    /// The next state has been written wholly.
    pub fn written(&mut self) {
        self.sequence += 1;
    }
}

fn slot_of(sequence: u64) -> usize {
    (sequence % 2) as usize
}

/// The newest state of a run in two slots, `None` if nothing was written to either.
///
/// # Errors
/// [`Unusable`] if something was, but holds no state of this run.
pub fn newest<T: DeserializeOwned>(slots: [Option<&[u8]>; 2], run_id: u64) -> Result<Option<Slot<T>>, Unusable> {
    let (mut newest, mut unusable) = (None::<Slot<T>>, None);
    for bytes in slots.into_iter().flatten() {
        match open::<T>(bytes) {
            Ok(slot) if slot.run_id != run_id => unusable = Some(Unusable::OtherRun),
            Ok(slot) if newest.as_ref().is_some_and(|newest| newest.sequence > slot.sequence) => {}
            Ok(slot) => newest = Some(slot),
            Err(reason) => unusable = Some(reason.into()),
        }
    }
    match (newest, unusable) {
        (None, Some(unusable)) => Err(unusable),
        (newest, _) => Ok(newest),
    }
}

fn open<T: DeserializeOwned>(bytes: &[u8]) -> Result<Slot<T>, SealError> {
    let (len, sealed) = bytes.split_first_chunk::<LEN_BYTES>().ok_or(SealError::Damaged)?;
    if sealed.len() != u32::from_le_bytes(*len) as usize {
        return Err(SealError::Damaged);
    }
    sealed::open(sealed)
}
