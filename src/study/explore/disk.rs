//! Checkpoint files in memory, which may be half written after a kill.

use rangehound_shared::sealed::slots::{self, SlotWriter};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// There is only one run here.
const RUN_ID: u64 = 1;

/// One checkpoint file.
#[derive(Debug, Clone, Default)]
pub(super) struct Disk {
    slots: [Vec<u8>; 2],
    /// For each slot, the number of the state that was written to it completely, if it is still intact.
    complete: [Option<u64>; 2],
    newest: u64,
}

impl Disk {
    /// Writes a state to the next slot, or only this share of it.
    ///
    /// # Errors
    /// If the state cannot be encoded.
    pub(super) fn write(&mut self, writer: &mut SlotWriter, state: &impl Serialize, share: f64) -> Result<(), String> {
        writer.encode(state).map_err(|error| error.to_string())?;
        let (index, bytes) = (writer.next_slot(), writer.bytes());
        let is_torn = share < 1.0;
        let written = if is_torn { (bytes.len() as f64 * share) as usize } else { bytes.len() };
        let slot = &mut self.slots[index];
        slot.resize(slot.len().max(written), 0);
        slot[..written].copy_from_slice(&bytes[..written]);
        if !is_torn {
            slot.truncate(written);
        }
        // The rest of a half-written slot may happen to be right.
        let is_complete = slot == bytes;
        self.newest += u64::from(is_complete);
        self.complete[index] = is_complete.then_some(self.newest);
        if !is_torn {
            writer.written();
        }
        Ok(())
    }

    /// The newest state, and the writer after it, for the process that goes on from it.
    ///
    /// # Errors
    /// If the state is not the newest one that was written completely.
    pub(super) fn read<T: DeserializeOwned>(&self) -> Result<(Option<T>, SlotWriter), String> {
        let slots = self.slots.each_ref().map(|slot| Some(slot.as_slice()).filter(|slot| !slot.is_empty()));
        let was_written = self.complete.iter().any(Option::is_some);
        match slots::newest::<T>(slots, RUN_ID) {
            Err(_) | Ok(None) if !was_written => Ok((None, SlotWriter::after(RUN_ID, 0))),
            Err(unusable) => Err(format!("a complete checkpoint was refused: {unusable}")),
            Ok(None) => Err("a complete checkpoint was not found".to_owned()),
            Ok(Some(slot)) => {
                let writer = SlotWriter::after(RUN_ID, slot.sequence);
                match self.complete[writer.newest_slot()] {
                    None => Err("a torn checkpoint was trusted".to_owned()),
                    complete if complete < self.complete.into_iter().max().flatten() => {
                        Err("an older checkpoint than the newest was used".to_owned())
                    }
                    _ => Ok((Some(slot.state), writer)),
                }
            }
        }
    }

    /// A new file that has only the newest state.
    pub(super) fn moved(&self, writer: &SlotWriter) -> Self {
        let mut moved = Self { newest: self.newest, ..Self::default() };
        let index = writer.newest_slot();
        moved.slots[index].clone_from(&self.slots[index]);
        moved.complete[index] = self.complete[index];
        moved
    }
}
