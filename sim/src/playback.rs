//! The recorded world: positions of the sensors and measured ranges.

use std::sync::Arc;

use rangehound_shared::measurement::Pose;
use rangehound_shared::message::{Drive, RangeKind, WorldEntry};
use rangehound_shared::recording::{RecordedMeasurement, Recording};
use rangehound_shared::sealed::{self, SealError};

use crate::world::{World, are_valid};

/// A recording: one instant per tick, from tick 1 on. As in a simulation, tick 0 has no range.
#[derive(Debug, Clone)]
pub struct Playback {
    recording: Arc<Recording>,
    target_height_m: Option<f64>,
    next_instant: usize,
    time_s: f64,
    entries: Vec<WorldEntry>,
}

impl Playback {
    /// Plays a recording from its start. With the target's height, the sensors' heights are relative to it.
    #[must_use]
    pub fn new(recording: Arc<Recording>, target_height_m: Option<f64>) -> Self {
        let entries = recording
            .sensors()
            .iter()
            .map(|sensor| WorldEntry { pose: Pose::at(sensor.first_position_m), ..WorldEntry::default() })
            .collect();
        let time_s = recording.instant(0).map_or(0.0, |(time_s, _)| time_s);
        Self { recording, target_height_m, next_instant: 0, time_s, entries }
    }
}

impl World for Playback {
    fn time_s(&self) -> f64 {
        self.time_s
    }

    fn entries(&self) -> &[WorldEntry] {
        &self.entries
    }

    fn truth(&self) -> &[f64] {
        &[]
    }

    fn advance(&mut self, _drives: &[Option<Drive>]) {
        for entry in &mut self.entries {
            entry.range_kind = RangeKind::Absent.to_bits();
            entry.range_m = 0.0;
        }
        if let Some((time_s, readings)) = self.recording.instant(self.next_instant) {
            self.time_s = time_s;
            for reading in readings {
                let RecordedMeasurement { sensor, position_m, height_m, range_m, .. } = reading;
                // Without the target's height, ranges are taken as horizontal.
                let height_m =
                    height_m.zip(self.target_height_m).map_or(0.0, |(sensor_m, target_m)| sensor_m - target_m);
                let range_kind = if range_m.is_some() { RangeKind::Measured } else { RangeKind::Absent }.to_bits();
                let pose = Pose { height_m, ..Pose::at(position_m) };
                self.entries[sensor] = WorldEntry { pose, range_m: range_m.unwrap_or(0.0), range_kind };
            }
            self.next_instant += 1;
        }
    }

    fn save(&self, bytes: &mut Vec<u8>) -> Result<(), SealError> {
        sealed::encode_into(&(self.next_instant, self.time_s, &self.entries), bytes)
    }

    fn restore(&mut self, bytes: &[u8]) -> Result<(), SealError> {
        let (next_instant, time_s, entries): (usize, f64, Vec<WorldEntry>) = sealed::decode(bytes)?;
        let places = entries.iter().flat_map(|entry| entry.pose.numbers().into_iter().chain([entry.range_m]));
        if entries.len() != self.entries.len() || !are_valid(places.chain([time_s])) {
            return Err(SealError::Malformed);
        }
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
            let measured = |entry: &&WorldEntry| entry.range_kind == RangeKind::Measured.to_bits();
            world.entries().iter().filter(measured).map(|e| (e.pose.x_m, e.pose.y_m, e.range_m)).collect()
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
        assert_eq!(world.entries(), [WorldEntry { pose: Pose::at([1.0, 2.0]), ..WorldEntry::default() }]);
        assert_eq!(world.entries()[0].range_kind, RangeKind::Absent.to_bits());
    }
}
