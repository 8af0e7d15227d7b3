"""The connection to a vehicle: one thread reads its messages, and sends setpoints and heartbeats."""

from __future__ import annotations

import contextlib
import math
import sys
import threading
import time
from typing import Any, Callable

from .._clock import now_s as clock_s
from .vehicle import STOP, Setpoint, Vehicle

#: Interval of our heartbeats, s.
HEARTBEAT_S = 1.0

#: Messages that the vehicle is asked for, and how often, Hz.
WANTED = {
    "LOCAL_POSITION_NED": 20, "GLOBAL_POSITION_INT": 20, "ATTITUDE": 10, "ODOMETRY": 2, "ESTIMATOR_STATUS": 2, "DISTANCE_SENSOR": 20,
}

#: Fields of a setpoint that do not count: position, acceleration and yaw rate, and the yaw where there is none (POSITION_TARGET_TYPEMASK).
IGNORED, IGNORED_YAW = 0b1001_1100_0111, 0b0100_0000_0000

#: Setpoints to stop at the end, because one may be lost, and the interval between them, s.
STOPS, STOP_S = 5, 0.02

#: Time between two attempts to open a connection again that was lost, s.
REOPEN_S = 1.0

#: With `--arm`: it asks after setpoints have streamed for a while, as PX4 demands, then at this interval, s, and so often at most.
STREAM_S, ASK_S, ASKS = 1.5, 1.0, 20


