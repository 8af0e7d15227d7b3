//! Two slots to which a node's state is written alternately, pure: the newest valid one counts.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::sealed::{self, SealError};

/// Bytes before the sealed state: its length.
pub const LEN_BYTES: usize = 4;

/// The contents of a slot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Slot<T> {
    run_id: u64,
    /// Number of the state, counted from 1.
    pub sequence: u64,
    /// The state.
    pub state: T,
}

/// Why no state can be used although a slot was written.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unusable {
    /// The state is another run's.
    #[error("of another run")]
    OtherRun,
    /// The state is damaged, or of another build or kind.
    #[error(transparent)]
    Sealed(#[from] SealError),
}

/// Writer of the slots: chooses the next slot and makes its bytes.
#[derive(Debug, Default)]
pub struct SlotWriter {
    run_id: u64,
    sequence: u64,
    bytes: Vec<u8>,
}

impl SlotWriter {
    /// A writer for a run after the state of this number; 0 if there is none.
    #[must_use]
    pub fn after(run_id: u64, sequence: u64) -> Self {
        Self { run_id, sequence, bytes: Vec::new() }
    }

    /// Makes the bytes of the next state: [`Self::bytes`]. Allocates nothing unless the state is larger than all before.
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

    /// The bytes made by [`Self::encode`].
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// The slot for the next state: not the one with the newest state.
    #[must_use]
    pub fn next_slot(&self) -> usize {
        slot_of(self.sequence + 1)
    }

    /// The slot with the newest state, if any.
    #[must_use]
    pub fn newest_slot(&self) -> usize {
        slot_of(self.sequence)
    }

    /// Marks the next state as completely written.
    pub fn written(&mut self) {
        self.sequence += 1;
    }
}

fn slot_of(sequence: u64) -> usize {
    (sequence % 2) as usize
}

/// The newest state of a run in two slots, `None` if neither was written.
///
/// # Errors
/// [`Unusable`] if a slot was written, but none holds a state of this run.
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
