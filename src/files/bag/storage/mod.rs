//! Topics and messages out of a bag's files, once from their beginning to their end.

mod mcap;
mod sqlite;

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use super::Fault;
use crate::files::bytes_read::BytesRead;
pub use mcap::read as read_mcap;

/// A topic of a bag.
#[derive(Debug, Clone, Copy)]
pub struct Topic<'a> {
    /// Its name.
    pub name: &'a str,
    /// The type of its messages: `package/msg/Name`.
    pub type_name: &'a str,
    /// The definition of the type, if the bag has one.
    pub definition: Option<&'a str>,
    /// Why its messages cannot be read, if so.
    pub obstacle: Option<&'a str>,
}

/// Takes topics and messages. A topic comes before its messages, and again for each file of the bag.
pub trait Sink {
    /// Takes a topic. Returns its number if its messages are wanted.
    ///
    /// # Errors
    /// [`Fault`] ends the reading.
    fn topic(&mut self, topic: Topic<'_>) -> Result<Option<usize>, Fault>;

    /// Takes a message of a wanted topic; `log_ns` is the time of recording.
    ///
    /// # Errors
    /// [`Fault`] ends the reading.
    fn message(&mut self, topic: usize, log_ns: i64, message: &[u8]) -> Result<(), Fault>;
}

/// Reads a bag: its folder, or one of its files. `bytes` counts what has been read.
///
/// # Errors
/// [`Fault`] of the first file that cannot be read, or of the sink.
pub fn read(path: &Path, sink: &mut impl Sink, bytes: &BytesRead) -> Result<(), Fault> {
    let is_folder = path.is_dir();
    let files = if is_folder { files_of(path)? } else { vec![path.to_owned()] };
    for file in &files {
        bytes.expect(std::fs::metadata(file).map_or(0, |found| found.len()));
    }
    for file in files {
        let of_file = |fault: Fault| match file.file_name().filter(|_| is_folder) {
            Some(name) => Fault::new(format!("{} ({})", fault.wrong, name.to_string_lossy()), fault.hint),
            None => fault,
        };
        read_file(&file, sink, bytes).map_err(of_file)?;
    }
    Ok(())
}

fn read_file(path: &Path, sink: &mut impl Sink, bytes: &BytesRead) -> Result<(), Fault> {
    let mut file = File::open(path).map_err(|error| unreadable(&error))?;
    let len = file.metadata().map_err(|error| unreadable(&error))?.len();
    let mut begin = Vec::new();
    file.by_ref().take(16).read_to_end(&mut begin).map_err(|error| unreadable(&error))?;
    if begin.starts_with(super::SQLITE_MAGIC) {
        sqlite::read(path, sink)?;
        bytes.add(len);
        return Ok(());
    }
    mcap::read(bytes.count(begin.chain(file)), len, sink)
}

fn unreadable(error: &std::io::Error) -> Fault {
    Fault::new("a file cannot be read", format!("expected a bag that can be read: {error}"))
}

/// The files of a bag in order: `NAME_0.mcap`, `NAME_1.mcap`, ..
fn files_of(folder: &Path) -> Result<Vec<PathBuf>, Fault> {
    let entries = std::fs::read_dir(folder).map_err(|error| unreadable(&error))?;
    let paths: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    let has_ending = |path: &Path, endings: &[&str]| {
        path.extension().is_some_and(|ending| endings.iter().any(|known| ending == *known))
    };
    let mut files: Vec<PathBuf> = paths.iter().filter(|path| has_ending(path, &["mcap", "db3"])).cloned().collect();
    if files.is_empty() {
        let hint = if paths.iter().any(|path| has_ending(path, &["zstd"])) {
            "its files are compressed as a whole: expected them decompressed, as by `zstd -d FILE`"
        } else {
            "expected the folder of a ROS 2 bag, with a file .mcap or .db3"
        };
        return Err(Fault::new("no file of a bag", hint));
    }
    // Numbers have no leading zeros.
    files.sort_by_cached_key(|path| (path.as_os_str().len(), path.clone()));
    Ok(files)
}
