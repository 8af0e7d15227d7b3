"""The state that a vehicle reports, and the setpoint that it gets now. No I/O: messages and the time come as arguments."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Callable

from . import frames

#: Autopilot and type in the heartbeats of companions and ground stations, which are no vehicle (MAV_AUTOPILOT_INVALID, MAV_TYPE_GCS).
NO_AUTOPILOT, GROUND_STATION = 8, 6

#: MAV_MODE_FLAG_SAFETY_ARMED
ARMED = 128

#: The modes in which an autopilot follows setpoints: those of ArduPilot and PX4.
MODES = ("GUIDED", "OFFBOARD")

#: MAV_FRAME_LOCAL_NED
LOCAL_NED = 1

#: Values of DISTANCE_SENSOR that mean "unknown": of its variance, and of the quality of an invalid range.
UNKNOWN_VARIANCE = (0, 255)
INVALID_QUALITY = 1


@dataclass(frozen=True)
class Setpoint:
    """A velocity, m/s, and a yaw, rad; without one the vehicle keeps its own. The vertical velocity is zero."""

    north_mps: float
    east_mps: float
    yaw_rad: float | None


#: The setpoint to stand still.
STOP = Setpoint(0.0, 0.0, None)


@dataclass(frozen=True)
class Settings:
    """How a vehicle is used.

    `origin_deg`: latitude and longitude of the run's origin; without it positions are local, and the vehicle's local origin lies
    at `offset_m` (east, north). `pose_std_m` counts where the vehicle names none. `range_id` is the id of the DISTANCE_SENSOR
    that measures the target. `silence_s`: age of position and heartbeat at which the link counts as lost. `hold_s`: age at which
    a command is no longer carried out. `range_age_s`: age at which a range is no longer used.
    """

    origin_deg: tuple[float, float] | None = None
    offset_m: tuple[float, float] = (0.0, 0.0)
    pose_std_m: float = 1.0
    range_id: int | None = None
    silence_s: float = 2.0
    hold_s: float = 1.0
    range_age_s: float = 0.1


class Vehicle:
    """The state of one vehicle."""

    def __init__(self, settings: Settings, mode_of: Callable[[Any], str]) -> None:
        """`mode_of(heartbeat)` names the mode."""
        self.settings, self.mode_of = settings, mode_of
        self.system: int | None = None
        self.component = self.kind = self.autopilot = 0
        self.mode, self.is_armed = "", False
        self.std_m: float | None = None
        self._heard_s = self._placed_s = self._moved_s = -math.inf
        self._place_m = (0.0, 0.0)
        self._velocity_ned = (0.0, 0.0)
        self._yaw_rad = 0.0
        self._range: tuple[float, tuple[float, ...]] | None = None
        self._command: tuple[float, float, float] | None = None

    def take(self, message: Any, now_s: float) -> None:
        """Takes a message. Messages that are not from the vehicle, or have no finite numbers, are passed over."""
        kind, system = message.get_type(), message.get_srcSystem()
        if kind == "HEARTBEAT":
            self._take_heartbeat(message, system, now_s)
        if system != self.system or self.system is None:
            return
        if kind == "LOCAL_POSITION_NED":
            self._move(message.vx, message.vy, now_s)
            if self.settings.origin_deg is None:
                self._place(message.x, message.y, now_s)
        elif kind == "GLOBAL_POSITION_INT" and self.settings.origin_deg is not None:
            # Speeds in cm/s.
            self._move(message.vx / 100, message.vy / 100, now_s)
            east_m, north_m = frames.local_m((message.lat / 1e7, message.lon / 1e7), self.settings.origin_deg)
            self._place(north_m, east_m, now_s)
        elif kind == "ODOMETRY":
            covariance = message.pose_covariance
            self.std_m = frames.position_std_m(covariance[0], covariance[1], covariance[6]) or self.std_m
        elif kind == "ESTIMATOR_STATUS":
            accuracy_m = message.pos_horiz_accuracy
            self.std_m = accuracy_m if math.isfinite(accuracy_m) and accuracy_m > 0 else self.std_m
        elif kind == "ATTITUDE" and math.isfinite(message.yaw):
            self._yaw_rad = message.yaw
        elif kind == "DISTANCE_SENSOR" and message.id == self.settings.range_id:
            self._take_range(message, now_s)

    def _take_heartbeat(self, message: Any, system: int, now_s: float) -> None:
        if message.autopilot == NO_AUTOPILOT or message.type == GROUND_STATION:
            return
        if self.system is None:
            self.system, self.component = system, message.get_srcComponent()
        if (system, message.get_srcComponent()) == (self.system, self.component):
            self.kind, self.autopilot = message.type, message.autopilot
            self.mode, self.is_armed = self.mode_of(message), bool(message.base_mode & ARMED)
            self._heard_s = now_s

    def _take_range(self, message: Any, now_s: float) -> None:
        centimetres = message.current_distance
        is_valid = 0 < centimetres and message.min_distance <= centimetres <= message.max_distance
        if not is_valid or getattr(message, "signal_quality", 0) == INVALID_QUALITY:
            return
        variance = message.covariance
        std_m = () if variance in UNKNOWN_VARIANCE else (math.sqrt(variance) / 100,)
        self._range = (now_s, (centimetres / 100, *std_m))

    def _place(self, north_m: float, east_m: float, now_s: float) -> None:
        if math.isfinite(north_m) and math.isfinite(east_m):
            self._place_m, self._placed_s = (east_m, north_m), now_s

    def _move(self, north_mps: float, east_mps: float, now_s: float) -> None:
        if math.isfinite(north_mps) and math.isfinite(east_mps):
            self._velocity_ned, self._moved_s = (north_mps, east_mps), now_s

    def command(self, heading_rad: float, speed_mps: float, now_s: float) -> None:
        """Takes a command of the run."""
        self._command = (now_s, heading_rad, speed_mps)

    def is_linked(self, now_s: float) -> bool:
        """True if heartbeat and position are fresh."""
        return now_s - min(self._heard_s, self._placed_s) <= self.settings.silence_s

    def is_commanded(self, now_s: float) -> bool:
        """True if the newest command is fresh."""
        return self._command is not None and now_s - self._command[0] <= self.settings.hold_s

    def follows(self) -> bool:
        """True if the vehicle follows setpoints: it is armed and in such a mode."""
        return self.is_armed and self.mode in MODES

    def condition(self, now_s: float) -> str:
        """Its state as text: it drives, or the event that it waits for."""
        if self.system is None:
            return "waits for a heartbeat of the vehicle"
        if self._placed_s == -math.inf:
            return f"waits for a position of vehicle {self.system}"
        if not self.is_linked(now_s):
            return f"the link to vehicle {self.system} is lost: the robot stops"
        if not self.is_armed:
            return f"vehicle {self.system} is not armed, mode {self.mode}: nothing drives until it is armed and in GUIDED or OFFBOARD"
        if self.mode not in MODES:
            return f"vehicle {self.system} is armed, mode {self.mode}: nothing drives until it is in GUIDED or OFFBOARD"
        if not self.is_commanded(now_s):
            return f"vehicle {self.system} stands still, mode {self.mode}: no commands come from the run"
        return f"vehicle {self.system} follows the run, mode {self.mode}"

    def setpoint(self, now_s: float) -> Setpoint:
        """The setpoint for now: to stand still unless the vehicle follows, the link stands and the command is fresh."""
        if self._command is None or not self.is_commanded(now_s) or not self.follows() or not self.is_linked(now_s):
            return STOP
        _, heading_rad, speed_mps = self._command
        if speed_mps <= 0:
            return STOP
        return Setpoint(*frames.velocity_ned(heading_rad, speed_mps), frames.yaw_of_heading(heading_rad))

    def pose(self) -> tuple[float, float, float, float]:
        """Its newest position, m, heading, rad, and standard deviation of the position, m."""
        (x_m, y_m), (east_m, north_m) = self.settings.offset_m, self._place_m
        return x_m + east_m, y_m + north_m, frames.heading_of_yaw(self._yaw_rad), self.std_m or self.settings.pose_std_m

    def motion(self, now_s: float) -> tuple[float, float]:
        """Heading, rad, and speed, m/s, of its motion, as it reports; zero if it has not reported them lately."""
        is_fresh = now_s - self._moved_s <= self.settings.silence_s
        return frames.motion_of_ned(*self._velocity_ned) if is_fresh else (0.0, 0.0)

    def range(self, now_s: float) -> tuple[float, ...] | None:
        """Its newest range, m, with the standard deviation if the vehicle names one. Each range is given once."""
        taken, self._range = self._range, None
        if taken is None or now_s - taken[0] > self.settings.range_age_s or not self.is_linked(now_s):
            return None
        return taken[1]
