"""The command: joins a run as a robot once the vehicle has a position."""

from __future__ import annotations

import argparse
import os
import sys
import time
from typing import Any

from .. import _command, _native
from .._clock import now_s as clock_s
from ..live import Radio, Robot
from .link import Link
from .vehicle import Settings, Vehicle

#: Slowest setpoints that the autopilots accept, and the fastest that make sense, Hz.
RATES_HZ = (2.0, 50.0)

#: Shortest time for which a command is carried out, s, and the same as a number of time steps.
HOLD_S, HOLD_TICKS = 1.0, 4

#: How often it looks whether the vehicle is there, s.
LOOK_S = 0.05


def numbers(count: int) -> Any:
    """A type of flag: so many numbers, with commas between."""

    def parse(text: str) -> tuple[float, ...]:
        values = tuple(float(part) for part in text.split(","))
        if len(values) != count or not all(abs(value) < 1e9 for value in values):
            raise ValueError
        return values

    parse.__name__ = f"{count} numbers with a comma between"
    return parse


def parser() -> _command.Parser:
    flags = _command.Parser(
        "mavlink",
        "Joins a run as a robot that is an ArduPilot or PX4 vehicle. Never flown: try it in a simulator first.\n"
        "The vehicle drives only while it is armed and in GUIDED or OFFBOARD, and the run commands it.",
        "examples:\n  python -m rangehound.mavlink --name demo --id 2 --connect udpin:0.0.0.0:14550\n"
        "  python -m rangehound.mavlink --name demo --id 2 --connect /dev/ttyACM0 --radio /dev/ttyUSB0 --format dwm1001 --anchor 022E",
    )
    flags.add_argument("--id", type=int, required=True, metavar="N", help="number of the robot in the team, from 0")
    flags.add_argument("--connect", required=True, metavar="URL", help="connection to the vehicle, as pymavlink names it: udpin:0.0.0.0:14550, tcp:127.0.0.1:5760, /dev/ttyACM0")
    flags.add_argument("--baud", type=int, default=57600, metavar="B", help="baud rate of a serial connection (default: 57600)")
    flags.add_argument("--arm", action="store_true", help="arm the vehicle and set GUIDED or OFFBOARD once at the start; without it the pilot does that")
    flags.add_argument("--rate", type=float, default=10.0, metavar="HZ", help="setpoints in a second, 2 to 50 (default: 10)")
    pose = flags.add_argument_group("where the vehicle is (only with a real target)")
    pose.add_argument("--origin", type=numbers(2), metavar="LAT,LON", help="the run's origin, degrees: positions are GLOBAL_POSITION_INT instead of LOCAL_POSITION_NED")
    pose.add_argument("--offset", type=numbers(2), metavar="EAST,NORTH", help="where the origin of the vehicle's local positions lies in the run's frame, m (default: 0,0)")
    pose.add_argument("--pose-std", type=float, default=1.0, metavar="M", help="standard deviation of its position, m, where the vehicle names none (default: 1)")
    ranges = flags.add_argument_group("what measures the target (without one: the scenario's simulated sensor)")
    which = ranges.add_mutually_exclusive_group()
    which.add_argument("--range-id", type=int, metavar="ID", help="the vehicle's DISTANCE_SENSOR with this id")
    which.add_argument("--radio", metavar="PATH", help="a UWB radio on a serial port of this machine")
    ranges.add_argument("--format", default="plain", help="what the radio prints: plain, dwm1001, linktrack or mauwb (default: plain)")
    ranges.add_argument("--anchor", metavar="ID", help="the anchor whose range is this robot's; all formats but plain need it")
    ranges.add_argument("--tag", metavar="ID", help="the tag, where the radio names several (default: the first one seen)")
    return flags


def drive(flags: argparse.Namespace) -> None:
    """Runs the robot until the run ends."""
    # The messages with covariances are of MAVLink 2.
    os.environ["MAVLINK20"] = "1"
    mavutil = _command.needed("pymavlink.mavutil", "mavlink")
    if not RATES_HZ[0] <= flags.rate <= RATES_HZ[1]:
        raise _native.InputError(f"--rate is {flags.rate}: expected {RATES_HZ[0]:g} to {RATES_HZ[1]:g} Hz")
    if not 0 < flags.pose_std < 1e4:
        raise _native.InputError(f"--pose-std is {flags.pose_std}: expected a positive number of metres")
    if flags.origin and not (abs(flags.origin[0]) < 90 and abs(flags.origin[1]) <= 180):
        raise _native.InputError(f"--origin is {flags.origin}: expected a latitude within 90 degrees and a longitude within 180")
    observer = _native.Observer(flags.name, False, False, _command.WAIT_S)
    facts = observer.describe()
    robots = len(facts["max_speeds_mps"])
    if not 0 <= flags.id < robots:
        raise _native.InputError(f"--id is {flags.id}: expected 0 to {robots - 1}")
    if facts["is_lockstep"]:
        raise _native.InputError(f"the run {flags.name} is in lock step: expected one in real time, because vehicles do not wait")
    settings = Settings(
        origin_deg=flags.origin,
        offset_m=flags.offset or (0.0, 0.0),
        pose_std_m=flags.pose_std,
        range_id=flags.range_id,
        hold_s=max(HOLD_S, HOLD_TICKS * facts["dt_s"]),
        range_age_s=facts["dt_s"],
    )
    # pymavlink prints what happens to a connection.
    sys.stdout = sys.stderr

    def connect() -> Any:
        component = mavutil.mavlink.MAV_COMP_ID_ONBOARD_COMPUTER
        return mavutil.mavlink_connection(flags.connect, baud=flags.baud, source_system=255, source_component=component, retries=1)

    vehicle = Vehicle(settings, mavutil.mode_string_v10)
    try:
        link = Link(mavutil, connect, vehicle, flags.rate, flags.arm)
    except Exception as error:
        raise _native.InputError(f"--connect is {flags.connect}: {error}: expected a connection that can be opened") from error
    link.start()
    try:
        while not is_there(link):
            time.sleep(LOOK_S)
            if observer.is_over():
                return
        robot_of(flags, link).run()
    finally:
        link.close()


def is_there(link: Link) -> bool:
    """True if the vehicle has a position: the robot may join."""
    if link.error:
        raise link.error
    with link.lock:
        return link.vehicle.is_linked(clock_s())


def robot_of(flags: argparse.Namespace, link: Link) -> Robot:
    """The robot whose functions ask the vehicle."""
    vehicle = link.vehicle

    def measure(robot: int, tick: int, range_m: float, bearing_rad: float) -> Any:
        with link.lock:
            return vehicle.range(clock_s())

    def pose(time_s: float, x_m: float, y_m: float, heading_rad: float) -> tuple[float, ...]:
        with link.lock:
            return vehicle.pose()

    def carry_out(heading_rad: float, speed_mps: float) -> tuple[float, float]:
        if link.error:
            raise link.error
        with link.lock:
            now_s = clock_s()
            vehicle.command(heading_rad, speed_mps, now_s)
            return vehicle.motion(now_s)

    radio = Radio(flags.radio, flags.format, anchor=flags.anchor, tag=flags.tag) if flags.radio else None
    # A simulated target is measured from the simulated body, which moves as the vehicle does.
    is_real = radio is not None or flags.range_id is not None
    return Robot(
        flags.name,
        flags.id,
        radio=radio,
        measure=measure if flags.range_id is not None else None,
        pose=pose if is_real else None,
        carry_out=carry_out,
    )


if __name__ == "__main__":
    _command.run(parser(), drive)
