//! The messages that a gateway sends a robot, and publishes for it.

use std::collections::{BTreeMap, HashMap, HashSet};

use rangehound_robot::remote::Publication;
use rangehound_robot::remote::wire::Downlink;
use rangehound_shared::message::{Command, Drive, Header, WorldEntry};
use rangehound_shared::scenario::Scenario;

/// Longest time between two frames, ns: the interval of those that only keep a link alive, and one look.
const FRAMES_NS: u64 = 121_000_000;

/// Longest time until what a robot has not answered is sent again, ns: the longest interval of repeats, and one look.
const REPEATS_NS: u64 = 201_000_000;

/// Over a good link, a measurement must have come within this time, ns: some repeats.
const ARRIVES_NS: u64 = 600_000_000;

/// The measurements and drives of robots on other hosts, and the published ones.
#[derive(Debug, Default)]
pub(in crate::study::explore) struct Reports {
    /// The drive that each robot has reported at each tick, and whether it obeyed a heading.
    driven: HashMap<(usize, u64), Vec<(Command, bool)>>,
    /// The measurements that no gateway has published: when a process made each one, by robot and tick, ns.
    measured: BTreeMap<(usize, u64), u64>,
    published: HashSet<(usize, u64)>,
}

impl Reports {
    /// A robot reports what it drives.
    pub(in crate::study::explore) fn drives(&mut self, robot: usize, tick: u64, drive: &Drive) {
        self.driven.entry((robot, tick)).or_default().push(driven(drive));
    }

    /// A robot has measured.
    pub(in crate::study::explore) fn measures(&mut self, robot: usize, tick: u64, now_ns: u64) {
        if !self.published.contains(&(robot, tick)) {
            self.measured.insert((robot, tick), now_ns);
        }
    }

    /// A process of a robot has ended, with the measurements that it had not sent yet.
    pub(in crate::study::explore) fn forget(&mut self, robot: usize) {
        self.measured.retain(|(of, _), _| *of != robot);
    }

    /// The gateway publishes a measurement.
    pub(in crate::study::explore) fn publishes(&mut self, robot: usize, tick: u64) {
        self.published.insert((robot, tick));
        self.measured.remove(&(robot, tick));
    }

    /// The gateway publishes what a robot drives: the robot must have reported that.
    pub(in crate::study::explore) fn drove(&self, robot: usize, tick: u64, drive: &Drive) -> Result<(), String> {
        let reported = self.driven.get(&(robot, tick)).is_some_and(|reported| reported.contains(&driven(drive)));
        if reported { Ok(()) } else { Err(format!("robot-{robot} never drove at tick {tick} as it publishes")) }
    }

    /// A robot has had a good link for `good_for_ns`: its measurements must have come.
    pub(in crate::study::explore) fn arrive(&self, robot: usize, now_ns: u64, good_for_ns: u64) -> Result<(), String> {
        let is_lost = |at_ns: u64| good_for_ns.min(now_ns - at_ns) > ARRIVES_NS;
        let of_robot = self.measured.range((robot, 0)..=(robot, u64::MAX));
        match of_robot.into_iter().find(|(_, at_ns)| is_lost(**at_ns)) {
            Some(((_, tick), _)) => Err(format!("its measurement of tick {tick} never came")),
            None => Ok(()),
        }
    }
}

fn driven(drive: &Drive) -> (Command, bool) {
    let Drive { heading_rad, speed_mps, heading_held_ns, .. } = *drive;
    (Command { heading_rad, speed_mps }, heading_held_ns != 0)
}

/// The messages and actions of one relay.
#[derive(Debug)]
pub(in crate::study::explore) struct LinkChecker {
    last_tick: u64,
    /// The newest world: incarnation of the simulator and tick.
    newest: Option<(u64, u64)>,
    /// The greatest known incarnation of fusion, and its newest tick with a heading.
    fusion: (u64, Option<u64>),
    /// Ticks whose measurement was published as new.
    heard: HashSet<u64>,
    /// The tick for which a drive with a heading was published.
    obeyed: Option<u64>,
    framed_ns: u64,
    /// When the present tick's world and heading were sent last, or came first, ns.
    world_ns: u64,
    heading_ns: u64,
}