class Link(threading.Thread):
    """Reads and writes the connection, which `connect` opens, until it is closed. Other threads use the vehicle under `lock`."""

    def __init__(self, mavutil: Any, connect: Callable[[], Any], vehicle: Vehicle, rate_hz: float, arms: bool) -> None:
        super().__init__(name="mavlink", daemon=True)
        self.mavutil, self.connect, self.vehicle = mavutil, connect, vehicle
        #: `None` while it is lost.
        self.connection: Any = ending(connect())
        self._reopen_s = -math.inf
        self.period_s = 1 / rate_hz
        self.lock = threading.Lock()
        self.error: BaseException | None = None
        self._closing = threading.Event()
        self._reported = ""
        self._was_linked = False
        began_s = clock_s()
        self._setpoint_s = self._heartbeat_s = began_s
        self._ask_s, self._asks_left = began_s + STREAM_S, ASKS if arms else 0

    def run(self) -> None:
        try:
            self._exchange()
        except Exception as error:  # The robot's thread raises it.
            self.error = error

    def close(self) -> None:
        """Stops the vehicle and ends the thread."""
        self._closing.set()
        self.join(timeout=10.0)

    def _exchange(self) -> None:
        while not self._closing.is_set():
            message = self._receive(self._setpoint_s - clock_s())
            now_s = clock_s()
            with self.lock:
                if message is not None:
                    self.vehicle.take(message, now_s)
                setpoint, condition = self.vehicle.setpoint(now_s), self.vehicle.condition(now_s)
                is_linked, follows = self.vehicle.is_linked(now_s), self.vehicle.follows()
            self._say(condition)
            if now_s >= self._heartbeat_s:
                self._heartbeat_s = now_s + HEARTBEAT_S
                self._beat(is_linked)
            if now_s >= self._setpoint_s:
                # A thread that was late does not catch up.
                self._setpoint_s = max(self._setpoint_s + self.period_s, now_s)
                self._send_setpoint(setpoint)
            if follows:
                # It never arms again: the pilot may have taken over.
                self._asks_left = 0
            if is_linked and self._asks_left > 0 and now_s >= self._ask_s:
                self._ask_s, self._asks_left = now_s + ASK_S, self._asks_left - 1
                self._ask_to_arm()
        for _ in range(STOPS):
            self._send_setpoint(STOP)
            time.sleep(STOP_S)
        self._disconnect()

    def _receive(self, wait_s: float) -> Any:
        wait_s = min(max(wait_s, 0.001), 0.1)
        try:
            if self.connection is None:
                self._open_again()
            return self.connection.recv_match(blocking=True, timeout=wait_s)
        except OSError:
            # As long as the vehicle is away, nothing is heard.
            self._disconnect()
            self._closing.wait(wait_s)
            return None

    def _open_again(self) -> None:
        """Opens a lost connection, unless it has just tried."""
        if time.monotonic() < self._reopen_s:
            raise ConnectionError
        self._reopen_s = time.monotonic() + REOPEN_S
        self.connection = ending(self.connect())

    def _disconnect(self) -> None:
        if self.connection is not None:
            self.connection.close()
        self.connection = None

    def _say(self, condition: str) -> None:
        if condition != self._reported:
            self._reported = condition
            # A full disk or a closed pipe must not end the control of the vehicle.
            with contextlib.suppress(OSError, ValueError):
                print(f"mavlink: {condition}", file=sys.stderr, flush=True)

    def _beat(self, is_linked: bool) -> None:
        """Sends our heartbeat. A vehicle that has just been heard, or is not heard well, is asked for its messages."""
        if self.vehicle.system is not None and not (is_linked and self._was_linked):
            self._ask_for_messages()
        self._was_linked = is_linked
        mavlink = self.mavutil.mavlink
        self._send(mavlink.MAVLink_heartbeat_message(
            mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
        ))

    def _send_setpoint(self, setpoint: Setpoint) -> None:
        if self.vehicle.system is None:
            return
        ignored = IGNORED if setpoint.yaw_rad is not None else IGNORED | IGNORED_YAW
        self._send(self.mavutil.mavlink.MAVLink_set_position_target_local_ned_message(
            int(clock_s() * 1e3) & 0xFFFFFFFF, self.vehicle.system, self.vehicle.component, self.mavutil.mavlink.MAV_FRAME_LOCAL_NED,
            ignored, 0.0, 0.0, 0.0, setpoint.north_mps, setpoint.east_mps, 0.0, 0.0, 0.0, 0.0, setpoint.yaw_rad or 0.0, 0.0,
        ))

    def _ask_for_messages(self) -> None:
        for name, rate_hz in WANTED.items():
            id = getattr(self.mavutil.mavlink, f"MAVLINK_MSG_ID_{name}")
            self._command(self.mavutil.mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, id, 1e6 / rate_hz)

    def _ask_to_arm(self) -> None:
        mavlink, vehicle = self.mavutil.mavlink, self.vehicle
        if vehicle.autopilot == mavlink.MAV_AUTOPILOT_PX4:
            _, main, sub = self.mavutil.px4_map["OFFBOARD"]
        else:
            main, sub = (self.mavutil.mode_mapping_byname(vehicle.kind) or {}).get("GUIDED"), 0
        if main is None:
            # A kind of vehicle without this mode: the line about its condition stays.
            return
        self._command(mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, main, sub)
        self._command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)

    def _command(self, command: int, *parameters: float) -> None:
        filled = [*parameters, *[0.0] * (7 - len(parameters))]
        self._send(self.mavutil.mavlink.MAVLink_command_long_message(self.vehicle.system, self.vehicle.component, command, 0, *filled))

    def _send(self, message: Any) -> None:
        if self.connection is None:
            return
        try:
            self.connection.mav.send(message)
        except OSError:
            # The vehicle stops by its own time-out.
            pass


def ending(connection: Any) -> Any:
    """The same connection of pymavlink, which raises `OSError` once the other end has closed it: otherwise it would read nothing
    for ever, without a pause."""

    def closed() -> None:
        raise ConnectionResetError("closed by the other end")

    connection.handle_eof = connection.handle_disconnect = closed
    if hasattr(connection, "listen"):
        receive = connection.recv

        def received(length: int | None = None) -> Any:
            # Without a client there is an empty text.
            data = receive(length)
            return closed() if data == b"" else data

        connection.recv = received
    return connection
