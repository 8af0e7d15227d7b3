"""Robots that are MAVLink vehicles, against autopilots that are played here. Nothing of this has been flown."""

import math
import os
import random
import signal
import socket
import subprocess
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
import rangehound as rh
from rangehound._clock import now_s as clock_s
from rangehound.mavlink import frames
from rangehound.mavlink.vehicle import STOP, Settings, Vehicle

os.environ["MAVLINK20"] = "1"
pytestmark = pytest.mark.usefixtures("watchdog")

#: Autopilot, its custom mode in which it follows setpoints, and one in which it does not.
ARDUPILOT, PX4 = 3, 12
GUIDED = {ARDUPILOT: 4, PX4: 6 << 16}
OTHER = {ARDUPILOT: 5, PX4: 3 << 16}

#: The id of the played sensor that measures the target.
RANGE_ID = 7


class Autopilot(threading.Thread):
    """Plays an autopilot: it integrates setpoints of velocity, and stops without fresh ones. PX4 leaves its mode then, too."""

    #: Time without a setpoint after which it stops, s.
    TIMEOUT_S = {PX4: 1.0, ARDUPILOT: 3.0}

    def __init__(self, address, system=1, kind=ARDUPILOT, place_m=(0.0, 0.0), target=None, armed=True, guided=True):
        super().__init__(daemon=True)
        mavutil = pytest.importorskip("pymavlink.mavutil", reason="pymavlink is not installed")
        self.mavlink = mavutil.mavlink
        self.connection = mavutil.mavlink_connection(address, source_system=system, source_component=1)
        self.kind, self.target, self.armed = kind, target, armed
        self.mode = (GUIDED if guided else OTHER)[kind]
        self.east_m, self.north_m, self.driven_m = 0.0, 0.0, 0.0
        self.start_m = place_m
        self.velocity, self.yaw, self.given_s = (0.0, 0.0), 0.0, -math.inf
        self.setpoints, self.timeouts, self.cut, self.asked = [], 0, False, set()
        self.noise = random.Random(system)
        self._ends = threading.Event()

    def stop(self):
        self._ends.set()
        self.join()
        self.connection.close()

    @property
    def speed_mps(self):
        """Its present speed."""
        return math.hypot(*self.velocity) if self.drives() else 0.0

    def drives(self):
        return self.armed and self.mode == GUIDED[self.kind]

    def run(self):
        last_s, heartbeat_s = clock_s(), 0.0
        while not self._ends.wait(0.02):
            now_s = clock_s()
            while message := self.connection.recv_match(blocking=False):
                if not self.cut:
                    self.take(message, now_s)
            if self.velocity != (0.0, 0.0) and now_s - self.given_s > self.TIMEOUT_S[self.kind]:
                self.velocity, self.timeouts = (0.0, 0.0), self.timeouts + 1
                if self.kind == PX4:
                    self.mode = OTHER[PX4]
            if self.drives():
                self.north_m += (now_s - last_s) * self.velocity[0]
                self.east_m += (now_s - last_s) * self.velocity[1]
                self.driven_m += (now_s - last_s) * self.speed_mps
            last_s = now_s
            if not self.cut:
                if now_s >= heartbeat_s:
                    heartbeat_s = now_s + 0.5
                    base = 1 | (128 if self.armed else 0)
                    self.send("heartbeat", self.mavlink.MAV_TYPE_QUADROTOR, self.kind, base, self.mode, 4, 3)
                self.report(int(now_s * 1e3) & 0xFFFFFFFF, now_s)

    def send(self, kind, *fields, **more):
        self.connection.mav.send(getattr(self.mavlink, f"MAVLink_{kind}_message")(*fields, **more))

    def report(self, time_ms, now_s):
        north_mps, east_mps = self.velocity if self.drives() else (0.0, 0.0)
        self.send("local_position_ned", time_ms, self.north_m, self.east_m, 0.0, north_mps, east_mps, 0.0)
        self.send("attitude", time_ms, 0.0, 0.0, self.yaw, 0.0, 0.0, 0.0)
        covariance = [math.nan] * 21
        covariance[0], covariance[1], covariance[6] = 0.04, 0.0, 0.01
        self.send("odometry", 0, 1, 8, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0, 0, 0, 0, covariance, [math.nan] * 21)
        if self.target is not None:
            x_m, y_m = self.target(now_s)
            range_m = math.hypot(x_m - self.start_m[0] - self.east_m, y_m - self.start_m[1] - self.north_m) + self.noise.gauss(0, 0.3)
            # An altimeter beside the sensor that counts.
            self.send("distance_sensor", time_ms, 10, 10_000, 333, 0, 0, 25, 9)
            self.send("distance_sensor", time_ms, 10, 60_000, max(10, round(100 * range_m)), 0, RANGE_ID, 0, 0)

    def take(self, message, now_s):
        kind = message.get_type()
        if kind == "SET_POSITION_TARGET_LOCAL_NED":
            has_yaw = message.type_mask == 0b1001_1100_0111
            assert has_yaw or message.type_mask == 0b1101_1100_0111
            assert message.coordinate_frame == 1 and message.vz == 0
            self.velocity, self.given_s = (message.vx, message.vy), now_s
            self.yaw = message.yaw if has_yaw else self.yaw
            self.setpoints.append((now_s, math.hypot(message.vx, message.vy)))
        elif kind == "COMMAND_LONG" and message.command == self.mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            self.asked.add(message.param1)
        elif kind == "COMMAND_LONG" and message.command == self.mavlink.MAV_CMD_DO_SET_MODE:
            self.mode = int(message.param2) << 16 if self.kind == PX4 else int(message.param2)
        elif kind == "COMMAND_LONG" and message.command == self.mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
            self.armed = message.param1 == 1


