"""The node that shows a run to ROS, and starts a process for each real robot."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
from typing import Any, Iterator, Sequence

import numpy as np

from .. import _native
from .._clock import now_ns
from .._native import InputError
from ..live import Tick
from . import messages, unicycle
from .markers import Markers
from .session import DIAGNOSTICS_S, Parser, Session, complain, diagnostic, message_type, split_ros_args

#: How long the process of a robot that has failed waits for its successor, s.
_RESTART_S = 1.0

#: How long robots' processes may take to end after the run, s.
_END_WAIT_S = 5.0

#: A measurement whose sensor is distrusted, in `range_used` and `bearing_used`.
_DISTRUSTED = 3

#: Niceness of the thread that publishes.
_NICE = 10

#: How long subscribers may take to be found before ticks of the past are published, and for how long no more of them come then, s.
_DISCOVERY_S, _SETTLED_S = 5.0, 1.0

#: Time between two looks for subscribers, s: to look at each tick would take longer than the rest.
_LOOK_S = 0.05

#: Ticks of the past after which subscribers must have taken them, fewer than a publisher keeps; and how long they may take, s.
_AT_ONCE, _TAKEN_S = 50, 1.0

_HELP = """
topics out:  target/pose target/odom robot_N/pose robot_N/cmd_vel
             rangehound/markers /tf /clock /diagnostics
topics in:   robot_N/range robot_N/bearing robot_N/odom (with --robots)
parameters:  map_frame target_frame base_frame publish_tf markers_rate_hz
             max_speed_mps max_turn_rate_radps heading_gain_per_s
             with --robots also those of python -m rangehound.ros2.robot

Arguments after --ros-args go to ROS:
  python -m rangehound.ros2 --name demo
  python -m rangehound.ros2 --name demo --robots 0,1 --ros-args -r __ns:=/team

docs/ros2.md has types, frames, quality of service, and the controller.
"""


def main(argv: Sequence[str]) -> None:
    """Runs the node until the run ends."""
    argv, ros_args = split_ros_args(argv)
    arguments = Parser("ros2", "Shows a live run to ROS 2, and lets real robots take part in it.", _HELP)
    arguments.add_argument("--robots", metavar="IDS", help="robots that are real, as in 0,2-5, or all: a process for each of them takes its role in the run")
    arguments.add_argument("--from-start", action="store_true", help="publish all ticks from the first one, not only new ones")
    arguments.add_argument("--stamps", choices=["run", "ros"], help="time of messages: run: the run's own, from 1 s, with the topic /clock; ros: the clock of ROS [default: ros with --robots in real time, else run]")
    args = arguments.parse_args(argv)
    with Session("rangehound", ros_args) as session:
        run = _native.Observer(args.name, args.from_start, False, args.wait_s)
        facts = run.describe()
        robots = robot_ids(args.robots, len(facts["max_speeds_mps"]))
        stamps = args.stamps or ("ros" if robots and not facts["is_lockstep"] else "run")
        node = Node(session, args.name, facts, robots, stamps == "run")
        team = Team(args.name, robots, ros_args)
        with session.calling(end=team.end):
            team.start()
            # Only this thread: those of the middleware find who subscribes, and robots' processes are in the control loop.
            os.nice(_NICE)
            if args.from_start:
                node.wait_for_subscribers()
            for count, arrays in enumerate(run, 1):
                node.publish(Tick(arrays))
                if args.from_start and count % _AT_ONCE == 0:
                    session.wait_until_taken(_TAKEN_S)
                team.check()
                node.rest()
            team.wait()
        team.check()


def robot_ids(text: str | None, count: int) -> list[int]:
    """The robots that a list such as `0,2-5` or `all` names, of so many in the run."""
    if text is None:
        return []
    if text == "all":
        return list(range(count))
    robots: set[int] = set()
    for part in text.split(","):
        first, _, last = part.partition("-")
        if not (first.isascii() and first.isdigit()) or (last and not (last.isascii() and last.isdigit())) or part.endswith("-"):
            raise InputError(f"--robots is {text}: expected all, or robots such as 0,2-5")
        bounds = int(first), int(last or first)
        if bounds[0] > bounds[1] or bounds[1] >= count:
            raise InputError(f"--robots is {text}: expected all, or robots from 0 to {count - 1}, such as 0,2-5")
        robots.update(range(bounds[0], bounds[1] + 1))
    return sorted(robots)


def controller_limits(session: Session, defaults: unicycle.Limits) -> unicycle.Limits:
    """The limits of a robot's controller, from the parameters of its node."""
    return unicycle.Limits(
        session.number("max_speed_mps", defaults.max_speed_mps, "greatest forward speed, m/s"),
        session.number("max_turn_rate_radps", defaults.max_turn_rate_radps, "greatest turn rate, rad/s"),
        session.number("heading_gain_per_s", defaults.heading_gain_per_s, "turn rate for each rad of heading error, 1/s"),
    )


