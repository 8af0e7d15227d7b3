//! Checkpoint files in memory, which a kill may leave half written.

use rangehound_shared::sealed::slots;
use serde::Serialize;
use serde::de::DeserializeOwned;

/// All runs are one: nothing of another lies here.
const RUN_ID: u64 = 1;

/// One role's file.
#[derive(Debug, Clone, Default)]
pub(super) struct Disk {
    slots: [Vec<u8>; 2],
    is_whole: [bool; 2],
    sequence: u64,
    bytes: Vec<u8>,
}

impl Disk {
    /// Writes a state over the older one, or half of it.
    ///
    /// # Errors
    /// A sentence, if it cannot be encoded.
    pub(super) fn write(&mut self, state: &impl Serialize, is_torn: bool) -> Result<(), String> {
        let sequence = self.sequence + 1;
        slots::write(RUN_ID, sequence, state, &mut self.bytes).map_err(|error| error.to_string())?;
        let index = (sequence % 2) as usize;
        let written = if is_torn { self.bytes.len() / 2 } else { self.bytes.len() };
        let slot = &mut self.slots[index];
        slot.resize(slot.len().max(written), 0);
        slot[..written].copy_from_slice(&self.bytes[..written]);
        if !is_torn {
            slot.truncate(written);
            self.sequence = sequence;
        }
        self.is_whole[index] = !is_torn;
        Ok(())
    }

    /// The newest state, for the process that goes on from here.
    ///
    /// # Errors
    /// A sentence, if it is not the newest one that was written wholly.
    pub(super) fn read<T: DeserializeOwned>(&mut self) -> Result<Option<T>, String> {
        let slots = self.slots.each_ref().map(|slot| Some(slot.as_slice()).filter(|slot| !slot.is_empty()));
        let was_written = self.is_whole.contains(&true);
        match slots::newest::<T>(slots, RUN_ID) {
            Err(_) if !was_written => Ok(None),
            Err(unusable) => Err(format!("a whole checkpoint was refused: {unusable}")),
            Ok(None) if !was_written => Ok(None),
            Ok(None) => Err("a whole checkpoint was not found".to_owned()),
            Ok(Some(slot)) => {
                if !self.is_whole[(slot.sequence % 2) as usize] {
                    return Err("a torn checkpoint was trusted".to_owned());
                }
                if slot.sequence != self.sequence {
                    return Err("an older checkpoint was taken than the newest".to_owned());
                }
                Ok(Some(slot.state))
            }
        }
    }
}
