//! The contents of the page, built from frames; bounded for any length of run and any number of robots.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use nalgebra::Matrix2;
use rangehound_shared::measurement::Pose;
use rangehound_shared::message::Estimate;
use rangehound_shared::robot_set::RobotSet;
use rangehound_shared::scenario::{RobotSpec, Scenario};
use serde::Serialize;
use serde_json::{Value, json};

use super::history::{History, Known, News};
use super::latency::{Latencies, Latency};
use crate::draw::belief::Belief;
use crate::draw::chart::{self, COLOURS};
use crate::results::frame::{Frame, UNSETTLED_TICKS};
use crate::results::report::{RangeSummary, measured, position_covariance};

/// Most places of all robots' trails together.
const TRAIL_PLACES_MAX: usize = 8_000;

/// Most places of one trail.
const TRAIL_MAX: usize = 240;

/// Time over which the tick rate is measured.
const RATE_SPAN: Duration = Duration::from_secs(2);

/// The contents of the page.
#[derive(Debug, Default)]
pub(super) struct Scene {
    about: Value,
    specs: Vec<RobotSpec>,
    trail_max: usize,
    newest: Option<Frame>,
    trails: VecDeque<Places>,
    history: History,
    counts: RangeCounter,
    latencies: Latencies,
    rate: VecDeque<(Instant, u64)>,
    nodes: Option<(u64, Value)>,
    ended: Option<String>,
}

/// The part of the scene that one viewer has received.
#[derive(Debug, Default)]
pub(super) struct Seen {
    is_begun: bool,
    history: Known,
    nodes: u64,
}

/// Positions of target, estimate and robots in one tick.
#[derive(Debug, Clone, Serialize)]
struct Places {
    tick: u64,
    target_m: Option<[f64; 2]>,
    estimate_m: [f64; 2],
    robots_m: Vec<[f64; 2]>,
}

/// Outcome of the ranges of all ticks that were read.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
struct Counts {
    ticks: u64,
    fused: u64,
    rejected: u64,
    late: u64,
    missing: u64,
}

/// Counts ranges as the report does. If one of the newest ticks is read again, its new counts replace the old ones.
#[derive(Debug, Default)]
struct RangeCounter {
    settled_ticks: u64,
    settled: RangeSummary,
    recent: VecDeque<(u64, Estimate)>,
}

/// The newest tick, and the changes that it brings.
#[derive(Debug, Serialize)]
struct Picture<'a> {
    tick: u64,
    time_s: f64,
    ticks_per_s: Option<f64>,
    target_m: Option<[f64; 2]>,
    estimate_m: [f64; 2],
    covariance_m2: [f64; 3],
    robots: Vec<Robot>,
    counts: Counts,
    latency: Latency,
    history: News<'a>,
}

/// One robot in the picture.
#[derive(Debug, Serialize)]
struct Robot {
    position_m: [f64; 2],
    /// Its driven heading.
    heading_rad: f64,
    speed_mps: f64,
    /// Fusion's command.
    command_rad: f64,
    command_mps: f64,
    /// The range that fusion received.
    range_m: Option<f64>,
    /// Where the robot believed it was when it measured, if fusion received its message, and the covariance of that, if it
    /// is not exact.
    believed_m: Option<[f64; 2]>,
    believed_covariance_m2: Option<[f64; 3]>,
    /// End of the ray of its bearing.
    bearing_to_m: Option<[f64; 2]>,
    is_distrusted: bool,
}

impl Scene {
    pub(super) fn new(name: &str, what: &str, scenario: &Scenario) -> Self {
        let robots = scenario.robots.len();
        let trail_max = (TRAIL_PLACES_MAX / robots.max(1)).clamp(30, TRAIL_MAX);
        let about = json!({
            "name": name,
            "what": what,
            "scenario": scenario.name,
            "clock": scenario.clock.name(),
            "planner": scenario.planner.name(),
            "robots": robots,
            // Display names: of a recording's sensors, their names.
            "labels": scenario.robots.iter().map(|robot| &robot.label).collect::<Vec<_>>(),
            "ticks": scenario.ticks,
            "dt_s": scenario.dt_s,
            "measured": measured(scenario.robots.iter().any(|robot| robot.sensor.bearing_std_rad.is_some())),
            "trail_max": trail_max,
            // Without the estimate's colour, by robot id; the same as in the report.
            "robot_colours": (0..COLOURS.len() - 1).map(|id| hex(chart::robot_colour(id))).collect::<Vec<_>>(),
            "estimate_colour": hex(chart::ESTIMATE),
        });
        Self { about, specs: scenario.robots.clone(), trail_max, ..Self::default() }
    }

