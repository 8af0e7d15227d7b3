//! Bags as sqlite3 files.

use std::collections::HashMap;
use std::fmt::Write as _;
use std::path::Path;

use rusqlite::types::ValueRef;
use rusqlite::{Connection, OpenFlags};

use super::{Sink, Topic};
use crate::files::atomic_file::with_ending;
use crate::files::bag::Fault;

impl From<rusqlite::Error> for Fault {
    fn from(error: rusqlite::Error) -> Self {
        Self::new("a damaged table", format!("expected an undamaged sqlite3 bag: {error}"))
    }
}

/// Reads a file.
///
/// # Errors
/// [`Fault`].
pub(super) fn read(path: &Path, sink: &mut impl Sink) -> Result<(), Fault> {
    let file = Connection::open_with_flags(uri(path), OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_URI)?;
    // A view could claim any number of rows.
    let kinds = "SELECT name FROM sqlite_schema WHERE type = 'table' AND sql NOT LIKE 'CREATE VIRTUAL%'";
    let tables: Vec<String> = file.prepare(kinds)?.query_map([], |row| row.get(0))?.collect::<Result<_, _>>()?;
    let has = |name: &str| tables.iter().any(|table| table == name);
    if !has("topics") || !has("messages") {
        return Err(Fault::new("no tables of topics and messages", "expected a bag of ROS 2"));
    }
    let mut definitions: HashMap<String, (String, String)> = HashMap::new();
    // Distributions before Iron do not write it.
    if has("message_definitions") {
        let all = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions";
        let mut query = file.prepare(all)?;
        let mut rows = query.query([])?;
        while let Some(row) = rows.next()? {
            definitions.insert(row.get(0)?, (row.get(1)?, row.get(2)?));
        }
    }
    let mut wanted: HashMap<i64, usize> = HashMap::new();
    let mut query = file.prepare("SELECT id, name, type, serialization_format FROM topics")?;
    let mut rows = query.query([])?;
    while let Some(row) = rows.next()? {
        let (id, name, type_name, format): (i64, String, String, String) =
            (row.get(0)?, row.get(1)?, row.get(2)?, row.get(3)?);
        let definition = definitions.get(&type_name).filter(|(language, _)| language == "ros2msg");
        let obstacle = (format != "cdr").then_some("its messages are not in CDR, the encoding of ROS 2");
        let definition = definition.map(|(_, text)| text.as_str()).filter(|text| !text.is_empty());
        if let Some(number) = sink.topic(Topic { name: &name, type_name: &type_name, definition, obstacle })? {
            wanted.insert(id, number);
        }
    }
    let mut messages = "SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN (".to_owned();
    for (index, id) in wanted.keys().enumerate() {
        let _ = write!(messages, "{}{id}", if index == 0 { "" } else { "," });
    }
    let mut query = file.prepare(&(messages + ")"))?;
    let mut rows = query.query([])?;
    while let Some(row) = rows.next()? {
        let (topic, log_ns): (i64, i64) = (row.get(0)?, row.get(1)?);
        if let (Some(number), ValueRef::Blob(message)) = (wanted.get(&topic), row.get_ref(2)?) {
            sink.message(*number, log_ns, message)?;
        }
    }
    Ok(())
}

/// The file as a URI by which it is opened without writing beside it, unless a journal there has messages.
fn uri(path: &Path) -> String {
    let mut uri = "file:".to_owned();
    for byte in path.as_os_str().as_encoded_bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'/' | b'.' | b'-' | b'_' => uri.push(char::from(*byte)),
            _ => drop(write!(uri, "%{byte:02X}")),
        }
    }
    let has_journal = std::fs::metadata(with_ending(path, "-wal")).is_ok_and(|journal| journal.len() > 0);
    uri + if has_journal { "" } else { "?immutable=1" }
}
