"""From the arrays of a tick to the fields of messages. Nothing here needs ROS.

Covariances of ROS are 6 x 6, row by row, over x, y, z, roll, pitch, yaw. A run is planar: entries of z, roll and pitch are
0, as those of planar localisers are, and by which RViz draws a pose in the plane. What is not known has a large variance:
a yaw that may be any has that of a uniform distribution, pi^2/3, and a velocity that is not estimated `UNKNOWN`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Variance of what is not estimated, in the square of its unit.
UNKNOWN = 1e6

#: Variance of an angle of which nothing is known: uniform over a turn, rad^2.
ANY_ANGLE_RAD2 = math.pi**2 / 3

#: Where x, y and yaw are in a covariance.
_PLANAR = np.ix_([0, 1, 5], [0, 1, 5])

#: Most seconds of a stamp, s.
_STAMP_MAX_S = 2**31 - 1


class Planar(NamedTuple):
    """A pose, or a velocity, in the plane, with its covariance as ROS has it."""

    x: float
    y: float
    yaw: float
    #: (36,)
    covariance: Array


class Ellipse(NamedTuple):
    """An ellipse: direction of its long axis, and its half axes."""

    yaw_rad: float
    long_m: float
    short_m: float


def stamp_of(time_s: float) -> tuple[int, int]:
    """Seconds and nanoseconds of a time. A time that a stamp cannot hold is its nearest one."""
    if math.isnan(time_s):
        return 0, 0
    bounded_s = min(max(time_s, -float(_STAMP_MAX_S)), float(_STAMP_MAX_S))
    second = math.floor(bounded_s)
    carried, nanosecond = divmod(round((bounded_s - second) * 1e9), 1_000_000_000)
    return second + carried, nanosecond


def quaternion_of(yaw_rad: float) -> tuple[float, float]:
    """z and w of the rotation about the vertical axis; x and y are 0."""
    return math.sin(yaw_rad / 2), math.cos(yaw_rad / 2)


def covariance_of(planar: Any) -> Array:
    """The covariance of ROS, (36,), from one of x, y and yaw, (3, 3)."""
    full = np.zeros((6, 6))
    full[_PLANAR] = planar
    return full.reshape(36)


def target_pose(state: Array, covariance: Array, has_velocity: bool) -> Planar:
    """The target's pose, which faces along its velocity.

    `state` is (n,), `covariance` (n, n): x, y and, with a velocity, vx, vy. With J = (-vy, vx) / |v|^2, the variance of the
    yaw is J P_v J^T and its covariance with the position P_pv J^T. Where that variance exceeds the one of any angle, the
    yaw is not known.
    """
    planar = np.zeros((3, 3))
    planar[:2, :2] = covariance[:2, :2]
    planar[2, 2] = ANY_ANGLE_RAD2
    yaw_rad = 0.0
    if has_velocity:
        vx_mps, vy_mps = float(state[2]), float(state[3])
        square = vx_mps * vx_mps + vy_mps * vy_mps
        yaw_rad = math.atan2(vy_mps, vx_mps)
        if square > 1e-12:
            slope = np.array([-vy_mps, vx_mps]) / square
            variance_rad2 = float(slope @ covariance[2:4, 2:4] @ slope)
            if variance_rad2 < ANY_ANGLE_RAD2:
                planar[2, 2] = variance_rad2
                planar[:2, 2] = planar[2, :2] = covariance[:2, 2:4] @ slope
    return Planar(float(state[0]), float(state[1]), yaw_rad, covariance_of(planar))


def target_twist(state: Array, covariance: Array, has_velocity: bool) -> Planar:
    """The target's velocity in its own frame, which faces along it: x is the speed, m/s. The turn rate is not estimated."""
    if not has_velocity:
        return Planar(0.0, 0.0, 0.0, covariance_of(np.diag([UNKNOWN] * 3)))
    vx_mps, vy_mps = float(state[2]), float(state[3])
    yaw_rad = math.atan2(vy_mps, vx_mps)
    to_own = np.array([[math.cos(yaw_rad), math.sin(yaw_rad)], [-math.sin(yaw_rad), math.cos(yaw_rad)]])
    planar = np.zeros((3, 3))
    planar[:2, :2] = to_own @ covariance[2:4, 2:4] @ to_own.T
    planar[2, 2] = UNKNOWN
    return Planar(math.hypot(vx_mps, vy_mps), 0.0, 0.0, covariance_of(planar))


def robot_pose(position_m: Array, covariance_m2: Array, heading_rad: float, heading_std_rad: float) -> Planar:
    """The pose of a robot as it reported it: position (2,), covariance (2, 2), heading."""
    planar = np.zeros((3, 3))
    planar[:2, :2] = covariance_m2
    planar[2, 2] = min(heading_std_rad * heading_std_rad, ANY_ANGLE_RAD2)
    return Planar(float(position_m[0]), float(position_m[1]), float(heading_rad), covariance_of(planar))


def ellipse_of(covariance_m2: Array, sigma: float) -> Ellipse:
    """The ellipse of a position's covariance, (2, 2), at so many standard deviations."""
    variances, directions = np.linalg.eigh(covariance_m2)
    short_m, long_m = sigma * np.sqrt(np.maximum(variances, 0.0))
    return Ellipse(math.atan2(directions[1, 1], directions[0, 1]), float(long_m), float(short_m))


def latency_s(last_range_ns: int, sent_ns: int) -> float:
    """Time from a tick's last range to its headings, s; NaN if it was not taken."""
    return (sent_ns - last_range_ns) * 1e-9 if 0 < last_range_ns <= sent_ns else math.nan