    /// Adds a tick; the last one is shown.
    pub(super) fn add(&mut self, frame: Frame) {
        self.latencies.add(&frame);
        self.count(frame);
    }

    /// Adds a tick from before the page was started.
    pub(super) fn recall(&mut self, frame: Frame) {
        self.latencies.recall(&frame);
        self.leave_trail(Places::of(&frame));
        self.count(frame);
    }

    fn count(&mut self, frame: Frame) {
        self.count_ranges(frame.tick, &frame.fusion.estimate);
        self.history.add(&frame);
        self.newest = Some(frame);
    }

    /// Counts a tick's ranges, or replaces their counts.
    pub(super) fn count_ranges(&mut self, tick: u64, estimate: &Estimate) {
        self.counts.count(tick, estimate);
    }

    /// Ticks that may still change and are read again.
    pub(super) fn unsettled(&self) -> Vec<u64> {
        self.counts.recent.iter().map(|(tick, _)| *tick).collect()
    }

    /// Updates the trails and the tick rate. Call it after each look, even without new ticks.
    pub(super) fn looked(&mut self, now: Instant) {
        let Some(places) = self.newest.as_ref().map(Places::of) else { return };
        self.rate.push_back((now, places.tick));
        self.leave_trail(places);
        while self.rate.len() > 2 && self.rate.get(1).is_some_and(|(at, _)| now.duration_since(*at) > RATE_SPAN) {
            self.rate.pop_front();
        }
    }

    fn leave_trail(&mut self, places: Places) {
        if self.trails.back().is_none_or(|last| last.tick != places.tick) {
            self.trails.push_back(places);
        }
        while self.trails.len() > self.trail_max {
            self.trails.pop_front();
        }
    }

    pub(super) fn set_nodes(&mut self, nodes: Value) {
        let version = self.nodes.as_ref().map_or(0, |(version, _)| *version);
        self.nodes = Some((version + 1, nodes));
    }

    /// Marks the scene as final.
    pub(super) fn end(&mut self, reason: &str) {
        self.ended = Some(reason.to_owned());
    }

    /// The parts that a viewer has not received, as events of a stream; true if they are the last.
    pub(super) fn news(&self, seen: &mut Seen) -> (String, bool) {
        let mut events = String::new();
        if !std::mem::replace(&mut seen.is_begun, true) {
            event(&mut events, "about", &self.about);
            event(&mut events, "trails", &self.trails);
        }
        if let Some((version, nodes)) = &self.nodes
            && *version != seen.nodes
        {
            seen.nodes = *version;
            event(&mut events, "nodes", nodes);
        }
        if let Some(frame) = &self.newest {
            event(&mut events, "picture", &self.picture(frame, &mut seen.history));
        }
        if let Some(reason) = &self.ended {
            event(&mut events, "ended", reason);
        }
        (events, self.ended.is_some())
    }

    fn picture(&self, frame: &Frame, known: &mut Known) -> Picture<'_> {
        let Places { tick, target_m, estimate_m, .. } = Places::of(frame);
        let p: Matrix2<f64> = position_covariance(&frame.fusion.estimate);
        let distrusted = frame.fusion.estimate.distrusted.map(RobotSet::from_bits);
        let beliefs = Belief::all(&self.specs, &frame.fusion, &frame.world);
        let robots = frame.world.robots.iter().zip(&frame.fusion.exchanges).zip(beliefs).enumerate();
        Picture {
            tick,
            time_s: frame.fusion.time_s,
            ticks_per_s: self.ticks_per_s(),
            target_m,
            estimate_m,
            covariance_m2: [p[(0, 0)], p[(0, 1)], p[(1, 1)]],
            robots: robots
                .map(|(id, ((robot, exchange), belief))| {
                    let range = exchange.heard.and_then(|heard| heard.measurement.range());
                    let covariance_m2 = belief.and_then(|belief| belief.covariance_m2);
                    Robot {
                        position_m: at(robot.pose),
                        heading_rad: milli(robot.driven.heading_rad),
                        speed_mps: milli(robot.driven.speed_mps),
                        command_rad: milli(exchange.command.heading_rad),
                        command_mps: milli(exchange.command.speed_mps),
                        range_m: range.map(|(range_m, _)| milli(range_m)),
                        believed_m: belief.map(|belief| belief.place_m.map(milli).into()),
                        believed_covariance_m2: covariance_m2.map(|p| [p[(0, 0)], p[(0, 1)], p[(1, 1)]]),
                        bearing_to_m: belief.and_then(|belief| Some(belief.ray_end_m?.map(milli).into())),
                        is_distrusted: distrusted.iter().any(|of_kind| of_kind.contains(id)),
                    }
                })
                .collect(),
            counts: self.counts.counts(),
            latency: self.latencies.summary(),
            history: self.history.news(known),
        }
    }

    fn ticks_per_s(&self) -> Option<f64> {
        let (first, last) = (self.rate.front()?, self.rate.back()?);
        let span_s = last.0.duration_since(first.0).as_secs_f64();
        // Over a shorter time the rate would fluctuate too much.
        (span_s >= 0.5).then(|| last.1.saturating_sub(first.1) as f64 / span_s)
    }
}

