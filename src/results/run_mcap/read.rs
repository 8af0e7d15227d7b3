//! Frames out of an MCAP file, in order of their ticks. The file may be cut short, damaged or foreign. Whatever lengths it
//! claims, at most one chunk is held in memory.

use std::io::Read;

use mcap::McapError;
use mcap::records::op;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use rangehound_node::rendezvous::RunDescription;
use rangehound_shared::sealed::SealError;
use serde::Serialize;

use super::PROFILE;
use super::messages::{OnTopic, TOPICS};
use super::topics::{Gathering, InvalidTick};
use crate::files::layout::{DESCRIPTION, SCENARIO};
use crate::files::records::{Fields, read};
use crate::files::zstd::ZstdDecoder;
use crate::results::frame::Frame;

/// Longest record, compressed or not: twelve times what the recorder writes, because other tools write longer chunks.
const RECORD_LEN_MAX: usize = 6 << 20;

/// Longest message of a tick: far above that of the largest team, yet small when decoded.
const MESSAGE_LEN_MAX: usize = 1 << 17;

/// The topic that has exactly one message for each tick: its index in [`TOPICS`].
pub(super) const ESTIMATE: usize = 4;

/// Most bytes read at once, whatever length a record claims.
const READ_LEN_MAX: usize = 1 << 16;

/// The reason why there is no frame.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file cannot be read.
    #[error(transparent)]
    Io(#[from] std::io::Error),
    /// The file is cut short, as by a kill.
    #[error("it is cut short {}", cut_position(*.after))]
    Cut {
        /// The last complete tick.
        after: Option<u64>,
    },
    /// It is not an MCAP file, or it is damaged.
    #[error("{reason} (after {})", position_after(*.after))]
    Damaged {
        /// The error.
        reason: String,
        /// The last complete tick.
        after: Option<u64>,
    },
    /// It is an MCAP file, but not one of a run.
    #[error("it holds no run: expected a run.mcap that rangehound recorded")]
    Foreign,
    /// The description of the run cannot be read.
    #[error("its description of the run cannot be used: {0}")]
    Description(#[from] SealError),
    /// The messages do not form a tick of a run.
    #[error(transparent)]
    InvalidTick(#[from] InvalidTick),
    /// A tick is out of order.
    #[error("tick {tick} comes after tick {after}: expected ticks in order")]
    Disordered {
        /// The tick.
        tick: u64,
        /// The one before it in the file.
        after: u64,
    },
}

/// Ticks that are missing in a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Missing {
    /// The first missing tick.
    pub first: u64,
    /// The last missing tick.
    pub last: u64,
    /// Number of missing ticks.
    pub number: u64,
}

impl Missing {
    /// The missing ticks between two ticks.
    #[must_use]
    pub fn between(first: u64, next: u64) -> Self {
        Self { first, last: next.saturating_sub(1), number: next.saturating_sub(first) }
    }
}

impl std::fmt::Display for Missing {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { first, last, number } = self;
        match number {
            1 => write!(f, "1 tick, {first}, is missing"),
            _ => write!(f, "{number} ticks, {first} to {last}, are missing"),
        }
    }
}

fn cut_position(after: Option<u64>) -> String {
    match after {
        Some(tick) => format!("after tick {tick}"),
        None => {
            "before its first tick, so it holds nothing: `rangehound record DIR` makes one from a run folder's logs"
                .to_owned()
        }
    }
}

fn position_after(tick: Option<u64>) -> String {
    tick.map_or("its beginning".to_owned(), |tick| format!("tick {tick}"))
}

/// Reads a run's file once, from its beginning to its end.
pub struct FrameReader<R> {
    input: R,
    mcap: LinearReader,
    run: Run,
    bytes_read: u64,
}

/// The state of reading.
#[derive(Default)]
struct Run {
    description: Option<RunDescription>,
    scenario_text: Option<Vec<u8>>,
    /// The known channels: id, and index in [`TOPICS`].
    channels: Vec<(u16, usize)>,
    gathering: Option<(u64, Gathering)>,
    /// The last complete tick.
    last: Option<u64>,
    /// Number of ticks read, number of ticks missing between them, and the number of ticks in the file's summary, if any.
    count: u64,
    skipped: u64,
    counted: Option<u64>,
    /// True if the data are over: index and summary follow.
    is_data_over: bool,
    is_over: bool,
}

