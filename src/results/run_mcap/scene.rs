//! A run drawn in well-known messages: positions, commanded headings, measured ranges and bearings, and the robots' own
//! views of their positions.
//!
//! Foxglove draws the scene. Rerun draws only poses and point clouds, so the main objects are sent as those too.

use std::f64::consts::TAU;

use foxglove::messages::line_primitive::Type as LineType;
use foxglove::messages::packed_element_field::NumericType;
use foxglove::messages::{
    ArrowPrimitive, Color, Duration, LinePrimitive, PackedElementField, Point3, PointCloud, Pose, PosesInFrame,
    Quaternion, SceneEntity, SceneUpdate, SpherePrimitive, TextPrimitive, Timestamp, Vector3,
};
use nalgebra::Vector2;
use plotters::style::RGBColor;
use rangehound_shared::scenario::{Scenario, printable};

use crate::draw::belief::Belief;
use crate::draw::chart::{ESTIMATE, TARGET, robot_colour};
use crate::draw::ellipse::Ellipse;
use crate::results::frame::Frame;
use crate::results::report::position_covariance;

/// The coordinate frame of all objects.
const FRAME: &str = "field";

/// How long a trail stays visible, s.
const TRAIL_S: i32 = 5;

/// Most scenes per second of the run's time.
const SCENES_PER_S: f64 = 10.0;

/// Most points of all range circles of a scene together, and the limits for one circle. Larger teams have no circles, rays
/// and believed places.
const CIRCLES_POINTS: usize = 128;
const CIRCLE_POINTS_MAX: usize = 36;
const CIRCLE_POINTS_MIN: usize = 12;

/// Most sensors with name labels, and the size of the labels, px.
const NAMES_MAX: usize = 16;
const FONT_PX: f64 = 14.0;

/// Points of the ellipse in the point cloud.
const ELLIPSE_POINTS: u32 = 32;

/// Size of an object, as a share of the longest range of the first scene, or of the distance to the estimate for a sensor
/// without ranges.
const SIZE_SHARE: f64 = 0.03;

/// As in the report's own pictures.
const SIGMAS: f64 = 3.0;

/// Opacity of ellipses, and of range circles and rays: objects behind them stay visible.
const ELLIPSE_OPACITY: f64 = 0.25;
const CIRCLE_OPACITY: f64 = 0.4;

/// Draws a run's scenes, tick by tick.
#[derive(Debug, Default)]
pub struct Scene {
    /// Size of an object, m; 0 until the first measurement gives the scale of the scene.
    size_m: f64,
    next_s: f64,
    /// Positions in the previous scene: target, estimate, robots.
    before: Vec<Option<[f64; 2]>>,
}

