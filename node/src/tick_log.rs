//! Logs with one record of fixed size for each tick, at the place that its tick gives it.
//!
//! Because a record's place depends on its tick alone, writing a tick twice leaves the file as it
//! was: a node that is started again after a kill repeats its last record and loses none. The
//! report and every table are made from these files, never from what an observer caught.

use std::fs::{File, OpenOptions};
use std::io::{BufReader, Read};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

/// Starts every log.
const MAGIC: u64 = u64::from_le_bytes(*b"rhticks1");

/// Words of the header: magic, run id, words a record.
const HEADER_WORDS: usize = 3;

/// A log file could not be used.
#[derive(Debug, thiserror::Error)]
#[error("{}: {reason}", .file.display())]
pub struct TickLogError {
    file: PathBuf,
    reason: String,
}

impl TickLogError {
    fn new(file: &Path, reason: impl ToString) -> Self {
        Self { file: file.to_owned(), reason: reason.to_string() }
    }
}

/// Writes records.
#[derive(Debug)]
pub struct TickLogWriter {
    file: File,
    path: PathBuf,
    bytes: Vec<u8>,
    record_words: usize,
}

impl TickLogWriter {
    /// Opens the log of this run, or starts it anew if the file is another run's.
    ///
    /// # Errors
    /// If the file cannot be opened or written.
    pub fn open(path: &Path, run_id: u64, record_words: usize) -> Result<Self, TickLogError> {
        let failed = |error: std::io::Error| TickLogError::new(path, error);
        let file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path).map_err(failed)?;
        let header: Vec<u8> = [MAGIC, run_id, record_words as u64].iter().flat_map(|word| word.to_le_bytes()).collect();
        let mut present = vec![0; header.len()];
        if file.read_exact_at(&mut present, 0).is_err() || present != header {
            file.set_len(0).map_err(failed)?;
            file.write_all_at(&header, 0).map_err(failed)?;
        }
        Ok(Self { file, path: path.to_owned(), bytes: Vec::with_capacity(8 * (record_words + 1)), record_words })
    }

    /// True if no tick has been written.
    ///
    /// # Errors
    /// If the system does not tell.
    pub fn is_empty(&self) -> Result<bool, TickLogError> {
        let metadata = self.file.metadata().map_err(|error| TickLogError::new(&self.path, error))?;
        Ok(metadata.len() <= 8 * HEADER_WORDS as u64)
    }

    /// Writes the record of one tick. Of `words`, as many as a record has are kept; if there are fewer,
    /// the rest is zero.
    ///
    /// # Errors
    /// If the system refuses the write.
    pub fn write(&mut self, tick: u64, words: impl IntoIterator<Item = u64>) -> Result<(), TickLogError> {
        self.bytes.clear();
        // Marks the record as written: a hole in the file reads as zero.
        self.bytes.extend((tick + 1).to_le_bytes());
        for word in words.into_iter().take(self.record_words) {
            self.bytes.extend(word.to_le_bytes());
        }
        self.bytes.resize(8 * (self.record_words + 1), 0);
        self.file.write_all_at(&self.bytes, self.offset(tick)).map_err(|error| TickLogError::new(&self.path, error))
    }

    /// Writes over some words of a record, from its `first` on.
    ///
    /// # Errors
    /// If the system refuses the write.
    pub fn amend(&mut self, tick: u64, first: usize, words: impl IntoIterator<Item = u64>) -> Result<(), TickLogError> {
        self.bytes.clear();
        for word in words.into_iter().take(self.record_words.saturating_sub(first)) {
            self.bytes.extend(word.to_le_bytes());
        }
        let offset = self.offset(tick) + 8 * (first as u64 + 1);
        self.file.write_all_at(&self.bytes, offset).map_err(|error| TickLogError::new(&self.path, error))
    }

    fn offset(&self, tick: u64) -> u64 {
        8 * (HEADER_WORDS as u64 + tick * (self.record_words as u64 + 1))
    }
}

/// Reads records in tick order.
#[derive(Debug)]
pub struct TickLogReader {
    input: BufReader<File>,
    path: PathBuf,
    words: Vec<u64>,
    bytes: Vec<u8>,
    tick: u64,
}

impl TickLogReader {
    /// Opens the log of a run.
    ///
    /// # Errors
    /// If the file cannot be read or is not a log of this run with such records.
    pub fn open(path: &Path, run_id: u64, record_words: usize) -> Result<Self, TickLogError> {
        let file = File::open(path).map_err(|error| TickLogError::new(path, error))?;
        let mut input = BufReader::with_capacity(1 << 16, file);
        for expected in [MAGIC, run_id, record_words as u64] {
            let mut word = [0; 8];
            let read = input.read_exact(&mut word);
            if read.is_err() || u64::from_le_bytes(word) != expected {
                return Err(TickLogError::new(path, "not a log of this run"));
            }
        }
        let bytes = vec![0; 8 * (record_words + 1)];
        Ok(Self { input, path: path.to_owned(), words: vec![0; record_words], bytes, tick: 0 })
    }