impl LinkChecker {
    pub(in crate::study::explore) fn new(scenario: &Scenario, fusion_incarnation: u64, now_ns: u64) -> Self {
        Self {
            last_tick: scenario.ticks,
            newest: None,
            fusion: (fusion_incarnation, None),
            heard: HashSet::new(),
            obeyed: None,
            framed_ns: now_ns,
            world_ns: now_ns,
            heading_ns: now_ns,
        }
    }

    /// The gateway was stopped until now: the times in which it sent nothing do not count.
    pub(in crate::study::explore) fn continued(&mut self, now_ns: u64) {
        (self.framed_ns, self.world_ns, self.heading_ns) = (now_ns, now_ns, now_ns);
    }

    /// A world reaches the relay.
    pub(in crate::study::explore) fn world(&mut self, header: &Header, entry: &WorldEntry) {
        let news = (header.incarnation, header.tick);
        let is_valid = header.tick <= self.last_tick && header.valid_at_s.is_finite() && entry.is_valid();
        if is_valid && self.newest.is_none_or(|newest| newest <= news) {
            self.newest = Some(news);
        }
    }

    /// A heading reaches the relay.
    pub(in crate::study::explore) fn heading(&mut self, header: &Header) {
        self.fusion = self.fusion.max((header.incarnation, Some(header.tick)));
    }

    /// The relay calls this new in a frame: a measurement may be new once.
    pub(in crate::study::explore) fn news(&mut self, news: &[Publication]) -> Result<(), String> {
        for publication in news {
            match publication {
                Publication::Range(range, _) if !self.heard.insert(range.tick) => {
                    return Err(format!("it publishes the measurement of tick {} as new again", range.tick));
                }
                Publication::Drive(drive, _)
                    if drive.entry.heading_held_ns != 0 && self.obeyed.replace(drive.tick) == Some(drive.tick) =>
                {
                    return Err(format!("it publishes the drive of tick {} as new again", drive.tick));
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// The gateway publishes a message: a drive is of the present tick.
    pub(in crate::study::explore) fn publishes(&self, publication: &Publication) -> Result<(), String> {
        let present = self.newest.map(|(_, tick)| tick);
        match publication {
            Publication::Drive(drive, _) if Some(drive.tick) != present => {
                Err(format!("it publishes a drive of tick {}, which is not the present one", drive.tick))
            }
            _ => Ok(()),
        }
    }

    /// The gateway sends a frame: news of the present tick, and whatever was not answered in time.
    pub(in crate::study::explore) fn sends(&mut self, frame: &Downlink, now_ns: u64) -> Result<(), String> {
        if now_ns - self.framed_ns > FRAMES_NS {
            return Err("it sends no frame that keeps the link alive".to_owned());
        }
        self.framed_ns = now_ns;
        let present = self.newest.map(|(_, tick)| tick);
        if let Some(heading) = &frame.heading
            && heading.incarnation < self.fusion.0
        {
            return Err(format!("it sends a heading for tick {} of a fusion that was deposed", heading.tick));
        }
        if let Some(world) = &frame.world
            && Some((world.incarnation, world.tick)) != self.newest
        {
            return Err(format!("it sends the world of tick {}, which is not the newest", world.tick));
        }
        let is_answered = present.is_none_or(|tick| self.heard.contains(&tick));
        if is_answered || frame.world.is_some() {
            self.world_ns = now_ns;
        }
        let is_obeyed = present.is_none() || self.fusion.1 != present || self.obeyed == present;
        if is_obeyed || frame.heading.is_some() {
            self.heading_ns = now_ns;
        }
        if now_ns - self.world_ns.min(self.heading_ns) > REPEATS_NS {
            return Err("it does not repeat what the robot has not answered".to_owned());
        }
        Ok(())
    }
}
