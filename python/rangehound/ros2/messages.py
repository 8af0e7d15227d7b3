"""From the arrays of a tick to the fields of messages. Nothing here needs ROS.

Poses, velocities and their covariances are those that a ROS 2 bag of the run has. Covariances of ROS are 6 x 6, row by row,
over x, y, z, roll, pitch, yaw. A run is planar: entries of z, roll and pitch are 0, as those of planar localisers are, and by
which RViz draws a pose in the plane. What is not known has a large variance: a yaw that may be any has that of a uniform
distribution, pi^2/3, and a velocity that is not estimated 1e6.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import _native

Array = NDArray[np.float64]

#: Most seconds of a stamp, s.
_STAMP_MAX_S = 2**31 - 1


class Planar(NamedTuple):
    """A pose in the plane, or above it, with its covariance as ROS has it."""

    x: float
    y: float
    z: float
    yaw: float
    #: (36,)
    covariance: Array


class Target(NamedTuple):
    """The estimated target: its pose, which faces along its velocity, and its velocity in its own frame."""

    pose: Planar
    #: Along x.
    speed_mps: float
    #: (36,)
    velocity_covariance: Array


def stamp_of(time_s: float, offset_ns: int = 0) -> tuple[int, int]:
    """Seconds and nanoseconds of a time with an offset. A time that a stamp cannot hold is its nearest one."""
    if math.isnan(time_s):
        return 0, 0
    bounded_s = min(max(time_s, -float(_STAMP_MAX_S)), float(_STAMP_MAX_S))
    second = math.floor(bounded_s)
    carried, nanosecond = divmod(round((bounded_s - second) * 1e9) + offset_ns, 1_000_000_000)
    return second + carried, nanosecond


def quaternion_of(yaw_rad: float) -> tuple[float, float]:
    """z and w of the rotation about the vertical axis; x and y are 0."""
    return math.sin(yaw_rad / 2), math.cos(yaw_rad / 2)


def target_of(state: Array, covariance: Array, has_velocity: bool) -> Target:
    """The target of an estimate: `state` is (n,), `covariance` (n, n): x, y and, with a velocity, vx, vy."""
    pose, speed_mps, velocity_covariance = _native.ros_target(state, covariance, has_velocity)
    return Target(Planar(*pose), speed_mps, velocity_covariance)


def robot_pose(position_m: Array, height_m: float, covariance_m2: Array, heading_rad: float, heading_std_rad: float) -> Planar:
    """The pose of a robot as it reported it: position (2,), height, covariance (2, 2), heading."""
    place_m = float(position_m[0]), float(position_m[1]), float(height_m)
    return Planar(*_native.ros_robot(place_m, covariance_m2, float(heading_rad), float(heading_std_rad)))
