//! The markers of a tick for RViz: the ellipse of the estimate, and for each robot an arrow along its heading, a ray to the target and a circle
//! with its range. The bag writes these markers, and the node of the Python package publishes them.

use std::f64::consts::TAU;

use nalgebra::{Matrix2, Vector2};
use rangehound_shared::measurement::Kind;
use rangehound_shared::message::Command;
use rangehound_shared::record::{Exchange, FusionDecision};

use crate::draw::ellipse::Ellipse;

/// Standard deviations of the ellipse.
pub const SIGMAS: f64 = 3.0;

/// Corners of a circle.
const CORNERS: u32 = 48;

/// Width of a line, and the shortest arrow.
const LINE_M: f64 = 0.05;
const ARROW_MIN_M: f64 = 0.5;

/// RViz refuses a scale of 0.
const SCALE_MIN_M: f64 = 1e-3;

/// Red, green, blue, opacity.
const ESTIMATE: [f32; 4] = [0.84, 0.15, 0.16, 0.35];
const ROBOT: [f32; 4] = [0.12, 0.47, 0.71, 1.0];
const MEASURED: [f32; 4] = [0.5, 0.5, 0.5, 0.6];
const REJECTED: [f32; 4] = [0.84, 0.15, 0.16, 0.9];

/// The shape of a marker, with its number in `visualization_msgs/Marker`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    /// Along x, as long as the x of its scale.
    Arrow = 0,
    /// Seen from above an ellipse, whose axes are x and y of its scale.
    Cylinder = 3,
    /// Through points, as wide as the x of its scale.
    LineStrip = 4,
}

/// A marker, in the frame of the run and in the plane of the target.
#[derive(Debug, Clone, PartialEq)]
pub struct Marker {
    /// Name of its kind.
    pub namespace: &'static str,
    /// Its number among those of its kind: that of the robot.
    pub id: usize,
    /// Its shape.
    pub shape: Shape,
    /// False if it is deleted, if there is one from an earlier tick.
    pub is_shown: bool,
    /// Its position.
    pub position_m: [f64; 2],
    /// Its direction.
    pub yaw_rad: f64,
    /// Its size; what x, y and z are depends on its shape.
    pub scale_m: [f64; 3],
    /// Red, green, blue, opacity.
    pub colour: [f32; 4],
    /// The points of a line.
    pub points_m: Vec<[f64; 2]>,
}

/// The drawing of a robot that has reported where it is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobotMarkers {
    /// Where it is.
    pub place_m: [f64; 2],
    /// Its command.
    pub command: Command,
    /// The range that it measured, m, and whether that was not fused.
    pub range: Option<(f64, bool)>,
}

impl RobotMarkers {
    /// That of fusion's exchange with a robot.
    #[must_use]
    pub fn of(exchange: &Exchange) -> Option<Self> {
        let heard = exchange.heard?;
        let [judged, _] = heard.judged;
        let is_rejected = judged.is_some_and(|judged| judged.used != FusionDecision::Fused);
        let range = heard.measurement.of(Kind::Range).map(|(range_m, _)| (range_m, is_rejected));
        let place_m = [heard.measurement.pose.x_m, heard.measurement.pose.y_m];
        Some(Self { place_m, command: exchange.command, range })
    }
}

/// The markers for an estimated position with its covariance, and a team. There are as many for each tick, in the same order: those of
/// robots that were not heard are deleted.
#[must_use]
pub fn markers(position_m: [f64; 2], covariance_m2: &Matrix2<f64>, robots: &[Option<RobotMarkers>]) -> Vec<Marker> {
    let ellipse = ellipse(position_m, covariance_m2);
    let arrow_m = ARROW_MIN_M.max(ellipse.scale_m[0] / 4.0);
    let each = |draw: &dyn Fn(usize, Option<&RobotMarkers>) -> Marker| -> Vec<Marker> {
        robots.iter().enumerate().map(|(id, seen)| draw(id, seen.as_ref())).collect()
    };
    let headings = each(&|id, seen| heading(id, seen, arrow_m));
    let rays = each(&|id, seen| ray(id, seen, position_m));
    std::iter::once(ellipse).chain(headings).chain(rays).chain(each(&circle)).collect()
}