    /// The newest tick that has room in the log, written or not; `None` before the first.
    ///
    /// # Errors
    /// If the system does not tell.
    pub fn newest_tick(&self) -> Result<Option<u64>, TickLogError> {
        let metadata = self.input.get_ref().metadata().map_err(|error| TickLogError::new(&self.path, error))?;
        let records = metadata.len().saturating_sub(8 * HEADER_WORDS as u64) / self.bytes.len() as u64;
        Ok(records.checked_sub(1))
    }

    /// The next tick that was written, with its record; `None` at the end.
    ///
    /// # Errors
    /// If the file cannot be read.
    #[expect(clippy::should_implement_trait, reason = "lends its buffer, which an iterator cannot")]
    pub fn next(&mut self) -> Option<Result<(u64, &[u64]), TickLogError>> {
        loop {
            match self.input.read_exact(&mut self.bytes) {
                Ok(()) => {}
                Err(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => return None,
                Err(error) => return Some(Err(TickLogError::new(&self.path, error))),
            }
            let tick = self.tick;
            self.tick += 1;
            if self.decode(tick) {
                return Some(Ok((tick, &self.words)));
            }
        }
    }

    /// The record of one tick, wherever [`Self::next`] is; `None` if it was not written. One that is being written
    /// while this reads may be half of each; an older one is whole.
    ///
    /// # Errors
    /// If the file cannot be read.
    pub fn at(&mut self, tick: u64) -> Result<Option<&[u64]>, TickLogError> {
        // Where no file reaches there is nothing.
        let offset =
            tick.checked_mul(self.bytes.len() as u64).and_then(|bytes| bytes.checked_add(8 * HEADER_WORDS as u64));
        let Some(offset) = offset.filter(|offset| *offset <= i64::MAX as u64) else { return Ok(None) };
        match self.input.get_ref().read_exact_at(&mut self.bytes, offset) {
            Ok(()) => Ok(self.decode(tick).then_some(&*self.words)),
            Err(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => Ok(None),
            Err(error) => Err(TickLogError::new(&self.path, error)),
        }
    }

    /// Turns the bytes that were read into words; false if they are not the record of this tick.
    fn decode(&mut self, tick: u64) -> bool {
        let (chunks, _) = self.bytes.as_chunks::<8>();
        let Some((mark, record)) = chunks.split_first() else { return false };
        for (word, chunk) in self.words.iter_mut().zip(record) {
            *word = u64::from_le_bytes(*chunk);
        }
        u64::from_le_bytes(*mark) == tick + 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_all(path: &Path) -> Vec<(u64, Vec<u64>)> {
        let mut reader = TickLogReader::open(path, 7, 2).unwrap();
        let mut records = Vec::new();
        while let Some(record) = reader.next() {
            let (tick, words) = record.unwrap();
            records.push((tick, words.to_vec()));
        }
        records
    }

    #[test]
    fn records_stand_at_their_tick_however_often_they_are_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        let mut log = TickLogWriter::open(&path, 7, 2).unwrap();
        log.write(3, [30, 31]).unwrap();
        log.write(0, [1]).unwrap();
        drop(log);
        let mut again = TickLogWriter::open(&path, 7, 2).unwrap();
        again.write(3, [30, 31]).unwrap();
        again.amend(0, 1, [2, 9]).unwrap();
        assert_eq!(read_all(&path), [(0, vec![1, 2]), (3, vec![30, 31])]);
        let mut reader = TickLogReader::open(&path, 7, 2).unwrap();
        let records = [3, 0, 1, 4, u64::MAX - 1].map(|tick| reader.at(tick).unwrap().map(<[u64]>::to_vec));
        assert_eq!(records, [Some(vec![30, 31]), Some(vec![1, 2]), None, None, None]);
    }

    #[test]
    fn a_log_of_another_run_is_started_anew_and_refused_by_readers() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        TickLogWriter::open(&path, 6, 2).unwrap().write(5, [1, 2]).unwrap();
        assert!(TickLogReader::open(&path, 7, 2).is_err());
        TickLogWriter::open(&path, 7, 2).unwrap().write(0, [8, 9]).unwrap();
        assert_eq!(read_all(&path), [(0, vec![8, 9])]);
    }

    #[test]
    fn a_cut_record_ends_the_log() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        let mut log = TickLogWriter::open(&path, 7, 2).unwrap();
        log.write(0, [1, 2]).unwrap();
        log.write(1, [3, 4]).unwrap();
        OpenOptions::new().write(true).open(&path).unwrap().set_len(24 + 24 + 10).unwrap();
        assert_eq!(read_all(&path), [(0, vec![1, 2])]);
    }
}
