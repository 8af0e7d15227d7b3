//! The recorded world: positions of the sensors and measured ranges.

use std::sync::Arc;

use rangehound_shared::measurement::{Kind, Pose};
use rangehound_shared::message::{Drive, Origin, WorldEntry};
use rangehound_shared::recording::{RecordedMeasurement, Recording};
use rangehound_shared::scenario::NuisanceSpec;
use rangehound_shared::sealed::{self, SealError};

use crate::world::{World, are_valid};

/// A recording: one instant per tick, from tick 1 on. As in a simulation, tick 0 has no range.
#[derive(Debug, Clone)]
pub struct Playback {
    recording: Arc<Recording>,
    target_height_m: Option<f64>,
    /// The errors of each sensor's pose, for rows that do not state their own.
    errors: Vec<NuisanceSpec>,
    start_s: f64,
    next_instant: usize,
    time_s: f64,
    entries: Vec<WorldEntry>,
    poses: Vec<Pose>,
}

impl Playback {
    /// Plays a recording from its start. With the target's height, the sensors' heights are relative to it.
    #[must_use]
    pub fn new(recording: Arc<Recording>, target_height_m: Option<f64>) -> Self {
        let poses: Vec<Pose> = recording.sensors().iter().map(|sensor| Pose::at(sensor.first_position_m)).collect();
        let origin = Origin::Recorded.to_bits();
        let entries = poses.iter().map(|pose| WorldEntry { pose: *pose, origin, ..WorldEntry::default() }).collect();
        let time_s = recording.instant(0).map_or(0.0, |(time_s, _)| time_s);
        let errors = vec![NuisanceSpec::default(); poses.len()];
        Self { recording, target_height_m, errors, start_s: 0.0, next_instant: 0, time_s, entries, poses }
    }

    /// The same with errors of the sensors' poses, which begin at this time, s: a row that states no standard deviation has
    /// theirs. Without this it is exact, as is a row that states 0.
    #[must_use]
    pub fn with_errors(self, errors: Vec<NuisanceSpec>, start_s: f64) -> Self {
        Self { errors, start_s, ..self }
    }
}

impl World for Playback {
    fn time_s(&self) -> f64 {
        self.time_s
    }

    fn entries(&self) -> &[WorldEntry] {
        &self.entries
    }

    fn poses(&self) -> &[Pose] {
        &self.poses
    }

    fn truth(&self) -> &[f64] {
        &[]
    }

    fn advance(&mut self, _drives: &[Option<Drive>]) {
        for entry in &mut self.entries {
            (entry.kinds, entry.range_m, entry.bearing_rad) = (0, 0.0, 0.0);
        }
        if let Some((time_s, readings)) = self.recording.instant(self.next_instant) {
            self.time_s = time_s;
            for reading in readings {
                let RecordedMeasurement { sensor, position_m, height_m, range_m, .. } = reading;
                // Without the target's height, ranges are taken as horizontal.
                let height_m =
                    height_m.zip(self.target_height_m).map_or(0.0, |(sensor_m, target_m)| sensor_m - target_m);
                let errors = self.errors.get(sensor).copied().unwrap_or_default();
                let default_m2 = errors.position_variance_m2(time_s - self.start_s);
                let variance_m2 = reading.position_std_m.map_or(default_m2, |std_m| std_m * std_m);
                let pose = Pose {
                    height_m,
                    // A bearing without a heading counts from the x axis.
                    heading_rad: reading.heading_rad.unwrap_or(0.0),
                    covariance_m2: [variance_m2, 0.0, variance_m2],
                    heading_std_rad: reading.heading_std_rad.unwrap_or(errors.heading_std_rad),
                    ..Pose::at(position_m)
                };
                let bit = |kind: Kind, is_measured: bool| if is_measured { kind.bit() } else { 0 };
                self.entries[sensor] = WorldEntry {
                    pose,
                    kinds: bit(Kind::Range, range_m.is_some()) | bit(Kind::Bearing, reading.bearing_rad.is_some()),
                    origin: Origin::Recorded.to_bits(),
                    range_m: range_m.unwrap_or(0.0),
                    bearing_rad: reading.bearing_rad.unwrap_or(0.0),
                };
                self.poses[sensor] = pose;
            }
            self.next_instant += 1;
        }
    }

    fn save(&self, bytes: &mut Vec<u8>) -> Result<(), SealError> {
        sealed::encode_into(&(self.next_instant, self.time_s, &self.entries), bytes)
    }

