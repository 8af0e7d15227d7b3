//! Conversion between a [`Frame`] and the messages of the six topics, exact to the last bit.

use rangehound_shared::measurement::{Measurement, Pose};
use rangehound_shared::message::{Command, Estimate as EstimateOfFusion, Stages as StagesOfFusion};
use rangehound_shared::record::digest::Digest;
use rangehound_shared::record::{
    Exchange, FusionDecision, FusionRecord, GateResult, Heading as Followed, Heard, RobotRecord, WorldRecord,
};
use rangehound_shared::robot_set::RobotSet;
use rangehound_shared::scenario::{Scenario, bounds};

use super::messages::{
    CommandTo, Drive, Estimate, Heading, OnTopic, Place, Range, Refused, Stages, TOPICS, Truth, World,
};
use crate::results::frame::Frame;

/// Largest coordinate or range that is accepted, m.
const PLACE_MAX_M: f64 = 1e12;

/// All messages of a tick.
pub fn messages_of(frame: &Frame) -> impl Iterator<Item = OnTopic> + '_ {
    let Frame { tick, fusion: FusionRecord { time_s, estimate, exchanges }, world } = frame;
    let (tick, time_s) = (*tick, *time_s);
    let places = world.robots.iter().map(|robot| {
        let Pose { x_m, y_m, height_m, heading_rad, covariance_m2, .. } = robot.pose;
        let RobotRecord { range_m, bearing_rad, .. } = *robot;
        let position_covariance_m2 = covariance_field(covariance_m2);
        Place { x_m, y_m, range_m, height_m, position_covariance_m2, bearing_rad, heading_rad }
    });
    let world_message = World { tick, time_s: world.time_s, robots: places.collect(), ended_ns: world.ended_ns };
    let ranges = exchanges.iter().zip(&world.robots).zip(0..).filter_map(move |((exchange, body), robot)| {
        let sent_ns = body.range_sent_ns;
        let Pose { x_m, y_m, height_m, heading_rad, covariance_m2, heading_std_rad } =
            exchange.heard.map_or(body.pose, |heard| heard.measurement.pose);
        let range = exchange.heard.and_then(|heard| heard.measurement.range());
        let taken_at = exchange.heard.map(|heard| heard.taken_at);
        let bearing = exchange.heard.and_then(|heard| heard.measurement.bearing());
        let judged = exchange.heard.map(|heard| heard.judged).unwrap_or_default();
        let [used, bearing_used] = judged.map(|judged| judged.map(|judged| judged.used.name().to_owned()));
        let [normalised_square, bearing_normalised_square] =
            judged.map(|judged| judged.and_then(|judged| judged.normalised_square));
        // A range that was neither sent nor received has no message.
        (taken_at.is_some() || sent_ns.is_some()).then(|| {
            let ((range_m, range_std_m), (bearing_rad, bearing_std_rad)) = (range.unzip(), bearing.unzip());
            OnTopic::Range(Range {
                tick,
                time_s,
                robot,
                x_m,
                y_m,
                range_m,
                range_std_m,
                taken_at_tick: taken_at,
                sent_ns,
                height_m,
                used,
                normalised_square,
                position_covariance_m2: covariance_field(covariance_m2),
                bearing_rad,
                bearing_std_rad,
                heading_rad,
                heading_std_rad,
                bearing_used,
                bearing_normalised_square,
            })
        })
    });
    let commands = exchanges
        .iter()
        .map(|Exchange { command: Command { heading_rad, speed_mps }, .. }| CommandTo {
            heading_rad: *heading_rad,
            speed_mps: *speed_mps,
        })
        .collect();
    let heading = Heading { tick, time_s, commands, sent_ns: estimate.stages.sent_ns };
    let drives = world.robots.iter().zip(0..).filter_map(move |(body, robot)| {
        let RobotRecord { pose, range_m, bearing_rad, .. } = *body;
        let silent = RobotRecord { pose, range_m, bearing_rad, ..RobotRecord::default() };
        let drive = || {
            let Command { heading_rad, speed_mps } = body.driven;
            OnTopic::Drive(Drive {
                tick,
                time_s,
                robot,
                heading_rad,
                speed_mps,
                heading: name_of(body.heading).to_owned(),
                range_sent_ns: body.range_sent_ns,
                heading_held_ns: body.heading_held_ns,
                headings_refused: body.headings_refused,
                network_ns: body.network_ns,
                robot_host_ns: body.robot_host_ns,
                gateway_ns: body.gateway_ns,
            })
        };
        (*body != silent).then(drive)
    });
    let truth = (!world.truth.is_empty())
        .then(|| OnTopic::Truth(Truth { tick, time_s: world.time_s, state: world.truth.clone() }));
    // In the order of events in a tick.
    std::iter::once(OnTopic::World(world_message))
        .chain(truth)
        .chain(ranges)
        .chain([OnTopic::Heading(heading), OnTopic::Estimate(Box::new(estimate_message(tick, time_s, estimate)))])
        .chain(drives)
}