def until(condition):
    """Waits; the watchdog ends a test that waits in vain."""
    while not condition():
        time.sleep(0.02)


@pytest.fixture
def play():
    """Plays autopilots, each on a port of its own, until the end of the test."""
    played = []

    def start(port=None, over="udp", **what):
        kind = {"udp": socket.SOCK_DGRAM, "tcp": socket.SOCK_STREAM}[over]
        with socket.socket(socket.AF_INET, kind) as free:
            free.bind(("127.0.0.1", 0))
            port = port or free.getsockname()[1]
        # The process listens for datagrams; it connects to a stream, as to a simulator.
        its, ours = {"udp": ("udpout", "udpin"), "tcp": ("tcpin", "tcp")}[over]
        autopilot = Autopilot(f"{its}:127.0.0.1:{port}", **what)
        autopilot.port = port
        autopilot.start()
        played.append(autopilot)
        return autopilot, f"{ours}:127.0.0.1:{port}"

    yield start
    for autopilot in played:
        if autopilot.is_alive():
            autopilot.stop()


@pytest.fixture
def one_vehicle(by_hand, command, name, play):
    """A run with a vehicle as robot 2 and a simulated target: the autopilot, our process, and a way to start another."""

    def start(*args, keys=(), **what):
        keys = dict(ticks=100_000, dt_s=0.1, clock="realtime") | dict(keys)
        started = by_hand(["sim"], ["fusion"], ["robot", "--id", "0"], ["robot", "--id", "1"], **keys)
        autopilot, address = play(**what)
        again = lambda: command("mavlink", "--name", name, "--id", 2, "--connect", address, *args)  # noqa: E731
        return autopilot, again(), again, started

    return start


def test_three_vehicles_track_a_target_that_only_they_measure(by_hand, command, name, play):
    starts_m = [(-20.0, 0.0), (20.0, 5.0), (0.0, -25.0)]
    began_s = clock_s()
    target = lambda now_s: (0.5 * (now_s - began_s), 10.0 + 0.25 * (now_s - began_s))  # noqa: E731
    scenario = {
        "robot": [{"id": id, "start_m": list(start_m), "speed_mps": 5.0} for id, start_m in enumerate(starts_m)],
        "target": {"start": [0.0, 10.0, 0.5, 0.25], "noise_psd": 0.5},
        "prior": {"mean": "start", "covariance": [25.0, 25.0, 1.0, 1.0]},
    }
    by_hand(["sim"], ["fusion"], scenario=scenario, ticks=200, dt_s=0.1, clock="realtime", timeout_s=2.0)
    kinds = [(ARDUPILOT, True, ()), (PX4, False, ("--arm",)), (ARDUPILOT, True, ())]
    processes, autopilots = [], []
    for id, (start_m, (kind, ready, args)) in enumerate(zip(starts_m, kinds)):
        autopilot, address = play(system=id + 1, kind=kind, place_m=start_m, target=target, armed=ready, guided=ready)
        offset = f"--offset={start_m[0]},{start_m[1]}"
        flags = ["--name", name, "--id", id, "--connect", address, "--range-id", RANGE_ID, offset, *args]
        processes.append(command("mavlink", *flags))
        autopilots.append(autopilot)
    errors_m, deviations_m = [], []
    for tick in rh.attach(name, from_start=True):
        if tick.tick > 60:
            errors_m.append(np.hypot(*(tick.position_m - target(tick.sent_ns * 1e-9))))
            heard = ~np.isnan(tick.believed_m[:, 0])
            places_m = np.array([(a.start_m[0] + a.east_m, a.start_m[1] + a.north_m) for a in autopilots])
            deviations_m.extend(np.hypot(*(tick.believed_m - places_m)[heard].T))
    for process in processes:
        _, err = process.communicate()
        assert process.returncode == 0 and "follows the run" in err, err
    assert len(errors_m) > 100 and np.median(errors_m) < 1.5, errors_m
    # The run believes the vehicles where they are, but for the age of a position.
    assert np.median(deviations_m) < 2.0
    until(lambda: all(autopilot.setpoints[-1][1] == 0 for autopilot in autopilots))
    # Its way, not its distance from the start: a planner may lead a vehicle back.
    assert all(autopilot.driven_m > 10 for autopilot in autopilots), [autopilot.driven_m for autopilot in autopilots]


