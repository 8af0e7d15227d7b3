//! Frames out of an MCAP file, in order of their ticks. The file may be cut, damaged or somebody else's; whatever it claims,
//! no more of it is held than a chunk.

use std::io::Read;

use mcap::McapError;
use mcap::records::op;
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use rangehound_node::rendezvous::RunDescription;
use rangehound_shared::sealed::SealError;
use serde::Serialize;

use super::PROFILE;
use super::messages::{OnTopic, TOPICS};
use super::topics::{Gathering, Senseless};
use super::zstd::ZstdDecoder;
use crate::files::layout::{DESCRIPTION, SCENARIO};
use crate::results::frame::Frame;

/// Longest record, compressed or not: a dozen times what the recorder writes, as other tools have longer chunks.
const RECORD_LEN_MAX: usize = 6 << 20;

/// Longest message of a tick: far above that of the largest team, and short enough for what it takes decoded.
const MESSAGE_LEN_MAX: usize = 1 << 17;

/// The topic of which each tick has one message: its place in [`TOPICS`].
pub(super) const ESTIMATE: usize = 4;

/// Most bytes taken at once, whatever a record's length claims.
const READ_LEN_MAX: usize = 1 << 16;

/// Why there is no frame.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file cannot be read.
    #[error(transparent)]
    Io(#[from] std::io::Error),
    /// It is cut in the middle, as by a kill.
    #[error("it is cut short {}", what_is_left(*.after))]
    Cut {
        /// The last tick that is whole.
        after: Option<u64>,
    },
    /// It is no MCAP file, or is damaged.
    #[error("{reason} (after {})", behind(*.after))]
    Damaged {
        /// What is wrong.
        reason: String,
        /// The last tick that is whole.
        after: Option<u64>,
    },
    /// It is an MCAP file, but not of a run.
    #[error("holds no run: expected a run.mcap that rangehound recorded")]
    Foreign,
    /// What the run is, cannot be read.
    #[error("what it says of its run cannot be used: {0}")]
    Description(#[from] SealError),
    /// Its messages are no tick of a run.
    #[error(transparent)]
    Senseless(#[from] Senseless),
    /// A tick stands where it should not.
    #[error("tick {tick} stands after tick {after}: expected ticks in order")]
    Disordered {
        /// The tick.
        tick: u64,
        /// The one before it in the file.
        after: u64,
    },
}

/// Ticks that are not in a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Missing {
    /// The first of them.
    pub first: u64,
    /// The last.
    pub last: u64,
    /// How many they are.
    pub number: u64,
}

impl Missing {
    /// The ticks between two that are there.
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

fn what_is_left(after: Option<u64>) -> String {
    match after {
        Some(tick) => format!("after tick {tick}"),
        None => "before its first tick: it holds nothing; `rangehound record DIR` makes one of a run folder's logs"
            .to_owned(),
    }
}

fn behind(tick: Option<u64>) -> String {
    tick.map_or("its beginning".to_owned(), |tick| format!("tick {tick}"))
}

/// Reads a run's file from its beginning to its end, once.
pub struct FrameReader<R> {
    input: R,
    mcap: LinearReader,
    run: Run,
    bytes_read: u64,
}

/// What a file has said so far.
#[derive(Default)]
struct Run {
    description: Option<RunDescription>,
    scenario_text: Option<Vec<u8>>,
    /// Of the channels that are ours: id, and place in [`TOPICS`].
    channels: Vec<(u16, usize)>,
    gathering: Option<(u64, Gathering)>,
    /// The last tick that is whole.
    last: Option<u64>,
    /// Ticks that were read, those between them that were not, and what the file's end says of their number, if it says it.
    count: u64,
    skipped: u64,
    told: Option<u64>,
    /// What comes now is index and summary.
    is_data_over: bool,
    is_over: bool,
}

impl<R: Read> FrameReader<R> {
    /// Reads what the run is.
    ///
    /// # Errors
    /// If it is no run's file.
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

    /// What the run is; its folder is where it was.
    ///
    /// # Errors
    /// None once the reader has been opened.
    pub fn description(&self) -> Result<&RunDescription, ReadError> {
        self.run.description.as_ref().ok_or(ReadError::Foreign)
    }

    /// The text of its scenario file, if that is in the file.
    #[must_use]
    pub fn scenario_text(&self) -> Option<&[u8]> {
        self.run.scenario_text.as_deref()
    }

    /// Ticks after the last one that the file's own count has and that cannot be read, once it has been read to its end. A
    /// chunk whose kind is damaged is no chunk any more, and is passed over like any record of an unknown kind.
    #[must_use]
    pub fn missing_at_end(&self) -> Option<Missing> {
        let Run { last, count, skipped, told, .. } = &self.run;
        let number = told.unwrap_or(0).checked_sub(count + skipped).filter(|number| *number > 0)?;
        let first = last.map_or(0, |last| last + 1);
        Some(Missing { first, last: first.saturating_add(number - 1), number })
    }

    /// Bytes of the file that have been read.
    #[must_use]
    pub fn bytes_read(&self) -> u64 {
        self.bytes_read
    }

    /// The next tick; `None` at the end.
    ///
    /// # Errors
    /// [`ReadError`]; after one there is no frame more.
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

    /// Reads on by a record or a piece of one.
    fn step(&mut self) -> Result<Option<Frame>, ReadError> {
        let Self { input, mcap, run, bytes_read } = self;
        match mcap.next_event() {
            None => run.end(),
            // Of index and summary no tick depends.
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

fn read(input: &mut impl Read, buffer: &mut [u8]) -> std::io::Result<usize> {
    loop {
        match input.read(buffer) {
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
            done => return done,
        }
    }
}

impl Run {
    fn damaged(&self, reason: impl ToString) -> ReadError {
        ReadError::Damaged { reason: reason.to_string(), after: self.last }
    }

    fn take(&mut self, opcode: u8, data: &[u8]) -> Result<Option<Frame>, ReadError> {
        let mut record = Fields(data);
        match opcode {
            op::HEADER if record.string() != Some(PROFILE.as_bytes()) => Err(ReadError::Foreign),
            op::ATTACHMENT => {
                let (name, data) = record.attachment().ok_or_else(|| self.damaged("an attachment makes no sense"))?;
                if name == SCENARIO.as_bytes() {
                    self.scenario_text = Some(data.to_owned());
                } else if name == DESCRIPTION.as_bytes() && self.description.is_none() {
                    self.description = Some(RunDescription::open(data)?);
                }
                Ok(None)
            }
            op::CHANNEL => {
                let (id, topic) = record.channel().ok_or_else(|| self.damaged("a channel makes no sense"))?;
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
                self.told = of_channel(ESTIMATE).and_then(|id| count_of(id, data));
                Ok(None)
            }
            // The record that ended the data was none.
            op::MESSAGE if self.is_data_over => Err(self.damaged("messages stand after the end of the data")),
            op::MESSAGE => {
                let (channel, data) = record.message().ok_or_else(|| self.damaged("a message makes no sense"))?;
                self.hear(channel, data)
            }
            _ => Ok(None),
        }
    }

    fn hear(&mut self, channel: u16, data: &[u8]) -> Result<Option<Frame>, ReadError> {
        let Some((_, topic)) = self.channels.iter().find(|(id, _)| *id == channel) else { return Ok(None) };
        let description = self.description.as_ref().ok_or(ReadError::Foreign)?;
        let damaged = Senseless::Message { tick: self.last.map_or(0, |last| last + 1), topic: TOPICS[*topic] };
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
                // The rest of it stood in a chunk that is missing.
                Err(Senseless::Lacking { .. }) => self.skipped += 1,
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
            Err(Senseless::Lacking { .. }) if self.told.is_some() => Ok(None),
            framed => {
                (self.last, self.count) = (Some(tick), self.count + 1);
                Ok(Some(framed?))
            }
        }
    }
}

/// How many messages of a channel a file's statistics tell of: after seven counts and two times they have pairs of channel
/// and count.
fn count_of(channel: u16, statistics: &[u8]) -> Option<u64> {
    let (pairs, _) = statistics.get(8 + 2 + 4 * 4 + 8 + 8 + 4..)?.as_chunks::<10>();
    let of_channel = pairs.iter().find(|pair| pair[..2] == channel.to_le_bytes());
    Some(of_channel.map_or(0, |pair| {
        let count = [pair[2], pair[3], pair[4], pair[5], pair[6], pair[7], pair[8], pair[9]];
        u64::from_le_bytes(count)
    }))
}

/// The fields of a record one after the other. The library's own parser takes as much memory as a damaged length says.
struct Fields<'a>(&'a [u8]);

impl<'a> Fields<'a> {
    fn take(&mut self, len: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(len)?;
        self.0 = rest;
        Some(taken)
    }

    fn u16(&mut self) -> Option<u16> {
        self.take(2)?.try_into().ok().map(u16::from_le_bytes)
    }

    fn string(&mut self) -> Option<&'a [u8]> {
        let len = u32::from_le_bytes(self.take(4)?.try_into().ok()?);
        self.take(len as usize)
    }

    /// Name and data.
    fn attachment(mut self) -> Option<(&'a [u8], &'a [u8])> {
        self.take(16)?;
        let name = self.string()?;
        self.string()?;
        let len = u64::from_le_bytes(self.take(8)?.try_into().ok()?);
        Some((name, self.take(usize::try_from(len).ok()?)?))
    }

    /// Id and topic.
    fn channel(mut self) -> Option<(u16, &'a [u8])> {
        let id = self.u16()?;
        self.u16()?;
        Some((id, self.string()?))
    }

    /// Id of its channel, and data.
    fn message(mut self) -> Option<(u16, &'a [u8])> {
        let channel = self.u16()?;
        self.take(4 + 8 + 8)?;
        Some((channel, self.0))
    }
}
