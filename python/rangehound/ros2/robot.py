"""The process of a real robot: its role in the run, with measurements and odometry from ROS and a twist to ROS."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections import Counter
from typing import Any, Sequence

from .. import _native
from .._native import InputError
from ..live import Robot
from . import measurements, messages, unicycle
from .measurements import Newest, Odometry, Refused
from .observer import controller_limits
from .session import DIAGNOSTICS_S, Ended, Parser, Session, complain, diagnostic, end_with, message_type, run_node, split_ros_args

#: Time steps for which an odometry message counts by default: as long as a robot holds a heading.
_ODOMETRY_TICKS = 3

#: Least standard deviation of a range that the filter takes, m.
_RANGE_STD_MIN_M = 1e-4

#: How long the last command, to stop, may take to arrive, s.
_LAST_COMMAND_S = 1.0

#: Names of the counts in the diagnostics.
_PLURALS = {"range": "ranges", "bearing": "bearings", "odometry": "odometry"}

_HELP = """
topics in:   robot_N/range robot_N/bearing robot_N/odom
topics out:  robot_N/cmd_vel /diagnostics
parameters:  map_frame base_frame odom_origin max_age_s odom_max_age_s
             lockstep_wait_s max_speed_mps max_turn_rate_radps
             heading_gain_per_s