def test_the_commands_of_the_book_drive_a_vehicle(book, play, name, tmp_path):
    (commands,) = book.blocks("docs/mavlink.md")
    autopilot, _ = play()
    assert "--ticks" not in commands and commands.count(":14550") == 1
    commands = commands.replace("paper.toml", "paper.toml --ticks 80").replace(":14550", f":{autopilot.port}")
    done = subprocess.run(["bash", "-c", book.script(commands)], cwd=tmp_path, capture_output=True, text=True, timeout=110)
    assert done.returncode == 0 and "follows the run" in done.stderr, done
    assert np.isfinite(rh.load(tmp_path / "runs" / name).range_m[:, 2]).sum() > 40
    assert autopilot.driven_m > 1
    until(lambda: autopilot.setpoints[-1][1] == 0)


def test_nothing_drives_before_the_vehicle_is_armed_and_in_its_mode(one_vehicle):
    autopilot, process, _, _ = one_vehicle(armed=False, guided=False)
    # Noise on the port disturbs nothing.
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as noise:
        for length in (1, 9, 300, 1400):
            noise.sendto(b"\xfd" + random.Random(length).randbytes(length), ("127.0.0.1", autopilot.port))
    until(lambda: len(autopilot.setpoints) > 20)
    autopilot.armed = True
    until(lambda: len(autopilot.setpoints) > 40)
    assert all(speed == 0 for _, speed in autopilot.setpoints)
    autopilot.mode = GUIDED[ARDUPILOT]
    until(lambda: autopilot.speed_mps > 0)
    autopilot.armed = False
    until(lambda: autopilot.setpoints[-1][1] == 0)
    # A signal ends the process in order.
    autopilot.armed = True
    until(lambda: autopilot.speed_mps > 0)
    process.terminate()
    _, err = process.communicate()
    assert process.returncode == 0, err
    until(lambda: autopilot.setpoints[-1][1] == 0)
    lines = [line for line in err.splitlines() if line.startswith("mavlink: ")]
    assert any("is not armed" in line for line in lines) and any("nothing drives until it is in GUIDED" in line for line in lines)
    assert {32, 132} <= autopilot.asked


@pytest.mark.parametrize("rate_hz", [10, 2])
def test_setpoints_come_more_often_than_commands_and_as_often_as_asked(one_vehicle, rate_hz):
    autopilot, _, _, _ = one_vehicle("--rate", rate_hz, keys=dict(dt_s=1.5), kind=PX4)
    until(lambda: autopilot.speed_mps > 0)
    first = len(autopilot.setpoints)
    until(lambda: len(autopilot.setpoints) > first + 4 * rate_hz)
    times_s, speeds_mps = np.array(autopilot.setpoints[first:]).T
    assert len(set(speeds_mps)) < 10 and autopilot.timeouts == 0
    # In the middle: a busy machine may delay a few.
    assert np.median(np.diff(times_s)) <= 1.1 / rate_hz


