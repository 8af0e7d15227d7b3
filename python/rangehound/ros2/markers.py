"""The markers of RViz: ellipse, headings, rays and range circles. Made once; each tick only fills in numbers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from . import messages

#: Standard deviations of the ellipse.
SIGMA = 3.0

#: Corners of a circle.
_CORNERS = 48

#: Red, green, blue, opacity.
_ESTIMATE = (0.84, 0.15, 0.16, 0.35)
_ROBOT = (0.12, 0.47, 0.71, 1.0)
_RAY = (0.5, 0.5, 0.5, 0.6)
_REJECTED = (0.84, 0.15, 0.16, 0.9)


class Markers:
    """A MarkerArray: one ellipse, and for each robot an arrow, a ray and a circle."""

    def __init__(self, types: tuple[Any, Any, Any, Any], frame: str, robots: int) -> None:
        array, self._marker, self._point, self._color = types
        self.message = array()
        self._ellipse = self._made("ellipse", 0, self._marker.CYLINDER, _ESTIMATE, frame)
        self._headings = [self._made("heading", i, self._marker.ARROW, _ROBOT, frame) for i in range(robots)]
        self._rays = [self._made("ray", i, self._marker.LINE_STRIP, _RAY, frame) for i in range(robots)]
        self._circles = [self._made("range", i, self._marker.LINE_STRIP, _RAY, frame) for i in range(robots)]
        for ray in self._rays:
            ray.points = [self._point(), self._point()]
        angles = np.linspace(0.0, math.tau, _CORNERS + 1)
        self._circle = np.stack([np.cos(angles), np.sin(angles)], -1)
        for circle in self._circles:
            circle.points = [self._point() for _ in angles]

    def _made(self, namespace: str, id: int, kind: int, color: tuple[float, float, float, float], frame: str) -> Any:
        marker = self._marker(ns=namespace, id=id, type=kind)
        marker.header.frame_id = frame
        marker.color = self._color(r=color[0], g=color[1], b=color[2], a=color[3])
        marker.scale.x = 0.05
        marker.pose.orientation.w = 1.0
        self.message.markers.append(marker)
        return marker

    def fill(self, tick: Any, stamp: Any) -> Any:
        """The message for a tick."""
        x_m, y_m = map(float, tick.state[:2])
        for marker in self.message.markers:
            marker.header.stamp = stamp
        ellipse = messages.ellipse_of(tick.covariance[:2, :2], SIGMA)
        self._place(self._ellipse, x_m, y_m, ellipse.yaw_rad)
        # RViz refuses a scale of 0.
        scale = self._ellipse.scale
        scale.x, scale.y, scale.z = max(2 * ellipse.long_m, 1e-3), max(2 * ellipse.short_m, 1e-3), 1e-3
        size_m = max(0.5, ellipse.long_m / 2)
        for robot, position_m in enumerate(tick.believed_m):
            shown = bool(np.isfinite(position_m).all())
            measured_m = float(tick.range_m[robot])
            self._show(self._headings[robot], shown and bool(tick.speed_mps[robot] > 0.0))
            self._show(self._rays[robot], shown)
            self._show(self._circles[robot], shown and math.isfinite(measured_m))
            if not shown:
                continue
            robot_x_m, robot_y_m = map(float, position_m)
            self._place(self._headings[robot], robot_x_m, robot_y_m, float(tick.heading_rad[robot]))
            arrow = self._headings[robot].scale
            arrow.x, arrow.y, arrow.z = size_m, size_m / 5, size_m / 5
            start, end = self._rays[robot].points
            start.x, start.y = robot_x_m, robot_y_m
            end.x, end.y = x_m, y_m
            if math.isfinite(measured_m):
                self._encircle(self._circles[robot], position_m, measured_m, tick.range_used[robot] > 1)
        return self.message

    def _encircle(self, circle: Any, centre_m: Any, radius_m: float, is_rejected: bool) -> None:
        for point, (x_m, y_m) in zip(circle.points, (centre_m + radius_m * self._circle).tolist()):
            point.x, point.y = x_m, y_m
        color = circle.color
        color.r, color.g, color.b, color.a = _REJECTED if is_rejected else _RAY

    def _show(self, marker: Any, is_shown: bool) -> None:
        marker.action = self._marker.ADD if is_shown else self._marker.DELETE

    def _place(self, marker: Any, x_m: float, y_m: float, yaw_rad: float) -> None:
        pose = marker.pose
        pose.position.x, pose.position.y = x_m, y_m
        pose.orientation.z, pose.orientation.w = messages.quaternion_of(yaw_rad)
