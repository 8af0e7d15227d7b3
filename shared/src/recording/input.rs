//! Where a recording comes from: a file, a pipe whose writer may be slow, or standard input.

use std::fs::File;
use std::io::Read;
use std::os::unix::fs::FileTypeExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use super::RecordingError;

/// Standard input, as a path.
const STANDARD_INPUT: &str = "-";

/// After so long without a byte the user is told what is waited for.
const PATIENCE: Duration = Duration::from_secs(2);

/// What is read, and what errors call it.
pub(super) struct Input {
    pub(super) reader: Box<dyn Read>,
    pub(super) name: PathBuf,
}

/// Opens a recording. Who may have to wait for a pipe's writer is told so.
pub(super) fn open(path: &Path) -> Result<Input, RecordingError> {
    let is_standard_input = path == Path::new(STANDARD_INPUT);
    let name = if is_standard_input { PathBuf::from("standard input") } else { path.to_owned() };
    let kind = std::fs::metadata(if is_standard_input { Path::new("/dev/stdin") } else { path }).ok();
    let may_wait = kind.is_some_and(|kind| kind.file_type().is_fifo() || kind.file_type().is_char_device());
    // From before it is opened: that alone waits for a writer.
    let watched = may_wait.then(|| watch(&name));
    let reader: Box<dyn Read> = if is_standard_input {
        Box::new(std::io::stdin().lock())
    } else {
        Box::new(File::open(path).map_err(|error| RecordingError::unreadable(path, &error))?)
    };
    Ok(match watched {
        None => Input { reader, name },
        Some(bytes) => Input { reader: Box::new(Counted { reader, bytes }), name },
    })
}

/// Says what is waited for whenever nothing has come for a while, until what is returned is let go of.
fn watch(name: &Path) -> Arc<AtomicU64> {
    let bytes = Arc::new(AtomicU64::new(0));
    let (weak, name) = (Arc::downgrade(&bytes), name.to_owned());
    let watch = move || {
        let (mut before, mut is_told) = (0, false);
        loop {
            std::thread::sleep(PATIENCE);
            let Some(bytes) = weak.upgrade() else { return };
            let now = bytes.load(Ordering::Relaxed);
            if now == before && !is_told {
                let given = if now == 0 { "nothing".to_owned() } else { format!("{now} bytes") };
                log::warn!("waiting for the writer of {}, which has given {given} so far", name.display());
            }
            is_told = now == before;
            before = now;
        }
    };
    // Where no thread can be had, it is waited in silence.
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
