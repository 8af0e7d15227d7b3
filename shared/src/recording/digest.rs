//! The identity of a recording.

use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::Xxh3;

use super::{RecordedMeasurement, Recording};

/// Number of measurements and a hash of the contents of a recording, to the last bit; independent of the file's format.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordingDigest {
    ranges: u64,
    hash: u128,
}

pub(super) fn digest(recording: &Recording) -> RecordingDigest {
    let mut hash = Xxh3::new();
    for sensor in &recording.sensors {
        let name = sensor.name.as_str();
        hash.update(&(name.len() as u64).to_le_bytes());
        hash.update(name.as_bytes());
    }
    let mut start = 0;
    for instant in &recording.instants {
        hash.update(&instant.time_s.to_le_bytes());
        hash.update(&(instant.readings_end as u64).to_le_bytes());
        for reading in recording.readings.range(start..instant.readings_end) {
            let RecordedMeasurement { sensor, position_m: [x_m, y_m], height_m, range_m, .. } = reading;
            let mut words = [0; 41];
            let numbers = [x_m, y_m, height_m.unwrap_or(0.0), range_m.unwrap_or(0.0)].map(f64::to_bits);
            for (slot, word) in words.as_chunks_mut::<8>().0.iter_mut().zip([sensor as u64].into_iter().chain(numbers))
            {
                *slot = word.to_le_bytes();
            }
            words[40] = u8::from(height_m.is_some());
            hash.update(&words);
        }
        start = instant.readings_end;
    }
    // None in a recording that has only ranges.
    for number in recording.readings.extras().as_flattened() {
        hash.update(&number.unwrap_or(0.0).to_le_bytes());
        hash.update(&[u8::from(number.is_some())]);
    }
    RecordingDigest { ranges: recording.readings.len() as u64, hash: hash.digest128() }
}
