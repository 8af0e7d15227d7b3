//! Logs with one fixed-width record per tick, at an offset given by the tick.
//!
//! Because a record's offset depends on its tick alone, writing a tick twice does not change the file: a node that is
//! restarted after a kill repeats its last record and loses none. The report and all tables come from these
//! files, never from an observer's messages.
//!
//! A log describes its own layout. It starts with three words: a magic number, the run's id, and the length of the
//! description that follows, which is JSON in the form of a NumPy `dtype`. Each record starts with its tick plus one; a record
//! that was never written is zeros.

use std::fs::{File, OpenOptions};
use std::io::{BufReader, Read};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use rangehound_shared::record::{Record, count, describe, put, take};

/// The first word of every log.
const MAGIC: u64 = u64::from_le_bytes(*b"rhticks2");

/// Bytes of a batch of records: then the costs of a call no longer count.
const BATCH_LEN: usize = 1 << 16;

/// A log file could not be used.
#[derive(Debug, thiserror::Error)]
#[error("cannot use the log {}: {reason}: {advice}", .file.display())]
pub struct TickLogError {
    file: PathBuf,
    reason: String,
    advice: &'static str,
}

impl TickLogError {
    fn new(file: &Path, reason: impl ToString) -> Self {
        let advice = "check that it can be read and written, and that its disk has room";
        Self { file: file.to_owned(), reason: reason.to_string(), advice }
    }
}

/// The layout of a log.
#[derive(Debug, Clone)]
struct Layout {
    header: Vec<u8>,
    /// Bytes of a record with its leading word.
    record_len: usize,
}

impl Layout {
    fn of(run_id: u64, record: &mut impl Record) -> Self {
        let mut description = format!(r#"[["tick_plus_1","<u8"],{}]"#, describe(record));
        // Records are aligned to words.
        description.extend(std::iter::repeat_n(' ', description.len().next_multiple_of(8) - description.len()));
        let words = [MAGIC, run_id, description.len() as u64];
        let mut header: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        header.extend(description.bytes());
        Self { header, record_len: 8 * (1 + count(record)) }
    }

    /// Offset of a tick's record; `None` beyond the largest file.
    fn offset(&self, tick: u64) -> Option<u64> {
        let offset = tick.checked_mul(self.record_len as u64)?.checked_add(self.header.len() as u64)?;
        (offset <= i64::MAX as u64).then_some(offset)
    }

    /// The newest tick that fits in a file of this length.
    fn newest_tick(&self, file: &File) -> std::io::Result<Option<u64>> {
        let records = file.metadata()?.len().saturating_sub(self.header.len() as u64) / self.record_len as u64;
        Ok(records.checked_sub(1))
    }
}

/// Writes records.
#[derive(Debug)]
pub struct TickLogWriter<R> {
    file: File,
    path: PathBuf,
    layout: Layout,
    /// Records that follow one another and are not yet in the file, and where they belong there.
    bytes: Vec<u8>,
    offset: u64,
    /// They are written once they have this many bytes.
    batch_len: usize,
    /// Buffer of the record that is written or changed.
    record: R,
}

impl<R: Record> TickLogWriter<R> {
    /// Opens the log of this run, or starts it anew if the file is another run's. `record` is any record with as many items as
    /// the run's.
    ///
    /// # Errors
    /// If the file cannot be opened or written.
    pub fn open(path: &Path, run_id: u64, mut record: R) -> Result<Self, TickLogError> {
        let failed = |error: std::io::Error| TickLogError::new(path, error);
        let file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path).map_err(failed)?;
        let layout = Layout::of(run_id, &mut record);
        let mut present = vec![0; layout.header.len()];
        if file.read_exact_at(&mut present, 0).is_err() || present != layout.header {
            file.set_len(0).map_err(failed)?;
            file.write_all_at(&layout.header, 0).map_err(failed)?;
        }
        let bytes = Vec::with_capacity(layout.record_len);
        Ok(Self { file, path: path.to_owned(), layout, bytes, offset: 0, batch_len: 0, record })
    }

    /// The same, but it writes many records at once, the last ones by [`Self::flush`]: for a process that nobody follows and that
    /// does not go on after a kill. The kernel then takes half the time for a tick.
    #[must_use]
    pub fn in_batches(self) -> Self {
        let bytes = Vec::with_capacity(BATCH_LEN + self.layout.record_len);
        Self { bytes, batch_len: BATCH_LEN, ..self }
    }

    /// True if no tick has been written.
    ///
    /// # Errors
    /// If the system does not tell.
    pub fn is_empty(&self) -> Result<bool, TickLogError> {
        let newest = self.layout.newest_tick(&self.file).map_err(|error| TickLogError::new(&self.path, error))?;
        Ok(newest.is_none())
    }