fn estimate_message(tick: u64, time_s: f64, estimate: &EstimateOfFusion) -> Estimate {
    let n = estimate.state_dim as usize;
    let [impostor, out_of_range, malformed, future, contradiction, jump] = estimate.refused;
    let StagesOfFusion { last_range_ns, began_ns, filtered_ns, planned_ns, saved_ns, sent_ns } = estimate.stages;
    let [distrusted, distrusted_bearings] =
        estimate.distrusted.map(|bits| RobotSet::from_bits(bits).iter().map(|id| id as u64).collect());
    let [noise_scale, bearing_noise_scale] = estimate.noise_scale;
    Estimate {
        tick,
        time_s,
        state: estimate.state[..n].to_vec(),
        covariance: estimate.covariance[..n * n].to_vec(),
        nis: estimate.nis,
        fused: estimate.fused,
        rejected: estimate.rejected,
        missing: estimate.missing,
        late: estimate.late,
        fused_late: estimate.fused_late,
        rejected_late: estimate.rejected_late,
        refused: Some(Refused { impostor, out_of_range, malformed, future, contradiction, jump }),
        distrusted,
        objective: estimate.objective,
        lower_bound: estimate.lower_bound,
        stages: Some(Stages { last_range_ns, began_ns, filtered_ns, planned_ns, saved_ns, sent_ns }),
        digest: Digest::from_words(estimate.digest).to_string(),
        nis_all: estimate.nis_all,
        tested: estimate.tested,
        noise_scale,
        least_trace_m2: estimate.least_trace_m2,
        distrusted_bearings,
        bearing_noise_scale,
    }
}

/// Why messages do not form a tick of a run.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum InvalidTick {
    /// A message's bytes or numbers are invalid.
    #[error("a message on {topic} is invalid in tick {tick}")]
    Message {
        /// The tick.
        tick: u64,
        /// Its topic.
        topic: &'static str,
    },
    /// A message is missing.
    #[error("no message on {topic} in tick {tick}")]
    MissingTopic {
        /// The tick.
        tick: u64,
        /// Its topic.
        topic: &'static str,
    },
}

/// Collects the messages of one tick into a [`Frame`].
#[derive(Debug)]
pub struct Gathering {
    tick: u64,
    robots: usize,
    state_dim: usize,
    has_truth: bool,
    world: Option<WorldRecord>,
    estimate: Option<(f64, EstimateOfFusion)>,
    exchanges: Vec<Exchange>,
    driven: Vec<Option<Drive>>,
    truth: Vec<f64>,
    has_headings: bool,
}

impl Gathering {
    /// An empty collection for a tick of a run of this scenario.
    #[must_use]
    pub fn of(scenario: &Scenario, tick: u64) -> Self {
        let robots = scenario.robots.len();
        Self {
            tick,
            robots,
            state_dim: scenario.motion.state_dim(),
            has_truth: scenario.has_truth(),
            world: None,
            estimate: None,
            exchanges: vec![Exchange::default(); robots],
            driven: vec![None; robots],
            truth: Vec::new(),
            has_headings: false,
        }
    }

    /// Takes a message of this tick.
    ///
    /// # Errors
    /// If it is not valid in such a run.
    pub fn take(&mut self, message: OnTopic) -> Result<(), InvalidTick> {
        let topic = TOPICS[message.topic()];
        self.admit(message).ok_or(InvalidTick::Message { tick: self.tick, topic })
    }

