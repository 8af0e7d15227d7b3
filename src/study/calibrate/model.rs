//! The estimation problem: readings by knots of the target's path, and the errors that each model gives a sensor.

use crate::statistics::median;

/// A value with the half width of its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Measured {
    /// The value.
    pub value: f64,
    /// Half width of the interval.
    pub half_width: f64,
}

impl Measured {
    /// The value times this factor.
    #[must_use]
    pub fn scaled(self, by: f64) -> Self {
        Self { value: self.value * by, half_width: self.half_width * by }
    }
}

/// One range for the calibration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// Time, s.
    pub time_s: f64,
    /// Index of the sensor.
    pub sensor: usize,
    /// Position of the sensor, m.
    pub position_m: [f64; 2],
    /// Height of the sensor above the target, m.
    pub height_m: f64,
    /// The measured range, m.
    pub range_m: f64,
}

impl Reading {
    /// Distance of the sensor from a position of the target, m.
    #[must_use]
    pub fn distance_m(&self, place_m: [f64; 2]) -> f64 {
        (place_m[0] - self.position_m[0]).hypot(place_m[1] - self.position_m[1]).hypot(self.height_m)
    }

    /// Distance in the plane that corresponds to the range, m.
    #[must_use]
    pub fn level_range_m(&self) -> f64 {
        (self.range_m.powi(2) - self.height_m.powi(2)).max(0.0).sqrt()
    }
}

/// A reading at a knot of the path.
#[derive(Debug, Clone, Copy)]
pub struct Observation {
    /// Index of the knot.
    pub knot: usize,
    /// Time since the knot, s.
    pub after_s: f64,
    /// The range.
    pub reading: Reading,
}

/// Readings grouped by knots in order of time.
#[derive(Debug, Clone)]
pub struct Problem {
    /// Times of the knots, s.
    pub knots_s: Vec<f64>,
    /// The readings.
    pub observations: Vec<Observation>,
    /// Number of sensors.
    pub sensors: usize,
    /// Size of the scene, m: twice the median range.
    pub span_m: f64,
    /// Readings that were left out to keep the problem small.
    pub thinned: usize,
}

/// Most knots of a path; with more, readings are thinned evenly.
pub const KNOTS_MAX: usize = 5_000;

impl Problem {
    /// Groups readings in order of time: a knot lasts half of the median gap between two ranges of one sensor.
    #[must_use]
    pub fn new(readings: &[Reading], sensors: usize) -> Self {
        let mut last = vec![f64::NAN; sensors];
        let mut gaps = Vec::with_capacity(readings.len());
        for reading in readings {
            let gap = reading.time_s - last[reading.sensor];
            if gap > 0.0 {
                gaps.push(gap);
            }
            last[reading.sensor] = reading.time_s;
        }
        let width_s = median(&mut gaps).map_or(0.0, |gap| 0.5 * gap);
        let mut knots_s: Vec<f64> = Vec::new();
        let mut observations = Vec::with_capacity(readings.len());
        for &reading in readings {
            if knots_s.last().is_none_or(|start| reading.time_s > start + width_s) {
                knots_s.push(reading.time_s);
            }
            let knot = knots_s.len() - 1;
            observations.push(Observation { knot, after_s: reading.time_s - knots_s[knot], reading });
        }
        let step = knots_s.len().div_ceil(KNOTS_MAX).max(1);
        if step > 1 {
            observations.retain(|observation| observation.knot % step == 0);
            observations.iter_mut().for_each(|observation| observation.knot /= step);
            knots_s = knots_s.into_iter().step_by(step).collect();
        }
        let mut ranges: Vec<f64> = observations.iter().map(|observation| observation.reading.range_m).collect();
        let span_m = median(&mut ranges).unwrap_or(1.0).max(1e-3) * 2.0;
        let thinned = readings.len() - observations.len();
        Self { knots_s, observations, sensors, span_m, thinned }
    }
}

/// How the sensors of a model share one kind of systematic error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sharing {
    /// None.
    Absent,
    /// One for all sensors.
    Common,
    /// One for each sensor.
    Each,
}

/// A model of the systematic errors, `measured = (1 + scale) true + bias`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Model {
    /// The biases.
    pub bias: Sharing,
    /// The scale errors.
    pub scale: Sharing,
}

impl Model {
    /// The models that are compared, the simple ones first.
    pub const ALL: [Self; 7] = [
        Self { bias: Sharing::Absent, scale: Sharing::Absent },
        Self { bias: Sharing::Common, scale: Sharing::Absent },
        Self { bias: Sharing::Absent, scale: Sharing::Common },
        Self { bias: Sharing::Common, scale: Sharing::Common },
        Self { bias: Sharing::Each, scale: Sharing::Absent },
        Self { bias: Sharing::Each, scale: Sharing::Common },
        Self { bias: Sharing::Each, scale: Sharing::Each },
    ];

    /// Index of a sensor's bias among the parameters.
    #[must_use]
    pub fn bias_index(self, sensor: usize) -> Option<usize> {
        match self.bias {
            Sharing::Absent => None,
            Sharing::Common => Some(0),
            Sharing::Each => Some(sensor),
        }
    }

    /// Index of a sensor's scale error among the parameters.
    #[must_use]
    pub fn scale_index(self, sensor: usize, sensors: usize) -> Option<usize> {
        let first = count(self.bias, sensors);
        match self.scale {
            Sharing::Absent => None,
            Sharing::Common => Some(first),
            Sharing::Each => Some(first + sensor),
        }
    }

    /// Standard deviations of the errors' weak priors, whose means are zero.
    #[must_use]
    pub fn prior_stds(self, sensors: usize, span_m: f64) -> Vec<f64> {
        let mut stds = vec![0.1 * span_m; count(self.bias, sensors)];
        stds.extend(vec![0.1; count(self.scale, sensors)]);
        stds
    }
}

fn count(sharing: Sharing, sensors: usize) -> usize {
    match sharing {
        Sharing::Absent => 0,
        Sharing::Common => 1,
        Sharing::Each => sensors,
    }
}
