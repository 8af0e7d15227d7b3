"""The common parts of the nodes: rclpy, the message types that are installed, the command line, and an end in order."""

from __future__ import annotations

import argparse
import contextlib
import copy
import importlib
import math
import os
import signal
import sys
import threading
import time
from typing import Any, Callable, Iterable, Iterator, Mapping, NoReturn, Sequence

from .. import _command
from .._native import InputError, RunError

#: Topics that every node publishes, and how long it is between two of their messages, s.
DIAGNOSTICS_S = 1.0

#: How long a node that ends waits for subscribers that have not acknowledged its last messages, s.
_END_WAIT_S = 2.0


def complain(problem: object) -> None:
    """Prints one line for the user."""
    # A full disk or a closed pipe must not end the node.
    with contextlib.suppress(OSError, ValueError):
        print(f"rangehound.ros2: {' '.join(str(problem).split())}", file=sys.stderr, flush=True)


def split_ros_args(argv: Sequence[str]) -> tuple[list[str], list[str]]:
    """Arguments of the command line: those of this program, and those from `--ros-args` up to a `--`, which are for rclpy."""
    if "--ros-args" not in argv:
        return list(argv), []
    start = list(argv).index("--ros-args")
    end = list(argv).index("--", start) if "--" in argv[start:] else len(argv)
    return [*argv[:start], *argv[end + 1 :]], list(argv[start:end])


class Parser(_command.Parser):
    """The flags of a node, with those that all nodes have. An error in them is one line."""

    def __init__(self, name: str, description: str, epilog: str) -> None:
        super().__init__(name, description, epilog)
        self.add_argument("--wait-s", type=seconds, default=10.0, metavar="S", help="how long to wait for the run, s; inf for ever [default: 10]")

    def error(self, message: str) -> NoReturn:
        raise InputError(f"{message}: see {self.prog} --help")


