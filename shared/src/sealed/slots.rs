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

/// Replaces `bytes` by a slot with this state. Allocates nothing once it has written one as large.
///
/// # Errors
/// [`SealError`] if it cannot be encoded, or is too large for any reader.
pub fn write(run_id: u64, sequence: u64, state: &impl Serialize, bytes: &mut Vec<u8>) -> Result<(), SealError> {
    bytes.clear();
    bytes.extend([0; LEN_BYTES]);
    sealed::seal_into(&Slot { run_id, sequence, state }, bytes)?;
    let len = (bytes.len() - LEN_BYTES) as u32;
    bytes[..LEN_BYTES].copy_from_slice(&len.to_le_bytes());
    Ok(())
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