/// The ellipse: the x of its scale is the long axis.
fn ellipse(position_m: [f64; 2], covariance_m2: &Matrix2<f64>) -> Marker {
    let ellipse = Ellipse::new(Vector2::from(position_m), covariance_m2, SIGMAS);
    let ([first_m, second_m], yaw_rad) = (ellipse.half_m(), ellipse.angle_rad());
    let (long_m, short_m, yaw_rad) = match first_m >= second_m {
        true => (first_m, second_m, yaw_rad),
        false => (second_m, first_m, yaw_rad + TAU / 4.0),
    };
    let [long_m, short_m] = [long_m, short_m].map(|half_m| (2.0 * half_m).max(SCALE_MIN_M));
    let scale_m = [long_m, short_m, SCALE_MIN_M];
    Marker { is_shown: true, position_m, yaw_rad, scale_m, ..hidden("ellipse", 0, Shape::Cylinder, ESTIMATE) }
}

fn heading(id: usize, seen: Option<&RobotMarkers>, long_m: f64) -> Marker {
    let hidden = hidden("heading", id, Shape::Arrow, ROBOT);
    let Some(RobotMarkers { place_m, command, .. }) = seen.filter(|seen| seen.command.speed_mps > 0.0) else {
        return hidden;
    };
    let scale_m = [long_m, long_m / 5.0, long_m / 5.0];
    Marker { is_shown: true, position_m: *place_m, yaw_rad: command.heading_rad, scale_m, ..hidden }
}

fn ray(id: usize, seen: Option<&RobotMarkers>, target_m: [f64; 2]) -> Marker {
    let hidden = hidden("ray", id, Shape::LineStrip, MEASURED);
    let Some(RobotMarkers { place_m, .. }) = seen else { return hidden };
    Marker { is_shown: true, points_m: vec![*place_m, target_m], ..hidden }
}

fn circle(id: usize, seen: Option<&RobotMarkers>) -> Marker {
    let hidden = hidden("range", id, Shape::LineStrip, MEASURED);
    let Some((seen, (radius_m, is_rejected))) = seen.and_then(|seen| Some((seen, seen.range?))) else { return hidden };
    let [x_m, y_m] = seen.place_m;
    let corner = |corner| {
        let (sin, cos) = (TAU * f64::from(corner) / f64::from(CORNERS)).sin_cos();
        [x_m + radius_m * cos, y_m + radius_m * sin]
    };
    let colour = if is_rejected { REJECTED } else { MEASURED };
    Marker { is_shown: true, colour, points_m: (0..=CORNERS).map(corner).collect(), ..hidden }
}

