//! The users' input files: scenarios, recordings with their anchors, true tracks. A recording may also be standard input
//! or a pipe, whose writer may be slow.

use std::fmt::Display;
use std::fs::File;
use std::io::Read;
use std::os::unix::fs::FileTypeExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use rangehound_node::system::bounded;
use rangehound_shared::recording::{
    Anchors, ColumnMap, ReadOptions, ReadSummary, Recording, RecordingError, TrackPoint, parse_track,
};
use rangehound_shared::scenario::{RecordingTable, Scenario, ScenarioError, ScenarioFile};

use crate::failure::Failure;
use crate::files::bag::table::{BagTable, Selection};
use crate::files::bag::{self, Fault};
use crate::files::bytes_read::BytesRead;

/// Stands in errors about flags for the name of the scenario file.
pub const COMMAND_LINE: &str = "the command line";

/// Longest scenario file, bytes: several times the length of one that lists 1024 robots.
const SCENARIO_LEN_MAX: usize = 4 << 20;

/// Longest definition of a message type, bytes.
const DEFINITION_LEN_MAX: usize = 1 << 20;

/// Standard input, as a path.
const STANDARD_INPUT: &str = "-";

/// After this time without a byte, a message says what the program is waiting for.
const QUIET_MAX: Duration = Duration::from_secs(2);

/// A path as text: a run's files and processes exchange paths as text.
///
/// # Errors
/// [`Failure::Input`], with the path, if it is not UTF-8.
pub(crate) fn in_utf8<'a>(what: &str, path: &'a Path) -> Result<&'a str, Failure> {
    path.to_str().ok_or_else(|| {
        Failure::input(format!("{what} is {path:?}: expected a path in UTF-8: rename it, or choose another"))
    })
}

/// Reads a scenario file without checking its values.
///
/// # Errors
/// [`Failure::Input`] if the file cannot be read, is not TOML, has an unknown key or a value of the wrong type.
pub fn scenario_file(path: &Path) -> Result<ScenarioFile, Failure> {
    let unreadable = |reason: &dyn Display| {
        Failure::input(format!("cannot read {}: {reason}: expected a scenario file", path.display()))
    };
    let bytes = bounded::read(path, SCENARIO_LEN_MAX).map_err(|error| unreadable(&error))?;
    let text = String::from_utf8(bytes).map_err(|error| unreadable(&error.utf8_error()))?;
    ScenarioFile::parse(&text, &path.display().to_string()).map_err(Failure::input)
}

/// Checks a scenario file, and reads the recording that it names. `file` names it in errors; paths in it are relative to
/// `folder`.
///
/// # Errors
/// [`ScenarioError`] for the first fault.
pub fn scenario(raw: &ScenarioFile, file: &str, folder: &Path) -> Result<Scenario, ScenarioError> {
    scenario_with(raw, file, folder, &BytesRead::default())
}

/// As [`scenario`], for a caller that shows how much of the recording has been read.
///
/// # Errors
/// As [`scenario`].
pub fn scenario_with(
    raw: &ScenarioFile,
    file: &str,
    folder: &Path,
    bytes: &BytesRead,
) -> Result<Scenario, ScenarioError> {
    Scenario::from_file_with(raw, file, |table| recording_of_with(table, file, folder, bytes))
}

/// Reads the recording that a scenario names, with its anchors: a file, a pipe, or `-` for standard input. `file` names the
/// scenario in errors.
///
/// # Errors
/// [`ScenarioError`] for the first fault.
pub fn recording_of(
    table: &RecordingTable,
    file: &str,
    folder: &Path,
) -> Result<(Recording, ReadSummary), ScenarioError> {
    recording_of_with(table, file, folder, &BytesRead::default())
}