    /// Writes the record of one tick. `fill` overwrites a buffer that holds another tick's.
    ///
    /// # Errors
    /// If the system refuses the write.
    pub fn write(&mut self, tick: u64, fill: impl FnOnce(&mut R)) -> Result<(), TickLogError> {
        let failed = |error: std::io::Error| TickLogError::new(&self.path, error);
        let offset = self.layout.offset(tick).ok_or_else(|| failed(std::io::ErrorKind::FileTooLarge.into()))?;
        if offset != self.offset + self.bytes.len() as u64 {
            self.flush()?;
            self.offset = offset;
        }
        fill(&mut self.record);
        append(&mut self.bytes, &self.layout, tick, &mut self.record);
        if self.bytes.len() < self.batch_len { Ok(()) } else { self.flush() }
    }

    /// Writes the records that are not yet in the file.
    ///
    /// # Errors
    /// If the system refuses the write. The records are lost then.
    pub fn flush(&mut self) -> Result<(), TickLogError> {
        let written = self.file.write_all_at(&self.bytes, self.offset);
        self.offset += self.bytes.len() as u64;
        self.bytes.clear();
        written.map_err(|error| TickLogError::new(&self.path, error))
    }

    /// Changes the record of a tick, if it exists.
    ///
    /// # Errors
    /// If the system refuses to read or to write.
    pub fn amend(&mut self, tick: u64, change: impl FnOnce(&mut R)) -> Result<(), TickLogError> {
        self.flush()?;
        let Self { file, path, layout, bytes, record, .. } = self;
        bytes.resize(layout.record_len, 0);
        let is_written = read_record(file, layout, bytes, tick, record);
        bytes.clear();
        if !is_written.map_err(|error| TickLogError::new(path, error))? {
            return Ok(());
        }
        self.write(tick, change)?;
        self.flush()
    }
}

/// Appends the record of a tick, as it is in the file.
fn append(bytes: &mut Vec<u8>, layout: &Layout, tick: u64, record: &mut impl Record) {
    let begin = bytes.len();
    bytes.resize(begin + layout.record_len, 0);
    if let Some((mark, words)) = bytes[begin..].split_first_chunk_mut::<8>() {
        // Marks the record as written: a hole in the file reads as zero.
        *mark = (tick + 1).to_le_bytes();
        put(record, words);
    }
}