impl RangeCounter {
    fn count(&mut self, tick: u64, estimate: &Estimate) {
        if let Some((_, before)) = self.recent.iter_mut().find(|(at, _)| *at == tick) {
            *before = *estimate;
            return;
        }
        self.recent.push_back((tick, *estimate));
        if self.recent.len() > UNSETTLED_TICKS
            && let Some((_, oldest)) = self.recent.pop_front()
        {
            self.settled_ticks += 1;
            self.settled.add(&oldest);
        }
    }

    fn counts(&self) -> Counts {
        let mut ranges = self.settled;
        self.recent.iter().for_each(|(_, recent)| ranges.add(recent));
        let RangeSummary { fused, rejected, late, missing, .. } = ranges;
        Counts { ticks: self.settled_ticks + self.recent.len() as u64, fused, rejected, late, missing }
    }
}

impl Places {
    fn of(frame: &Frame) -> Self {
        let state = &frame.fusion.estimate.state;
        Self {
            tick: frame.tick,
            target_m: match *frame.world.truth.as_slice() {
                [x_m, y_m, ..] => Some([milli(x_m), milli(y_m)]),
                _ => None,
            },
            estimate_m: [milli(state[0]), milli(state[1])],
            robots_m: frame.world.robots.iter().map(|robot| at(robot.pose)).collect(),
        }
    }
}

/// Appends an event of a stream.
fn event(events: &mut String, name: &str, data: &impl Serialize) {
    // Plain structs with text for keys always have a JSON form, and it has no line breaks.
    let data = serde_json::to_string(data).unwrap_or_default();
    for part in ["event: ", name, "\ndata: ", &data, "\n\n"] {
        events.push_str(part);
    }
}

/// A position as it is shown.
fn at(pose: Pose) -> [f64; 2] {
    [pose.x_m, pose.y_m].map(milli)
}

/// Rounds to thousandths, enough for a picture.
fn milli(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}

fn hex(colour: plotters::style::RGBColor) -> String {
    let plotters::style::RGBColor(red, green, blue) = colour;
    format!("#{red:02x}{green:02x}{blue:02x}")
}

/// A tick of a team without any other data.
#[cfg(test)]
pub(super) fn frame_for_test(tick: u64, scenario: &Scenario) -> Frame {
    use rangehound_shared::record::{FusionRecord, WorldRecord};

    let fusion = FusionRecord { time_s: tick as f64 * scenario.dt_s, ..FusionRecord::of(scenario) };
    Frame { tick, fusion, world: WorldRecord { truth: Vec::new(), ..WorldRecord::of(scenario) } }
}

#[cfg(test)]
mod tests {

    use rangehound_shared::measurement::Measurement;
    use rangehound_shared::record::Heard;
    use rangehound_shared::scenario::ScenarioFile;

    use super::*;

    /// Names and data of the events that a viewer receives.
    fn events(scene: &Scene, seen: &mut Seen) -> Vec<(String, Value)> {
        let (text, _) = scene.news(seen);
        let event = |event: &str| {
            let (name, data) = event.strip_prefix("event: ").unwrap().split_once("\ndata: ").unwrap();
            (name.to_owned(), serde_json::from_str(data).unwrap())
        };
        text.split_terminator("\n\n").map(event).collect()
    }

