//! A node's state on file, from which a successor resumes after a kill.
//!
//! One file has two slots, written alternately. Each write is sealed with the run's id and a sequence
//! number; the newest valid slot counts. A kill during a write loses only the slot being written. No other node
//! has seen its effects: a node writes before it publishes what depends on the state.
//!
//! Safe against kills, not against power loss: there is no `fsync`, so the kernel keeps the data when a process ends, but
//! not when the machine stops.
//!
//! A leader with predecessors continues in a new file that replaces the old one. A deposed predecessor that wakes up
//! again then writes to a file without a name, which nobody reads.

use std::fs::{File, OpenOptions};
use std::os::unix::fs::{FileExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use rangehound_shared::sealed::slots::{self, LEN_BYTES, SlotWriter};
use rangehound_shared::sealed::{self, SealError};
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::rendezvous::tenure::needs_own_checkpoint;
use crate::rendezvous::{Rendezvous, Role, RoleLease};

/// File of a role's checkpoint in the run folder.
#[must_use]
pub fn file_name(role: Role) -> String {
    format!("{role}.checkpoint")
}

/// Bytes of a slot; the file is sparse, so only the state itself takes disk space.
const SLOT_LEN: usize = 1 << 20;

/// Bytes of a slot that are read to detect whether it was written.
const FIRST_READ: usize = 4_096;

/// Why a checkpoint cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    /// The file holds no state of this run that this build can read.
    #[error("cannot use {}: {reason}: start a new run, or restore a valid checkpoint; the file is kept as {}", .file.display(), .kept.display())]
    Unusable {
        /// The file.
        file: PathBuf,
        /// Why.
        reason: String,
        /// Where it has been moved.
        kept: PathBuf,
    },
    /// The system refuses.
    #[error("cannot use {}: {source}: check that it can be read and written, and that its disk has room", .file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The state cannot be encoded.
    #[error("cannot write {}: {reason}: please report this", .file.display())]
    Unencodable {
        /// The file.
        file: PathBuf,
        /// Why.
        reason: SealError,
    },
    /// The state is larger than a slot.
    #[error("cannot write {}: a state of {len} bytes: expected at most {}: please report this", .file.display(), SLOT_LEN - LEN_BYTES)]
    TooLarge {
        /// The file.
        file: PathBuf,
        /// Bytes it would take.
        len: usize,
    },
}

/// The checkpoint file of one role.
#[derive(Debug)]
pub struct Checkpoint {
    file: File,
    path: PathBuf,
    writer: SlotWriter,
}

impl Checkpoint {
    /// Opens the checkpoint of a role of a run, and returns the state to resume from. If the folder cannot be
    /// written, the run goes on without a checkpoint: `None`, with a warning.
    ///
    /// # Errors
    /// [`CheckpointError::Unusable`].
    pub fn of_role<T: DeserializeOwned>(
        rendezvous: &Rendezvous,
        role: Role,
        lease: &RoleLease,
    ) -> Result<(Option<Self>, Option<T>), CheckpointError> {
        let description = rendezvous.description();
        match Self::open(&description.out_dir.join(file_name(role)), description.run_id) {
            Ok((mut checkpoint, state)) => {
                if role == Role::Fusion && needs_own_checkpoint(lease.incarnation) {
                    let partial = beside(&checkpoint.path, &format!(".{}", lease.incarnation));
                    // Nobody can be deposed meanwhile, so no successor's file is replaced.
                    let moved = rendezvous.while_current(lease, || checkpoint.move_to_new_file(&partial));
                    let _ = std::fs::remove_file(&partial);
                    match moved {
                        Ok(Some(Ok(()))) => {}
                        Ok(Some(Err(error))) => log::warn!(
                            "cannot replace the checkpoint, which deposed predecessors can still write: {error}"
                        ),
                        // This process was deposed: the file belongs to its successor.
                        Ok(None) => return Ok((None, state)),
                        Err(error) => {
                            log::warn!(
                                "{error}: this node continues without a checkpoint; if it is killed, the run ends"
                            );
                            checkpoint.remove();
                            return Ok((None, state));
                        }
                    }
                }
                Ok((Some(checkpoint), state))
            }
            Err(error @ CheckpointError::Unusable { .. }) => Err(error),
            Err(error) => {
                log::warn!("{error}: this node continues without a checkpoint; if it is killed, the run ends");
                Ok((None, None))
            }
        }
    }