/// Reads the record of a tick; false if it was not written.
fn read_record(
    file: &File,
    layout: &Layout,
    bytes: &mut [u8],
    tick: u64,
    record: &mut impl Record,
) -> std::io::Result<bool> {
    let Some(offset) = layout.offset(tick) else { return Ok(false) };
    match file.read_exact_at(bytes, offset) {
        Ok(()) => Ok(take_marked(bytes, tick, record)),
        Err(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => Ok(false),
        Err(error) => Err(error),
    }
}

/// Decodes a record; false if the bytes are not of this tick.
fn take_marked(bytes: &[u8], tick: u64, record: &mut impl Record) -> bool {
    let Some((mark, words)) = bytes.split_first_chunk::<8>() else { return false };
    let is_written = u64::from_le_bytes(*mark) == tick + 1;
    if is_written {
        take(record, words);
    }
    is_written
}

/// Reads records, in tick order or at random.
#[derive(Debug)]
pub struct TickLogReader<R> {
    input: BufReader<File>,
    path: PathBuf,
    layout: Layout,
    bytes: Vec<u8>,
    record: R,
    tick: u64,
}

impl<R: Record> TickLogReader<R> {
    /// Opens the log of a run. `record` is any record with as many items as the run's.
    ///
    /// # Errors
    /// If the file cannot be read or is not a log of this run with such records.
    pub fn open(path: &Path, run_id: u64, mut record: R) -> Result<Self, TickLogError> {
        let file = File::open(path).map_err(|error| TickLogError::new(path, error))?;
        let layout = Layout::of(run_id, &mut record);
        let mut input = BufReader::with_capacity(1 << 16, file);
        let mut header = vec![0; layout.header.len()];
        if input.read_exact(&mut header).is_err() || header != layout.header {
            return Err(TickLogError {
                advice: "move it away",
                ..TickLogError::new(path, "it is not a log of this run")
            });
        }
        Ok(Self { input, path: path.to_owned(), bytes: vec![0; layout.record_len], layout, record, tick: 0 })
    }

    /// The newest tick that fits in the log, written or not; `None` before the first.
    ///
    /// # Errors
    /// If the system does not tell.
    pub fn newest_tick(&self) -> Result<Option<u64>, TickLogError> {
        self.layout.newest_tick(self.input.get_ref()).map_err(|error| TickLogError::new(&self.path, error))
    }

    /// The next written tick, with its record; `None` at the end.
    ///
    /// # Errors
    /// If the file cannot be read.
    #[expect(clippy::should_implement_trait, reason = "lends its record, which an iterator cannot")]
    pub fn next(&mut self) -> Option<Result<(u64, &R), TickLogError>> {
        loop {
            match self.input.read_exact(&mut self.bytes) {
                Ok(()) => {}
                Err(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => return None,
                Err(error) => return Some(Err(TickLogError::new(&self.path, error))),
            }
            let tick = self.tick;
            self.tick += 1;
            if take_marked(&self.bytes, tick, &mut self.record) {
                return Some(Ok((tick, &self.record)));
            }
        }
    }

    /// The record of one tick, independent of [`Self::next`]; `None` if it was not written. A record that is being overwritten
    /// meanwhile may mix old and new; older records are complete.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn at(&mut self, tick: u64) -> Result<Option<&R>, TickLogError> {
        let Self { input, path, layout, bytes, record, .. } = self;
        let is_written = read_record(input.get_ref(), layout, bytes, tick, record);
        Ok(is_written.map_err(|error| TickLogError::new(path, error))?.then_some(&*record))
    }
}

#[cfg(test)]
mod tests {
    use rangehound_shared::record::Fields;

    use super::*;

    #[derive(Debug, Clone, Copy, PartialEq, Default)]
    struct Pair(u64, f64);

    impl Record for Pair {
        fn fields(&mut self, fields: &mut impl Fields) {
            fields.whole("a", &mut self.0);
            fields.number("b", &mut self.1);
        }
    }

    fn writer(path: &Path, run_id: u64) -> TickLogWriter<Pair> {
        TickLogWriter::open(path, run_id, Pair::default()).unwrap()
    }

    fn read_all(path: &Path) -> Vec<(u64, Pair)> {
        let mut reader = TickLogReader::open(path, 7, Pair::default()).unwrap();
        let mut records = Vec::new();
        while let Some(record) = reader.next() {
            let (tick, record) = record.unwrap();
            records.push((tick, *record));
        }
        records
    }

    #[test]
    fn records_stand_at_their_tick_however_often_they_are_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        let mut log = writer(&path, 7);
        assert!(log.is_empty().unwrap());
        log.write(3, |pair| *pair = Pair(30, 3.1)).unwrap();
        log.write(0, |pair| *pair = Pair(1, 0.0)).unwrap();
        drop(log);
        let mut again = writer(&path, 7);
        assert!(!again.is_empty().unwrap());
        again.write(3, |pair| *pair = Pair(30, 3.1)).unwrap();
        again.amend(0, |pair| pair.1 = 2.0).unwrap();
        again.amend(1, |pair| pair.1 = 9.0).unwrap();
        assert_eq!(read_all(&path), [(0, Pair(1, 2.0)), (3, Pair(30, 3.1))]);
        let mut reader = TickLogReader::open(&path, 7, Pair::default()).unwrap();
        let records = [3, 0, 1, 4, u64::MAX - 1].map(|tick| reader.at(tick).unwrap().copied());
        assert_eq!(records, [Some(Pair(30, 3.1)), Some(Pair(1, 2.0)), None, None, None]);
    }

    #[test]
    fn batches_give_the_same_log() {
        let folder = tempfile::tempdir().unwrap();
        let bytes_of = |name: &str, batched: bool| {
            let path = folder.path().join(name);
            let log = writer(&path, 7);
            let mut log = if batched { log.in_batches() } else { log };
            // More than a batch; then back, with a gap, and a change of a record that is not yet in the file.
            let len_before = std::fs::metadata(&path).unwrap().len();
            for tick in (0..3_000).chain([5, 6, 4_000, 4_001]) {
                log.write(tick, |pair| *pair = Pair(tick, 0.5)).unwrap();
                if tick == 1_000 {
                    let is_in_file = std::fs::metadata(&path).unwrap().len() > len_before;
                    assert_ne!(is_in_file, batched);
                }
            }
            log.amend(4_001, |pair| pair.1 = 2.0).unwrap();
            log.write(4_002, |pair| *pair = Pair(7, 8.0)).unwrap();
            log.flush().unwrap();
            drop(log);
            std::fs::read(&path).unwrap()
        };
        assert!(bytes_of("single", false) == bytes_of("batched", true));
    }

    #[test]
    fn a_log_of_another_run_is_started_anew_and_refused_by_readers() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        writer(&path, 6).write(5, |pair| *pair = Pair(1, 2.0)).unwrap();
        assert!(TickLogReader::open(&path, 7, Pair::default()).is_err());
        writer(&path, 7).write(0, |pair| *pair = Pair(8, 9.0)).unwrap();
        assert_eq!(read_all(&path), [(0, Pair(8, 9.0))]);
    }

    #[test]
    fn a_log_says_what_is_in_it_and_a_cut_record_ends_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        let mut log = writer(&path, 7);
        log.write(0, |pair| *pair = Pair(1, 2.0)).unwrap();
        log.write(1, |pair| *pair = Pair(3, 4.0)).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let len = u64::from_le_bytes(bytes[16..24].try_into().unwrap()) as usize;
        let description = std::str::from_utf8(&bytes[24..24 + len]).unwrap();
        assert_eq!(description.trim_end(), r#"[["tick_plus_1","<u8"],["a","<u8"],["b","<f8"]]"#);
        assert!(len.is_multiple_of(8) && bytes.len() == 24 + len + 2 * 24);
        OpenOptions::new().write(true).open(&path).unwrap().set_len(24 + len as u64 + 24 + 10).unwrap();
        assert_eq!(read_all(&path), [(0, Pair(1, 2.0))]);
    }
}