impl<R: Read> FrameReader<R> {
    /// Reads the description of the run.
    ///
    /// # Errors
    /// If the file is not a recording of a run.
    pub fn open(input: R) -> Result<Self, ReadError> {
        let options =
            LinearReaderOptions::default().with_prevalidate_chunk_crcs(true).with_record_length_limit(RECORD_LEN_MAX);
        let mut mcap = LinearReader::new_with_options(options);
        mcap.add_decompressor(ZstdDecoder::new())
            .map_err(|error| ReadError::Damaged { reason: error.to_string(), after: None })?;
        let mut reader = Self { input, mcap, run: Run::default(), bytes_read: 0 };
        while reader.run.description.is_none() {
            if reader.run.is_over {
                return Err(ReadError::Foreign);
            }
            reader.step()?;
        }
        Ok(reader)
    }

    /// The run's description; its folder is the original one.
    ///
    /// # Errors
    /// None once the reader is open.
    pub fn description(&self) -> Result<&RunDescription, ReadError> {
        self.run.description.as_ref().ok_or(ReadError::Foreign)
    }

    /// The text of the scenario file, if the file holds it.
    #[must_use]
    pub fn scenario_text(&self) -> Option<&[u8]> {
        self.run.scenario_text.as_deref()
    }

    /// Ticks after the last one that the file's own count includes but that cannot be read, known at the end of the file. A
    /// chunk with a damaged record type is skipped like any record of an unknown type.
    #[must_use]
    pub fn missing_at_end(&self) -> Option<Missing> {
        let Run { last, count, skipped, counted, .. } = &self.run;
        let number = counted.unwrap_or(0).checked_sub(count + skipped).filter(|number| *number > 0)?;
        let first = last.map_or(0, |last| last + 1);
        Some(Missing { first, last: first.saturating_add(number - 1), number })
    }

    /// Number of bytes read.
    #[must_use]
    pub fn bytes_read(&self) -> u64 {
        self.bytes_read
    }

    /// The next tick; `None` at the end.
    ///
    /// # Errors
    /// [`ReadError`]; after an error there are no further frames.
    pub fn next_frame(&mut self) -> Result<Option<Frame>, ReadError> {
        while !self.run.is_over {
            match self.step() {
                Ok(None) => {}
                Ok(frame) => return Ok(frame),
                Err(error) => {
                    self.run.is_over = true;
                    return Err(error);
                }
            }
        }
        Ok(None)
    }

    /// Reads the next record or a piece of it.
    fn step(&mut self) -> Result<Option<Frame>, ReadError> {
        let Self { input, mcap, run, bytes_read } = self;
        match mcap.next_event() {
            None => run.end(),
            // No tick depends on index and summary.
            Some(Err(_)) if run.is_data_over => run.end(),
            Some(Ok(LinearReadEvent::ReadRequest(wanted))) => {
                let count = read(input, mcap.insert(wanted.min(READ_LEN_MAX)))?;
                mcap.notify_read(count);
                *bytes_read += count as u64;
                Ok(None)
            }
            Some(Ok(LinearReadEvent::Record { opcode, data })) => run.take(opcode, data),
            Some(Err(McapError::UnexpectedEof)) => Err(ReadError::Cut { after: run.last }),
            Some(Err(McapError::BadMagic)) if run.description.is_none() => Err(ReadError::Foreign),
            Some(Err(error)) => Err(run.damaged(error)),
        }
    }
}

impl Run {
    fn damaged(&self, reason: impl ToString) -> ReadError {
        ReadError::Damaged { reason: reason.to_string(), after: self.last }
    }

