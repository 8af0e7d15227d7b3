"""The controller of a robot that drives forwards and turns: from a heading and a speed to a twist.

With the robot's yaw `psi`, the commanded heading `theta` and the commanded speed `s`::

    e = theta - psi, wrapped to (-pi, pi]
    w = clamp(k e, -w_max, w_max)            rad/s
    v = min(s, v_max) max(0, cos e)          m/s

A robot that faces away from its heading turns on the spot, and drives once the error is below 90 degrees. With a constant
heading and without the limit the error decays as `e(t) = e(0) exp(-k t)`.
"""

from __future__ import annotations

from typing import NamedTuple

from .. import _native


class Limits(NamedTuple):
    """The limits of a robot's motion."""

    #: Greatest forward speed v_max, m/s.
    max_speed_mps: float
    #: Greatest turn rate w_max, rad/s.
    max_turn_rate_radps: float
    #: Turn rate for each rad of error k, 1/s.
    heading_gain_per_s: float


def twist(heading_rad: float, speed_mps: float, yaw_rad: float, limits: Limits) -> tuple[float, float]:
    """Forward speed, m/s, and turn rate, rad/s, for a commanded heading and speed; zero to stop or if a value is no number."""
    linear_mps, angular_radps = _native.ros_twist(heading_rad, speed_mps, yaw_rad, *limits)
    return linear_mps, angular_radps