/// As [`recording_of`], for a caller that shows how much of the recording has been read.
///
/// # Errors
/// As [`recording_of`].
pub fn recording_of_with(
    table: &RecordingTable,
    file: &str,
    folder: &Path,
    bytes: &BytesRead,
) -> Result<(Recording, ReadSummary), ScenarioError> {
    let Some(ranges) = table.ranges_path(folder) else {
        return Err(ScenarioError::WrongValue {
            file: file.to_owned(),
            key: "recording.ranges".to_owned(),
            expected: "the path of a file of ranges".to_owned(),
            got: "missing".to_owned(),
        });
    };
    let mut options = table.read_options(file)?;
    let is_bag = bag::is_bag(&ranges);
    // In a bag the user's columns are fields of messages, which the file of the anchors does not have.
    let columns = if is_bag { &ColumnMap::default() } else { &options.columns };
    options.anchors = table.anchors_path(folder).map(|path| anchors(&path, columns)).transpose()?;
    if is_bag {
        return Ok(bag_recording(&ranges, table, folder, options, bytes)?);
    }
    let of_bag =
        [("topic", table.topic.is_some()), ("position", table.position.is_some()), ("msg", table.msg.is_some())];
    if let Some((key, _)) = of_bag.iter().find(|(_, is_given)| *is_given) {
        return Err(ScenarioError::WrongValue {
            file: file.to_owned(),
            key: format!("recording.{key}"),
            expected: format!("the folder or a file of a bag: {} is no ROS 2 bag", ranges.display()),
            got: "given".to_owned(),
        });
    }
    Ok(recording(&ranges, &options, bytes)?)
}

/// Reads the measurements of a bag.
fn bag_recording(
    path: &Path,
    table: &RecordingTable,
    folder: &Path,
    mut options: ReadOptions,
    bytes: &BytesRead,
) -> Result<(Recording, ReadSummary), RecordingError> {
    let definitions = definitions(table.msg.as_deref().unwrap_or_default(), folder)?;
    let refused = |fault: Fault| RecordingError::of_file(path, fault.wrong, fault.hint);
    if table.format.is_some() {
        return Err(refused(Fault::new("a ROS 2 bag", "expected no --format, which is for logs of a radio's port")));
    }
    let selection = Selection {
        topic: table.topic.as_deref(),
        position: table.position.as_deref(),
        columns: Some(&options.columns),
        definitions: &definitions,
        has_anchors: options.anchors.is_some(),
    };
    let read = BagTable::read(path, &selection, bytes).map_err(refused)?;
    options.columns = read.map.clone();
    let (recording, mut summary) = Recording::parse(read.text(), path, &options)?;
    // The table's separator is not the user's.
    let columns = summary.read_as.split_once("; ").map_or("", |(_, columns)| columns);
    summary.read_as = format!("a ROS 2 bag, topic {}; {columns}", table.topic.as_deref().unwrap_or_default());
    Ok((recording, summary))
}

/// Reads a track from a topic of a bag, in order of time. `definitions` are of types that the bag does not define, as
/// `TYPE=FILE`.
///
/// # Errors
/// [`RecordingError`] for the first fault.
pub fn bag_track(path: &Path, topic: &str, definitions: &[String]) -> Result<Vec<TrackPoint>, RecordingError> {
    let definitions = self::definitions(definitions, Path::new(""))?;
    bag::table::read_track(path, topic, &definitions)
        .map_err(|fault| RecordingError::of_file(path, fault.wrong, fault.hint))
}

/// The definitions of message types from files, each given as `TYPE=FILE`.
fn definitions(given: &[String], folder: &Path) -> Result<Vec<(String, String)>, RecordingError> {
    let read = |given: &String| {
        let Some((name, file)) = given.split_once('=') else {
            let hint = "expected TYPE=FILE, as in my_msgs/msg/Uwb=Uwb.msg";
            return Err(RecordingError::of_file(Path::new("--msg"), format!("no file, {given:?},"), hint));
        };
        let path = folder.join(file);
        let unreadable = |error: &dyn Display| {
            RecordingError::of_file(&path, "no definition", format!("expected the fields of a message type: {error}"))
        };
        let text = bounded::read(&path, DEFINITION_LEN_MAX).map_err(|error| unreadable(&error))?;
        Ok((name.to_owned(), String::from_utf8_lossy(&text).into_owned()))
    };
    given.iter().map(read).collect()
}

