//! Bags as MCAP files.

use std::collections::HashMap;
use std::io::Read;

use mcap::McapError;
use mcap::records::op;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};

use super::{Sink, Topic, unreadable};
use crate::files::bag::Fault;
use crate::files::records::{Fields, PROFILE, Schema, read as read_some};
use crate::files::zstd::ZstdDecoder;

/// Longest record of a small file.
const RECORD_LEN_SMALL: u64 = 8 << 20;

/// Longest record: a large image.
const RECORD_LEN_MAX: u64 = 256 << 20;

/// Most bytes of a record for each byte of the file: LZ4 cannot compress better, and no message of a sensor does.
const EXPANSION_MAX: u64 = 256;

/// Most bytes read at once, whatever length a record claims.
const READ_LEN_MAX: usize = 1 << 16;

/// Reads a file of this length.
///
/// # Errors
/// [`Fault`].
pub fn read(mut input: impl Read, len: u64, sink: &mut impl Sink) -> Result<(), Fault> {
    let record_len_max = len.saturating_mul(EXPANSION_MAX).clamp(RECORD_LEN_SMALL, RECORD_LEN_MAX) as usize;
    let options =
        LinearReaderOptions::default().with_validate_chunk_crcs(true).with_record_length_limit(record_len_max);
    let mut reader = LinearReader::new_with_options(options);
    reader.add_decompressor(ZstdDecoder::new()).map_err(|error| damaged(&error))?;
    let mut file = Contents::default();
    while let Some(event) = reader.next_event() {
        match event {
            Ok(LinearReadEvent::ReadRequest(wanted)) => {
                let count = read_some(&mut input, reader.insert(wanted.min(READ_LEN_MAX)));
                let count = count.map_err(|error| unreadable(&error))?;
                reader.notify_read(count);
            }
            Ok(LinearReadEvent::Record { opcode, data }) => {
                if file.take(opcode, data, sink)? {
                    return Ok(());
                }
            }
            Err(McapError::UnexpectedEof) => {
                let hint =
                    "expected a complete bag: `mcap recover` and `ros2 bag reindex` repair one that was not closed";
                return Err(Fault::new("the file is cut short", hint));
            }
            Err(McapError::BadMagic) => {
                return Err(Fault::new("no MCAP or sqlite3 file", "expected a bag of ROS 2"));
            }
            Err(error) => return Err(damaged(&error)),
        }
    }
    Ok(())
}

fn damaged(error: &McapError) -> Fault {
    Fault::new("a damaged record", format!("expected an undamaged bag: {error}"))
}

/// The records of the file so far.
#[derive(Default)]
struct Contents {
    /// Name, language and text of each schema.
    schemas: HashMap<u16, (String, Vec<u8>, Vec<u8>)>,
    /// The sink's number of each channel, if it wants it.
    channels: HashMap<u16, Option<usize>>,
}

impl Contents {
    /// Takes a record; true if no message follows.
    fn take(&mut self, opcode: u8, data: &[u8], sink: &mut impl Sink) -> Result<bool, Fault> {
        let invalid = || Fault::new("a damaged record", "expected an undamaged bag: a length in it is wrong");
        let mut fields = Fields::of(data);
        match opcode {
            op::HEADER if fields.string() == Some(PROFILE.as_bytes()) => {
                let hint = "expected a bag of ROS 2: `rangehound replay` reads a run's recording, and `rangehound record --ros2` makes a bag of a run";
                return Err(Fault::new("a recording of rangehound", hint));
            }
            op::SCHEMA => {
                let Schema { id, name, language, text } = fields.schema().ok_or_else(invalid)?;
                let name = String::from_utf8_lossy(name).into_owned();
                self.schemas.entry(id).or_insert_with(|| (name, language.to_owned(), text.to_owned()));
            }
            op::CHANNEL => {
                let (id, schema, topic, encoding) = fields.channel().ok_or_else(invalid)?;
                if !self.channels.contains_key(&id) {
                    let number = self.topic(schema, topic, encoding, sink)?;
                    self.channels.insert(id, number);
                }
            }
            op::MESSAGE => {
                let (channel, log_ns, data) = fields.message().ok_or_else(invalid)?;
                if let Some(number) = self.channels.get(&channel).ok_or_else(invalid)? {
                    sink.message(*number, i64::try_from(log_ns).map_err(|_| invalid())?, data)?;
                }
            }
            op::DATA_END => return Ok(true),
            _ => {}
        }
        Ok(false)
    }

    fn topic(&self, schema: u16, topic: &[u8], encoding: &[u8], sink: &mut impl Sink) -> Result<Option<usize>, Fault> {
        let none = (String::new(), Vec::new(), Vec::new());
        let (type_name, language, text) = self.schemas.get(&schema).unwrap_or(&none);
        let obstacle = if encoding != b"cdr" {
            Some("its messages are not in CDR, the encoding of ROS 2")
        } else if !language.is_empty() && language != b"ros2msg" {
            Some("its definition is in another language than ros2msg")
        } else {
            None
        };
        let definition = std::str::from_utf8(text).ok().filter(|text| !text.is_empty());
        let name = String::from_utf8_lossy(topic);
        sink.topic(Topic { name: &name, type_name, definition, obstacle })
    }
}
