//! The frames between a robot and its gateway: each fits in one datagram.
//!
//! The first byte of a frame is its version, the others are its fields in order: integers and floats in little-endian order, an
//! optional field after a byte that is 1 if it is there, a list after its number of entries (8 bytes).

use bincode::config::{Configuration, Fixint, Limit, LittleEndian};
use rangehound_shared::measurement::Measurement;
use rangehound_shared::message::{Command, WorldEntry};
use rangehound_shared::protocol::PROTOCOL;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// Longest frame, bytes: it fits in a datagram on every link.
pub const FRAME_LEN_MAX: usize = 1_150;

/// The version of a frame, its first byte: the lowest byte of the protocol number. Joining compares the whole number.
pub const FRAME_VERSION: u8 = PROTOCOL.to_le_bytes()[0];

/// Measurements in one frame, at most.
pub const MEASUREMENTS_MAX: usize = 6;

/// Ticks for which a gateway knows which measurements have come: the bits of a `u64`.
pub const REMEMBERED_TICKS: u64 = 64;

/// From the gateway to the robot.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Downlink {
    /// Id of the run.
    pub run_id: u64,
    /// When it was sent, ns, by the gateway's clock: it comes back as it is.
    pub sent_ns: u64,
    /// The world at the present tick, if the robot has not answered it.
    pub world: Option<World>,
    /// The heading of the present tick, if the robot has not carried it out.
    pub heading: Option<Heading>,
    /// The measurements that have come.
    pub heard: Ticks,
    /// How long the robot waits before it sends a measurement again, ns.
    pub repeat_after_ns: u64,
}

/// From the robot to the gateway.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Uplink {
    /// Id of the run.
    pub run_id: u64,
    /// The newest frame of the gateway.
    pub echo: Option<Echo>,
    /// Measurements that the gateway may not have, the newest first.
    pub measured: Vec<Measured>,
    /// The robot's drive.
    pub driven: Option<Driven>,
}

/// A message of the topic `world`, for one robot.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct World {
    /// Incarnation of the simulator.
    pub incarnation: u64,
    /// The tick.
    pub tick: u64,
    /// Its time, s.
    pub valid_at_s: f64,
    /// The robot's entry.
    pub entry: WorldEntry,
}

/// A message of the topic `heading`, for one robot.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Heading {
    /// Incarnation of fusion.
    pub incarnation: u64,
    /// The tick.
    pub tick: u64,
    /// The robot's command.
    pub command: Command,
}

/// The measurement of a tick.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Measured {
    /// The tick.
    pub tick: u64,
    /// Its time, s.
    pub valid_at_s: f64,
    /// The measurement.
    pub measurement: Measurement,
}

/// A robot's motion in a tick.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Driven {
    /// The tick.
    pub tick: u64,
    /// Its time, s.
    pub valid_at_s: f64,
    /// The motion.
    pub command: Command,
    /// True if it measured something at this tick.
    pub has_measured: bool,
    /// Time from its measurement to the tick's heading by its own clock, ns; `None` if it drives without the heading.
    pub heading_after_ns: Option<u64>,
    /// Part of that time on its host: until the measurement was sent, and since the frame with the heading, ns.
    pub host_ns: u32,
    /// True if the heading came after its deadline.
    pub heading_late: bool,
    /// Headings refused since its last report.
    pub headings_refused: u32,
}

/// The answer to the time stamp of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Echo {
    /// The stamp, as it came.
    pub sent_ns: u64,
    /// How long the robot has had it, ns.
    pub held_ns: u64,
}

/// A set of ticks: the newest and some before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Ticks {
    /// One more than the newest tick; 0 if the set is empty.
    end: u64,
    /// Bit i: the newest tick minus i.
    bits: u64,
}

impl Ticks {
    /// Adds a tick. Ticks that are too old are not added.
    pub fn add(&mut self, tick: u64) {
        let Some(end) = tick.checked_add(1) else { return };
        if end > self.end {
            self.bits = self.bits.checked_shl(u32::try_from(end - self.end).unwrap_or(u32::MAX)).unwrap_or(0) | 1;
            self.end = end;
        } else if self.end - end < REMEMBERED_TICKS {
            self.bits |= 1 << (self.end - end);
        }
    }