    /// Writes a state. A failure is logged and ends the checkpoint, as in [`Self::of_role`]. The file is removed too: its
    /// state would be too old for a successor, because the other nodes go on.
    pub fn write_or_give_up(checkpoint: &mut Option<Self>, state: &impl Serialize) {
        if let Some(file) = checkpoint
            && let Err(error) = file.write(state)
        {
            log::warn!("{error}: this node continues without a checkpoint; if it is killed, the run ends");
            file.remove();
            *checkpoint = None;
        }
    }

    /// Opens the checkpoint of a role and returns its newest state, if any. A file without a
    /// valid state is moved aside, never overwritten.
    ///
    /// # Errors
    /// [`CheckpointError`].
    pub fn open<T: DeserializeOwned>(path: &Path, run_id: u64) -> Result<(Self, Option<T>), CheckpointError> {
        let io_error = |source| CheckpointError::Io { file: path.to_owned(), source };
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .mode(0o600)
            .open(path)
            .map_err(io_error)?;
        let len = file.metadata().map_err(io_error)?.len();
        let slots = [0, 1].map(|index| read_slot(&file, index, len));
        let [first, second] = slots;
        let slots = [first.map_err(io_error)?, second.map_err(io_error)?];
        let newest = match slots::newest(slots.each_ref().map(Option::as_deref), run_id) {
            Ok(newest) => newest,
            Err(unusable) => {
                let (kept, reason) = (free_name(path), unusable.to_string());
                std::fs::rename(path, &kept).map_err(io_error)?;
                return Err(CheckpointError::Unusable { file: path.to_owned(), reason, kept });
            }
        };
        let (sequence, state) = newest.map_or((0, None), |slot| (slot.sequence, Some(slot.state)));
        Ok((Self { file, path: path.to_owned(), writer: SlotWriter::after(run_id, sequence) }, state))
    }

    /// True if the file is empty or a checkpoint of any run and version.
    #[must_use]
    pub fn is_one(path: &Path) -> bool {
        let is_file = path.symlink_metadata().is_ok_and(|file| file.is_file());
        let Some(file) = is_file.then(|| File::open(path).ok()).flatten() else { return false };
        let begins_sealed = |index| {
            let mut magic = [0; sealed::MAGIC.len()];
            file.read_exact_at(&mut magic, slot_start(index) + LEN_BYTES as u64).is_ok() && magic == sealed::MAGIC
        };
        file.metadata().is_ok_and(|file| file.len() == 0) || begins_sealed(0) || begins_sealed(1)
    }

    /// Removes the file, unless another file has replaced it.
    fn remove(&self) {
        let inode = |file: std::fs::Metadata| file.ino();
        let named = std::fs::metadata(&self.path).map(inode).ok();
        if named.is_some() && named == self.file.metadata().map(inode).ok() {
            let _ = std::fs::remove_file(&self.path);
        }
    }

    /// Replaces the file by a new one that holds the newest slot.
    fn move_to_new_file(&mut self, partial: &Path) -> std::io::Result<()> {
        let file = OpenOptions::new().read(true).write(true).create(true).truncate(true).mode(0o600).open(partial)?;
        let index = self.writer.newest_slot();
        if let Some(slot) = read_slot(&self.file, index, self.file.metadata()?.len())? {
            file.write_all_at(&slot, slot_start(index))?;
        }
        std::fs::rename(partial, &self.path)?;
        self.file = file;
        Ok(())
    }

