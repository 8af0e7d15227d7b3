//! The measurements of a recording, in little memory: most recordings have only ranges.

use std::ops::Range;

/// One measurement of a recording: a range, a bearing or both.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RecordedMeasurement {
    /// Index of the sensor.
    pub sensor: usize,
    /// Place of the sensor, m.
    pub position_m: [f64; 2],
    /// Height of the sensor in the recording's frame, m; `None` if the recording has no heights.
    pub height_m: Option<f64>,
    /// The measured range, m, more than 0.
    pub range_m: Option<f64>,
    /// The measured bearing, rad, counter-clockwise in (-pi, pi]: from the sensor's heading if there is one, else from the
    /// x axis.
    pub bearing_rad: Option<f64>,
    /// Heading of the sensor, rad, counter-clockwise from the x axis in (-pi, pi].
    pub heading_rad: Option<f64>,
    /// Standard deviation of each coordinate of the sensor's place, m; 0 if the place is exact.
    pub position_std_m: Option<f64>,
    /// Standard deviation of the sensor's heading, rad; 0 if the heading is exact.
    pub heading_std_rad: Option<f64>,
}

/// The optional values of a measurement besides a range: bearing, heading, and the standard deviations of position and heading.
pub(super) type Extras = [Option<f64>; 4];

impl RecordedMeasurement {
    pub(super) fn extras(&self) -> Extras {
        [self.bearing_rad, self.heading_rad, self.position_std_m, self.heading_std_rad]
    }
}

/// A list of measurements.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Measurements {
    rows: Vec<Row>,
    /// As long as `rows`, or empty if no measurement has any.
    extras: Vec<Extras>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Row {
    sensor: usize,
    position_m: [f64; 2],
    height_m: Option<f64>,
    /// 0 if there is none.
    range_m: f64,
}

impl Measurements {
    pub(super) fn len(&self) -> usize {
        self.rows.len()
    }

    pub(super) fn push(&mut self, measurement: RecordedMeasurement) {
        let RecordedMeasurement { sensor, position_m, height_m, range_m, .. } = measurement;
        let extras = measurement.extras();
        if !self.extras.is_empty() || extras != Extras::default() {
            self.extras.resize(self.rows.len(), Extras::default());
            self.extras.push(extras);
        }
        self.rows.push(Row { sensor, position_m, height_m, range_m: range_m.unwrap_or(0.0) });
    }

    pub(super) fn get(&self, index: usize) -> RecordedMeasurement {
        let Row { sensor, position_m, height_m, range_m } = self.rows[index];
        let [bearing_rad, heading_rad, position_std_m, heading_std_rad] =
            self.extras.get(index).copied().unwrap_or_default();
        let range_m = Some(range_m).filter(|range_m| *range_m > 0.0);
        RecordedMeasurement {
            sensor,
            position_m,
            height_m,
            range_m,
            bearing_rad,
            heading_rad,
            position_std_m,
            heading_std_rad,
        }
    }

    pub(super) fn range(&self, indices: Range<usize>) -> impl ExactSizeIterator<Item = RecordedMeasurement> {
        indices.map(|index| self.get(index))
    }

    pub(super) fn iter(&self) -> impl ExactSizeIterator<Item = RecordedMeasurement> {
        self.range(0..self.len())
    }

    /// The sensor of each measurement.
    pub(super) fn sensors(&self, indices: Range<usize>) -> impl Iterator<Item = usize> {
        self.rows[indices].iter().map(|row| row.sensor)
    }

    /// The values of the measurements besides ranges; empty if they are only ranges.
    pub(super) fn extras(&self) -> &[Extras] {
        &self.extras
    }

    /// Gives each sensor its new number.
    pub(super) fn renumber(&mut self, numbers: &[usize]) {
        for row in &mut self.rows {
            row.sensor = numbers[row.sensor];
        }
    }

    /// Overwrites a measurement by another.
    pub(super) fn overwrite(&mut self, index: usize, by: usize) {
        self.rows[index] = self.rows[by];
        if !self.extras.is_empty() {
            self.extras[index] = self.extras[by];
        }
    }

    pub(super) fn truncate(&mut self, len: usize) {
        self.rows.truncate(len);
        self.extras.truncate(len);
    }
}