impl Scene {
    /// The scene of a frame, unless the previous scene is too recent.
    pub fn update(&mut self, scenario: &Scenario, frame: &Frame, time_ns: u64) -> Option<SceneUpdate> {
        let time_s = time_ns as f64 * 1e-9;
        // A rounding error of half a nanosecond must not suppress a scene.
        if time_s + 1e-6 < self.next_s {
            return None;
        }
        self.next_s = time_s + 1.0 / SCENES_PER_S;
        if self.size_m == 0.0 {
            let ranges = frame.world.robots.iter().filter_map(|robot| {
                let to_estimate_m = (robot.pose.position_m() - Vector2::from(estimate_of(frame))).norm();
                robot.range_m.or(robot.bearing_rad.map(|_| to_estimate_m))
            });
            let widest_m = ranges.fold(0.0_f64, |widest_m, range_m| widest_m.max(range_m.abs()));
            self.size_m = SIZE_SHARE * widest_m;
        }
        let size_m = if self.size_m > 0.0 { rounded(self.size_m) } else { 0.5 };
        let timestamp = Some(timestamp(time_ns));
        let entity = |id: String, lifetime_s: i32| SceneEntity {
            timestamp,
            frame_id: FRAME.to_owned(),
            id,
            lifetime: (lifetime_s > 0).then_some(Duration::new(lifetime_s, 0)),
            ..SceneEntity::default()
        };
        let mut entities = Vec::new();
        if let Some(place) = target_of(frame) {
            entities.push(SceneEntity {
                spheres: vec![ball(place, size_m, opaque(TARGET))],
                ..entity("target".to_owned(), 0)
            });
        }
        entities.push(SceneEntity {
            spheres: vec![
                ball(estimate_of(frame), 0.8 * size_m, opaque(ESTIMATE)),
                ellipsoid(estimate_of(frame), ellipse_of(frame), ESTIMATE),
            ],
            ..entity("estimate".to_owned(), 0)
        });
        let (mut arrows, mut circles, mut rays) = (Vec::new(), Vec::new(), Vec::new());
        let (mut errors, mut ellipses) = (Vec::new(), Vec::new());
        let points = (CIRCLES_POINTS / scenario.robots.len().max(1)).min(CIRCLE_POINTS_MAX);
        let beliefs = Belief::all(&scenario.robots, &frame.fusion, &frame.world);
        for (id, ((robot, exchange), belief)) in
            frame.world.robots.iter().zip(&frame.fusion.exchanges).zip(beliefs).enumerate()
        {
            arrows.push(arrow(
                at(robot.pose),
                exchange.command.heading_rad,
                exchange.command.speed_mps,
                size_m,
                opaque(robot_colour(id)),
            ));
            let Some((heard, belief)) = exchange.heard.zip(belief).filter(|_| points >= CIRCLE_POINTS_MIN) else {
                continue;
            };
            let (place_m, colour) = (belief.place_m.into(), robot_colour(id));
            if let Some((range_m, _)) = heard.measurement.range() {
                circles.push(circle(place_m, range_m, points, colour));
            }
            if let Some(end_m) = belief.ray_end_m {
                rays.push(segment(place_m, end_m.into(), with_opacity(colour, CIRCLE_OPACITY)));
            }
            if let Some(covariance_m2) = &belief.covariance_m2 {
                ellipses.push(ellipsoid(place_m, Ellipse::new(belief.place_m, covariance_m2, SIGMAS), colour));
            }
            if belief.place_m != belief.true_m {
                errors.push(segment(belief.true_m.into(), place_m, opaque(colour)));
            }
        }
        entities.push(SceneEntity { arrows, texts: names(scenario, frame, size_m), ..entity("robots".to_owned(), 0) });
        entities.push(SceneEntity { lines: circles, ..entity("ranges".to_owned(), 0) });
        // Even without contents: an entity stays as it is until the next one of its name.
        entities.push(SceneEntity { lines: rays, ..entity("bearings".to_owned(), 0) });
        entities.push(SceneEntity { spheres: ellipses, lines: errors, ..entity("believed".to_owned(), 0) });
        let now: Vec<Option<[f64; 2]>> = [target_of(frame), Some(estimate_of(frame))]
            .into_iter()
            .chain(frame.world.robots.iter().map(|robot| Some(at(robot.pose))))
            .collect();
        let trail = trail(&self.before, &now);
        if !trail.points.is_empty() {
            entities.push(SceneEntity { lines: vec![trail], ..entity(format!("trail {}", frame.tick), TRAIL_S) });
        }
        self.before = now;
        Some(SceneUpdate { deletions: Vec::new(), entities })
    }
}

/// The robots' positions and commanded headings.
#[must_use]
pub fn robot_poses(frame: &Frame, time_ns: u64) -> PosesInFrame {
    let robots = frame.world.robots.iter().zip(&frame.fusion.exchanges);
    let poses = robots.map(|(robot, exchange)| pose(at(robot.pose), exchange.command.heading_rad)).collect();
    PosesInFrame { timestamp: Some(timestamp(time_ns)), frame_id: FRAME.to_owned(), poses }
}

/// The target, if its position is known.
#[must_use]
pub fn target_cloud(frame: &Frame, time_ns: u64) -> Option<PointCloud> {
    target_of(frame).map(|place| cloud([place], time_ns))
}

/// The estimate, and the points of its ellipse.
#[must_use]
pub fn estimate_cloud(frame: &Frame, time_ns: u64) -> PointCloud {
    let round = ellipse_of(frame).outline_m(ELLIPSE_POINTS).skip(1);
    cloud(std::iter::once(estimate_of(frame)).chain(round.map(Into::into)), time_ns)
}

