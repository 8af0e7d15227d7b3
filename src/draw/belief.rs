//! A robot's own view of a tick: where it believes it is, and in which direction it measured the target.

use nalgebra::{Matrix2, Vector2};
use rangehound_shared::measurement::{Measurement, Pose};
use rangehound_shared::record::{FusionRecord, WorldRecord};
use rangehound_shared::scenario::RobotSpec;

/// Length of a bearing's ray, as a multiple of the distance to the estimate: it passes the target visibly.
const RAY_SHARE: f64 = 1.1;

/// A robot's own view of a tick, beside its true place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Belief {
    /// Where the robot is, m.
    pub true_m: Vector2<f64>,
    /// Where it believes it is, m.
    pub place_m: Vector2<f64>,
    /// Covariance of that, m^2; `None` if the position is exact.
    pub covariance_m2: Option<Matrix2<f64>>,
    /// End of its bearing's ray, which begins at the believed place, m; `None` without a bearing.
    pub ray_end_m: Option<Vector2<f64>>,
}

impl Belief {
    /// The views of all robots at a tick; `None` of a robot that fusion did not hear.
    pub fn all<'a>(
        specs: &'a [RobotSpec],
        fusion: &'a FusionRecord,
        world: &'a WorldRecord,
    ) -> impl Iterator<Item = Option<Self>> + 'a {
        let [x_m, y_m, ..] = fusion.estimate.state;
        let robots = specs.iter().zip(&world.robots).zip(&fusion.exchanges);
        robots.map(move |((spec, robot), exchange)| {
            let measurement = exchange.heard?.measurement;
            Some(Self::of(robot.pose, &measurement, spec.sensor.reach_m(), Vector2::new(x_m, y_m)))
        })
    }

    /// The view of a robot at this true pose that sent this measurement. The ray ends just behind the estimate, or where the
    /// sensor's reach ends.
    fn of(true_pose: Pose, measurement: &Measurement, reach_m: f64, estimate_m: Vector2<f64>) -> Self {
        let Measurement { pose, .. } = measurement;
        let place_m = pose.position_m();
        let covariance_m2 = (pose.covariance_m2 != [0.0; 3]).then(|| pose.position_covariance_m2());
        let ray_end_m = measurement.bearing().map(|(bearing_rad, _)| {
            let length_m = (RAY_SHARE * (estimate_m - place_m).norm()).min(reach_m);
            let (sin, cos) = (pose.heading_rad + bearing_rad).sin_cos();
            place_m + length_m * Vector2::new(cos, sin)
        });
        Self { true_m: true_pose.position_m(), place_m, covariance_m2, ray_end_m }
    }

    /// True if the robot knows exactly where it is, and has no bearing: then there is nothing to show.
    #[must_use]
    pub fn is_plain(&self) -> bool {
        self.place_m == self.true_m && self.covariance_m2.is_none() && self.ray_end_m.is_none()
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;

    #[test]
    fn a_ray_points_along_heading_and_bearing_from_the_believed_place_to_just_behind_the_estimate() {
        let pose = Pose { heading_rad: FRAC_PI_2, covariance_m2: [1.0, 0.0, 4.0], ..Pose::at([3.0, 1.0]) };
        let measurement = Measurement::new(pose, None).with_bearing(Some((FRAC_PI_2, 0.1)));
        let view = |reach_m| Belief::of(Pose::at([3.0, 2.0]), &measurement, reach_m, Vector2::new(-7.0, 1.0));
        let far = view(f64::INFINITY);
        assert_eq!((far.true_m, far.place_m), (Vector2::new(3.0, 2.0), Vector2::new(3.0, 1.0)));
        assert_eq!(far.covariance_m2, Some(Matrix2::new(1.0, 0.0, 0.0, 4.0)));
        assert!((far.ray_end_m.unwrap() - Vector2::new(-8.0, 1.0)).norm() < 1e-9);
        assert!((view(4.0).ray_end_m.unwrap() - Vector2::new(-1.0, 1.0)).norm() < 1e-9);
    }

    #[test]
    fn a_robot_with_an_exact_pose_and_no_bearing_has_nothing_to_show() {
        let view = |at, measured| {
            Belief::of(Pose::at(at), &Measurement::new(Pose::at([1.0; 2]), measured), 9.0, Vector2::zeros())
        };
        assert!(view([1.0; 2], Some((1.0, 0.1))).is_plain() && view([1.0; 2], None).is_plain());
        assert!(!view([1.0, 1.1], None).is_plain());
    }
}
