//! The messages of a bag. All positions are in the frame `map`: x and y as in the run, z is the height above the plane in which the target
//! moves. Covariances of ROS are 6 x 6, row by row over x, y, z, roll, pitch, yaw; a run is planar, and has 0 for z, roll and pitch.

use rangehound_shared::message::Command;

use crate::files::bag::cdr::Writer;
use crate::files::bag::interfaces::{self, Interface};
use crate::results::ros_bag::diagnostics::Status;
use crate::results::ros_bag::markers::Marker;
use crate::results::ros_bag::planar::{Moving, PlanarPose};

/// The frame of all positions.
const MAP: &str = "map";

/// The frame of the target.
const TARGET: &str = "target";

/// Actions of a marker: it stays until the next one of its name, or is deleted.
const ADD: i32 = 0;
const DELETE: i32 = 2;

/// A topic of the bag; those of robots with the robot's id.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Topic {
    /// Where the target is estimated to be.
    TargetPose,
    /// The same with its velocity.
    TargetOdometry,
    /// Where the target truly is.
    Truth,
    /// The frames of target and robots.
    Frames,
    /// The markers that RViz draws.
    Markers,
    /// How the run is.
    Diagnostics,
    /// Where a robot says it is.
    Pose(usize),
    /// The range that it measured.
    Range(usize),
    /// The bearing that it measured.
    Bearing(usize),
    /// The twist for its commanded heading, in its own frame: what the node's controller makes of it by default.
    Twist(usize),
    /// Its commanded velocity over ground.
    Velocity(usize),
}

impl Topic {
    /// Its name.
    #[must_use]
    pub fn name(self) -> String {
        match self {
            Self::TargetPose => "/target/pose".to_owned(),
            Self::TargetOdometry => "/target/odom".to_owned(),
            Self::Truth => "/target/truth".to_owned(),
            Self::Frames => "/tf".to_owned(),
            Self::Markers => "/rangehound/markers".to_owned(),
            Self::Diagnostics => "/diagnostics".to_owned(),
            Self::Pose(robot) => format!("/robot_{robot}/pose"),
            Self::Range(robot) => format!("/robot_{robot}/range"),
            Self::Bearing(robot) => format!("/robot_{robot}/bearing"),
            Self::Twist(robot) => format!("/robot_{robot}/cmd_vel"),
            Self::Velocity(robot) => format!("/robot_{robot}/velocity"),
        }
    }

    /// The type of its messages.
    #[must_use]
    pub fn interface(self) -> Interface {
        match self {
            Self::TargetPose | Self::Pose(_) => interfaces::POSE_WITH_COVARIANCE,
            Self::TargetOdometry => interfaces::ODOMETRY,
            Self::Truth => interfaces::POSE,
            Self::Frames => interfaces::TRANSFORMS,
            Self::Markers => interfaces::MARKERS,
            Self::Diagnostics => interfaces::DIAGNOSTICS,
            Self::Range(_) => interfaces::RANGE,
            Self::Bearing(_) => interfaces::VECTOR,
            Self::Twist(_) | Self::Velocity(_) => interfaces::TWIST,
        }
    }
}

/// The bytes of messages, one at a time.
#[derive(Debug, Default)]
pub struct Messages {
    out: Writer,
    stamp_ns: i64,
}

impl Messages {
    /// The stamp of the next messages, ns.
    pub fn set_stamp(&mut self, stamp_ns: i64) {
        self.stamp_ns = stamp_ns;
    }

