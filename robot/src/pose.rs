//! Where a robot says it is: the trait that a localiser implements, and the ones that need no hardware.

use rangehound_shared::measurement::Pose;
use rangehound_shared::message::WorldEntry;
use rangehound_shared::scenario::{NuisanceSpec, Scenario, Source};

/// A robot's localiser.
pub trait PoseSource: std::fmt::Debug + Send {
    /// Where the robot is at a tick, with the covariance of that; an exact pose has none. `time_s` is the time of the
    /// tick. Called once for each tick; on the control path. `entry` is this robot's entry of the world; a real
    /// localiser ignores its pose.
    fn pose(&mut self, time_s: f64, entry: &WorldEntry) -> Pose;
}

/// The localiser of a simulated robot: the pose that the simulator has disturbed, with the covariance of its errors.
#[derive(Debug, Clone)]
pub struct SimulatedPose {
    nuisances: NuisanceSpec,
}

/// The localiser of a recording: recorded poses, whose standard deviations the playback has filled in.
#[derive(Debug, Clone, Copy)]
pub struct RecordedPose;

impl PoseSource for SimulatedPose {
    fn pose(&mut self, time_s: f64, entry: &WorldEntry) -> Pose {
        let variance_m2 = self.nuisances.position_variance_m2(time_s);
        let heading_std_rad = self.nuisances.heading_std_rad;
        Pose { covariance_m2: [variance_m2, 0.0, variance_m2], heading_std_rad, ..entry.pose }
    }
}

impl PoseSource for RecordedPose {
    fn pose(&mut self, _time_s: f64, entry: &WorldEntry) -> Pose {
        entry.pose
    }
}

/// The localiser that a scenario gives a robot, by id; `None` if it has no such robot.
#[must_use]
pub fn of_scenario(scenario: &Scenario, robot: usize) -> Option<Box<dyn PoseSource>> {
    let nuisances = scenario.robots.get(robot)?.nuisances;
    Some(match scenario.source {
        Source::Simulated { .. } => Box::new(SimulatedPose { nuisances }),
        Source::Recorded(_) => Box::new(RecordedPose),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drifting_pose_is_less_certain_with_time_and_a_recorded_one_is_as_recorded() {
        let nuisances =
            NuisanceSpec { pose_std_m: 1.0, pose_drift_m: 0.5, heading_std_rad: 0.1, ..NuisanceSpec::default() };
        let entry = WorldEntry { pose: Pose::at([1.0, 2.0]), ..WorldEntry::default() };
        let pose = SimulatedPose { nuisances }.pose(8.0, &entry);
        assert_eq!((pose.covariance_m2, pose.heading_std_rad), ([3.0, 0.0, 3.0], 0.1));
        let own = Pose { covariance_m2: [0.25, 0.0, 0.25], heading_std_rad: 0.3, ..entry.pose };
        for pose in [own, entry.pose] {
            assert_eq!(RecordedPose.pose(8.0, &WorldEntry { pose, ..entry }), pose);
        }
        let exact = SimulatedPose { nuisances: NuisanceSpec::default() }.pose(8.0, &entry);
        assert!(exact.is_exact());
    }
}
