//! A robot's measurement and its pose: the same types in messages, in fusion and in logs.

#[cfg(feature = "iceoryx2")]
use iceoryx2::prelude::ZeroCopySend;
use nalgebra::{Matrix2, Vector2};
use serde::{Deserialize, Serialize};

/// Where a robot or a sensor says it is, in the frame of the run.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "iceoryx2", derive(ZeroCopySend), type_name("rangehound.Pose.v2"))]
#[repr(C)]
pub struct Pose {
    /// Position, m.
    pub x_m: f64,
    /// Position, m.
    pub y_m: f64,
    /// Height above the plane in which the target moves, m; 0 if both move in one plane.
    pub height_m: f64,
    /// Direction that it faces, rad counter-clockwise from the x axis. Its bearings count from there.
    pub heading_rad: f64,
    /// Covariance of the position, m^2: xx, xy, yy. All zero means that the position is exact.
    pub covariance_m2: [f64; 3],
    /// Standard deviation of the heading, rad. Zero means that the heading is exact.
    pub heading_std_rad: f64,
}

impl Pose {
    /// A place in the plane of the target, known exactly, that faces along the x axis.
    #[must_use]
    pub fn at([x_m, y_m]: [f64; 2]) -> Self {
        Self { x_m, y_m, ..Self::default() }
    }

    /// The position in the plane, m.
    #[must_use]
    pub fn position_m(self) -> Vector2<f64> {
        Vector2::new(self.x_m, self.y_m)
    }

    /// Covariance of the position, m^2.
    #[must_use]
    pub fn position_covariance_m2(self) -> Matrix2<f64> {
        let [xx_m2, xy_m2, yy_m2] = self.covariance_m2;
        Matrix2::new(xx_m2, xy_m2, xy_m2, yy_m2)
    }

    /// True if position and heading are exact.
    #[must_use]
    pub fn is_exact(self) -> bool {
        self.covariance_m2 == [0.0; 3] && self.heading_std_rad == 0.0
    }

    /// All its numbers.
    #[must_use]
    pub fn numbers(self) -> [f64; 8] {
        let Self { x_m, y_m, height_m, heading_rad, covariance_m2: [xx_m2, xy_m2, yy_m2], heading_std_rad } = self;
        [x_m, y_m, height_m, heading_rad, xx_m2, xy_m2, yy_m2, heading_std_rad]
    }
}

/// A kind of measurement of the target.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
pub enum Kind {
    /// The distance, m.
    #[default]
    Range,
    /// The direction, rad counter-clockwise from the robot's heading.
    Bearing,
}

impl Kind {
    /// All of them. A kind's number is its place here.
    pub const ALL: [Self; 2] = [Self::Range, Self::Bearing];

    /// Number of kinds.
    pub const COUNT: usize = Self::ALL.len();

    /// Its name in logs and reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Range => "range",
            Self::Bearing => "bearing",
        }
    }

    /// Its bit in a set of kinds.
    #[must_use]
    pub fn bit(self) -> u64 {
        1 << self as u64
    }
}

/// A sensor's result at a tick: a range, a bearing, both or nothing.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "iceoryx2", derive(ZeroCopySend), type_name("rangehound.Measurement.v2"))]
#[repr(C)]
pub struct Measurement {
    /// Pose of the sensor, as the robot knows it.
    pub pose: Pose,
    /// The kinds that were measured: the [bits](Kind::bit) of the kinds. The fields of the other kinds are zero.
    pub kinds: u64,
    /// The range, calibrated, m: the slant range if the sensor and the target differ in height.
    pub range_m: f64,
    /// Standard deviation of the range, m.
    pub range_std_m: f64,
    /// The bearing, rad counter-clockwise from the heading of the pose.
    pub bearing_rad: f64,
    /// Standard deviation of the bearing, rad.
    pub bearing_std_rad: f64,
}

impl Measurement {
    /// A measurement of a range with its standard deviation, m, or of nothing.
    #[must_use]
    pub fn new(pose: Pose, range_m: Option<(f64, f64)>) -> Self {
        let (range_m, range_std_m, kinds) =
            range_m.map_or((0.0, 0.0, 0), |(range_m, std_m)| (range_m, std_m, Kind::Range.bit()));
        Self { pose, kinds, range_m, range_std_m, ..Self::default() }
    }

    /// The same with a bearing and its standard deviation, rad, if there is one.
    #[must_use]
    pub fn with_bearing(self, bearing_rad: Option<(f64, f64)>) -> Self {
        let Some((bearing_rad, bearing_std_rad)) = bearing_rad else { return self };
        Self { kinds: self.kinds | Kind::Bearing.bit(), bearing_rad, bearing_std_rad, ..self }
    }

    /// The range and its standard deviation, m, if there is one.
    #[must_use]
    pub fn range(&self) -> Option<(f64, f64)> {
        self.has(Kind::Range).then_some((self.range_m, self.range_std_m))
    }

    /// The bearing and its standard deviation, rad, if there is one.
    #[must_use]
    pub fn bearing(&self) -> Option<(f64, f64)> {
        self.has(Kind::Bearing).then_some((self.bearing_rad, self.bearing_std_rad))
    }

    /// The value of a kind and its standard deviation, m or rad, if it was measured.
    #[must_use]
    pub fn of(&self, kind: Kind) -> Option<(f64, f64)> {
        match kind {
            Kind::Range => self.range(),
            Kind::Bearing => self.bearing(),
        }
    }

    /// True if this kind was measured.
    #[must_use]
    pub fn has(&self, kind: Kind) -> bool {
        self.kinds & kind.bit() != 0
    }

    /// Number of kinds that were measured.
    #[must_use]
    pub fn count(&self) -> u64 {
        Kind::ALL.into_iter().filter(|kind| self.has(*kind)).count() as u64
    }
}
