//! Frames into the encoded messages of all channels: the same bytes for a file and for a viewer of a live run.

use foxglove::messages::{PointCloud, PosesInFrame, SceneUpdate};
use foxglove::{Encode, Schema};
use rangehound_shared::scenario::Scenario;

use super::messages::{Drive, Estimate, Heading, Range, TOPICS, Truth, World, encode};
use super::scene::{self, Scene};
use super::topics::messages_of;
use crate::results::frame::Frame;

/// The topics that viewers draw. Their channels follow those of [`TOPICS`].
const VIEWS: [&str; 4] = ["/scene", "/scene/robots", "/scene/target", "/scene/estimate"];

/// Number of channels.
pub const CHANNELS: usize = TOPICS.len() + VIEWS.len();

/// A channel of a run.
#[derive(Debug, Clone)]
pub struct Channel {
    /// Its topic.
    pub topic: &'static str,
    /// The schema of its messages.
    pub schema: Option<Schema>,
    /// The encoding of its messages.
    pub message_encoding: String,
}

impl Channel {
    fn of<M: Encode>(topic: &'static str) -> Self {
        Self { topic, schema: M::get_schema(), message_encoding: M::get_message_encoding() }
    }
}

/// All channels. A message names its channel by its place here.
#[must_use]
pub fn channels() -> [Channel; CHANNELS] {
    [
        Channel::of::<World>(TOPICS[0]),
        Channel::of::<Range>(TOPICS[1]),
        Channel::of::<Heading>(TOPICS[2]),
        Channel::of::<Drive>(TOPICS[3]),
        Channel::of::<Estimate>(TOPICS[4]),
        Channel::of::<Truth>(TOPICS[5]),
        Channel::of::<SceneUpdate>(VIEWS[0]),
        Channel::of::<PosesInFrame>(VIEWS[1]),
        Channel::of::<PointCloud>(VIEWS[2]),
        Channel::of::<PointCloud>(VIEWS[3]),
    ]
}

/// An encoded message.
#[derive(Debug, Clone, Copy)]
pub struct Encoded<'a> {
    /// Its channel: the place in [`channels`].
    pub channel: usize,
    /// Time of the run, ns, 0 at its first tick.
    pub log_time_ns: u64,
    /// The sender's monotonic stamp, or its last known one, or `log_time_ns`.
    pub publish_time_ns: u64,
    /// The message.
    pub bytes: &'a [u8],
}

/// Encodes the frames of a run in order of their ticks, from the first one on.
#[derive(Debug)]
pub struct Encoder {
    scenario: Scenario,
    scene: Scene,
    /// Time of the first frame, s; the channels' time starts there.
    first_s: Option<f64>,
    last_ns: u64,
    /// The newest stamp of each topic's sender.
    stamps_ns: [Option<u64>; TOPICS.len()],
    bytes: Vec<u8>,
}

impl Encoder {
    /// An encoder for a run of this scenario.
    #[must_use]
    pub fn new(scenario: &Scenario) -> Self {
        Self {
            scenario: scenario.clone(),
            scene: Scene::default(),
            first_s: None,
            last_ns: 0,
            stamps_ns: [None; TOPICS.len()],
            bytes: Vec::new(),
        }
    }

    /// Passes the messages of a frame to `put`.
    ///
    /// # Errors
    /// If a message cannot be encoded; also the errors of `put`.
    pub fn encode<E: From<std::io::Error>>(
        &mut self,
        frame: &Frame,
        mut put: impl FnMut(Encoded<'_>) -> Result<(), E>,
    ) -> Result<(), E> {
        let time_s = frame.fusion.time_s;
        let since_first_s = time_s - *self.first_s.get_or_insert(time_s);
        // Playback uses the run's time, which never decreases.
        let log_time_ns = ((since_first_s * 1e9).round() as u64).max(self.last_ns);
        self.last_ns = log_time_ns;
        let Self { scenario, scene, stamps_ns, bytes, .. } = self;
        for message in messages_of(frame) {
            let channel = message.topic();
            bytes.clear();
            message.encode(bytes)?;
            // An unknown stamp, as after a kill, is replaced so that the topic stays in its clock.
            let stamp_ns = &mut stamps_ns[channel];
            *stamp_ns = message.sent_ns().or(*stamp_ns);
            put(Encoded { channel, log_time_ns, publish_time_ns: stamp_ns.unwrap_or(log_time_ns), bytes })?;
        }
        let Some(update) = scene.update(scenario, frame, log_time_ns) else { return Ok(()) };
        let mut view = |view: usize, encoded: &dyn Fn(&mut Vec<u8>) -> std::io::Result<()>| {
            bytes.clear();
            encoded(bytes)?;
            put(Encoded { channel: TOPICS.len() + view, log_time_ns, publish_time_ns: log_time_ns, bytes })
        };
        view(0, &|bytes| encode(&update, bytes))?;
        view(1, &|bytes| encode(&scene::robot_poses(frame, log_time_ns), bytes))?;
        if let Some(target) = scene::target_cloud(frame, log_time_ns) {
            view(2, &|bytes| encode(&target, bytes))?;
        }
        view(3, &|bytes| encode(&scene::estimate_cloud(frame, log_time_ns), bytes))
    }
}