    fn admit(&mut self, message: OnTopic) -> Option<()> {
        match message {
            OnTopic::World(World { time_s, robots, ended_ns, .. }) => {
                let is_valid = |place: &Place| {
                    [place.x_m, place.y_m, place.height_m, place.range_m.unwrap_or(0.0)].into_iter().all(is_near)
                };
                (robots.len() == self.robots && robots.iter().all(is_valid) && time_s.is_finite()).then_some(())?;
                let record = |place: Place| {
                    let Place { x_m, y_m, range_m, height_m, position_covariance_m2, bearing_rad, heading_rad } = place;
                    let covariance_m2 = covariance_of(&position_covariance_m2)?;
                    let pose = Pose { x_m, y_m, height_m, heading_rad, covariance_m2, heading_std_rad: 0.0 };
                    Some(RobotRecord { pose, range_m, bearing_rad, ..RobotRecord::default() })
                };
                let robots = robots.into_iter().map(record).collect::<Option<Vec<_>>>()?;
                self.world = Some(WorldRecord { time_s, ended_ns, truth: Vec::new(), robots });
            }
            OnTopic::Range(range) => {
                let slot = self.exchanges.get_mut(usize::try_from(range.robot).ok()?)?;
                let covariance_m2 = covariance_of(&range.position_covariance_m2)?;
                let Range { x_m, y_m, height_m, heading_rad, heading_std_rad, taken_at_tick, .. } = range;
                let range_m = range.range_m.zip(range.range_std_m);
                let bearing_rad = range.bearing_rad.zip(range.bearing_std_rad);
                let is_valid = range_m
                    .is_none_or(|(range_m, std_m)| is_near(range_m) && bounds::STD_M.contains(&std_m))
                    && bearing_rad.is_none_or(|(bearing_rad, std_rad)| {
                        is_near(bearing_rad) && bounds::BEARING_STD_RAD.contains(&std_rad)
                    })
                    && bounds::HEADING_STD_RAD.contains(&heading_std_rad);
                ([x_m, y_m, height_m, heading_rad].into_iter().all(is_near) && is_valid).then_some(())?;
                let judged = [
                    judged_of(range.used.as_deref(), range.normalised_square)?,
                    judged_of(range.bearing_used.as_deref(), range.bearing_normalised_square)?,
                ];
                let pose = Pose { x_m, y_m, height_m, heading_rad, covariance_m2, heading_std_rad };
                let measurement = Measurement::new(pose, range_m).with_bearing(bearing_rad);
                let heard = |taken_at| Heard { measurement, taken_at, judged };
                slot.heard = taken_at_tick.map(heard);
                slot.heard.is_none_or(|heard| heard.taken_at >= self.tick).then_some(())?;
            }
            OnTopic::Heading(Heading { commands, .. }) => {
                (commands.len() == self.robots).then_some(())?;
                for (slot, CommandTo { heading_rad, speed_mps }) in self.exchanges.iter_mut().zip(commands) {
                    slot.command = Command { heading_rad, speed_mps };
                }
                self.has_headings = true;
            }
            OnTopic::Drive(drive) => {
                let slot = self.driven.get_mut(usize::try_from(drive.robot).ok()?)?;
                *slot = Some(drive);
            }
            OnTopic::Estimate(estimate) => {
                self.estimate = Some((estimate.time_s, estimate_of(&estimate, self.state_dim)?))
            }
            OnTopic::Truth(Truth { state, .. }) => {
                (self.has_truth && state.len() == self.state_dim).then_some(())?;
                self.truth = state;
            }
        }
        Some(())
    }

    /// The frame, if it is complete.
    ///
    /// # Errors
    /// Names the missing topic.
    pub fn into_frame(self) -> Result<Frame, InvalidTick> {
        let Self { tick, has_truth, world, estimate, exchanges, driven, truth, has_headings, .. } = self;
        let missing = |topic| InvalidTick::MissingTopic { tick, topic };
        if !has_headings {
            return Err(missing("/heading"));
        }
        if has_truth && truth.is_empty() {
            return Err(missing("/truth"));
        }
        let mut world = world.ok_or(missing("/world"))?;
        world.truth = truth;
        for (robot, drive) in world.robots.iter_mut().zip(driven) {
            let Some(drive) = drive else { continue };
            robot.driven = Command { heading_rad: drive.heading_rad, speed_mps: drive.speed_mps };
            robot.heading =
                Followed::ALL.into_iter().find(|heading| name_of(*heading) == drive.heading).unwrap_or_default();
            robot.range_sent_ns = drive.range_sent_ns;
            robot.heading_held_ns = drive.heading_held_ns;
            robot.headings_refused = drive.headings_refused;
            robot.network_ns = drive.network_ns;
            robot.robot_host_ns = drive.robot_host_ns;
            robot.gateway_ns = drive.gateway_ns;
        }
        let (time_s, estimate) = estimate.ok_or(missing("/estimate"))?;
        Ok(Frame { tick, fusion: FusionRecord { time_s, estimate, exchanges }, world })
    }
}