    /// Overwrites the older state. Allocates nothing unless the state is larger than all before.
    ///
    /// # Errors
    /// [`CheckpointError`]; the last written state stays valid.
    pub fn write(&mut self, state: &impl Serialize) -> Result<(), CheckpointError> {
        let encoded = self.writer.encode(state);
        let bytes = self.writer.bytes();
        let len = bytes.len().saturating_sub(LEN_BYTES);
        match encoded {
            Ok(()) if bytes.len() <= SLOT_LEN => {}
            Ok(()) | Err(SealError::TooLarge(_)) => {
                return Err(CheckpointError::TooLarge { file: self.path.clone(), len });
            }
            Err(reason) => return Err(CheckpointError::Unencodable { file: self.path.clone(), reason }),
        }
        self.file
            .write_all_at(bytes, slot_start(self.writer.next_slot()))
            .map_err(|source| CheckpointError::Io { file: self.path.clone(), source })?;
        self.writer.written();
        Ok(())
    }
}

fn slot_start(index: usize) -> u64 {
    (index * SLOT_LEN) as u64
}

/// A path in the same folder with a suffix appended to the file name.
fn beside(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    PathBuf::from(name)
}

/// A free path for a refused file: an earlier refused file is never overwritten.
fn free_name(path: &Path) -> PathBuf {
    let numbered =
        |number: u32| beside(path, &if number == 1 { ".refused".to_owned() } else { format!(".refused-{number}") });
    (1..1_000).map(numbered).find(|name| !name.exists()).unwrap_or_else(|| numbered(1_000))
}