    fn take(&mut self, opcode: u8, data: &[u8]) -> Result<Option<Frame>, ReadError> {
        let mut record = Fields::of(data);
        match opcode {
            op::HEADER if record.string() != Some(PROFILE.as_bytes()) => Err(ReadError::Foreign),
            op::ATTACHMENT => {
                let (name, data) = record.attachment().ok_or_else(|| self.damaged("an attachment is invalid"))?;
                if name == SCENARIO.as_bytes() {
                    self.scenario_text = Some(data.to_owned());
                } else if name == DESCRIPTION.as_bytes() && self.description.is_none() {
                    self.description = Some(RunDescription::open(data)?);
                }
                Ok(None)
            }
            op::CHANNEL => {
                let (id, _, topic, _) = record.channel().ok_or_else(|| self.damaged("a channel is invalid"))?;
                let topic = TOPICS.iter().position(|known| known.as_bytes() == topic);
                if let Some(topic) = topic.filter(|_| !self.channels.iter().any(|(known, _)| *known == id)) {
                    self.channels.push((id, topic));
                }
                Ok(None)
            }
            op::DATA_END => {
                self.is_data_over = true;
                Ok(None)
            }
            op::STATISTICS => {
                let of_channel =
                    |topic: usize| self.channels.iter().find(|(_, known)| *known == topic).map(|(id, _)| *id);
                self.counted = of_channel(ESTIMATE).and_then(|id| count_of(id, data));
                Ok(None)
            }
            // The record that ended the data was not valid.
            op::MESSAGE if self.is_data_over => Err(self.damaged("messages come after the end of the data")),
            op::MESSAGE => {
                let (channel, _, data) = record.message().ok_or_else(|| self.damaged("a message is invalid"))?;
                self.hear(channel, data)
            }
            _ => Ok(None),
        }
    }

    fn hear(&mut self, channel: u16, data: &[u8]) -> Result<Option<Frame>, ReadError> {
        let Some((_, topic)) = self.channels.iter().find(|(id, _)| *id == channel) else { return Ok(None) };
        let description = self.description.as_ref().ok_or(ReadError::Foreign)?;
        let damaged = InvalidTick::Message { tick: self.last.map_or(0, |last| last + 1), topic: TOPICS[*topic] };
        if data.len() > MESSAGE_LEN_MAX {
            return Err(damaged.into());
        }
        let message = OnTopic::decode(*topic, data).map_err(|_| damaged)?;
        let tick = message.tick();
        let mut whole = None;
        if let Some((before, gathering)) = self.gathering.take_if(|(gathered, _)| *gathered != tick) {
            if tick < before {
                return Err(ReadError::Disordered { tick, after: before });
            }
            self.skipped += tick - before - 1;
            match gathering.into_frame() {
                Ok(frame) => {
                    (self.last, self.count) = (Some(before), self.count + 1);
                    whole = Some(frame);
                }
                // The other messages of the tick were in a missing chunk.
                Err(InvalidTick::MissingTopic { .. }) => self.skipped += 1,
                Err(error) => return Err(error.into()),
            }
        }
        let (_, gathering) = self.gathering.get_or_insert_with(|| (tick, Gathering::of(&description.scenario, tick)));
        gathering.take(message)?;
        Ok(whole)
    }

    fn end(&mut self) -> Result<Option<Frame>, ReadError> {
        self.is_over = true;
        let Some((tick, gathering)) = self.gathering.take() else { return Ok(None) };
        match gathering.into_frame() {
            Err(InvalidTick::MissingTopic { .. }) if self.counted.is_some() => Ok(None),
            framed => {
                (self.last, self.count) = (Some(tick), self.count + 1);
                Ok(Some(framed?))
            }
        }
    }
}

/// The number of messages of a channel in a file's statistics. Seven counts and two times come first, then pairs of
/// channel and count.
fn count_of(channel: u16, statistics: &[u8]) -> Option<u64> {
    let (pairs, _) = statistics.get(8 + 2 + 4 * 4 + 8 + 8 + 4..)?.as_chunks::<10>();
    let of_channel = pairs.iter().find(|pair| pair[..2] == channel.to_le_bytes());
    Some(of_channel.map_or(0, |pair| {
        let count = [pair[2], pair[3], pair[4], pair[5], pair[6], pair[7], pair[8], pair[9]];
        u64::from_le_bytes(count)
    }))
}
