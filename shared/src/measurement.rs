//! A robot's measurement and its place: the same types in messages, in fusion and in logs.

#[cfg(feature = "iceoryx2")]
use iceoryx2::prelude::ZeroCopySend;
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

/// Place of a robot or a sensor, in the frame of the run.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "iceoryx2", derive(ZeroCopySend), type_name("rangehound.Pose.v1"))]
#[repr(C)]
pub struct Pose {
    /// Position, m.
    pub x_m: f64,
    /// Position, m.
    pub y_m: f64,
    /// Height above the plane in which the target moves, m; 0 if both move in one plane.
    pub height_m: f64,
    /// Covariance of the position, m^2: xx, xy, yy. All zero, as now, means that the position is exact.
    pub covariance_m2: [f64; 3],
}

impl Pose {
    /// A place in the plane of the target, known exactly.
    #[must_use]
    pub fn at([x_m, y_m]: [f64; 2]) -> Self {
        Self { x_m, y_m, ..Self::default() }
    }

    /// The position in the plane, m.
    #[must_use]
    pub fn position_m(self) -> Vector2<f64> {
        Vector2::new(self.x_m, self.y_m)
    }

    /// All its numbers.
    #[must_use]
    pub fn numbers(self) -> [f64; 6] {
        let Self { x_m, y_m, height_m, covariance_m2: [xx_m2, xy_m2, yy_m2] } = self;
        [x_m, y_m, height_m, xx_m2, xy_m2, yy_m2]
    }
}

/// A sensor's result at a tick.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "iceoryx2", derive(ZeroCopySend), type_name("rangehound.Measurement.v1"))]
#[repr(C)]
pub struct Measurement {
    /// Place of the sensor.
    pub pose: Pose,
    /// 1 if there is a range, 0 if not; the next two fields are zero then.
    pub has_range: u64,
    /// The range, calibrated, m: the slant range if the sensor and the target differ in height.
    pub range_m: f64,
    /// Standard deviation of the range, m.
    pub range_std_m: f64,
}

impl Measurement {
    /// A measurement with a range and its standard deviation, m, or without a range.
    #[must_use]
    pub fn new(pose: Pose, range_m: Option<(f64, f64)>) -> Self {
        let (has_range, (range_m, range_std_m)) = (u64::from(range_m.is_some()), range_m.unwrap_or_default());
        Self { pose, has_range, range_m, range_std_m }
    }

    /// The range and its standard deviation, m, if there is one.
    #[must_use]
    pub fn range(&self) -> Option<(f64, f64)> {
        (self.has_range != 0).then_some((self.range_m, self.range_std_m))
    }
}