    /// The message that was made last.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        self.out.bytes()
    }

    /// `geometry_msgs/PoseWithCovarianceStamped`.
    pub fn pose_with_covariance(&mut self, placed: &PlanarPose) {
        self.begin(MAP);
        self.placed(placed);
    }

    /// `geometry_msgs/PoseStamped` of the true target.
    pub fn truth(&mut self, state: &[f64], has_velocity: bool) {
        let at = |index: usize| state.get(index).copied().unwrap_or(0.0);
        let yaw_rad = if has_velocity { at(3).atan2(at(2)) } else { 0.0 };
        self.begin(MAP);
        self.pose([at(0), at(1), 0.0], yaw_rad);
    }

    /// `nav_msgs/Odometry` of the target: the twist is in its own frame.
    pub fn odometry(&mut self, target: &PlanarPose, moving: &Moving) {
        self.begin(MAP);
        self.out.text(TARGET);
        self.placed(target);
        self.out.f64s(&[moving.speed_mps, 0.0, 0.0, 0.0, 0.0, 0.0]);
        self.out.f64s(&moving.covariance());
    }

    /// `sensor_msgs/Range`, in the frame of the robot.
    pub fn range(&mut self, robot: usize, range_m: f64, std_m: f64) {
        self.begin(&base(robot));
        self.out.u8(0);
        // No cone, and no limits.
        for number in [0.0, 0.0, f32::INFINITY, range_m as f32, (std_m * std_m) as f32] {
            self.out.f32(number);
        }
    }

    /// `geometry_msgs/Vector3Stamped`: the direction in the frame of the robot, of length 1.
    pub fn bearing(&mut self, robot: usize, bearing_rad: f64) {
        self.begin(&base(robot));
        let (sin, cos) = bearing_rad.sin_cos();
        self.out.f64s(&[cos, sin, 0.0]);
    }

    /// `geometry_msgs/TwistStamped`: the commanded velocity over ground, along the axes of `map`.
    pub fn velocity(&mut self, command: Command) {
        self.begin(MAP);
        let Command { heading_rad, speed_mps } = command;
        let (sin, cos) = heading_rad.sin_cos();
        self.out.f64s(&[speed_mps * cos, speed_mps * sin, 0.0, 0.0, 0.0, 0.0]);
    }

    /// `geometry_msgs/TwistStamped` in the frame of the robot: forward speed and turn rate.
    pub fn twist(&mut self, robot: usize, [forward_mps, turn_radps]: [f64; 2]) {
        self.begin(&base(robot));
        self.out.f64s(&[forward_mps, 0.0, 0.0, 0.0, 0.0, turn_radps]);
    }

    /// `tf2_msgs/TFMessage`: the frames of the target and of robots by id.
    pub fn frames<'a>(&mut self, target: &PlanarPose, robots: impl ExactSizeIterator<Item = (usize, &'a PlanarPose)>) {
        self.out.begin();
        self.out.u32(robots.len() as u32 + 1);
        self.frame(TARGET, target);
        for (robot, placed) in robots {
            self.frame(&base(robot), placed);
        }
    }

    /// `visualization_msgs/MarkerArray`.
    pub fn markers(&mut self, markers: &[Marker]) {
        self.out.begin();
        self.out.u32(markers.len() as u32);
        for marker in markers {
            self.marker(marker);
        }
    }

    fn marker(&mut self, marker: &Marker) {
        let Marker { namespace, id, shape, is_shown, position_m: [x_m, y_m], yaw_rad, .. } = *marker;
        self.header(MAP);
        self.out.text(namespace);
        for number in [id as i32, shape as i32, if is_shown { ADD } else { DELETE }] {
            self.out.i32(number);
        }
        self.pose([x_m, y_m, 0.0], yaw_rad);
        self.out.f64s(&marker.scale_m);
        marker.colour.iter().for_each(|part| self.out.f32(*part));
        // Without an end.
        self.out.i32(0);
        self.out.u32(0);
        // Placed once.
        self.out.u8(0);
        self.out.u32(marker.points_m.len() as u32);
        for [x_m, y_m] in &marker.points_m {
            self.out.f64s(&[*x_m, *y_m, 0.0]);
        }
        // No colours of single points.
        self.out.u32(0);
        // No texture: its resource; the stamp, frame, format and bytes of its image; its coordinates.
        self.out.text("");
        self.out.i32(0);
        self.out.u32(0);
        self.out.text("");
        self.out.text("");
        self.out.u32(0);
        self.out.u32(0);
        // No text, and no mesh: its resource; the name and the bytes of its file; its materials.
        self.out.text("");
        self.out.text("");
        self.out.text("");
        self.out.u32(0);
        self.out.u8(0);
    }

    /// `diagnostic_msgs/DiagnosticArray` of one status.
    pub fn diagnostics(&mut self, status: &Status) {
        self.begin("");
        self.out.u32(1);
        self.out.u8(status.level);
        for text in [status.name, status.message, "rangehound"] {
            self.out.text(text);
        }
        self.out.u32(status.values.len() as u32);
        for (key, value) in &status.values {
            self.out.text(key);
            self.out.text(value);
        }
    }

    fn frame(&mut self, child: &str, placed: &PlanarPose) {
        self.header(MAP);
        self.out.text(child);
        self.pose(placed.position_m, placed.yaw_rad);
    }

    fn begin(&mut self, frame: &str) {
        self.out.begin();
        self.header(frame);
    }

    fn header(&mut self, frame: &str) {
        // A stamp has 32 bits of seconds: until 2038.
        let second = self.stamp_ns.div_euclid(1_000_000_000);
        self.out.i32(second.clamp(i32::MIN.into(), i32::MAX.into()) as i32);
        self.out.u32(self.stamp_ns.rem_euclid(1_000_000_000) as u32);
        self.out.text(frame);
    }

    fn placed(&mut self, placed: &PlanarPose) {
        self.pose(placed.position_m, placed.yaw_rad);
        self.out.f64s(&placed.covariance());
    }

    /// A position, and an orientation about the vertical.
    fn pose(&mut self, position_m: [f64; 3], yaw_rad: f64) {
        let (sin, cos) = (0.5 * yaw_rad).sin_cos();
        self.out.f64s(&position_m);
        self.out.f64s(&[0.0, 0.0, sin, cos]);
    }
}

