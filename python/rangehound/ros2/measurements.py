"""From the fields of messages to measurements, or the reason why there is none. Nothing here needs ROS."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Sequence

#: A message that is older than its predecessor by more than this comes from a clock that was set back, s.
_CLOCK_RESET_S = 1.0


class Refused(ValueError):
    """Why the values of a message are not used."""


@dataclass(frozen=True)
class Odometry:
    """A robot's pose in the frame of the run, and its motion."""

    x_m: float
    y_m: float
    yaw_rad: float
    #: Covariance of the position, m^2: xx, xy, yy. Zero means that it is exact.
    covariance_m2: tuple[float, float, float]
    yaw_std_rad: float
    #: Forward and sideward speed, m/s, and turn rate, rad/s.
    velocity: tuple[float, float, float]


def range_of(range_m: float, min_m: float, max_m: float, variance_m2: float, std_m: float) -> tuple[float, float]:
    """The range and its standard deviation, m: that of the message, or `std_m` where its variance is 0.

    Raises `Refused` for NaN, infinite (nothing, or too close), negative ranges and those outside of the sensor's limits.
    """
    if math.isnan(range_m):
        raise Refused("the range is NaN")
    if math.isinf(range_m):
        raise Refused("the range is infinite: nothing was detected")
    if range_m < 0.0:
        raise Refused("the range is negative")
    if not min_m <= range_m <= max_m:
        raise Refused(f"the range is outside of min_range {min_m:g} to max_range {max_m:g} m")
    if not (math.isfinite(variance_m2) and variance_m2 >= 0.0):
        raise Refused(f"the variance is {variance_m2:g}: expected a finite number of at least 0")
    return range_m, math.sqrt(variance_m2) if variance_m2 > 0.0 else std_m


def bearing_of(x: float, y: float) -> float:
    """The bearing of a direction in the robot's frame (x forwards, y to the left), rad counter-clockwise.

    Raises `Refused` for NaN or infinite values, and for a direction without a horizontal part.
    """
    if not (math.isfinite(x) and math.isfinite(y)):
        raise Refused("the direction has NaN or infinite values")
    if x == 0.0 and y == 0.0:
        raise Refused("the direction has no horizontal part")
    return math.atan2(y, x)


def yaw_of(x: float, y: float, z: float, w: float) -> float:
    """The yaw of a rotation, rad. Raises `Refused` if it is no unit quaternion."""
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    if not 0.99 < norm < 1.01:
        raise Refused("the orientation has a length other than 1: expected a unit quaternion")
    return math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)


def odometry_of(
    position: Sequence[float], orientation: Sequence[float], covariance: Any, velocity: Sequence[float]
) -> Odometry:
    """A pose from x, y, a quaternion and a covariance (36,), row by row over x, y, z, roll, pitch, yaw.

    `velocity` is forward and sideward speed and turn rate; values that are not finite count as 0. Raises `Refused` for a
    pose with NaN or infinite values, and for a covariance that is none.
    """
    x_m, y_m = position
    if not (math.isfinite(x_m) and math.isfinite(y_m)):
        raise Refused("the position has NaN or infinite values")
    yaw_rad = yaw_of(*orientation)
    xx_m2, xy_m2, yy_m2, yaw_rad2 = (float(covariance[i]) for i in (0, 1, 7, 35))
    values = (xx_m2, xy_m2, yy_m2, yaw_rad2)
    is_covariance = min(xx_m2, yy_m2, yaw_rad2) >= 0.0 and xy_m2 * xy_m2 <= xx_m2 * yy_m2 * (1 + 1e-9)
    if not all(map(math.isfinite, values)) or not is_covariance:
        raise Refused("the covariance of the pose is not positive semidefinite or not finite")
    # An angle of which nothing is known has a standard deviation of less than pi.
    yaw_std_rad = min(math.sqrt(yaw_rad2), math.pi)
    moved = [value if math.isfinite(value) else 0.0 for value in velocity]
    return Odometry(x_m, y_m, yaw_rad, (xx_m2, xy_m2, yy_m2), yaw_std_rad, (moved[0], moved[1], moved[2]))


def placed(odometry: Odometry, origin: Sequence[float]) -> Odometry:
    """The same in the frame of the run; `origin` is x, m, y, m, and yaw, rad, of the odometry's frame in it."""
    x_m, y_m, yaw_rad = origin
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    xx, xy, yy = odometry.covariance_m2
    turned = (
        c * c * xx - 2 * c * s * xy + s * s * yy,
        c * s * (xx - yy) + (c * c - s * s) * xy,
        s * s * xx + 2 * c * s * xy + c * c * yy,
    )
    return Odometry(
        x_m + c * odometry.x_m - s * odometry.y_m,
        y_m + s * odometry.x_m + c * odometry.y_m,
        odometry.yaw_rad + yaw_rad,
        turned,
        odometry.yaw_std_rad,
        odometry.velocity,
    )


def moved(odometry: Odometry, time_s: float) -> Odometry:
    """The same after a time that is short against a turn, s, with its velocity."""
    forward_mps, sideward_mps, turn_radps = odometry.velocity
    yaw_rad = odometry.yaw_rad + turn_radps * time_s / 2
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return Odometry(
        odometry.x_m + (c * forward_mps - s * sideward_mps) * time_s,
        odometry.y_m + (s * forward_mps + c * sideward_mps) * time_s,
        odometry.yaw_rad + turn_radps * time_s,
        odometry.covariance_m2,
        odometry.yaw_std_rad,
        odometry.velocity,
    )


class Newest:
    """The newest value of a topic. Each is used once, and only while it is young."""

    def __init__(self) -> None:
        self.stamp_s = -math.inf
        self.value: Any = None
        self._used_s = -math.inf

    def put(self, stamp_s: float, value: Any) -> bool:
        """Stores a value, `None` for a refused one. False if it is not newer than the stored one."""
        if self.stamp_s - _CLOCK_RESET_S <= stamp_s <= self.stamp_s:
            return False
        if stamp_s < self.stamp_s:
            self._used_s = -math.inf
        self.stamp_s, self.value = stamp_s, value
        return True

    def look(self, now_s: float, max_age_s: float) -> Any:
        """The value, used or not; `None` if it is too old, or from a future that no clock's error explains."""
        return self.value if abs(now_s - self.stamp_s) <= max_age_s else None

    def take(self, now_s: float, max_age_s: float) -> Any:
        """The value, once."""
        value = self.look(now_s, max_age_s)
        if value is None or self.stamp_s <= self._used_s:
            return None
        self._used_s = self.stamp_s
        return value
