//! Checkpoint files in memory, which a kill may leave half written.

use rangehound_shared::sealed::slots::{self, Turns};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// All runs are one: nothing of another lies here.
const RUN_ID: u64 = 1;

/// One file.
#[derive(Debug, Clone, Default)]
pub(super) struct Disk {
    slots: [Vec<u8>; 2],
    /// The number of the state that was written wholly to each, as far as it still is.
    whole: [Option<u64>; 2],
    newest: u64,
}

impl Disk {
    /// Writes a state in its turn, or only this share of it.
    ///
    /// # Errors
    /// A sentence, if it cannot be encoded.
    pub(super) fn write(&mut self, turns: &mut Turns, state: &impl Serialize, share: f64) -> Result<(), String> {
        turns.encode(state).map_err(|error| error.to_string())?;
        let (index, bytes) = (turns.next_slot(), turns.bytes());
        let is_torn = share < 1.0;
        let written = if is_torn { (bytes.len() as f64 * share) as usize } else { bytes.len() };
        let slot = &mut self.slots[index];
        slot.resize(slot.len().max(written), 0);
        slot[..written].copy_from_slice(&bytes[..written]);
        if !is_torn {
            slot.truncate(written);
        }
        // The rest may be what stood there before.
        let is_complete = slot == bytes;
        self.newest += u64::from(is_complete);
        self.whole[index] = is_complete.then_some(self.newest);
        if !is_torn {
            turns.written();
        }
        Ok(())
    }

    /// The newest state and the turns after it, for the process that goes on from here.
    ///
    /// # Errors
    /// A sentence, if it is not the newest one that was written wholly.
    pub(super) fn read<T: DeserializeOwned>(&self) -> Result<(Option<T>, Turns), String> {
        let slots = self.slots.each_ref().map(|slot| Some(slot.as_slice()).filter(|slot| !slot.is_empty()));
        let was_written = self.whole.iter().any(Option::is_some);
        match slots::newest::<T>(slots, RUN_ID) {
            Err(_) | Ok(None) if !was_written => Ok((None, Turns::after(RUN_ID, 0))),
            Err(unusable) => Err(format!("a whole checkpoint was refused: {unusable}")),
            Ok(None) => Err("a whole checkpoint was not found".to_owned()),
            Ok(Some(slot)) => {
                let turns = Turns::after(RUN_ID, slot.sequence);
                match self.whole[turns.newest_slot()] {
                    None => Err("a torn checkpoint was trusted".to_owned()),
                    whole if whole < self.whole.into_iter().max().flatten() => {
                        Err("an older checkpoint was taken than the newest".to_owned())
                    }
                    _ => Ok((Some(slot.state), turns)),
                }
            }
        }
    }

    /// A file of its own with the newest state alone.
    pub(super) fn moved(&self, turns: &Turns) -> Self {
        let mut moved = Self { newest: self.newest, ..Self::default() };
        let index = turns.newest_slot();
        moved.slots[index].clone_from(&self.slots[index]);
        moved.whole[index] = self.whole[index];
        moved
    }
}