/// The name in a message of what a robot drove by.
fn name_of(heading: Followed) -> &'static str {
    match heading {
        Followed::Unknown => "unknown",
        Followed::Fresh => "fresh",
        Followed::Late => "late",
        Followed::None => "none",
    }
}

/// A covariance as a message has it: empty where it is zero.
fn covariance_field(covariance_m2: [f64; 3]) -> Vec<f64> {
    if covariance_m2 == [0.0; 3] { Vec::new() } else { covariance_m2.to_vec() }
}

/// The covariance of a message; `None` if it is invalid.
fn covariance_of(field: &[f64]) -> Option<[f64; 3]> {
    let covariance_m2 = if field.is_empty() { [0.0; 3] } else { field.try_into().ok()? };
    covariance_m2.into_iter().all(is_near).then_some(covariance_m2)
}

fn is_near(value: f64) -> bool {
    value.abs() <= PLACE_MAX_M
}

/// Fusion's estimate, if its sizes are those of the run.
fn estimate_of(message: &Estimate, state_dim: usize) -> Option<EstimateOfFusion> {
    let n = state_dim;
    (message.state.len() == n && message.covariance.len() == n * n && message.time_s.is_finite()).then_some(())?;
    let digest = u128::from_str_radix(&message.digest, 16).ok()?;
    let Refused { impostor, out_of_range, malformed, future, contradiction, jump } =
        message.refused.clone().unwrap_or_default();
    let Stages { last_range_ns, began_ns, filtered_ns, planned_ns, saved_ns, sent_ns } =
        message.stages.clone().unwrap_or_default();
    let distrusted = [set_of(&message.distrusted)?, set_of(&message.distrusted_bearings)?];
    let mut estimate = EstimateOfFusion {
        state_dim: n as u64,
        nis: message.nis,
        fused: message.fused,
        rejected: message.rejected,
        missing: message.missing,
        late: message.late,
        fused_late: message.fused_late,
        rejected_late: message.rejected_late,
        refused: [impostor, out_of_range, malformed, future, contradiction, jump],
        distrusted: distrusted.map(RobotSet::to_bits),
        objective: message.objective,
        lower_bound: message.lower_bound,
        stages: StagesOfFusion { last_range_ns, began_ns, filtered_ns, planned_ns, saved_ns, sent_ns },
        digest: [digest as u64, (digest >> 64) as u64],
        nis_all: message.nis_all,
        tested: message.tested,
        noise_scale: [message.noise_scale, message.bearing_noise_scale],
        least_trace_m2: message.least_trace_m2,
        ..EstimateOfFusion::default()
    };
    estimate.state[..n].copy_from_slice(&message.state);
    estimate.covariance[..n * n].copy_from_slice(&message.covariance);
    Some(estimate)
}

/// Fusion's decision with this name; `Some(None)` without one, and `None` for an unknown name.
fn judged_of(name: Option<&str>, normalised_square: Option<f64>) -> Option<Option<GateResult>> {
    let Some(name) = name else { return Some(None) };
    let used = FusionDecision::ALL.into_iter().find(|used| used.name() == name)?;
    Some(Some(GateResult { used, normalised_square: normalised_square.filter(|square| !square.is_nan()) }))
}

/// The robots with these ids; `None` if one is not a robot's.
fn set_of(ids: &[u64]) -> Option<RobotSet> {
    let mut robots = RobotSet::default();
    for id in ids {
        robots.set(usize::try_from(*id).ok().filter(|id| *id < rangehound_shared::ROBOTS_MAX)?, true);
    }
    Some(robots)
}
