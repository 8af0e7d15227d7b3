//! ROS 2 bags: recordings of topics, as MCAP or sqlite3 files.
//!
//! | module | what |
//! |---|---|
//! | [`definition`], [`interfaces`] | message definitions: those in a bag, and standard ones |
//! | [`cdr`], [`path`] | messages from and to bytes; their fields by name |
//! | [`storage`] | topics and messages out of a bag, which may be damaged |
//! | [`selection`] | what to read of which topic, as the user says it |
//! | [`table`] | measurements as a table, which is read like any other recording; true tracks |

pub mod cdr;
pub mod definition;
pub mod interfaces;
pub mod path;
pub mod selection;
pub mod storage;
pub mod table;

use std::io::Read;
use std::path::Path;

/// The first bytes of an MCAP file and of an sqlite3 file.
const MCAP_MAGIC: &[u8] = b"\x89MCAP0\r\n";
const SQLITE_MAGIC: &[u8] = b"SQLite format 3\0";

/// Why a bag is refused: what is wrong with it, and what was expected.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fault {
    /// The problem.
    pub wrong: String,
    /// The expected contents, and the remedy.
    pub hint: String,
}

impl Fault {
    /// A fault of a bag.
    pub fn new(wrong: impl Into<String>, hint: impl Into<String>) -> Self {
        Self { wrong: wrong.into(), hint: hint.into() }
    }
}

/// True if the path is a folder, or a file with the first bytes of a bag.
#[must_use]
pub fn is_bag(path: &Path) -> bool {
    match std::fs::metadata(path) {
        Ok(found) if found.is_dir() => true,
        Ok(found) if found.is_file() => {
            let mut begin = Vec::new();
            let read = std::fs::File::open(path).and_then(|file| file.take(16).read_to_end(&mut begin));
            read.is_ok() && [MCAP_MAGIC, SQLITE_MAGIC].iter().any(|magic| begin.starts_with(magic))
        }
        _ => false,
    }
}
