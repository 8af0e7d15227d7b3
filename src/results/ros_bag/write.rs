//! Frames into the MCAP file of a bag, one at a time.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::io::{Seek, Write};
use std::rc::Rc;

use mcap::records::MessageHeader;
use mcap::{Compression, McapError, WriteOptions};
use rangehound_shared::message::Estimate;
use rangehound_shared::scenario::{Scenario, Source};

use super::diagnostics::TickDiagnostics;
use super::markers::{RobotMarkers, markers};
use super::messages::{Messages, Topic};
use super::planar::{self, Controller, Moving, PlanarPose};
use crate::results::frame::Frame;
use crate::results::report::position_covariance;
use crate::results::run_mcap::write::{Counting, Written};

/// A chunk is written once it has this many bytes before compression: as rosbag2 does.
const CHUNK_LEN: u64 = 768 << 10;

/// Least time between two messages of markers, and between two of diagnostics: those of the node, by default.
const MARKERS_NS: i64 = 100_000_000;
const DIAGNOSTICS_NS: i64 = 1_000_000_000;

/// Stamps are rounded.
const ROUNDING_NS: i64 = 1_000;

/// A topic in the file.
#[derive(Debug, Clone, Copy)]
pub struct Channel {
    id: u16,
    /// Number of its messages.
    pub count: u64,
}

/// The contents of the file, for `metadata.yaml`.
#[derive(Debug, Clone, Default)]
pub struct Contents {
    /// The topics.
    pub topics: BTreeMap<Topic, Channel>,
    /// First and last stamp, ns.
    pub span_ns: Option<[i64; 2]>,
    /// The offset from the run's times to the stamps, ns.
    pub offset_ns: i64,
}

impl Contents {
    /// Number of messages.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.topics.values().map(|topic| topic.count).sum()
    }
}

/// The quality of service of all topics, as rosbag2 writes it.
pub const QOS: &str = "- history: keep_last\n  depth: 10\n  reliability: reliable\n  durability: volatile\n  \
                       deadline:\n    sec: 9223372036\n    nsec: 854775807\n  lifespan:\n    sec: 9223372036\n    nsec: 854775807\n  \
                       liveliness: automatic\n  liveliness_lease_duration:\n    sec: 9223372036\n    nsec: 854775807\n  \
                       avoid_ros_namespace_conventions: false\n";

/// Writes the frames of a run in order of their ticks.
pub struct BagWriter<W: Write + Seek> {
    mcap: mcap::Writer<Counting<W>>,
    messages: Messages,
    contents: Contents,
    bytes_max: u64,
    bytes_written: Rc<Cell<u64>>,
    is_recording: bool,
    has_velocity: bool,
    controller: Controller,
    ticks: u64,
    marked_ns: Option<i64>,
    diagnosed_ns: Option<i64>,
    /// Measurements rejected since the last diagnostics.
    rejected: u64,
    /// The values at the newest stamp. A recording may have several ticks for it, of which the last knows most.
    newest: Option<Newest>,
}

struct Newest {
    time_s: f64,
    estimate: Estimate,
    robots: BTreeMap<usize, PlanarPose>,
    /// The drawing of each robot.
    seen: Vec<Option<RobotMarkers>>,
    facts: TickDiagnostics,
}

impl<W: Write + Seek> BagWriter<W> {
    /// Begins a file.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn begin(out: W, scenario: &Scenario, bytes_max: u64) -> Result<Self, McapError> {
        let bytes_written = Rc::new(Cell::new(0));
        let options = WriteOptions::new()
            .profile("ros2")
            .compression(Some(Compression::Lz4))
            .chunk_size(Some(CHUNK_LEN))
            .disable_seeking(true);
        Ok(Self {
            mcap: options.create(Counting { out, bytes_written: Rc::clone(&bytes_written) })?,
            messages: Messages::default(),
            contents: Contents { offset_ns: planar::stamp_offset_ns(scenario), ..Contents::default() },
            bytes_max,
            bytes_written,
            is_recording: matches!(scenario.source, Source::Recorded { .. }),
            has_velocity: planar::has_velocity(scenario),
            controller: Controller::of_team(scenario),
            ticks: scenario.ticks,
            marked_ns: None,
            diagnosed_ns: None,
            rejected: 0,
            newest: None,
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
        // Tick 0 of a recording comes before the first range, when nothing is known.
        if self.is_recording && frame.tick == 0 {
            return Ok(Written::Taken);
        }
        let time_s = frame.fusion.time_s;
        if self.newest.as_ref().is_some_and(|newest| newest.time_s != time_s) {
            self.put_newest(false)?;
        }
        self.set_stamp(time_s);
        if !frame.world.truth.is_empty() {
            self.messages.truth(&frame.world.truth, self.has_velocity);
            self.put(Topic::Truth)?;
        }
        let (mut robots, mut seen) = self.newest.take().map(|newest| (newest.robots, newest.seen)).unwrap_or_default();
        seen.resize(frame.fusion.exchanges.len(), None);
        for (id, exchange) in frame.fusion.exchanges.iter().enumerate() {
            if let Some(heard) = exchange.heard {
                let placed = PlanarPose::robot(&heard.measurement.pose);
                self.messages.pose_with_covariance(&placed);
                self.put(Topic::Pose(id))?;
                if !self.is_recording {
                    self.messages.twist(id, self.controller.twist(exchange.command, placed.yaw_rad));
                    self.put(Topic::Twist(id))?;
                }
                robots.insert(id, placed);
                // The range of an earlier tick of this stamp counts.
                let before = seen[id].and_then(|before| before.range);
                seen[id] = RobotMarkers::of(exchange).map(|now| RobotMarkers { range: now.range.or(before), ..now });
                if let Some((range_m, std_m)) = heard.measurement.range() {
                    self.messages.range(id, range_m, std_m);
                    self.put(Topic::Range(id))?;
                }
                if let Some((bearing_rad, _)) = heard.measurement.bearing() {
                    self.messages.bearing(id, bearing_rad);
                    self.put(Topic::Bearing(id))?;
                }
            }
            if !self.is_recording {
                self.messages.velocity(exchange.command);
                self.put(Topic::Velocity(id))?;
            }
        }
        self.rejected += frame.fusion.estimate.rejected;
        let facts = TickDiagnostics::of(frame.tick, self.ticks, &frame.fusion);
        self.newest = Some(Newest { time_s, estimate: frame.fusion.estimate, robots, seen, facts });
        Ok(Written::Taken)
    }

    /// Writes index and summary.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn finish(mut self) -> Result<(W, Contents), McapError> {
        self.put_newest(true)?;
        self.mcap.finish()?;
        Ok((self.mcap.into_inner().out, self.contents))
    }