def test_a_vehicle_over_tcp_is_found_again_after_its_end_was_closed(one_vehicle, play):
    autopilot, process, _, _ = one_vehicle(over="tcp")
    until(lambda: autopilot.speed_mps > 0)
    autopilot.stop()
    line = ""
    while "link to vehicle 1 is lost" not in line:
        line = process.stderr.readline()
    # Without an end that answers it waits; it does not spin.
    used = lambda: sum(map(int, open(f"/proc/{process.pid}/stat").read().rpartition(")")[2].split()[11:13]))  # noqa: E731
    before = used()
    time.sleep(2)
    spent_s = (used() - before) / os.sysconf("SC_CLK_TCK")
    assert spent_s < 1, "a whole core would be 2 s"
    again, _ = play(port=autopilot.port, over="tcp")
    until(lambda: again.speed_mps > 0)
    process.terminate()
    out, err = process.communicate()
    assert (process.returncode, out) == (0, "") and "EOF" not in err, err


def test_a_vehicle_stops_when_nobody_commands_it_and_goes_on_with_the_next_fusion(one_vehicle, by_hand):
    keys = dict(ticks=100_000, dt_s=0.1, clock="realtime")
    autopilot, process, _, started = one_vehicle()
    until(lambda: autopilot.speed_mps > 0)
    started[1].kill()
    until(lambda: autopilot.setpoints[-1][1] == 0)
    assert process.poll() is None and autopilot.timeouts == 0
    by_hand(["fusion"], **keys)
    until(lambda: autopilot.speed_mps > 0)


@pytest.mark.parametrize("kind", [ARDUPILOT, PX4])
def test_a_killed_process_leaves_a_vehicle_that_stops_by_itself_and_its_successor_goes_on(one_vehicle, kind):
    autopilot, process, again, _ = one_vehicle(kind=kind)
    until(lambda: autopilot.speed_mps > 0)
    process.send_signal(signal.SIGKILL)
    process.wait()
    until(lambda: autopilot.timeouts == 1)
    assert autopilot.speed_mps == 0
    again()
    count = len(autopilot.setpoints)
    until(lambda: len(autopilot.setpoints) > count + 20)
    if kind == PX4:
        # It has left OFFBOARD: only the pilot sets that again.
        assert autopilot.setpoints[-1][1] == 0
        autopilot.mode = GUIDED[PX4]
    until(lambda: autopilot.speed_mps > 0)


def test_a_robot_whose_link_is_lost_stops_and_comes_back(one_vehicle):
    autopilot, process, _, _ = one_vehicle()
    until(lambda: autopilot.speed_mps > 0)
    autopilot.cut = True
    until(lambda: autopilot.timeouts == 1)
    line = ""
    while "link to vehicle 1 is lost" not in line:
        line = process.stderr.readline()
    autopilot.cut = False
    until(lambda: autopilot.speed_mps > 0)


def test_a_radio_beside_the_vehicle_measures_the_target(one_vehicle, name, tmp_path):
    os.mkfifo(tmp_path / "uwb")
    one_vehicle("--radio", tmp_path / "uwb", "--offset=3,4")
    with open(tmp_path / "uwb", "w") as radio:
        for tick in rh.attach(name):
            radio.write("12.5\n")
            radio.flush()
            if tick.range_m[2] == 12.5:
                break
    # Robots report where the vehicle is, as the vehicle says: it may have left its start meanwhile.
    assert np.hypot(*(tick.believed_m[2] - (3, 4))) < 10


def test_the_end_of_the_run_stops_the_vehicle(one_vehicle, name, program):
    autopilot, process, _, _ = one_vehicle()
    until(lambda: autopilot.speed_mps > 0)
    subprocess.run([program, "stop", "--name", name], check=True, capture_output=True, timeout=60)
    _, err = process.communicate()
    assert process.returncode == 0, err
    until(lambda: autopilot.setpoints[-1][1] == 0)


def test_headings_and_yaws_turn_into_each_other():
    for heading_rad, yaw_rad in ((0.0, math.pi / 2), (math.pi / 2, 0.0), (-math.pi / 2, math.pi), (math.pi / 4, math.pi / 4)):
        assert abs(math.remainder(frames.yaw_of_heading(heading_rad) - yaw_rad, math.tau)) < 1e-12
        assert abs(math.remainder(frames.heading_of_yaw(yaw_rad) - heading_rad, math.tau)) < 1e-12
    north_mps, east_mps = frames.velocity_ned(math.pi / 2, 3.0)
    assert (round(north_mps, 12), round(east_mps, 12)) == (3.0, 0.0)
    assert frames.motion_of_ned(*frames.velocity_ned(-2.5, 4.0)) == pytest.approx((-2.5, 4.0))
    assert frames.motion_of_ned(0.0, 2.0) == (0.0, 2.0)


