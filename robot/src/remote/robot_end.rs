//! The robot's end of the link.

use std::collections::VecDeque;

use rangehound_shared::message::{Command, Drive, Header, Outgoing, Range, WorldEntry};
use rangehound_shared::scenario::Clock;

use super::round_trip::INTERVAL_NS;
use super::wire::{Downlink, Driven, Echo, Heading, MEASUREMENTS_MAX, Measured, REMEMBERED_TICKS, Uplink, World};

/// A measurement that the gateway may not have.
#[derive(Debug, Clone, Copy)]
struct Kept {
    measured: Measured,
    sent_at_ns: Option<u64>,
}

/// Composes the robot's frames: it answers each frame of the gateway, and in real time repeats measurements of past ticks until
/// the gateway has them.
#[derive(Debug)]
pub struct RobotEnd {
    run_id: u64,
    clock: Clock,
    /// The newest frame's stamp, and when it came, ns.
    newest: Option<(u64, u64)>,
    owes_answer: bool,
    kept: VecDeque<Kept>,
    /// A measurement to be sent now, for the first time or again.
    measured: Option<Measured>,
    driven: Option<Driven>,
    repeat_after_ns: u64,
    /// The newest tick whose measurement was sent, and when first, ns.
    sent: Option<(u64, u64)>,
    /// The newest tick whose heading came, and when first, ns.
    headed: Option<(u64, u64)>,
}

impl RobotEnd {
    /// The robot's end of the link to a run.
    #[must_use]
    pub fn new(run_id: u64, clock: Clock) -> Self {
        Self {
            run_id,
            clock,
            newest: None,
            owes_answer: false,
            kept: VecDeque::new(),
            measured: None,
            driven: None,
            repeat_after_ns: *INTERVAL_NS.end(),
            sent: None,
            headed: None,
        }
    }

    /// Takes a frame of the gateway that came at `now_ns`.
    pub fn on_downlink(&mut self, frame: &Downlink, now_ns: u64) {
        self.newest = Some((frame.sent_ns, now_ns));
        self.owes_answer = true;
        if let Some(heading) = &frame.heading {
            note_first(&mut self.headed, heading.tick, now_ns);
        }
        // Whatever a frame says, a measurement is not sent again at once, nor never.
        self.repeat_after_ns = frame.repeat_after_ns.clamp(*INTERVAL_NS.start(), *INTERVAL_NS.end());
        self.kept.retain(|kept| !frame.heard.has(kept.measured.tick));
    }

    /// Takes a message of the robot for the topic `range`.
    pub fn on_range(&mut self, message: &Outgoing<Range>) {
        let Outgoing { tick, valid_at_s, entry: Range { measurement, .. } } = *message;
        let measured = Measured { tick, valid_at_s, measurement };
        self.measured = Some(measured);
        // In lock step the present tick is the only one, and the gateway asks for it.
        let is_new = self.kept.back().is_none_or(|newest| newest.measured.tick < tick);
        if self.clock == Clock::Realtime && is_new {
            if self.kept.len() as u64 == REMEMBERED_TICKS {
                self.kept.pop_front();
            }
            self.kept.push_back(Kept { measured, sent_at_ns: None });
        }
    }

    /// Takes a message of the robot for the topic `drive`.
    pub fn on_drive(&mut self, message: &Outgoing<Drive>) {
        let Outgoing { tick, valid_at_s, entry } = *message;
        self.driven = Some(Driven {
            tick,
            valid_at_s,
            command: Command { heading_rad: entry.heading_rad, speed_mps: entry.speed_mps },
            has_measured: entry.range_sent_ns != 0,
            heading_after_ns: (entry.heading_held_ns != 0).then(|| entry.latency_ns().unwrap_or(0)),
            host_ns: self.host_ns(tick, &entry),
            heading_late: entry.heading_late != 0,
            headings_refused: entry.headings_refused,
        });
    }

    /// How long range and heading of a tick have waited on this host, ns.
    fn host_ns(&self, tick: u64, drive: &Drive) -> u32 {
        let of_tick = |at: Option<(u64, u64)>| at.filter(|(of, _)| *of == tick).map(|(_, at_ns)| at_ns);
        let [sent_ns, headed_ns] = [self.sent, self.headed].map(of_tick);
        let until_sent_ns = sent_ns.map_or(0, |at_ns| at_ns.saturating_sub(drive.range_sent_ns));
        let since_headed_ns = headed_ns.map_or(0, |at_ns| drive.heading_held_ns.saturating_sub(at_ns));
        u32::try_from(until_sent_ns.saturating_add(since_headed_ns)).unwrap_or(u32::MAX)
    }

    /// The next frame for the gateway, if one is due.
    pub fn next_frame(&mut self, now_ns: u64) -> Option<Uplink> {
        // Only a frame of the gateway shows that a measurement has not come.
        let (answers, repeat_after_ns) = (self.owes_answer, self.repeat_after_ns);
        let is_due = |kept: &Kept| {
            kept.sent_at_ns.is_none_or(|at_ns| answers && at_ns.saturating_add(repeat_after_ns) <= now_ns)
        };
        let has_due = self.kept.iter().any(is_due);
        if !self.owes_answer && self.measured.is_none() && self.driven.is_none() && !has_due {
            return None;
        }
        let newest = self.measured.take();
        if let Some(measured) = &newest {
            note_first(&mut self.sent, measured.tick, now_ns);
        }
        let mut measured: Vec<Measured> = newest.into_iter().collect();
        for kept in self.kept.iter_mut().rev() {
            let is_newest = newest.is_some_and(|newest| newest.tick == kept.measured.tick);
            // Measurements that do not fit are due in the next frame.
            let is_sent = !is_newest && is_due(kept) && measured.len() < MEASUREMENTS_MAX;
            if is_sent {
                measured.push(kept.measured);
            }
            if is_newest || is_sent {
                kept.sent_at_ns = Some(now_ns);
            }
        }
        self.owes_answer = false;
        let echo = self.newest.map(|(sent_ns, at_ns)| Echo { sent_ns, held_ns: now_ns.saturating_sub(at_ns) });
        Some(Uplink { run_id: self.run_id, echo, measured, driven: self.driven.take() })
    }

    /// How long the gateway has been silent, ns; `None` before its first frame.
    #[must_use]
    pub fn silence_ns(&self, now_ns: u64) -> Option<u64> {
        self.newest.map(|(_, at_ns)| now_ns.saturating_sub(at_ns))
    }

    /// When a measurement is due that was not sent yet, ns.
    #[must_use]
    pub fn wakes_at_ns(&self) -> Option<u64> {
        self.kept.iter().any(|kept| kept.sent_at_ns.is_none()).then_some(0)
    }
}

/// Notes when something of a tick happened first.
fn note_first(known: &mut Option<(u64, u64)>, tick: u64, now_ns: u64) {
    if known.is_none_or(|(of, _)| of != tick) {
        *known = Some((tick, now_ns));
    }
}

impl World {
    /// The message of the topic `world` that it was.
    #[must_use]
    pub fn message(&self, run_id: u64) -> (Header, WorldEntry) {
        let Self { incarnation, tick, valid_at_s, entry } = *self;
        (Header { run_id, incarnation, tick, valid_at_s, sent_ns: 0 }, entry)
    }
}

impl Heading {
    /// The message of the topic `heading` that it was.
    #[must_use]
    pub fn message(&self, run_id: u64) -> (Header, Command) {
        let Self { incarnation, tick, command } = *self;
        (Header { run_id, incarnation, tick, ..Header::default() }, command)
    }
}
