//! Where a robot says it is: the trait that a localiser implements, and the ones that need no hardware.

use rangehound_shared::measurement::Pose;
use rangehound_shared::message::WorldEntry;
use rangehound_shared::scenario::{NuisanceSpec, RecordedRanges, Scenario, Source};

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

/// The localiser of a recording: recorded poses, with the standard deviations in the recording or the ones given for it.
#[derive(Debug, Clone)]
pub struct RecordedPose {
    nuisances: NuisanceSpec,
    start_s: f64,
}

/// A pose with the standard deviations of its errors after this time, s, unless it has its own.
fn with_errors(pose: Pose, nuisances: &NuisanceSpec, elapsed_s: f64) -> Pose {
    let variance_m2 = nuisances.position_variance_m2(elapsed_s);
    let covariance_m2 =
        if pose.covariance_m2 == [0.0; 3] { [variance_m2, 0.0, variance_m2] } else { pose.covariance_m2 };
    let heading_std_rad = if pose.heading_std_rad == 0.0 { nuisances.heading_std_rad } else { pose.heading_std_rad };
    Pose { covariance_m2, heading_std_rad, ..pose }
}

impl PoseSource for SimulatedPose {
    fn pose(&mut self, time_s: f64, entry: &WorldEntry) -> Pose {
        with_errors(entry.pose, &self.nuisances, time_s)
    }
}

impl PoseSource for RecordedPose {
    fn pose(&mut self, time_s: f64, entry: &WorldEntry) -> Pose {
        with_errors(entry.pose, &self.nuisances, time_s - self.start_s)
    }
}

/// The localiser that a scenario gives a robot, by id; `None` if it has no such robot.
#[must_use]
pub fn of_scenario(scenario: &Scenario, robot: usize) -> Option<Box<dyn PoseSource>> {
    let nuisances = scenario.robots.get(robot)?.nuisances;
    Some(match scenario.source {
        Source::Simulated { .. } => Box::new(SimulatedPose { nuisances }),
        Source::Recorded(RecordedRanges { start_s, .. }) => Box::new(RecordedPose { nuisances, start_s }),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drifting_pose_is_less_certain_with_time_and_a_recorded_deviation_goes_first() {
        let nuisances =
            NuisanceSpec { pose_std_m: 1.0, pose_drift_m: 0.5, heading_std_rad: 0.1, ..NuisanceSpec::default() };
        let entry = WorldEntry { pose: Pose::at([1.0, 2.0]), ..WorldEntry::default() };
        let pose = SimulatedPose { nuisances }.pose(8.0, &entry);
        assert_eq!((pose.covariance_m2, pose.heading_std_rad), ([3.0, 0.0, 3.0], 0.1));
        let mut recorded = RecordedPose { nuisances, start_s: 1e9 };
        assert_eq!(recorded.pose(1e9 + 8.0, &entry).covariance_m2, [3.0, 0.0, 3.0]);
        let own = Pose { covariance_m2: [0.25, 0.0, 0.25], heading_std_rad: 0.3, ..entry.pose };
        assert_eq!(recorded.pose(1e9, &WorldEntry { pose: own, ..entry }), own);
        let exact = SimulatedPose { nuisances: NuisanceSpec::default() }.pose(8.0, &entry);
        assert!(exact.is_exact());
    }
}
