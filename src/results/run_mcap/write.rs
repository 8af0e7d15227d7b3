//! Frames into an MCAP file.

use std::borrow::Cow;
use std::cell::Cell;
use std::collections::BTreeMap;
use std::io::{Seek, SeekFrom, Write};
use std::rc::Rc;
use std::time::{Duration, Instant};

use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, Compression, McapError, WriteOptions};
use rangehound_node::rendezvous::RunDescription;
use rangehound_shared::protocol;

use super::PROFILE;
use super::encode::{CHANNELS, Channel, Encoded, Encoder, channels};
use crate::files::layout::{DESCRIPTION, SCENARIO};
use crate::results::frame::Frame;

/// A chunk is written once it has this many bytes before compression.
const CHUNK_LEN: u64 = 1 << 19;

/// A chunk is written after this time at the latest: a kill loses no more.
const FLUSH: Duration = Duration::from_secs(1);

/// The outcome of writing a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Written {
    /// The frame is in the file, or will be within a second.
    Taken,
    /// The file has its maximum size: it takes neither this frame nor later ones.
    Full,
}

/// Writes the frames of a run in order of their ticks.
pub struct FrameWriter<W: Write + Seek> {
    mcap: mcap::Writer<Counting<W>>,
    encoder: Encoder,
    /// The file's numbers of the channels.
    channel_ids: [u16; CHANNELS],
    bytes_max: u64,
    bytes_written: Rc<Cell<u64>>,
    flushed: Instant,
}

impl<W: Write + Seek> FrameWriter<W> {
    /// Creates a file. The run's description comes first, so that a file cut short still has it.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn begin(
        out: W,
        description: &RunDescription,
        scenario: Option<&[u8]>,
        bytes_max: u64,
    ) -> anyhow::Result<Self> {
        let bytes_written = Rc::new(Cell::new(0));
        let options = WriteOptions::new()
            .profile(PROFILE)
            .compression(Some(Compression::Lz4))
            .chunk_size(Some(CHUNK_LEN))
            // A chunk is either complete in the file or absent.
            .disable_seeking(true);
        let mut mcap = options.create(Counting { out, bytes_written: Rc::clone(&bytes_written) })?;
        mcap.write_metadata(&Metadata { name: PROFILE.to_owned(), metadata: words_about(description) })?;
        if let Some(text) = scenario {
            attach(&mut mcap, SCENARIO, "application/toml", text)?;
        }
        // This record is the last one about the run itself.
        attach(&mut mcap, DESCRIPTION, "application/json", description.seal()?.as_bytes())?;
        let mut channel_ids = [0; CHANNELS];
        for (id, channel) in channel_ids.iter_mut().zip(channels()) {
            *id = add(&mut mcap, &channel)?;
        }
        let encoder = Encoder::new(&description.scenario);
        Ok(Self { mcap, encoder, channel_ids, bytes_max, bytes_written, flushed: Instant::now() })
    }

    /// Writes a frame.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn write(&mut self, frame: &Frame) -> Result<Written, McapError> {
        if self.bytes_written.get() >= self.bytes_max {
            return Ok(Written::Full);
        }
        let Self { mcap, encoder, channel_ids, .. } = self;
        encoder.encode(frame, |Encoded { channel, log_time_ns, publish_time_ns, bytes }| {
            let header = MessageHeader {
                channel_id: channel_ids[channel],
                sequence: frame.tick as u32,
                log_time: log_time_ns,
                publish_time: publish_time_ns,
            };
            mcap.write_to_known_channel(&header, bytes)
        })?;
        self.flush_if_due()?;
        Ok(Written::Taken)
    }

    /// Ends the current chunk if it is a second old.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn flush_if_due(&mut self) -> Result<(), McapError> {
        if self.flushed.elapsed() >= FLUSH {
            self.mcap.flush()?;
            self.flushed = Instant::now();
        }
        Ok(())
    }

    /// Writes index and summary.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn finish(mut self) -> Result<W, McapError> {
        self.mcap.finish()?;
        Ok(self.mcap.into_inner().out)
    }
}

fn add<W: Write + Seek>(mcap: &mut mcap::Writer<W>, channel: &Channel) -> Result<u16, McapError> {
    let schema = match &channel.schema {
        Some(schema) => mcap.add_schema(&schema.name, &schema.encoding, &schema.data)?,
        // The format's encoding of "no schema".
        None => 0,
    };
    mcap.add_channel(schema, channel.topic, &channel.message_encoding, &BTreeMap::new())
}

fn attach<W: Write + Seek>(
    mcap: &mut mcap::Writer<W>,
    name: &str,
    media_type: &str,
    data: &[u8],
) -> Result<(), McapError> {
    mcap.attach(&Attachment {
        log_time: 0,
        create_time: 0,
        name: name.to_owned(),
        media_type: media_type.to_owned(),
        data: Cow::Borrowed(data),
    })
}

/// Facts about a run that are readable without opening it.
fn words_about(description: &RunDescription) -> BTreeMap<String, String> {
    let RunDescription { run_id, scenario, .. } = description;
    let words = [
        ("program", protocol::PROGRAM.to_owned()),
        ("protocol", protocol::PROTOCOL.to_string()),
        ("run_id", format!("{run_id:016x}")),
        ("scenario", scenario.name.clone()),
        ("seed", scenario.seed.to_string()),
        ("clock", scenario.clock.name().to_owned()),
        ("planner", scenario.planner.name().to_owned()),
        ("robots", scenario.robots.len().to_string()),
        ("names", (0..scenario.robots.len()).map(|id| scenario.name_of(id)).collect::<Vec<_>>().join(", ")),
        ("ticks", scenario.ticks.to_string()),
        ("dt_s", scenario.dt_s.to_string()),
    ];
    words.map(|(key, value)| (key.to_owned(), value)).into()
}

/// Counts the written bytes.
pub(in crate::results) struct Counting<W> {
    pub(in crate::results) out: W,
    pub(in crate::results) bytes_written: Rc<Cell<u64>>,
}

impl<W: Write> Write for Counting<W> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let count = self.out.write(bytes)?;
        self.bytes_written.update(|written| written + count as u64);
        Ok(count)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.out.flush()
    }
}

impl<W: Seek> Seek for Counting<W> {
    fn seek(&mut self, to: SeekFrom) -> std::io::Result<u64> {
        self.out.seek(to)
    }
}
