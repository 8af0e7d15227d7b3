//! The number of ticks in a recording: from the summary of a file just made, or by reading any other file to its end.

use std::fs::File;
use std::io::{BufReader, Read, Seek};
use std::path::Path;

use mcap::Summary;
use mcap::sans_io::summary_reader::{SummaryReadEvent, SummaryReader, SummaryReaderOptions};

use super::messages::TOPICS;
use super::read::{ESTIMATE, FrameReader, Missing};

/// The kind of file that already has the recording's name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Found {
    /// No file.
    Nothing,
    /// A recording of the same run, with its number of ticks.
    Same(u64),
    /// Any other file.
    Foreign,
}

/// Examines the file at a path, for a recording of the run with this id.
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
    // In a damaged file, the summary may count more ticks than can be read.
    let (mut ticks, mut next) = (0, 0);
    let warn = |missing: Missing| {
        log::warn!(
            "{}: {missing}: the file is damaged or has holes: `rangehound replay --repair FILE` keeps the ticks before the damage",
            path.display()
        )
    };
    while let Ok(Some(frame)) = reader.next_frame() {
        if frame.tick > next {
            warn(Missing::between(next, frame.tick));
        }
        (ticks, next) = (ticks + 1, frame.tick + 1);
    }
    if let Some(missing) = reader.missing_at_end() {
        warn(missing);
    }
    Found::Same(ticks)
}

/// The number of ticks according to the summary; `None` without a summary.
#[must_use]
pub fn ticks_in_summary(mut file: &File) -> Option<u64> {
    let options = SummaryReaderOptions::default().with_file_size(file.metadata().ok()?.len());
    let mut reader = SummaryReader::new_with_options(options);
    while let Some(event) = reader.next_event() {
        match event.ok()? {
            SummaryReadEvent::ReadRequest(len) => {
                let read = file.read(reader.insert(len)).ok()?;
                reader.notify_read(read);
            }
            SummaryReadEvent::SeekRequest(to) => reader.notify_seeked(file.seek(to).ok()?),
        }
    }
    let Summary { stats, channels, .. } = reader.finish()?;
    let estimates = channels.values().find(|channel| channel.topic == TOPICS[ESTIMATE])?;
    stats.map(|stats| stats.channel_message_counts.get(&estimates.id).copied().unwrap_or(0))
}