`python -m rangehound.ros2 --robots` starts this for each real robot.
Arguments after --ros-args go to ROS.
"""


def main(argv: Sequence[str]) -> None:
    """Takes part in the run until it ends. The last command is to stop."""
    argv, ros_args = split_ros_args(argv)
    arguments = Parser("ros2.robot", "A real robot takes part in a live run, by topics of ROS 2.", _HELP)
    arguments.add_argument("--id", required=True, type=int, metavar="N", help="number of the robot in the team, from 0")
    arguments.add_argument("--end-with", type=int, metavar="PID", help="end when this process ends")
    args = arguments.parse_args(argv)
    if args.end_with is not None:
        end_with(args.end_with)
    with Session(f"rangehound_robot_{args.id}" if args.id >= 0 else "rangehound_robot", ros_args) as session:
        facts = _native.Observer(args.name, False, False, args.wait_s).describe()
        count = len(facts["max_speeds_mps"])
        if not 0 <= args.id < count:
            raise InputError(f"--id is {args.id}: expected a robot from 0 to {count - 1}")
        bridge = Bridge(session, facts, args.id)
        with session.calling(end=bridge.stop):
            bridge.wait_for_odometry(args.name)
            Robot(args.name, args.id, measure=bridge.measure, pose=bridge.pose, carry_out=bridge.carry_out).run()


class Bridge:
    """A robot between the run, which calls `pose`, `measure` and `carry_out`, and ROS, which calls the subscriptions."""

    def __init__(self, session: Session, facts: dict[str, Any], robot: int) -> None:
        from builtin_interfaces.msg import Time
        from rclpy.clock import Clock, ClockType
        from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_sensor_data

        self._session, self._robot, self._time = session, robot, Time
        self._dt_s, self._is_lockstep = float(facts["dt_s"]), bool(facts["is_lockstep"])
        self._range_std_m = float(facts["range_stds_m"][robot])
        self._bearing_std_rad = float(facts["bearing_stds_rad"][robot])
        own = unicycle.Limits(*facts["controller"])._replace(max_speed_mps=float(facts["max_speeds_mps"][robot]))
        self._limits = controller_limits(session, own)
        self._offset_ns = int(facts["stamp_offset_ns"])
        self._map_frame = session.parameter("map_frame", "map", "frame of the run")
        self._origin = session.parameter("odom_origin", [math.nan] * 3, "x, m, y, m, and yaw, rad, of the odometry's frame in map_frame")
        if len(self._origin) != 3 or any(map(math.isinf, self._origin)):
            raise InputError(f"odom_origin is {self._origin}: expected x, y and yaw")
        self._max_age_s = session.number("max_age_s", self._dt_s, "age up to which a range or a bearing is used, s")
        self._odom_max_age_s = session.number("odom_max_age_s", _ODOMETRY_TICKS * self._dt_s, "age up to which odometry is used, s")
        self._wait_s = session.number("lockstep_wait_s", 1.0, "how long a tick in lock step waits for this robot's messages, s")

        self._changed = threading.Condition()
        self._odometry, self._range, self._bearing = Newest(), Newest(), Newest()
        #: The newest pose, and what was measured with it: a range with its deviation, a bearing.
        self._odom: Odometry | None = None
        self._measured_now: list[Any] = [None, None]
        self._command = (0.0, 0.0)
        self._tick_s = 0.0
        self._received: Counter[str] = Counter()
        self._refused: Counter[str] = Counter()
        self._used = {"range": 0, "bearing": 0}

        twist = message_type("geometry_msgs", "TwistStamped", f"robot_{robot}/cmd_vel", needed=True)
        reliable = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
        self._publisher = session.publisher(twist, f"robot_{robot}/cmd_vel", reliable)
        self._twist = twist()
        [self._twist.header.frame_id] = session.base_frames([robot])
        odometry = message_type("nav_msgs", "Odometry", f"robot_{robot}/odom", needed=True)
        session.subscribe(odometry, f"robot_{robot}/odom", qos_profile_sensor_data, self._on_odometry)
        if self._has_range:
            kind = message_type("sensor_msgs", "Range", f"robot_{robot}/range", needed=True)
            session.subscribe(kind, f"robot_{robot}/range", qos_profile_sensor_data, self._on_range)
        if self._has_bearing:
            kind = message_type("geometry_msgs", "Vector3Stamped", f"robot_{robot}/bearing", needed=True)
            session.subscribe(kind, f"robot_{robot}/bearing", qos_profile_sensor_data, self._on_bearing)
        self._diagnostics = message_type("diagnostic_msgs", "DiagnosticArray", "/diagnostics")
        if self._diagnostics is not None:
            self._diagnostics_publisher = session.publisher(self._diagnostics, "/diagnostics", reliable)
            session.node.create_timer(DIAGNOSTICS_S, self._report, clock=Clock(clock_type=ClockType.STEADY_TIME))

    @property
    def _has_range(self) -> bool:
        return math.isfinite(self._range_std_m)

    @property
    def _has_bearing(self) -> bool:
        return math.isfinite(self._bearing_std_rad)

    # Called by ROS.

    def _on_range(self, message: Any) -> None:
        # Distributions before Iron have no variance in it.
        variance_m2 = float(getattr(message, "variance", 0.0))
        limits = float(message.min_range), float(message.max_range)
        self._receive("range", self._range, message, lambda: self._measured(float(message.range), *limits, variance_m2))

    def _measured(self, range_m: float, min_m: float, max_m: float, variance_m2: float) -> tuple[float, float]:
        range_m, std_m = measurements.range_of(range_m, min_m, max_m, variance_m2, self._range_std_m)
        return range_m, max(std_m, _RANGE_STD_MIN_M)

    def _on_bearing(self, message: Any) -> None:
        self._receive("bearing", self._bearing, message, lambda: measurements.bearing_of(message.vector.x, message.vector.y))

    def _on_odometry(self, message: Any) -> None:
        is_new = self._receive("odometry", self._odometry, message, lambda: self._posed(message))
        # In lock step the robot moves from tick to tick.
        if is_new and not self._is_lockstep:
            self._drive(self._session.now_s())

    def _posed(self, message: Any) -> Odometry:
        place, turned, moves = message.pose.pose.position, message.pose.pose.orientation, message.twist.twist
        odometry = measurements.odometry_of(
            (place.x, place.y),
            (turned.x, turned.y, turned.z, turned.w),
            message.pose.covariance,
            (moves.linear.x, moves.linear.y, moves.angular.z),
        )
        frame = message.header.frame_id.lstrip("/")
        if frame == self._map_frame.lstrip("/"):
            return odometry
        if any(map(math.isnan, self._origin)):
            raise Refused(f"the frame is {frame!r}: expected {self._map_frame!r}, or the parameter odom_origin for the place of that frame")
        return measurements.placed(odometry, self._origin)

    def _receive(self, what: str, newest: Newest, message: Any, read: Any) -> bool:
        """Stores the value of a message, or that it was refused. True if it has one that is new."""
        stamp_s = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
        if stamp_s == 0.0 and not self._is_lockstep:
            stamp_s = self._session.now_s()
        try:
            value = read()
        except Refused as refusal:
            value = None
            self._refuse(what, str(refusal))
        with self._changed:
            self._received[what] += 1
            is_new = newest.put(stamp_s, value) and value is not None
            if is_new and newest is self._odometry:
                self._odom = value
            self._changed.notify_all()
        return is_new

    def _refuse(self, what: str, cause: str) -> None:
        self._refused[what] += 1
        if self._refused[f"{what}: {cause}"] == 0:
            complain(f"robot {self._robot}: a message of robot_{self._robot}/{'odom' if what == 'odometry' else what} is refused: {cause}")
        self._refused[f"{what}: {cause}"] += 1

    # Called by the run.

    def wait_for_odometry(self, name: str) -> None:
        """Waits for the first pose: without one the robot would take part from a place where it is not."""
        looked_s = time.monotonic()
        is_reported = False
        while True:
            with self._changed:
                if self._odom is not None:
                    return
                self._changed.wait(timeout=0.1)
            if time.monotonic() - looked_s > 2.0:
                looked_s = time.monotonic()
                if not is_reported:
                    complain(f"robot {self._robot} waits for odometry on robot_{self._robot}/odom")
                    is_reported = True
                try:
                    _native.Observer(name, False, False, 0.0)
                except InputError:
                    raise Ended from None

    def pose(self, time_s: float, x_m: float, y_m: float, heading_rad: float) -> tuple[float, ...]:
        """Where the robot is at a tick. Takes the measurements of the tick with it, so that all are of one moment."""
        with self._changed:
            self._tick_s = time_s + self._offset_ns * 1e-9
            now_s = self._now_s()
            if self._is_lockstep:
                expected = [self._odometry, *([self._range] if self._has_range else []), *([self._bearing] if self._has_bearing else [])]
                self._changed.wait_for(lambda: all(topic.stamp_s >= now_s - self._dt_s / 2 for topic in expected), timeout=self._wait_s)
            max_age_s = self._dt_s / 2 if self._is_lockstep else self._max_age_s
            odometry = self._odometry.look(now_s, self._odom_max_age_s)
            measured = [topic.take(now_s, max_age_s) if odometry is not None and time_s > 0.0 else None for topic in (self._range, self._bearing)]
            self._measured_now = measured
            at_s = max((topic.stamp_s for topic, value in zip((self._range, self._bearing), measured) if value is not None), default=now_s)
            if odometry is not None:
                odometry = measurements.moved(odometry, at_s - self._odometry.stamp_s)
            for what, value in zip(self._used, measured):
                self._used[what] += value is not None
        at = odometry or self._odom
        if at is None:
            raise RuntimeError("asked for a pose before the first odometry")
        return at.x_m, at.y_m, at.yaw_rad, *at.covariance_m2, at.yaw_std_rad

    def measure(self, robot: int, tick: int, range_m: float, bearing_rad: float) -> tuple[float, ...] | None:
        """The measurements of the sensors since the last tick."""
        ranged, bearing = self._measured_now
        if ranged is None and bearing is None:
            return None
        ranged = ranged or (math.nan, 1.0)
        return (*ranged, math.nan, 1.0) if bearing is None else (*ranged, bearing, self._bearing_std_rad)

    def carry_out(self, heading_rad: float, speed_mps: float) -> tuple[float, float]:
        """Drives by a command until the next one. Returns the heading and the speed of the robot."""
        with self._changed:
            self._command = heading_rad, speed_mps
        return self._drive(self._now_s())

    def _now_s(self) -> float:
        """The time by which the stamps of messages are judged: in lock step that of the tick."""
        return self._tick_s if self._is_lockstep else self._session.now_s()

    def _drive(self, now_s: float) -> tuple[float, float]:
        """Publishes the twist for the command; zero without fresh odometry."""
        with self._changed:
            odometry = self._odometry.look(now_s, self._odom_max_age_s)
            yaw_rad = odometry.yaw_rad if odometry is not None else math.nan
            linear_mps, angular_radps = unicycle.twist(*self._command, yaw_rad, self._limits)
            second, nanosecond = messages.stamp_of(now_s)
            self._twist.header.stamp = self._time(sec=second, nanosec=nanosecond)
            self._twist.twist.linear.x, self._twist.twist.angular.z = linear_mps, angular_radps
            self._publisher.publish(self._twist)
        return (yaw_rad, linear_mps) if odometry is not None else (0.0, 0.0)

    def stop(self) -> None:
        """Stops the robot, and waits until it knows."""
        from rclpy.duration import Duration

        self.carry_out(0.0, 0.0)
        self._publisher.wait_for_all_acked(Duration(seconds=_LAST_COMMAND_S))

    def _report(self) -> None:
        from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

        with self._changed:
            is_fresh = self._odometry.look(self._now_s(), self._odom_max_age_s) is not None
            received = {f"{_PLURALS[what]} received": count for what, count in self._received.items()}
            used = {f"{_PLURALS[what]} used": count for what, count in self._used.items()}
        refused = {f"refused, {cause}": count for cause, count in self._refused.items()}
        values = {**received, **used, **refused}
        message = self._diagnostics()
        message.header.stamp = self._session.node.get_clock().now().to_msg()
        text = "odometry is fresh" if is_fresh else "no fresh odometry: the robot stands still"
        message.status = [diagnostic((DiagnosticStatus, KeyValue), f"rangehound: robot-{self._robot} bridge", 0 if is_fresh else 2, text, values)]
        self._diagnostics_publisher.publish(message)


if __name__ == "__main__":
    sys.exit(run_node(main))