    /// True if the tick was added, or is too old to be known: then nobody waits for it.
    #[must_use]
    pub fn has(&self, tick: u64) -> bool {
        match self.end.checked_sub(tick.saturating_add(1)) {
            None => false,
            Some(age) => age >= REMEMBERED_TICKS || self.bits >> age & 1 == 1,
        }
    }
}

/// Why bytes are not a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// They are longer than a frame.
    #[error("a frame of {0} bytes: at most {FRAME_LEN_MAX} are allowed")]
    TooLong(usize),
    /// They are cut, or something else.
    #[error("a damaged frame")]
    Malformed,
    /// It is of a build with another protocol number.
    #[error("a frame of another version (protocol {0}, expected {FRAME_VERSION}): use one version on both hosts")]
    OtherVersion(u8),
    /// It has more measurements than a frame may have.
    #[error("a frame with too many measurements")]
    TooMany,
    /// It is of another run.
    #[error("a frame of another run")]
    OtherRun,
    /// It is of a tick that the run does not have.
    #[error("a frame of tick {0}, after the last one of the run")]
    AfterEnd(u64),
}

impl FrameError {
    /// The cause in a few words.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::TooLong(_) => "frame too long",
            Self::Malformed => "damaged frame",
            Self::OtherVersion(_) => "frame of another version",
            Self::TooMany => "frame with too many measurements",
            Self::OtherRun => "frame of another run",
            Self::AfterEnd(_) => "frame of a tick after the last one",
        }
    }
}

fn configuration() -> Configuration<LittleEndian, Fixint, Limit<FRAME_LEN_MAX>> {
    bincode::config::standard().with_little_endian().with_fixed_int_encoding().with_limit::<FRAME_LEN_MAX>()
}

fn decoded<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, FrameError> {
    if bytes.len() > FRAME_LEN_MAX {
        return Err(FrameError::TooLong(bytes.len()));
    }
    let fields = match bytes.split_first() {
        Some((&FRAME_VERSION, fields)) => fields,
        Some((version, _)) => return Err(FrameError::OtherVersion(*version)),
        None => return Err(FrameError::Malformed),
    };
    match bincode::serde::decode_from_slice(fields, configuration()) {
        Ok((frame, read)) if read == fields.len() => Ok(frame),
        _ => Err(FrameError::Malformed),
    }
}

fn encoded(frame: &impl Serialize) -> Vec<u8> {
    // Frames are bounded by construction: a test sends the longest.
    bincode::serde::encode_to_vec((FRAME_VERSION, frame), configuration()).unwrap_or_default()
}

impl Downlink {
    /// Its bytes.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        encoded(self)
    }

    /// The frame of these bytes, if it is of this run.
    ///
    /// # Errors
    /// [`FrameError`].
    pub fn from_bytes(bytes: &[u8], run_id: u64) -> Result<Self, FrameError> {
        let frame: Self = decoded(bytes)?;
        if frame.run_id == run_id { Ok(frame) } else { Err(FrameError::OtherRun) }
    }
}