    #[test]
    fn a_viewer_receives_the_full_scene_first_and_then_changes() {
        let scenario = Scenario::from_file(&ScenarioFile::default(), "test").unwrap();
        let (mut scene, mut seen) = (Scene::new("a", "run", &scenario), Seen::default());
        let names = |events: &[(String, Value)]| events.iter().map(|(name, _)| name.clone()).collect::<Vec<_>>();
        assert_eq!(names(&events(&scene, &mut seen)), ["about", "trails"]);
        for tick in 0..=9 {
            scene.add(frame_for_test(tick, &scenario));
        }
        scene.set_nodes(json!({"nodes": []}));
        let sent = events(&scene, &mut seen);
        assert_eq!(names(&sent), ["nodes", "picture"]);
        assert_eq!(sent[1].1["history"]["points"].as_array().unwrap().len(), 9);
        scene.add(frame_for_test(10, &scenario));
        scene.end("over");
        let sent = events(&scene, &mut seen);
        assert_eq!(names(&sent), ["picture", "ended"]);
        // The last point may have changed.
        assert_eq!(sent[0].1["history"]["from"], 8);
        assert_eq!(sent[0].1["history"]["points"].as_array().unwrap().len(), 2);
    }

    #[test]
    fn late_ranges_were_not_missing_and_a_tick_read_again_counts_once() {
        let mut counts = RangeCounter::default();
        let tick = |fused, missing| Estimate { fused, missing, ..Estimate::default() };
        counts.count(1, &tick(3, 0));
        // Recorded again after a kill.
        counts.count(1, &tick(1, 2));
        counts.count(2, &Estimate { late: 3, fused_late: 1, rejected_late: 1, ..tick(3, 0) });
        let expected = Counts { ticks: 2, fused: 5, rejected: 1, late: 3, missing: 0 };
        assert_eq!(counts.counts(), expected);
        (3..=100).for_each(|at| counts.count(at, &tick(3, 0)));
        assert_eq!(counts.counts(), Counts { ticks: 100, fused: 5 + 98 * 3, ..expected });
        assert_eq!(counts.recent.len(), UNSETTLED_TICKS);
    }

    #[test]
    fn a_robot_has_its_believed_place_its_uncertainty_and_the_ray_of_its_bearing() {
        let file = ScenarioFile::parse(include_str!("../../scenarios/mixed_sensors.toml"), "test").unwrap();
        let scenario = Scenario::from_file(&file, "test").unwrap();
        let (mut scene, mut seen) = (Scene::new("a", "run", &scenario), Seen::default());
        let mut frame = frame_for_test(1, &scenario);
        frame.fusion.estimate.state[..2].copy_from_slice(&[10.0, 0.0]);
        let exact = Measurement::new(Pose::default(), Some((9.5, 0.3)));
        let pose = Pose { covariance_m2: [1.0, 0.25, 4.0], ..Pose::at([0.0, 1.0]) };
        let uncertain = Measurement::new(pose, None).with_bearing(Some((0.0, 0.02)));
        for (exchange, measurement) in frame.fusion.exchanges.iter_mut().zip([exact, uncertain]) {
            exchange.heard = Some(Heard { measurement, ..Heard::default() });
        }
        scene.add(frame);
        let sent = events(&scene, &mut seen);
        assert_eq!(sent[0].1["measured"], "measurements");
        let shown = ["range_m", "believed_m", "believed_covariance_m2", "bearing_to_m"];
        let of = |robot: usize| shown.map(|key| sent[2].1["robots"][robot][key].clone());
        assert_eq!(of(0), [json!(9.5), json!([0.0, 0.0]), Value::Null, Value::Null]);
        assert_eq!(of(1), [Value::Null, json!([0.0, 1.0]), json!([1.0, 0.25, 4.0]), json!([11.055, 1.0])]);
        assert_eq!(of(2), [Value::Null, Value::Null, Value::Null, Value::Null]);
    }

    #[test]
    fn nan_and_infinite_values_are_shown_as_unknown() {
        let scenario = Scenario::from_file(&ScenarioFile::default(), "test").unwrap();
        let (mut scene, mut seen) = (Scene::new("a\n\"b", "run", &scenario), Seen::default());
        let mut frame = frame_for_test(u64::MAX - 1, &scenario);
        frame.fusion.estimate.state = [f64::NAN; 8];
        frame.fusion.estimate.covariance = [f64::INFINITY; 64];
        frame.fusion.estimate.fused = u64::MAX;
        frame.world.robots[0].pose = Pose::at([f64::NAN; 2]);
        scene.add(frame.clone());
        scene.add(frame);
        scene.looked(Instant::now());
        let sent = events(&scene, &mut seen);
        assert_eq!(sent[2].1["estimate_m"], json!([null, null]));
    }
}