fn cloud(places: impl IntoIterator<Item = [f64; 2]>, time_ns: u64) -> PointCloud {
    let field = |(name, offset): (&str, u32)| PackedElementField {
        name: name.to_owned(),
        offset,
        r#type: NumericType::Float32 as i32,
    };
    let numbers = places.into_iter().flat_map(|[x_m, y_m]| [x_m as f32, y_m as f32, 0.0]);
    PointCloud {
        timestamp: Some(timestamp(time_ns)),
        frame_id: FRAME.to_owned(),
        pose: Some(pose([0.0; 2], 0.0)),
        point_stride: 12,
        fields: [("x", 0), ("y", 4), ("z", 8)].map(field).to_vec(),
        data: numbers.flat_map(f32::to_le_bytes).collect::<Vec<u8>>().into(),
    }
}

fn timestamp(time_ns: u64) -> Timestamp {
    const NS_PER_S: u64 = 1_000_000_000;
    Timestamp::new((time_ns / NS_PER_S) as u32, (time_ns % NS_PER_S) as u32)
}

fn at(pose: rangehound_shared::measurement::Pose) -> [f64; 2] {
    [pose.x_m, pose.y_m]
}

fn target_of(frame: &Frame) -> Option<[f64; 2]> {
    frame.world.truth.first_chunk().copied()
}

fn estimate_of(frame: &Frame) -> [f64; 2] {
    let [x_m, y_m, ..] = frame.fusion.estimate.state;
    [x_m, y_m]
}

fn ellipse_of(frame: &Frame) -> Ellipse {
    Ellipse::new(Vector2::from(estimate_of(frame)), &position_covariance(&frame.fusion.estimate), SIGMAS)
}

fn opaque(colour: RGBColor) -> Color {
    with_opacity(colour, 1.0)
}

/// A colour of the report's pictures with an opacity.
fn with_opacity(RGBColor(r, g, b): RGBColor, a: f64) -> Color {
    let [r, g, b] = [r, g, b].map(|part| f64::from(part) / 255.0);
    Color { r, g, b, a }
}

/// Rounded to what a viewer can show: numbers with few bits compress well.
fn rounded(value_m: f64) -> f64 {
    f64::from(value_m as f32)
}

fn pose([x_m, y_m]: [f64; 2], heading_rad: f64) -> Pose {
    let (z, w) = (0.5 * heading_rad).sin_cos();
    Pose {
        position: Some(Vector3 { x: rounded(x_m), y: rounded(y_m), z: 0.0 }),
        orientation: Some(Quaternion { x: 0.0, y: 0.0, z: rounded(z), w: rounded(w) }),
    }
}

fn ball(place_m: [f64; 2], size_m: f64, of: Color) -> SpherePrimitive {
    let size = Some(Vector3 { x: size_m, y: size_m, z: size_m });
    SpherePrimitive { pose: Some(pose(place_m, 0.0)), size, color: Some(of) }
}

/// A covariance as a flat ellipsoid.
fn ellipsoid(place_m: [f64; 2], ellipse: Ellipse, of: RGBColor) -> SpherePrimitive {
    let [a_m, b_m] = ellipse.half_m();
    let size = Some(Vector3 { x: rounded(2.0 * a_m), y: rounded(2.0 * b_m), z: 0.01 });
    SpherePrimitive {
        pose: Some(pose(place_m, ellipse.angle_rad())),
        size,
        color: Some(with_opacity(of, ELLIPSE_OPACITY)),
    }
}

fn arrow(place_m: [f64; 2], heading_rad: f64, speed_mps: f64, size_m: f64, of: Color) -> ArrowPrimitive {
    // A robot that is commanded to stand still has an arrowhead only.
    let shaft_length = if speed_mps > 0.0 { 1.5 * size_m } else { 0.0 };
    ArrowPrimitive {
        pose: Some(pose(place_m, heading_rad)),
        shaft_length,
        shaft_diameter: 0.4 * size_m,
        head_length: size_m,
        head_diameter: 0.8 * size_m,
        color: Some(of),
    }
}