impl Uplink {
    /// Its bytes.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        encoded(self)
    }

    /// The frame of these bytes, if it is of this run.
    ///
    /// # Errors
    /// [`FrameError`].
    pub fn from_bytes(bytes: &[u8], run_id: u64) -> Result<Self, FrameError> {
        let frame: Self = decoded(bytes)?;
        match frame {
            Self { run_id: of, .. } if of != run_id => Err(FrameError::OtherRun),
            Self { ref measured, .. } if measured.len() > MEASUREMENTS_MAX => Err(FrameError::TooMany),
            frame => Ok(frame),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn longest() -> (Downlink, Uplink) {
        let heading = Heading { incarnation: 2, tick: 9, command: Command::default() };
        let world = World { incarnation: 1, tick: 9, valid_at_s: 0.9, entry: WorldEntry::default() };
        let measured = Measured { tick: 9, valid_at_s: 0.9, measurement: Measurement::default() };
        let driven = Driven {
            tick: 9,
            valid_at_s: 0.9,
            command: Command::default(),
            has_measured: true,
            heading_after_ns: Some(5),
            host_ns: 2,
            heading_late: false,
            headings_refused: 0,
        };
        let down = Downlink {
            run_id: 7,
            sent_ns: 3,
            world: Some(world),
            heading: Some(heading),
            heard: Ticks::default(),
            repeat_after_ns: 1,
        };
        let echo = Some(Echo { sent_ns: 3, held_ns: 4 });
        (down, Uplink { run_id: 7, echo, measured: vec![measured; MEASUREMENTS_MAX], driven: Some(driven) })
    }

    #[test]
    fn the_longest_frames_fit_in_a_datagram_and_are_read_as_they_were_written() {
        let (down, up) = longest();
        let (down_bytes, up_bytes) = (down.to_bytes(), up.to_bytes());
        assert!(!down_bytes.is_empty() && !up_bytes.is_empty());
        assert_eq!(Downlink::from_bytes(&down_bytes, 7), Ok(down));
        assert_eq!(Uplink::from_bytes(&up_bytes, 7), Ok(up));
    }

    #[test]
    fn cut_long_foreign_and_random_frames_are_refused() {
        use rand::{RngExt as _, SeedableRng as _};
        let (down, up) = longest();
        let bytes = up.to_bytes();
        assert_eq!(Uplink::from_bytes(&bytes, 8), Err(FrameError::OtherRun));
        assert_eq!(Downlink::from_bytes(&down.to_bytes(), 8), Err(FrameError::OtherRun));
        // Whatever follows: another version may have other fields.
        let other = FRAME_VERSION.wrapping_add(1);
        for fields in [&[][..], &bytes[1..], &down.to_bytes()[1..], &[0; 400]] {
            let frame = [&[other][..], fields].concat();
            assert_eq!(Uplink::from_bytes(&frame, 7), Err(FrameError::OtherVersion(other)));
            assert_eq!(Downlink::from_bytes(&frame, 7), Err(FrameError::OtherVersion(other)));
        }
        for len in 0..bytes.len() {
            assert!(Uplink::from_bytes(&bytes[..len], 7).is_err(), "{len}");
        }
        assert_eq!(Uplink::from_bytes(&[], 7), Err(FrameError::Malformed));
        assert_eq!(Uplink::from_bytes(&[FRAME_VERSION], 7), Err(FrameError::Malformed));
        assert_eq!(Uplink::from_bytes(&[0; 70_000], 7), Err(FrameError::TooLong(70_000)));
        let crowd = Uplink { measured: vec![up.measured[0]; MEASUREMENTS_MAX + 1], driven: None, ..up };
        assert!(Uplink::from_bytes(&crowd.to_bytes(), 7).is_err());
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        for _ in 0..10_000 {
            let noise = (0..random.random_range(0..FRAME_LEN_MAX)).map(|_| random.random());
            let noise: Vec<u8> = std::iter::once(FRAME_VERSION).chain(noise).collect();
            assert!(Uplink::from_bytes(&noise, 7).is_err() && Downlink::from_bytes(&noise, 7).is_err());
        }
    }

    #[test]
    fn a_set_of_ticks_knows_the_newest_ones() {
        let mut ticks = Ticks::default();
        assert!(!ticks.has(0));
        [3, 0, 5].into_iter().for_each(|tick| ticks.add(tick));
        assert_eq!((0..8).filter(|tick| ticks.has(*tick)).collect::<Vec<_>>(), [0, 3, 5]);
        ticks.add(5 + REMEMBERED_TICKS);
        assert!(ticks.has(5) && !ticks.has(6), "older ticks count as known");
        ticks.add(u64::MAX);
        assert!(!ticks.has(u64::MAX), "no tick has this number");
    }
}