/// The frame of a robot.
fn base(robot: usize) -> String {
    format!("robot_{robot}/base_link")
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix2;
    use rangehound_shared::measurement::Pose;
    use rangehound_shared::message::Estimate;

    use super::*;
    use crate::files::bag::cdr::{Value, read};
    use crate::files::bag::definition::Types;
    use crate::files::bag::path::Path;
    use crate::results::ros_bag::diagnostics::TickDiagnostics;
    use crate::results::ros_bag::markers::{RobotMarkers, markers};
    use crate::results::ros_bag::planar::UNKNOWN;

    fn number(messages: &Messages, topic: Topic, path: &str) -> f64 {
        let types = Types::parse(topic.interface().name, &topic.interface().text()).unwrap();
        let mut values = Vec::new();
        read(&types, messages.bytes(), &Path::parse(&types, path).unwrap(), &mut values).unwrap();
        match &values[..] {
            [value @ (Value::Whole(_) | Value::Real(_))] => value.number(),
            other => panic!("{path}: {other:?}"),
        }
    }

    #[test]
    fn an_estimate_has_its_numbers_where_ros_expects_them() {
        let mut estimate = Estimate { state_dim: 4, ..Estimate::default() };
        estimate.state[..4].copy_from_slice(&[1.0, 2.0, 3.0, 4.0]);
        for (place, number) in [(0, 0.5), (1, 0.1), (4, 0.1), (5, 0.6), (10, 2.0), (11, 0.25), (14, 0.25), (15, 1.0)] {
            estimate.covariance[place] = number;
        }
        let mut messages = Messages::default();
        messages.set_stamp(5_000_000_007);
        messages.odometry(&PlanarPose::target(&estimate, true), &Moving::target(&estimate, true));
        let at = |path: &str| number(&messages, Topic::TargetOdometry, path);
        assert_eq!((at("header.stamp.sec"), at("header.stamp.nanosec")), (5.0, 7.0));
        assert_eq!((at("pose.pose.position.x"), at("pose.pose.position.y")), (1.0, 2.0));
        assert_eq!([0, 1, 6, 7].map(|i| at(&format!("pose.covariance[{i}]"))), [0.5, 0.1, 0.1, 0.6]);
        // tan(yaw) = 4/3; J = (-0.16, 0.12).
        let yaw_rad = 2.0 * at("pose.pose.orientation.z").atan2(at("pose.pose.orientation.w"));
        assert!((yaw_rad - 4.0_f64.atan2(3.0)).abs() < 1e-12);
        let turn = 0.16 * 0.16 * 2.0 - 2.0 * 0.16 * 0.12 * 0.25 + 0.12 * 0.12;
        assert!((at("pose.covariance[35]") - turn).abs() < 1e-12);
        assert_eq!(at("twist.twist.linear.x"), 5.0);
        let along = 0.36 * 2.0 + 2.0 * 0.48 * 0.25 + 0.64;
        assert!((at("twist.covariance[0]") - along).abs() < 1e-12);
        assert!((at("twist.covariance[0]") + at("twist.covariance[7]") - 3.0).abs() < 1e-12, "a turn keeps the trace");
        assert_eq!(at("twist.covariance[35]"), UNKNOWN);
        messages.odometry(&PlanarPose::target(&estimate, false), &Moving::target(&estimate, false));
        let at = |path: &str| number(&messages, Topic::TargetOdometry, path);
        assert_eq!(
            (at("twist.twist.linear.x"), at("twist.covariance[0]")),
            (0.0, UNKNOWN),
            "the model has no velocity"
        );
    }

    #[test]
    fn robots_measure_in_their_own_frames() {
        let mut messages = Messages::default();
        messages.range(3, 2.5, 0.5);
        assert_eq!(number(&messages, Topic::Range(3), "range"), 2.5);
        assert_eq!(number(&messages, Topic::Range(3), "variance"), 0.25);
        messages.bearing(3, 0.5);
        assert_eq!(number(&messages, Topic::Bearing(3), "vector.y"), 0.5_f64.sin());
        messages.velocity(Command { heading_rad: 0.25, speed_mps: 2.0 });
        assert_eq!(number(&messages, Topic::Velocity(3), "twist.linear.x"), 2.0 * 0.25_f64.cos());
        messages.twist(3, [1.5, -0.5]);
        assert_eq!(number(&messages, Topic::Twist(3), "twist.linear.x"), 1.5);
        assert_eq!(number(&messages, Topic::Twist(3), "twist.angular.z"), -0.5);
        messages.pose_with_covariance(&PlanarPose::robot(&Pose { height_m: 1.5, ..Pose::at([1.0, 2.0]) }));
        assert_eq!(number(&messages, Topic::Pose(3), "pose.pose.position.z"), 1.5);
        messages.truth(&[7.0, 8.0], false);
        assert_eq!(number(&messages, Topic::Truth, "pose.position.y"), 8.0);
        let placed = PlanarPose::robot(&Pose::at([1.0, 2.0]));
        messages.frames(&placed, [(0, &placed), (12, &placed)].into_iter());
        assert_eq!(number(&messages, Topic::Frames, "transforms[2].transform.translation.y"), 2.0);
    }

    #[test]
    fn markers_and_diagnostics_have_their_fields_where_ros_expects_them() {
        let seen = RobotMarkers { place_m: [3.0, -1.0], command: Command::default(), range: None };
        let mut messages = Messages::default();
        messages.set_stamp(5_000_000_007);
        messages.markers(&markers([5.0, 6.0], &Matrix2::identity(), &[Some(seen), None]));
        let at = |path: &str| number(&messages, Topic::Markers, path);
        // The last marker is read only if all before it are where they should be.
        assert_eq!([at("markers[0].scale.x"), at("markers[0].pose.position.y")], [6.0, 6.0]);
        assert_eq!([at("markers[3].points[1].x"), at("markers[3].action"), at("markers[3].type")], [5.0, 0.0, 4.0]);
        assert_eq!(
            [at("markers[6].id"), at("markers[6].action"), at("markers[6].header.stamp.nanosec")],
            [1.0, 2.0, 7.0]
        );
        assert_eq!(at("markers[6].mesh_use_embedded_materials"), 0.0);
        messages.diagnostics(&TickDiagnostics::default().status(2));
        assert_eq!(number(&messages, Topic::Diagnostics, "status[0].level"), 1.0);
        let types = Types::parse(interfaces::DIAGNOSTICS.name, &interfaces::DIAGNOSTICS.text()).unwrap();
        let mut values = Vec::new();
        read(&types, messages.bytes(), &Path::parse(&types, "status[0].values[5].value").unwrap(), &mut values)
            .unwrap();
        assert_eq!(values, [Value::Text("2".to_owned())]);
    }
}