def seconds(text: str) -> float:
    """A number of seconds that is not negative."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not value >= 0.0:
        raise argparse.ArgumentTypeError(f"{text} is no time: expected a number of seconds from 0")
    return value


def message_type(package: str, name: str, topics: str, needed: bool = False) -> Any:
    """A type of messages, or `None` with one line if its package is not installed."""
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        install = f"ros-DISTRO-{package.replace('_', '-')}"
        if needed:
            raise InputError(f"{package} is not installed, and {topics} needs it: expected the package {install}") from None
        complain(f"{package} is not installed: {topics} is not published; the package {install} has it")
        return None


class Session:
    """A node of ROS in this process, whose callbacks run in a thread of their own. It leaves ROS at the end of a `with`."""

    def __init__(self, node_name: str, ros_args: Sequence[str]) -> None:
        try:
            import rclpy
            import rclpy.executors
            import rclpy.node
            from rclpy.signals import SignalHandlerOptions
        except ImportError as error:
            raise InputError(
                f"rclpy cannot be imported ({error}): expected a sourced ROS 2 environment, such as /opt/ros/DISTRO/setup.bash"
            ) from None
        self.rclpy = rclpy
        try:
            # Python's own handlers end the node, so that a robot stops first.
            rclpy.init(args=["rangehound", *ros_args], signal_handler_options=SignalHandlerOptions.NO)
            self.node = rclpy.node.Node(node_name)
        except Exception as error:  # rclpy has a class for each fault of its arguments.
            raise InputError(f"--ros-args: {error}") from None
        self.publishers: list[Any] = []
        self._failure: BaseException | None = None
        self._executor = rclpy.executors.SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin, name="rclpy", daemon=True)

    def parameter(self, name: str, default: Any, description: str) -> Any:
        """Declares a parameter of the node and returns its value."""
        from rcl_interfaces.msg import ParameterDescriptor

        described = ParameterDescriptor(description=description, read_only=True)
        try:
            return self.node.declare_parameter(name, default, described).value
        except Exception as error:
            raise InputError(f"parameter {name}: {error}") from None

    def number(self, name: str, default: float, description: str) -> float:
        """As `parameter`: a finite number that is not negative."""
        value = float(self.parameter(name, default, description))
        if not 0.0 <= value < math.inf:
            raise InputError(f"{name} is {value}: expected a finite number that is not negative")
        return value

    def base_frames(self, robots: Iterable[int]) -> list[str]:
        """The frames of these robots, by the parameter `base_frame`."""
        pattern = self.parameter("base_frame", "robot_{}/base_link", "frame of a robot; {} is its number")
        if "{}" not in pattern:
            raise InputError(f"base_frame is {pattern!r}: expected a name with {{}} for the number of the robot")
        return [pattern.replace("{}", str(robot)) for robot in robots]

    def publisher(self, kind: Any, topic: str, qos: Any) -> Any:
        """A publisher whose quality of service may be overridden by parameters `qos_overrides`; `None` without a type."""
        from rclpy.qos_overriding_options import QoSOverridingOptions

        if kind is None:
            return None
        # The overriding changes the profile that it gets.
        overriding = QoSOverridingOptions.with_default_policies()
        self.publishers.append(self.node.create_publisher(kind, topic, copy.copy(qos), qos_overriding_options=overriding))
        return self.publishers[-1]

    def subscribe(self, kind: Any, topic: str, qos: Any, callback: Callable[[Any], None]) -> None:
        """A subscription whose quality of service may be overridden by parameters `qos_overrides`."""
        from rclpy.qos_overriding_options import QoSOverridingOptions

        overriding = QoSOverridingOptions.with_default_policies()
        self.node.create_subscription(kind, topic, callback, copy.copy(qos), qos_overriding_options=overriding)

    def wait_until_taken(self, at_most_s: float) -> None:
        """Waits until reliable subscribers have what was published."""
        from rclpy.duration import Duration

        until_s = time.monotonic() + at_most_s
        for publisher in self.node.publishers:
            publisher.wait_for_all_acked(Duration(seconds=max(until_s - time.monotonic(), 0.001)))

    def now_s(self) -> float:
        """The time of the node's clock, s: the wall clock, or the topic /clock with the parameter use_sim_time."""
        return float(self.node.get_clock().now().nanoseconds) * 1e-9

    @contextlib.contextmanager
    def calling(self, end: Callable[[], None]) -> Iterator[None]:
        """Calls callbacks from now on. Ends its body when this process is asked to end, and always calls `end` after it."""
        self._thread.start()
        try:
            yield
        except Ended:
            pass
        finally:
            ignore_signals()
            end()

    def _spin(self) -> None:
        try:
            self._executor.spin()
        except BaseException as error:
            if self.rclpy.ok():
                self._failure = error
                os.kill(os.getpid(), signal.SIGTERM)

    def __enter__(self) -> Session:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        ignore_signals()
        self._close()
        if self._failure is not None and kind is None:
            raise RunError(str(self._failure)) from self._failure

    def _close(self) -> None:
        """Waits for a moment until subscribers have what was published, ends the callbacks, and leaves ROS."""
        self.wait_until_taken(_END_WAIT_S)
        self._executor.shutdown(timeout_sec=2.0)
        if self._thread.is_alive():
            self._thread.join(timeout=2.0)
        self.node.destroy_node()
        self.rclpy.try_shutdown()


class Ended(BaseException):
    """SIGINT or SIGTERM: the node ends in order."""


def _end(*_: object) -> None:
    raise Ended


def ignore_signals() -> None:
    """From here on the node ends anyway."""
    _command.on_signals(signal.SIG_IGN)


def run_node(main: Callable[[Sequence[str]], None]) -> int:
    """Runs a node, and returns its exit code: 0 at the end of the run or when asked to end, 2 for invalid input, 1 otherwise."""
    _command.on_signals(_end)
    try:
        main(sys.argv[1:])
        return 0
    except Ended:
        return 0
    except InputError as error:
        complain(error)
        return 2
    except (RunError, OSError) as error:
        complain(error)
        return 1


def diagnostic(types: Any, name: str, level: int, message: str, values: Mapping[str, object]) -> Any:
    """A status of diagnostics. `types` are DiagnosticStatus and KeyValue."""
    status_type, pair_type = types
    pairs = [pair_type(key=key, value=str(value)) for key, value in values.items()]
    return status_type(level=bytes([level]), name=name, message=message, hardware_id="rangehound", values=pairs)


def end_with(pid: int) -> None:
    """Sends this process SIGTERM when another process ends."""
    import select

    try:
        ended = os.pidfd_open(pid)
    except OSError:
        os.kill(os.getpid(), signal.SIGTERM)
        return

    def wait() -> None:
        select.select([ended], [], [])
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=wait, name="parent", daemon=True).start()
