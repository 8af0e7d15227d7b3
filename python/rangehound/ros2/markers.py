"""The markers of RViz: those that a ROS 2 bag of the run has. The messages are made once; each tick only fills them in."""

from __future__ import annotations

from typing import Any

from .. import _native
from . import messages


class Markers:
    """A MarkerArray: one ellipse, and for each robot an arrow, a ray and a circle."""

    def __init__(self, types: tuple[Any, Any, Any], frame: str) -> None:
        array, self._marker, self._point = types
        self.message, self._frame = array(), frame

    def fill(self, tick: Any, stamp: Any) -> Any:
        """The message for a tick."""
        robots = zip(tick.believed_m.tolist(), tick.range_m.tolist(), (tick.range_used > 1).tolist(), tick.heading_rad.tolist(), tick.speed_mps.tolist())
        drawn = _native.ros_markers(tick.state[:2].tolist(), tick.covariance[:2, :2].tolist(), list(robots))
        markers = self.message.markers
        while len(markers) < len(drawn):
            markers.append(self._marker())
        for marker, one in zip(markers, drawn):
            marker.header.frame_id, marker.header.stamp = self._frame, stamp
            self._fill(marker, *one)
        return self.message

    def _fill(
        self, marker: Any, namespace: str, id: int, kind: int, is_shown: bool, place_m: list[float], yaw_rad: float, scale_m: list[float], color: list[float], points_m: list[list[float]]
    ) -> None:
        marker.ns, marker.id, marker.type = namespace, id, kind
        marker.action = self._marker.ADD if is_shown else self._marker.DELETE
        marker.pose.position.x, marker.pose.position.y = place_m
        marker.pose.orientation.z, marker.pose.orientation.w = messages.quaternion_of(yaw_rad)
        marker.scale.x, marker.scale.y, marker.scale.z = scale_m
        marker.color.r, marker.color.g, marker.color.b, marker.color.a = color
        if len(marker.points) != len(points_m):
            marker.points = [self._point() for _ in points_m]
        for point, (x_m, y_m) in zip(marker.points, points_m):
            point.x, point.y = x_m, y_m