/// Reads a recording: a file, a pipe, or standard input if the path is `-`.
///
/// # Errors
/// [`RecordingError`] for the first fault.
pub fn recording(
    path: &Path,
    options: &ReadOptions,
    bytes: &BytesRead,
) -> Result<(Recording, ReadSummary), RecordingError> {
    let Input { reader, name } = open(path)?;
    bytes.expect(std::fs::metadata(path).map_or(0, |found| found.len()));
    Recording::parse(bytes.count(reader), &name, options)
}

/// Reads a file of anchors.
///
/// # Errors
/// [`RecordingError`] for the first fault.
pub fn anchors(path: &Path, columns: &ColumnMap) -> Result<Anchors, RecordingError> {
    Anchors::parse(open_file(path)?, path, columns)
}

/// Reads a track, in order of time.
///
/// # Errors
/// [`RecordingError`] for the first fault.
pub fn track(path: &Path) -> Result<Vec<TrackPoint>, RecordingError> {
    parse_track(open_file(path)?, path)
}

fn open_file(path: &Path) -> Result<File, RecordingError> {
    File::open(path).map_err(|error| RecordingError::unreadable(path, &error))
}

/// An input and its name in errors.
struct Input {
    reader: Box<dyn Read>,
    name: PathBuf,
}

/// Opens a recording. A message is printed if it must wait for a pipe's writer.
fn open(path: &Path) -> Result<Input, RecordingError> {
    let is_standard_input = path == Path::new(STANDARD_INPUT);
    let name = if is_standard_input { PathBuf::from("standard input") } else { path.to_owned() };
    let kind = std::fs::metadata(if is_standard_input { Path::new("/dev/stdin") } else { path }).ok();
    let may_wait = kind.is_some_and(|kind| kind.file_type().is_fifo() || kind.file_type().is_char_device());
    // Started before the file is opened, because opening a pipe already waits for its writer.
    let watched = may_wait.then(|| watch(&name));
    let reader: Box<dyn Read> =
        if is_standard_input { Box::new(std::io::stdin().lock()) } else { Box::new(open_file(path)?) };
    Ok(match watched {
        None => Input { reader, name },
        Some(bytes) => Input { reader: Box::new(Counted { reader, bytes }), name },
    })
}

/// Prints what the program is waiting for when no byte has arrived for a while, until the returned value is dropped.
fn watch(name: &Path) -> Arc<AtomicU64> {
    let bytes = Arc::new(AtomicU64::new(0));
    let (weak, name) = (Arc::downgrade(&bytes), name.to_owned());
    let watch = move || {
        let (mut before, mut is_reported) = (0, false);
        loop {
            std::thread::sleep(QUIET_MAX);
            let Some(bytes) = weak.upgrade() else { return };
            let now = bytes.load(Ordering::Relaxed);
            if now == before && !is_reported {
                let given = if now == 0 { "nothing".to_owned() } else { format!("{now} bytes") };
                log::warn!("waiting for the writer of {}, which has sent {given} so far", name.display());
            }
            is_reported = now == before;
            before = now;
        }
    };
    // Without a thread, the program waits without a message.
    let _ = std::thread::Builder::new().name("input-watch".to_owned()).spawn(watch);
    bytes
}

struct Counted {
    reader: Box<dyn Read>,
    bytes: Arc<AtomicU64>,
}

impl Read for Counted {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let read = self.reader.read(buffer)?;
        self.bytes.fetch_add(read as u64, Ordering::Relaxed);
        Ok(read)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_is_not_there_is_named() {
        let missing = Path::new("/nonexistent/r.csv");
        let errors = [
            recording(missing, &ReadOptions::default(), &BytesRead::default()).unwrap_err(),
            anchors(missing, &ColumnMap::default()).unwrap_err(),
            track(missing).unwrap_err(),
        ];
        for error in errors {
            let text = error.to_string();
            assert!(
                text.starts_with("cannot read /nonexistent/r.csv: ") && text.ends_with(": expected the path of a file"),
                "{text}"
            );
        }
    }
}