class Topic:
    """A publisher, and the message that is filled in at each tick."""

    def __init__(self, publisher: Any, message: Any) -> None:
        self.publisher, self.message = publisher, message
        #: Whether anybody subscribes to it: otherwise the message need not be made.
        self.is_heard = False

    def look(self) -> bool:
        """Looks for subscribers."""
        self.is_heard = self.publisher.get_subscription_count() > 0
        return self.is_heard

    def publish(self, stamp: Any) -> None:
        """Publishes the message with a stamp."""
        self.message.header.stamp = stamp
        self.publisher.publish(self.message)


class Node:
    """The publishers of a run. Its messages are made once, and filled in at each tick."""

    def __init__(self, session: Session, name: str, facts: dict[str, Any], robots: Sequence[int], is_simulated_time: bool) -> None:
        from builtin_interfaces.msg import Time
        from rclpy.clock import Clock, ClockType
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        self._session, self._facts, self._time = session, facts, Time
        self._status = _native.Observer(name, False, False, 0.0)
        count = len(facts["max_speeds_mps"])
        self._is_simulated_time = is_simulated_time
        map_frame = session.parameter("map_frame", "map", "frame of the run")
        target_frame = session.parameter("target_frame", "target", "frame of the target")
        base_frames = session.base_frames(range(count))
        with_tf = session.parameter("publish_tf", True, "publish the frames of the target and of robots that are not real")
        rate_hz = session.number("markers_rate_hz", 10.0, "greatest rate of the markers, 1/s")
        self._limits = controller_limits(session, unicycle.Limits(*facts["controller"]))
        self._simulated = [robot for robot in range(count) if robot not in robots]

        # Every subscription matches a reliable publisher: those that want the newest value are best effort themselves.
        reliable = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT, durability=DurabilityPolicy.VOLATILE)
        pose = message_type("geometry_msgs", "PoseWithCovarianceStamped", "target/pose", needed=True)
        twist = message_type("geometry_msgs", "TwistStamped", "robot_N/cmd_vel", needed=True)
        odometry = message_type("nav_msgs", "Odometry", "target/odom")

        def topic(kind: Any, name: str, frame: str) -> Topic:
            return Topic(session.publisher(kind, name, reliable), _framed(kind, frame))

        self._target = topic(pose, "target/pose", map_frame)
        self._odometry = topic(odometry, "target/odom", map_frame) if odometry is not None else None
        if self._odometry is not None:
            self._odometry.message.child_frame_id = target_frame
        self._poses = [topic(pose, f"robot_{robot}/pose", map_frame) for robot in range(count)]
        self._twists = {robot: topic(twist, f"robot_{robot}/cmd_vel", base_frames[robot]) for robot in self._simulated if not facts["is_recording"]}
        self._led_by_others: set[int] = set()
        self._frames = self._made_frames(map_frame, target_frame, base_frames) if with_tf else None
        self._markers, self._marked_s, self._marker_interval_s = self._made_markers(map_frame), -math.inf, 1.0 / rate_hz if rate_hz > 0.0 else math.inf
        self._clock: Topic | None = None
        if is_simulated_time:
            clock = message_type("rosgraph_msgs", "Clock", "/clock", needed=True)
            self._clock = Topic(session.publisher(clock, "/clock", newest), clock())
        self._diagnostics = self._made_diagnostics(reliable)
        optional = [self._odometry, self._clock, self._frames and self._frames[0], self._markers and self._markers[0]]
        self._topics = [self._target, *self._poses, *self._twists.values(), *(topic for topic in optional if topic is not None)]
        self._is_heard, self._looked_s = False, -math.inf
        self._newest: Tick | None = None
        #: Of all ticks, and those of them that a status has named: each thread writes one of them.
        self._rejected, self._rejected_named = 0, 0
        # By the steady clock: ticks may cease.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        session.node.create_timer(DIAGNOSTICS_S, self._look, clock=steady)

    def _made_frames(self, map_frame: str, target_frame: str, base_frames: Sequence[str]) -> Any:
        message = message_type("tf2_msgs", "TFMessage", "/tf")
        if message is None:
            return None
        from geometry_msgs.msg import TransformStamped
        from rclpy.qos import QoSProfile

        # Real robots publish their own frames.
        named = [target_frame, *(base_frames[robot] for robot in self._simulated)]
        transforms = [_framed(TransformStamped, map_frame) for _ in named]
        for transform, frame in zip(transforms, named):
            transform.child_frame_id = frame
        return Topic(self._session.publisher(message, "/tf", QoSProfile(depth=100)), message()), transforms

    def _made_markers(self, map_frame: str) -> Any:
        array = message_type("visualization_msgs", "MarkerArray", "rangehound/markers")
        if array is None:
            return None
        from geometry_msgs.msg import Point
        from rclpy.qos import QoSProfile
        from visualization_msgs.msg import Marker

        markers = Markers((array, Marker, Point), map_frame)
        return Topic(self._session.publisher(array, "rangehound/markers", QoSProfile(depth=1)), markers.message), markers

    def _made_diagnostics(self, qos: Any) -> Any:
        array = message_type("diagnostic_msgs", "DiagnosticArray", "/diagnostics")
        if array is None:
            return None
        from diagnostic_msgs.msg import DiagnosticStatus, KeyValue

        return self._session.publisher(array, "/diagnostics", qos), array, (DiagnosticStatus, KeyValue)

    def publish(self, tick: Tick) -> None:
        """Publishes a tick on all topics that anybody subscribes to."""
        self._rejected += int(tick.rejected)
        self._newest = tick
        now_s = time.monotonic()
        if now_s - self._looked_s >= _LOOK_S:
            self._looked_s = now_s
            self._is_heard = any([topic.look() for topic in self._topics])
        if not self._is_heard:
            return
        stamp = self._stamp(tick)
        if self._clock is not None and self._clock.is_heard:
            self._clock.message.clock = stamp
            self._clock.publisher.publish(self._clock.message)
        self._publish_target(tick, stamp)
        # A robot that has not reported is nowhere.
        for robot in np.flatnonzero(np.isfinite(tick.believed_m).all(axis=1)).tolist():
            self._publish_robot(tick, robot, stamp)
        self._publish_frames(tick, stamp)
        if self._markers is not None and self._markers[0].is_heard and now_s - self._marked_s >= self._marker_interval_s:
            topic, markers = self._markers
            topic.publisher.publish(markers.fill(tick, stamp))
            self._marked_s = now_s

    def rest(self) -> None:
        """Sleeps until the next look for subscribers, if there is none: waking at each tick would cost the run's processes their caches."""
        tick = self._newest
        # After the sleep its ticks come at once, and the first of them are old.
        if not self._is_heard and tick is not None and now_ns() - int(tick.sent_ns) < 0.5e9 * _LOOK_S:
            time.sleep(_LOOK_S)

    def _stamp(self, tick: Tick) -> Any:
        if self._is_simulated_time:
            stamp = messages.stamp_of(float(tick.time_s), self._facts["stamp_offset_ns"])
        else:
            age_s = (now_ns() - int(tick.sent_ns)) * 1e-9 if tick.sent_ns else 0.0
            stamp = messages.stamp_of(self._session.now_s() - age_s)
        return self._time(sec=stamp[0], nanosec=stamp[1])

    def wait_for_subscribers(self) -> None:
        """Waits, for a while, until subscribers have been found and no more come: what nobody hears yet is not published."""
        began_s = since_s = time.monotonic()
        count = 0
        while (now_s := time.monotonic()) < began_s + _DISCOVERY_S:
            found = sum(publisher.get_subscription_count() for publisher in self._session.publishers)
            if found != count:
                count, since_s = found, now_s
            if count > 0 and now_s - since_s >= _SETTLED_S:
                return
            time.sleep(0.05)

    def _target_of(self, tick: Tick) -> messages.Target:
        return messages.target_of(tick.state, tick.covariance, self._facts["has_velocity"])

    def _publish_target(self, tick: Tick, stamp: Any) -> None:
        topics = [topic for topic in (self._target, self._odometry) if topic is not None and topic.is_heard]
        if not topics:
            return
        target = self._target_of(tick)
        for topic in topics:
            _fill_pose(topic.message.pose, target.pose)
            if topic is self._odometry:
                topic.message.twist.twist.linear.x = target.speed_mps
                topic.message.twist.covariance = target.velocity_covariance
            topic.publish(stamp)

    def _publish_robot(self, tick: Tick, robot: int, stamp: Any) -> None:
        """Pose and twist of a robot that has reported where it is."""
        topic = self._poses[robot]
        if topic.is_heard:
            about = tick.believed_height_m[robot], tick.believed_covariance_m2[robot], tick.believed_heading_rad[robot], tick.believed_heading_std_rad[robot]
            _fill_pose(topic.message.pose, messages.robot_pose(tick.believed_m[robot], *about))
            topic.publish(stamp)
        twist = self._twists.get(robot)
        if twist is not None and robot not in self._led_by_others and twist.is_heard:
            command = float(tick.heading_rad[robot]), float(tick.speed_mps[robot])
            linear_mps, angular_radps = unicycle.twist(*command, float(tick.believed_heading_rad[robot]), self._limits)
            twist.message.twist.linear.x, twist.message.twist.angular.z = linear_mps, angular_radps
            twist.publish(stamp)

    def _publish_frames(self, tick: Tick, stamp: Any) -> None:
        if self._frames is None or not self._frames[0].is_heard:
            return
        topic, transforms = self._frames
        target = self._target_of(tick).pose
        robots = np.column_stack([tick.believed_m, tick.believed_height_m, tick.believed_heading_rad])[self._simulated].tolist()
        topic.message.transforms = []
        for transform, (x_m, y_m, z_m, yaw_rad) in zip(transforms, [target[:4], *robots]):
            if not math.isfinite(x_m):
                continue
            moved = transform.transform
            moved.translation.x, moved.translation.y, moved.translation.z = x_m, y_m, z_m
            moved.rotation.z, moved.rotation.w = messages.quaternion_of(yaw_rad)
            transform.header.stamp = stamp
            topic.message.transforms.append(transform)
        topic.publisher.publish(topic.message)

    def _look(self) -> None:
        """Once a second: who else leads robots, and the diagnostics."""
        node = self._session.node
        others = {robot for robot in self._twists if node.count_publishers(f"robot_{robot}/cmd_vel") > 1}
        for robot in others - self._led_by_others:
            complain(f"another node publishes robot_{robot}/cmd_vel: this one no longer does")
        self._led_by_others = others
        if self._diagnostics is None:
            return
        publisher, array, types = self._diagnostics
        message = array()
        message.header.stamp = node.get_clock().now().to_msg()
        message.status = list(self._statuses(types))
        publisher.publish(message)

    def _statuses(self, types: Any) -> Iterator[Any]:
        status = json.loads(self._status.status())
        for one in status["nodes"]:
            is_well = one["state"] == "running"
            level = 0 if is_well else 2
            values = {key: one[key] for key in ("pid", "starts", "silent_s") if one[key] is not None}
            yield diagnostic(types, f"rangehound: {one['name']}", level, one["state"], values)
        tick = self._newest
        if tick is None:
            yield diagnostic(types, "rangehound: estimate", 1, "no estimate yet", {})
            return
        rejected = self._rejected - self._rejected_named
        self._rejected_named += rejected
        level, name, message, pairs = _native.ros_status(
            tick=int(tick.tick), ticks=status["ticks"], fused=int(tick.fused), missing=int(tick.missing), rejected=rejected,
            silent=np.flatnonzero(np.isnan(tick.believed_m).any(axis=1)).tolist(),
            distrusted=np.flatnonzero((tick.range_used == _DISTRUSTED) | (tick.bearing_used == _DISTRUSTED)).tolist(),
            sent_ns=[int(tick.last_range_ns), int(tick.sent_ns)], trace_m2=float(np.trace(tick.covariance[:2, :2])),
        )
        yield diagnostic(types, name, level, message, dict(pairs))