    /// Writes what holds at the newest stamp, which may be the last.
    fn put_newest(&mut self, is_last: bool) -> Result<(), McapError> {
        let Some(Newest { time_s, estimate, robots, seen, facts }) = self.newest.take() else { return Ok(()) };
        let stamp_ns = self.set_stamp(time_s);
        let target = PlanarPose::target(&estimate, self.has_velocity);
        self.messages.pose_with_covariance(&target);
        self.put(Topic::TargetPose)?;
        self.messages.odometry(&target, &Moving::target(&estimate, self.has_velocity));
        self.put(Topic::TargetOdometry)?;
        self.messages.frames(&target, robots.iter().map(|(id, placed)| (*id, placed)));
        self.put(Topic::Frames)?;
        if is_due(self.marked_ns, stamp_ns, MARKERS_NS) {
            self.marked_ns = Some(stamp_ns);
            let [x_m, y_m, ..] = estimate.state;
            self.messages.markers(&markers([x_m, y_m], &position_covariance(&estimate), &seen));
            self.put(Topic::Markers)?;
        }
        // The last one makes the sum of all rejected measurements complete.
        if is_last || is_due(self.diagnosed_ns, stamp_ns, DIAGNOSTICS_NS) {
            self.diagnosed_ns = Some(stamp_ns);
            self.messages.diagnostics(&facts.status(std::mem::take(&mut self.rejected)));
            self.put(Topic::Diagnostics)?;
        }
        Ok(())
    }

    /// Sets the stamp of the next messages, and returns it, ns.
    fn set_stamp(&mut self, time_s: f64) -> i64 {
        let Contents { span_ns, offset_ns, .. } = &mut self.contents;
        let stamp_ns = planar::stamp_ns(time_s).saturating_add(*offset_ns);
        *span_ns = Some([span_ns.map_or(stamp_ns, |[first, _]| first), stamp_ns]);
        self.messages.set_stamp(stamp_ns);
        stamp_ns
    }

    /// Writes the message that was made last.
    fn put(&mut self, topic: Topic) -> Result<(), McapError> {
        let known = self.contents.topics.get(&topic).copied();
        let channel = match known {
            Some(channel) => channel,
            None => Channel { id: self.channel(topic)?, count: 0 },
        };
        self.contents.topics.insert(topic, Channel { count: channel.count + 1, ..channel });
        let stamp_ns = self.contents.span_ns.map_or(0, |[_, last_ns]| last_ns.max(0)).cast_unsigned();
        let header = MessageHeader {
            channel_id: channel.id,
            sequence: channel.count as u32,
            log_time: stamp_ns,
            publish_time: stamp_ns,
        };
        self.mcap.write_to_known_channel(&header, self.messages.bytes())
    }

    fn channel(&mut self, topic: Topic) -> Result<u16, McapError> {
        let interface = topic.interface();
        let schema = self.mcap.add_schema(interface.name, "ros2msg", interface.text().as_bytes())?;
        let facts = [("offered_qos_profiles", QOS), ("topic_type_hash", interface.hash)];
        let facts = facts.map(|(key, value)| (key.to_owned(), value.to_owned())).into();
        self.mcap.add_channel(schema, &topic.name(), "cdr", &facts)
    }
}

/// True if a message is due that comes at most once in an interval.
fn is_due(before_ns: Option<i64>, stamp_ns: i64, interval_ns: i64) -> bool {
    before_ns.is_none_or(|before_ns| stamp_ns.saturating_sub(before_ns) >= interval_ns - ROUNDING_NS)
}
