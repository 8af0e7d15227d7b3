//! How many ticks a recording holds: as its end says of one just made, and by reading it all of any other.

use std::fs::File;
use std::io::BufReader;
use std::os::unix::fs::FileExt;
use std::path::Path;

use mcap::records::op;

use super::messages::TOPICS;
use super::read::{ESTIMATE, Fields, FrameReader, Missing, count_of};

/// Longest index and summary that is read.
const SUMMARY_LEN_MAX: u64 = 64 << 20;

/// The last record with its head, and the magic number at the end.
const FOOTER_LEN: u64 = 1 + 8 + 8 + 8 + 4 + 8;

/// What lies under the name that a recording is to have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Found {
    /// Nothing.
    Nothing,
    /// A recording of the same run, with so many ticks.
    Same(u64),
    /// Anything else.
    Foreign,
}

/// Looks what lies under a name, beside a recording of the run of this id.
#[must_use]
pub fn look(path: &Path, run_id: u64) -> Found {
    match path.symlink_metadata() {
        Err(_) => return Found::Nothing,
        Ok(file) if !file.is_file() => return Found::Foreign,
        Ok(_) => {}
    }
    let Ok(file) = File::open(path) else { return Found::Foreign };
    let Ok(mut reader) = FrameReader::open(BufReader::new(&file)) else { return Found::Foreign };
    if !reader.description().is_ok_and(|description| description.run_id == run_id) {
        return Found::Foreign;
    }
    // What its end says is not what can be read, where it is damaged.
    let (mut ticks, mut next) = (0, 0);
    let tell = |missing: Missing| log::warn!("{}: {missing}: the file is damaged, or has holes", path.display());
    while let Ok(Some(frame)) = reader.next_frame() {
        if frame.tick > next {
            tell(Missing::between(next, frame.tick));
        }
        (ticks, next) = (ticks + 1, frame.tick + 1);
    }
    if let Some(missing) = reader.missing_at_end() {
        tell(missing);
    }
    Found::Same(ticks)
}

/// The number of ticks by what the end of the file says; `None` if it has no end.
#[must_use]
pub fn ticks_told(file: &File) -> Option<u64> {
    let len = file.metadata().ok()?.len();
    let mut footer = [0; FOOTER_LEN as usize];
    let footer_start = len.checked_sub(FOOTER_LEN)?;
    file.read_exact_at(&mut footer, footer_start).ok()?;
    let (head, rest) = footer.split_first_chunk::<9>()?;
    let (start, _) = rest.split_first_chunk::<8>()?;
    let start = u64::from_le_bytes(*start);
    let summary_len = footer_start.checked_sub(start)?;
    if head[0] != op::FOOTER || !footer.ends_with(mcap::MAGIC) || start == 0 || summary_len > SUMMARY_LEN_MAX {
        return None;
    }
    let mut summary = vec![0; usize::try_from(summary_len).ok()?];
    file.read_exact_at(&mut summary, start).ok()?;
    let (mut records, mut estimates, mut statistics) = (Fields(&summary), None, None);
    while let Some(opcode) = records.take(1) {
        let len = u64::from_le_bytes(records.take(8)?.try_into().ok()?);
        let data = records.take(usize::try_from(len).ok()?)?;
        match opcode[0] {
            op::CHANNEL => {
                let (id, topic) = Fields(data).channel()?;
                if topic == TOPICS[ESTIMATE].as_bytes() {
                    estimates = Some(id);
                }
            }
            op::STATISTICS => statistics = Some(data),
            _ => {}
        }
    }
    count_of(estimates?, statistics?)
}