class Team:
    """A process for each real robot. One that is killed or fails is started again."""

    def __init__(self, name: str, robots: Sequence[int], ros_args: Sequence[str]) -> None:
        self._name, self._ros_args = name, ros_args
        self._processes: dict[int, subprocess.Popen[bytes]] = {}
        self._threads = [threading.Thread(target=self._keep, args=(robot,), daemon=True) for robot in robots]
        self._is_ending = threading.Event()
        self._lock = threading.Lock()
        self._refused: int | None = None

    def start(self) -> None:
        """Starts the processes."""
        for thread in self._threads:
            thread.start()

    def check(self) -> None:
        """Raises an error if a robot cannot take part."""
        if self._refused is not None:
            raise InputError(f"robot {self._refused} cannot take part: its line above says why")

    def wait(self) -> None:
        """Waits until the processes have ended with the run."""
        until_s = time.monotonic() + _END_WAIT_S
        for thread in self._threads:
            thread.join(timeout=max(0.0, until_s - time.monotonic()))

    def end(self) -> None:
        """Asks the processes to end, so that their robots stop, and kills those that do not."""
        self._is_ending.set()
        for number in (signal.SIGTERM, signal.SIGKILL):
            with self._lock:
                for process in self._processes.values():
                    if process.poll() is None:
                        process.send_signal(number)
            self.wait()

    def _keep(self, robot: int) -> None:
        args = [sys.executable, "-m", "rangehound.ros2.robot", "--name", self._name, "--id", str(robot), "--end-with", str(os.getpid())]
        while True:
            with self._lock:
                if self._is_ending.is_set():
                    return
                # Ctrl-C reaches this process, which ends the others in order.
                process = subprocess.Popen([*args, *self._ros_args], stdin=subprocess.DEVNULL, start_new_session=True)
                self._processes[robot] = process
            code = process.wait()
            if code == 0 or self._is_ending.is_set():
                return
            if code == 2:
                self._refused = robot
                os.kill(os.getpid(), signal.SIGTERM)
                return
            complain(f"the process of robot {robot} ended with code {code}; it is started again")
            self._is_ending.wait(_RESTART_S)


def _framed(kind: Any, frame: str) -> Any:
    message = kind()
    message.header.frame_id = frame
    return message


def _fill_pose(message: Any, pose: messages.Planar) -> None:
    message.pose.position.x, message.pose.position.y, message.pose.position.z = pose.x, pose.y, pose.z
    message.pose.orientation.z, message.pose.orientation.w = messages.quaternion_of(pose.yaw)
    message.covariance = pose.covariance