/// The sensors' display names beside them; none if there are too many sensors.
fn names(scenario: &Scenario, frame: &Frame, size_m: f64) -> Vec<TextPrimitive> {
    if scenario.robots.len() > NAMES_MAX {
        return Vec::new();
    }
    let robots = frame.world.robots.iter().enumerate();
    let named = robots.filter_map(|(id, robot)| Some((at(robot.pose), robot_colour(id), scenario.sensor_of(id)?)));
    let text = |([x_m, y_m], colour, name): ([f64; 2], RGBColor, &str)| TextPrimitive {
        pose: Some(pose([x_m, y_m + 1.5 * size_m], 0.0)),
        billboard: true,
        font_size: FONT_PX,
        scale_invariant: true,
        color: Some(opaque(colour)),
        text: printable(name),
    };
    named.map(text).collect()
}

fn circle([x_m, y_m]: [f64; 2], radius_m: f64, points: usize, of: RGBColor) -> LinePrimitive {
    let points = (0..points).map(|point| {
        let (sin, cos) = (TAU * point as f64 / points as f64).sin_cos();
        Point3 { x: rounded(x_m + radius_m * cos), y: rounded(y_m + radius_m * sin), z: 0.0 }
    });
    line(LineType::LineLoop, points.collect(), with_opacity(of, CIRCLE_OPACITY))
}

fn segment(from_m: [f64; 2], to_m: [f64; 2], of: Color) -> LinePrimitive {
    let points = [from_m, to_m].map(|[x_m, y_m]| Point3 { x: rounded(x_m), y: rounded(y_m), z: 0.0 });
    line(LineType::LineStrip, points.to_vec(), of)
}

/// Lines from the previous positions to the present ones.
fn trail(before: &[Option<[f64; 2]>], now: &[Option<[f64; 2]>]) -> LinePrimitive {
    let steps = before.iter().zip(now).filter_map(|(before, now)| Some([(*before)?, (*now)?]));
    let points = steps.flatten().map(|[x_m, y_m]| Point3 { x: rounded(x_m), y: rounded(y_m), z: 0.0 });
    line(LineType::LineList, points.collect(), Color { r: 0.4, g: 0.4, b: 0.4, a: 0.8 })
}

fn line(kind: LineType, points: Vec<Point3>, of: Color) -> LinePrimitive {
    LinePrimitive {
        r#type: kind as i32,
        pose: Some(pose([0.0; 2], 0.0)),
        thickness: 2.0,
        scale_invariant: true,
        points,
        color: Some(of),
        ..LinePrimitive::default()
    }
}

#[cfg(test)]
mod tests {
    use rangehound_shared::measurement::{Measurement, Pose};
    use rangehound_shared::record::{FusionRecord, Heard, WorldRecord};
    use rangehound_shared::scenario::ScenarioFile;

    use super::*;

    #[test]
    fn the_scene_has_rays_and_believed_places_where_there_are_any_and_empty_entities_elsewhere() {
        let scenario = Scenario::from_file(&ScenarioFile::default(), "test").unwrap();
        let frame = |measurement: Measurement| {
            let mut fusion = FusionRecord::of(&scenario);
            fusion.exchanges[1].heard = Some(Heard { measurement, ..Heard::default() });
            Frame { tick: 1, fusion, world: WorldRecord::of(&scenario) }
        };
        let drawn = |measurement| {
            let scene = Scene::default().update(&scenario, &frame(measurement), 0).unwrap();
            let counts = |id| {
                let entity = scene.entities.iter().find(|entity| entity.id == id).unwrap();
                (entity.lines.len(), entity.spheres.len())
            };
            ["ranges", "bearings", "believed"].map(counts)
        };
        let uncertain = Pose { covariance_m2: [1.0, 0.0, 1.0], ..Pose::at([3.0, 4.0]) };
        let bearing = Some((0.5, 0.02));
        assert_eq!(drawn(Measurement::new(Pose::default(), Some((5.0, 0.1)))), [(1, 0), (0, 0), (0, 0)]);
        assert_eq!(drawn(Measurement::new(Pose::default(), None).with_bearing(bearing)), [(0, 0), (1, 0), (0, 0)]);
        assert_eq!(
            drawn(Measurement::new(uncertain, Some((5.0, 0.1))).with_bearing(bearing)),
            [(1, 0), (1, 0), (1, 1)]
        );
    }
}