def ecef(latitude_deg, longitude_deg):
    """A place on the ellipsoid, m from the centre of the earth."""
    latitude, longitude = np.radians([latitude_deg, longitude_deg])
    n = frames.SEMI_MAJOR_M / np.sqrt(1 - frames.ECCENTRICITY_2 * np.sin(latitude) ** 2)
    across = n * np.cos(latitude)
    return np.array([across * np.cos(longitude), across * np.sin(longitude), n * (1 - frames.ECCENTRICITY_2) * np.sin(latitude)])


@pytest.mark.parametrize("latitude", [-70.0, 0.0, 47.4, 70.0])
def test_global_positions_are_local_ones_as_exactly_as_documented(latitude):
    origin = (latitude, 179.999)
    phi, lam = np.radians(origin)
    east = np.array([-np.sin(lam), np.cos(lam), 0])
    north = np.array([-np.sin(phi) * np.cos(lam), -np.sin(phi) * np.sin(lam), np.cos(phi)])
    for angle in np.linspace(0, 2 * np.pi, 8, endpoint=False):
        place = (latitude + np.degrees(1000 * np.sin(angle) / 6.37e6), 179.999 + np.degrees(1000 * np.cos(angle) / 6.37e6 / np.cos(phi)))
        expected = (ecef(*place) - ecef(*origin)) @ np.array([east, north]).T
        wrapped = (place[0], math.remainder(place[1], 360))
        assert np.hypot(*(frames.local_m(wrapped, origin) - expected)) < 0.25


def test_the_least_certain_direction_counts_and_an_unknown_covariance_does_not():
    assert frames.position_std_m(4.0, 0.0, 1.0) == 2.0
    assert frames.position_std_m(2.5, 1.5, 2.5) == pytest.approx(2.0)
    assert [frames.position_std_m(*c) for c in ((math.nan, 0.0, 1.0), (0.0, 0.0, 0.0), (-1.0, 0.0, 2.0))] == [None] * 3


def message(kind, system=1, component=1, **fields):
    return SimpleNamespace(get_type=lambda: kind, get_srcSystem=lambda: system, get_srcComponent=lambda: component, **fields)


def heartbeat(system=1, autopilot=ARDUPILOT, type=2, base_mode=129, mode="GUIDED"):
    return message("HEARTBEAT", system, autopilot=autopilot, type=type, base_mode=base_mode, mode=mode)


def placed(x=1.0, y=2.0, vx=0.0, vy=0.0, system=1):
    return message("LOCAL_POSITION_NED", system, x=x, y=y, z=0.0, vx=vx, vy=vy, vz=0.0)


def vehicle(*messages, now_s=0.0, **settings):
    vehicle = Vehicle(Settings(**settings), lambda heartbeat: heartbeat.mode)
    for each in messages:
        vehicle.take(each, now_s)
    return vehicle


def test_a_setpoint_is_a_velocity_only_while_all_is_well():
    ready = lambda: vehicle(heartbeat(), placed(), hold_s=1.0, silence_s=2.0)  # noqa: E731
    assert ready().setpoint(0.0) == STOP
    driven = ready()
    driven.command(math.pi / 2, 3.0, 0.0)
    setpoint = driven.setpoint(0.5)
    assert (setpoint.north_mps, round(setpoint.east_mps, 12), setpoint.yaw_rad) == (3.0, 0.0, 0.0)
    assert driven.setpoint(1.1) == STOP, "the command is old"
    assert "follows the run" in driven.condition(0.5) and "no commands" in driven.condition(1.1)
    driven.command(math.pi / 2, 3.0, 2.0)
    assert driven.setpoint(1.9).north_mps == 3.0 and driven.setpoint(2.1) == STOP, "the link is lost"
    for other in (heartbeat(base_mode=1), heartbeat(mode="LOITER")):
        driven = ready()
        driven.take(other, 0.0)
        driven.command(0.0, 3.0, 0.0)
        assert driven.setpoint(0.0) == STOP
    stopped = ready()
    stopped.command(1.0, 0.0, 0.0)
    assert stopped.setpoint(0.0) == STOP


def test_only_the_vehicle_counts_and_numbers_that_are_finite():
    seen = vehicle(heartbeat(9, autopilot=8), heartbeat(8, type=6), placed(system=9), heartbeat(1), placed(), heartbeat(2), placed(50.0, system=2), placed(math.nan))
    assert seen.system == 1 and seen.pose()[:2] == (2.0, 1.0)
    assert not vehicle(placed()).is_linked(0.0) and not vehicle(heartbeat()).is_linked(0.0)
    assert "heartbeat" in vehicle().condition(0.0) and "position" in vehicle(heartbeat()).condition(0.0)