    fn restore(&mut self, bytes: &[u8]) -> Result<(), SealError> {
        let (next_instant, time_s, entries): (usize, f64, Vec<WorldEntry>) = sealed::decode(bytes)?;
        let places = entries.iter().flat_map(WorldEntry::numbers);
        if entries.len() != self.entries.len() || !are_valid(places.chain([time_s])) {
            return Err(SealError::Malformed);
        }
        self.poses = entries.iter().map(|entry| entry.pose).collect();
        (self.next_instant, self.time_s, self.entries) = (next_instant, time_s, entries);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use rangehound_shared::recording::ReadOptions;

    use super::*;

    #[test]
    fn every_range_is_played_once_at_its_time_and_place() {
        let csv = "time_s,sensor_id,sensor_x_m,sensor_y_m,range_m\n5,1,0,0,3\n6,2,1,1,4\n6,1,0,2,5\n";
        let (recording, _) = Recording::parse(csv.as_bytes(), Path::new("r.csv"), &ReadOptions::default()).unwrap();
        let mut world = Playback::new(Arc::new(recording), None);
        let heard = |world: &Playback| -> Vec<(f64, f64, f64)> {
            let measured = |e: &WorldEntry| Some((e.pose.x_m, e.pose.y_m, e.of(Origin::Recorded).0?));
            world.entries().iter().filter_map(measured).collect()
        };
        assert_eq!((world.time_s(), heard(&world)), (5.0, vec![]));
        world.advance(&[]);
        assert_eq!((world.time_s(), heard(&world)), (5.0, vec![(0.0, 0.0, 3.0)]));
        world.advance(&[]);
        assert_eq!((world.time_s(), heard(&world)), (6.0, vec![(0.0, 2.0, 5.0), (1.0, 1.0, 4.0)]));
        world.advance(&[]);
        assert_eq!((world.time_s(), heard(&world)), (6.0, vec![]), "the end repeats nothing");
    }

    #[test]
    fn a_bearing_alone_is_an_entry_without_a_range_at_the_sensors_place() {
        let csv = "time_s,sensor_id,sensor_x_m,sensor_y_m,range_m,bearing_rad\n5,1,0,0,3,\n6,1,1,2,,0.5\n";
        let (recording, _) = Recording::parse(csv.as_bytes(), Path::new("r.csv"), &ReadOptions::default()).unwrap();
        let mut world = Playback::new(Arc::new(recording), None);
        world.advance(&[]);
        world.advance(&[]);
        let pose = Pose::at([1.0, 2.0]);
        let (kinds, origin) = (Kind::Bearing.bit(), Origin::Recorded.to_bits());
        assert_eq!(world.entries(), [WorldEntry { pose, kinds, origin, range_m: 0.0, bearing_rad: 0.5 }]);
    }

    #[test]
    fn headings_and_standard_deviations_are_played_with_the_pose() {
        let csv = "time_s,sensor_id,sensor_x_m,sensor_y_m,sensor_heading_rad,sensor_std_m,sensor_heading_std_rad,range_m\n\
                   5,1,0,0,0.5,0.2,0.1,3\n";
        let (recording, _) = Recording::parse(csv.as_bytes(), Path::new("r.csv"), &ReadOptions::default()).unwrap();
        let mut world = Playback::new(Arc::new(recording), None);
        world.advance(&[]);
        let pose = world.entries()[0].pose;
        assert_eq!((pose.heading_rad, pose.heading_std_rad), (0.5, 0.1));
        assert!((pose.covariance_m2[0] - 0.04).abs() < 1e-12 && pose.covariance_m2[1] == 0.0);
    }

    /// A row that states 0 is exact, whatever the errors of the other rows.
    #[test]
    fn rows_without_standard_deviations_have_those_of_all_and_a_zero_means_exact() {
        let csv = "time_s,sensor_id,sensor_x_m,sensor_y_m,sensor_std_m,sensor_heading_std_rad,range_m\n\
                   5,1,0,0,,,3\n13,1,0,0,,,3\n21,1,0,0,0,0,3\n29,1,0,0,0.5,0.2,3\n";
        let (recording, _) = Recording::parse(csv.as_bytes(), Path::new("r.csv"), &ReadOptions::default()).unwrap();
        let errors =
            NuisanceSpec { pose_std_m: 1.0, pose_drift_m: 0.5, heading_std_rad: 0.1, ..NuisanceSpec::default() };
        let mut world = Playback::new(Arc::new(recording), None).with_errors(vec![errors], 5.0);
        let played: Vec<_> = (0..4)
            .map(|_| {
                world.advance(&[]);
                let pose = world.entries()[0].pose;
                (pose.covariance_m2, pose.heading_std_rad)
            })
            .collect();
        let expected = [([1.0, 0.0, 1.0], 0.1), ([3.0, 0.0, 3.0], 0.1), ([0.0; 3], 0.0), ([0.25, 0.0, 0.25], 0.2)];
        assert_eq!(played, expected);
    }
}