/// The written part of a slot, by its length field; `None` if the slot is empty.
fn read_slot(file: &File, index: usize, file_len: u64) -> std::io::Result<Option<Vec<u8>>> {
    let room = file_len.saturating_sub(slot_start(index)).min(SLOT_LEN as u64) as usize;
    let mut bytes = vec![0; room.min(FIRST_READ)];
    file.read_exact_at(&mut bytes, slot_start(index))?;
    if bytes.iter().all(|byte| *byte == 0) {
        return Ok(None);
    }
    let len = bytes.first_chunk::<LEN_BYTES>().map_or(0, |len| u32::from_le_bytes(*len) as usize);
    let first = bytes.len();
    bytes.resize((LEN_BYTES + len).min(room), 0);
    if first < bytes.len() {
        file.read_exact_at(&mut bytes[first..], slot_start(index) + first as u64)?;
    }
    Ok(Some(bytes))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rangehound_shared::protocol::PROTOCOL;

    type State = (u64, Vec<f64>);

    fn open(path: &Path, run_id: u64) -> Result<(Checkpoint, Option<State>), CheckpointError> {
        Checkpoint::open(path, run_id)
    }

    /// A file with the states 1 to `count`.
    fn written(path: &Path, count: u64) {
        let (mut checkpoint, _) = open(path, 7).unwrap();
        for k in 1..=count {
            checkpoint.write(&(k, vec![0.5 * k as f64; 40])).unwrap();
        }
    }

    #[test]
    fn the_newest_state_comes_back_and_writing_goes_on() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("checkpoint");
        assert_eq!(open(&path, 7).unwrap().1, None);
        for count in 1..6 {
            written(&path, count);
            assert_eq!(open(&path, 7).unwrap().1.unwrap().0, count);
        }
    }

    /// A deposed predecessor's writes do not reach its successor's file.
    #[test]
    fn a_predecessor_does_not_write_to_a_moved_checkpoint() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("checkpoint");
        for count in [0, 1, 4, 5] {
            let _ = std::fs::remove_file(&path);
            written(&path, count);
            let (mut old, _) = open(&path, 7).unwrap();
            let (mut new, state) = open(&path, 7).unwrap();
            new.move_to_new_file(&folder.path().join("new")).unwrap();
            for k in 10..14 {
                old.write(&(k, vec![0.0])).unwrap();
            }
            assert_eq!(open(&path, 7).unwrap().1, state);
            new.write(&(20_u64, vec![1.0])).unwrap();
            assert_eq!(open(&path, 7).unwrap().1, Some((20, vec![1.0])));
        }
    }

    #[test]
    fn a_torn_newest_slot_leaves_the_one_before() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("checkpoint");
        for cut in [5, 40, 100, 300] {
            let _ = std::fs::remove_file(&path);
            written(&path, 4);
            // State 4 is in slot 0: the truncated write of a fifth state overwrites its first bytes.
            let file = OpenOptions::new().write(true).open(&path).unwrap();
            file.write_all_at(&vec![0xA5; cut], 0).unwrap();
            assert_eq!(open(&path, 7).unwrap().1.unwrap().0, 3, "{cut}");
        }
    }

    #[test]
    fn a_checkpoint_of_another_run_is_refused_and_kept() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("checkpoint");
        let kept = folder.path().join("checkpoint.refused");
        written(&path, 3);
        let error = open(&path, 8).unwrap_err().to_string();
        assert!(error.contains("of another run") && !error.contains('\n'), "{error}");
        assert!(kept.exists() && !path.exists());

        let first = std::fs::read(&kept).unwrap();
        std::fs::write(&path, b"not a checkpoint").unwrap();
        assert!(open(&path, 7).is_err());
        assert_eq!(std::fs::read(&kept).unwrap(), first, "an earlier refused file stays");
        assert_eq!(std::fs::read(folder.path().join("checkpoint.refused-2")).unwrap(), b"not a checkpoint");
        std::fs::write(&path, vec![0xFF; 3 * SLOT_LEN]).unwrap();
        assert!(open(&path, 7).is_err());

        // From a future build.
        written(&path, 1);
        let file = OpenOptions::new().write(true).open(&path).unwrap();
        file.write_all_at(&(PROTOCOL + 1).to_le_bytes(), SLOT_LEN as u64 + LEN_BYTES as u64 + 8).unwrap();
        let error = open(&path, 7).unwrap_err().to_string();
        assert!(error.contains(&format!("(protocol {})", PROTOCOL + 1)) && !path.exists(), "{error}");

        // Valid, but of another type.
        let (mut checkpoint, _) = Checkpoint::open::<u8>(&path, 7).unwrap();
        checkpoint.write(&"text").unwrap();
        assert!(open(&path, 7).is_err());
    }

    #[test]
    fn a_state_larger_than_a_slot_is_refused_and_the_last_one_stays() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("checkpoint");
        written(&path, 2);
        let (mut checkpoint, _) = open(&path, 7).unwrap();
        assert!(checkpoint.write(&(3_u64, vec![1.0; SLOT_LEN])).is_err());
        assert_eq!(open(&path, 7).unwrap().1.unwrap().0, 2);
    }

    #[test]
    fn an_abandoned_checkpoint_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("checkpoint");
        written(&path, 2);
        let mut checkpoint = Some(open(&path, 7).unwrap().0);
        Checkpoint::write_or_give_up(&mut checkpoint, &(3_u64, vec![1.0; SLOT_LEN]));
        assert!(checkpoint.is_none());
        assert_eq!(open(&path, 7).unwrap().1, None);
    }

    proptest! {
        /// After damage of one bit, every state that opens is one that was written.
        #[test]
        fn no_damage_passes_for_a_state(at in 0..2_000_usize, slot in 0..2_u64, bit in 0..8_u8) {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("checkpoint");
            written(&path, 4);
            let file = OpenOptions::new().read(true).write(true).open(&path).unwrap();
            let offset = slot * SLOT_LEN as u64 + at as u64;
            let mut byte = [0];
            let _ = file.read_at(&mut byte, offset);
            file.write_all_at(&[byte[0] ^ (1 << bit)], offset).unwrap();
            let (k, values) = open(&path, 7).unwrap().1.unwrap();
            prop_assert!(k == 3 || k == 4);
            prop_assert_eq!(values, vec![0.5 * k as f64; 40]);
        }
    }
}