def test_poses_are_in_the_runs_frame_with_the_vehicles_own_deviation():
    moved = vehicle(heartbeat(), placed(1.0, 2.0, 3.0, 4.0), message("ATTITUDE", yaw=math.pi / 2), offset_m=(10.0, 20.0), pose_std_m=0.7)
    assert moved.pose() == pytest.approx((12.0, 21.0, 0.0, 0.7))
    assert moved.motion(0.0) == pytest.approx((math.atan2(3, 4), 5.0)) and moved.motion(9.0) == (0.0, 0.0)
    covariance = [0.04, 0.0, 0, 0, 0, 0, 0.09] + [math.nan] * 14
    moved.take(message("ODOMETRY", pose_covariance=covariance), 0.0)
    assert moved.pose()[3] == pytest.approx(0.3)
    moved.take(message("ESTIMATOR_STATUS", pos_horiz_accuracy=0.5), 0.0)
    moved.take(message("ESTIMATOR_STATUS", pos_horiz_accuracy=math.nan), 0.0)
    assert moved.pose()[3] == 0.5
    fix = message("GLOBAL_POSITION_INT", lat=474_000_000, lon=85_001_000, vx=300, vy=400)
    there = vehicle(heartbeat(), placed(99.0, 99.0), fix, origin_deg=(47.4, 8.5))
    assert there.pose()[:2] == pytest.approx((7.55, 0.0), abs=0.01) and there.motion(0.0)[1] == 5.0


def measured(distance=1234, id=RANGE_ID, low=10, high=60_000, covariance=0, signal_quality=0):
    fields = dict(current_distance=distance, id=id, min_distance=low, max_distance=high, covariance=covariance, signal_quality=signal_quality)
    return message("DISTANCE_SENSOR", **fields)


def test_a_range_counts_once_while_it_is_fresh_and_valid():
    ranged = vehicle(heartbeat(), placed(), measured(), range_id=RANGE_ID, range_age_s=0.1)
    assert ranged.range(0.05) == (12.34,) and ranged.range(0.05) is None
    ranged.take(measured(covariance=9), 0.0)
    assert ranged.range(0.0) == (12.34, 0.03)
    ranged.take(measured(), 0.0)
    assert ranged.range(0.2) is None
    for refused in (measured(id=3), measured(0), measured(5), measured(60_001), measured(signal_quality=1)):
        ranged.take(refused, 0.0)
        assert ranged.range(0.0) is None


def test_faults_of_flags_are_one_line(command, name, python):
    hidden = "import sys, runpy; sys.modules['pymavlink'] = None; sys.argv[1:] = ['--name', 'x', '--id', '0', '--connect', 'udpin:127.0.0.1:1']; runpy.run_module('rangehound.mavlink', run_name='__main__')"
    done = python(hidden)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and "pip install 'rangehound[mavlink]'" in done.stderr
    pytest.importorskip("pymavlink", reason="pymavlink is not installed")
    address = ["--name", name, "--id", 0, "--connect", "udpin:127.0.0.1:0"]
    for args, expected in (
        (["--rate", 1], "--rate is 1.0: expected 2 to 50 Hz"),
        (["--pose-std", "nan"], "--pose-std is nan"),
        (["--origin", "91,0"], "expected a latitude"),
        (["--origin", "1"], "--origin"),
        (["--range-id", 1, "--radio", "x"], "not allowed with"),
        ([], f"no run {name} after 10 s"),
    ):
        process = command("mavlink", *address, *args)
        out, err = process.communicate()
        assert (process.returncode, out, err.count("\n")) == (2, "", 1) and expected in err, err


def test_robots_and_clocks_that_do_not_fit_are_one_line(by_hand, command, name):
    pytest.importorskip("pymavlink", reason="pymavlink is not installed")
    by_hand(["sim"], ticks=100_000, clock="lockstep")
    for id, expected in ((9, "--id is 9: expected 0 to 2"), (2, "is in lock step: expected one in real time")):
        process = command("mavlink", "--name", name, "--id", id, "--connect", "udpin:127.0.0.1:0")
        out, err = process.communicate()
        assert (process.returncode, out, err.count("\n")) == (2, "", 1) and expected in err, err