fn hidden(namespace: &'static str, id: usize, shape: Shape, colour: [f32; 4]) -> Marker {
    Marker {
        namespace,
        id,
        shape,
        is_shown: false,
        position_m: [0.0; 2],
        yaw_rad: 0.0,
        scale_m: [LINE_M, 0.0, 0.0],
        colour,
        points_m: Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use rangehound_shared::measurement::{Measurement, Pose};
    use rangehound_shared::record::{GateResult, Heard};

    use super::*;

    fn seen(range: Option<(f64, bool)>, speed_mps: f64) -> RobotMarkers {
        RobotMarkers { place_m: [3.0, -1.0], command: Command { heading_rad: 0.25, speed_mps }, range }
    }

    #[test]
    fn the_long_axis_of_the_ellipse_is_where_the_variance_is_greatest() {
        // Standard deviations of 2 m and 1 m, turned by 30 degrees, and by a right angle more.
        let turn = nalgebra::Rotation2::new(TAU / 12.0);
        for (variances, yaw_rad) in [([4.0, 1.0], TAU / 12.0), ([1.0, 4.0], TAU / 12.0 + TAU / 4.0)] {
            let covariance = turn.matrix() * Matrix2::from_diagonal(&variances.into()) * turn.matrix().transpose();
            let [ellipse] = &markers([5.0, 6.0], &covariance, &[])[..] else { panic!("no robots, one marker") };
            assert_eq!(
                (ellipse.namespace, ellipse.shape, ellipse.position_m),
                ("ellipse", Shape::Cylinder, [5.0, 6.0])
            );
            for (scale_m, expected_m) in ellipse.scale_m.into_iter().zip([12.0, 6.0, 1e-3]) {
                assert!((scale_m - expected_m).abs() < 1e-9, "{ellipse:?}");
            }
            // A direction and its opposite are one axis.
            assert!((ellipse.yaw_rad - yaw_rad).sin().abs() < 1e-9, "{ellipse:?}");
        }
        assert_eq!(markers([0.0; 2], &Matrix2::zeros(), &[])[0].scale_m, [1e-3; 3], "RViz refuses 0");
        assert_eq!(markers([0.0; 2], &Matrix2::repeat(f64::NAN), &[])[0].scale_m, [1e-3; 3]);
    }

    #[test]
    fn a_robot_has_an_arrow_a_ray_to_the_target_and_a_circle_of_its_range() {
        let drawn = markers([5.0, 6.0], &Matrix2::identity(), &[None, Some(seen(Some((2.0, false)), 1.0))]);
        let named: Vec<_> = drawn.iter().map(|marker| (marker.namespace, marker.id, marker.is_shown)).collect();
        let of_robot = |kind| [(kind, 0, false), (kind, 1, true)];
        let expected = [of_robot("heading"), of_robot("ray"), of_robot("range")].concat();
        assert_eq!(named, [vec![("ellipse", 0, true)], expected].concat());
        let (arrow, ray, circle) = (&drawn[2], &drawn[4], &drawn[6]);
        assert_eq!((arrow.position_m, arrow.yaw_rad, arrow.scale_m), ([3.0, -1.0], 0.25, [1.5, 0.3, 0.3]));
        assert_eq!(ray.points_m, [[3.0, -1.0], [5.0, 6.0]]);
        assert_eq!(circle.points_m.len(), 49);
        for [x_m, y_m] in &circle.points_m {
            assert!(((x_m - 3.0).hypot(y_m + 1.0) - 2.0).abs() < 1e-12);
        }
        assert_eq!(circle.colour, MEASURED);
    }

    #[test]
    fn rejected_ranges_are_red_and_what_there_is_not_is_deleted() {
        let all = [seen(Some((2.0, true)), 1.0), seen(None, 0.0)].map(Some);
        let drawn = markers([0.0; 2], &Matrix2::identity(), &all);
        assert_eq!((drawn[5].colour, drawn[5].is_shown), (REJECTED, true));
        let shown: Vec<_> = [2, 4, 6].iter().map(|index| drawn[*index].is_shown).collect();
        assert_eq!(shown, [false, true, false], "it stands still and has measured nothing");
    }

    #[test]
    fn the_markers_of_a_robot_show_the_reports_that_fusion_heard() {
        let command = Command { heading_rad: 0.25, speed_mps: 1.0 };
        assert_eq!(RobotMarkers::of(&Exchange { heard: None, command }), None);
        for (used, is_rejected) in
            [(FusionDecision::Fused, false), (FusionDecision::Rejected, true), (FusionDecision::Distrusted, true)]
        {
            let measurement = Measurement::new(Pose::at([3.0, -1.0]), Some((2.0, 0.1)));
            let judged = [Some(GateResult { used, normalised_square: None }), None];
            let heard = Some(Heard { measurement, judged, ..Heard::default() });
            assert_eq!(RobotMarkers::of(&Exchange { heard, command }), Some(seen(Some((2.0, is_rejected)), 1.0)));
        }
    }
}
