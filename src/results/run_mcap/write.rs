//! Frames into an MCAP file.

use std::borrow::Cow;
use std::cell::Cell;
use std::collections::BTreeMap;
use std::io::{Seek, SeekFrom, Write};
use std::rc::Rc;
use std::time::{Duration, Instant};

use foxglove::Encode;
use foxglove::messages::{PointCloud, PosesInFrame, SceneUpdate};
use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, Compression, McapError, WriteOptions};
use rangehound_node::rendezvous::RunDescription;
use rangehound_shared::protocol;

use super::PROFILE;
use super::messages::{Drive, Estimate, Heading, Range, TOPICS, Truth, World, encode};
use super::scene::{self, Scene};
use super::topics::messages_of;
use crate::files::layout::{DESCRIPTION, SCENARIO};
use crate::results::frame::Frame;

/// A chunk is written once it has this many bytes before compression.
const CHUNK_LEN: u64 = 1 << 19;

/// A chunk is written after this time at the latest: a kill loses no more.
const FLUSH: Duration = Duration::from_secs(1);

/// The channels that viewers draw.
const VIEWS: [&str; 4] = ["/scene", "/scene/robots", "/scene/target", "/scene/estimate"];

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
    description: RunDescription,
    topics: [u16; TOPICS.len()],
    views: [u16; VIEWS.len()],
    scene: Scene,
    bytes_max: u64,
    bytes_written: Rc<Cell<u64>>,
    /// Time of the first frame, s; the file's time starts there.
    first_s: Option<f64>,
    last_ns: u64,
    /// The newest stamp of each topic's sender.
    stamps_ns: [Option<u64>; TOPICS.len()],
    flushed: Instant,
    bytes: Vec<u8>,
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
        let topics = [
            channel::<World, _>(&mut mcap, TOPICS[0])?,
            channel::<Range, _>(&mut mcap, TOPICS[1])?,
            channel::<Heading, _>(&mut mcap, TOPICS[2])?,
            channel::<Drive, _>(&mut mcap, TOPICS[3])?,
            channel::<Estimate, _>(&mut mcap, TOPICS[4])?,
            channel::<Truth, _>(&mut mcap, TOPICS[5])?,
        ];
        let views = [
            channel::<SceneUpdate, _>(&mut mcap, VIEWS[0])?,
            channel::<PosesInFrame, _>(&mut mcap, VIEWS[1])?,
            channel::<PointCloud, _>(&mut mcap, VIEWS[2])?,
            channel::<PointCloud, _>(&mut mcap, VIEWS[3])?,
        ];
        Ok(Self {
            mcap,
            description: description.clone(),
            topics,
            views,
            scene: Scene::default(),
            bytes_max,
            bytes_written,
            first_s: None,
            last_ns: 0,
            stamps_ns: [None; TOPICS.len()],
            flushed: Instant::now(),
            bytes: Vec::new(),
        })
    }

    /// Writes a frame.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn write(&mut self, frame: &Frame) -> Result<Written, McapError> {
        if self.bytes_written.get() >= self.bytes_max {
            return Ok(Written::Full);
        }
        let time_s = frame.fusion.time_s;
        let since_first_s = time_s - *self.first_s.get_or_insert(time_s);
        // Playback uses the run's time, which never decreases.
        let time_ns = ((since_first_s * 1e9).round() as u64).max(self.last_ns);
        self.last_ns = time_ns;
        for message in messages_of(frame) {
            self.bytes.clear();
            message.encode(&mut self.bytes)?;
            // An unknown stamp, as after a kill, is replaced so that the topic stays in its clock.
            let stamp_ns = &mut self.stamps_ns[message.topic()];
            *stamp_ns = message.sent_ns().or(*stamp_ns);
            let (channel, publish_ns) = (self.topics[message.topic()], stamp_ns.unwrap_or(time_ns));
            self.put(channel, frame.tick, time_ns, publish_ns)?;
        }
        if let Some(scene) = self.scene.update(&self.description.scenario, frame, time_ns) {
            self.view(0, frame.tick, time_ns, &scene)?;
            self.view(1, frame.tick, time_ns, &scene::robot_poses(frame, time_ns))?;
            if let Some(target) = scene::target_cloud(frame, time_ns) {
                self.view(2, frame.tick, time_ns, &target)?;
            }
            self.view(3, frame.tick, time_ns, &scene::estimate_cloud(frame, time_ns))?;
        }
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

    fn view(&mut self, view: usize, tick: u64, time_ns: u64, message: &impl Encode) -> Result<(), McapError> {
        self.bytes.clear();
        encode(message, &mut self.bytes)?;
        self.put(self.views[view], tick, time_ns, time_ns)
    }

    /// Writes the current bytes to a channel.
    fn put(&mut self, channel_id: u16, tick: u64, log_time: u64, publish_time: u64) -> Result<(), McapError> {
        let header = MessageHeader { channel_id, sequence: tick as u32, log_time, publish_time };
        self.mcap.write_to_known_channel(&header, &self.bytes)
    }
}

fn channel<M: Encode, W: Write + Seek>(mcap: &mut mcap::Writer<W>, topic: &str) -> Result<u16, McapError> {
    let schema = match M::get_schema() {
        Some(schema) => mcap.add_schema(&schema.name, &schema.encoding, &schema.data)?,
        // The format's encoding of "no schema".
        None => 0,
    };
    mcap.add_channel(schema, topic, &M::get_message_encoding(), &BTreeMap::new())
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
