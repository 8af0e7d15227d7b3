"""ROS 2 bags: what others read of ours, and ours of what others write."""

import csv
import json
import math
import subprocess

import numpy as np
import pytest
import rangehound as rh

rosbags = pytest.importorskip("rosbags", reason="the package rosbags is not installed")
from rosbags.highlevel import AnyReader  # noqa: E402
from rosbags.rosbag2 import Reader, StoragePlugin, Writer  # noqa: E402
from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: E402

TYPES = {
    "/target/pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/target/odom": "nav_msgs/msg/Odometry",
    "/target/truth": "geometry_msgs/msg/PoseStamped",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/rangehound/markers": "visualization_msgs/msg/MarkerArray",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    "/robot_4/pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/robot_4/range": "sensor_msgs/msg/Range",
    "/robot_4/bearing": "geometry_msgs/msg/Vector3Stamped",
    "/robot_4/cmd_vel": "geometry_msgs/msg/TwistStamped",
    "/robot_4/velocity": "geometry_msgs/msg/TwistStamped",
}


def call(program, folder, *args):
    done = subprocess.run([program, *map(str, args)], capture_output=True, text=True, timeout=120, cwd=folder)
    assert done.returncode == 0, done
    return done.stdout


@pytest.fixture
def run(program, root, tmp_path):
    """A folder with a run, which has ranges and bearings, in `out`, and its bag in `bag`."""
    scenario = root / "scenarios/mixed_sensors.toml"
    call(program, tmp_path, "run", scenario, "--in-process", "--ticks", 100, "--out", "out", "--no-record")
    call(program, tmp_path, "record", "out", "--ros2", "bag")
    return tmp_path


def estimates(run):
    with (run / "out/estimate.csv").open(newline="") as file:
        return [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)]


def time_s(stamp):
    return stamp.sec + stamp.nanosec * 1e-9


def assert_is_row(pose, stamp, row):
    """The position, the covariance and the stamp of a row of estimate.csv."""
    assert (pose.pose.position.x, pose.pose.position.y, pose.pose.position.z) == (row["x_m"], row["y_m"], 0.0)
    covariance = pose.covariance
    assert [covariance[i] for i in (0, 1, 6, 7)] == [row[key] for key in ("var_x_m2", "cov_xy_m2", "cov_xy_m2", "var_y_m2")]
    # The run begins at 0 s, and so the bag at 1 s.
    assert time_s(stamp) == pytest.approx(row["time_s"] + 1.0, abs=2e-9)


def test_each_message_is_a_row_of_the_estimate(run):
    rows, bag = estimates(run), run / "bag"
    with Reader(bag) as reader:
        kinds = {connection.topic: connection for connection in reader.connections}
        store = get_typestore(Stores.ROS2_JAZZY)
        for topic, kind in TYPES.items():
            assert kinds[topic].msgtype == kind
            assert kinds[topic].digest == store.hash_rihs01(kind)
        assert reader.message_count == sum(connection.msgcount for connection in reader.connections)
        assert reader.start_time == 1_000_000_000
        assert reader.end_time - 1 == reader.start_time + round(rows[-1]["time_s"] * 1e9)
    read = {topic: [] for topic in kinds}
    with AnyReader([bag]) as reader:
        for connection, log_ns, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            read[connection.topic].append(message)
            if hasattr(message, "header"):
                assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == log_ns
    assert len(read["/target/pose"]) == len(read["/target/odom"]) == len(rows) == 101
    for row, pose, odometry in zip(rows, read["/target/pose"], read["/target/odom"]):
        assert_is_row(pose.pose, pose.header.stamp, row)
        assert_is_row(odometry.pose, odometry.header.stamp, row)
        assert (pose.header.frame_id, odometry.child_frame_id) == ("map", "target")
        turn = odometry.pose.pose.orientation
        yaw = 2 * math.atan2(turn.z, turn.w)
        speed = odometry.twist.twist.linear.x
        assert (speed * math.cos(yaw), speed * math.sin(yaw)) == pytest.approx((row["vx_mps"], row["vy_mps"]), abs=1e-9)
    assert all(len(message.transforms) >= 1 and message.transforms[0].child_frame_id == "target" for message in read["/tf"])
    ranges = [message for topic, messages in read.items() if topic.endswith("/range") for message in messages]
    assert ranges and all(message.range > 0 and message.variance > 0 for message in ranges)
    assert read["/robot_4/range"][0].header.frame_id == "robot_4/base_link"
    assert all(math.hypot(m.vector.x, m.vector.y) == pytest.approx(1.0) for m in read["/robot_4/bearing"])
    assert len(read["/robot_4/cmd_vel"]) == len(read["/robot_4/velocity"]) == len(read["/target/truth"]) == 101
    # A twist turns the robot towards its heading; a velocity is over ground.
    live = rh.load(run / "out")
    for tick in (3, 50):
        twist, velocity = (read[f"/robot_4/{topic}"][tick] for topic in ("cmd_vel", "velocity"))
        heading, speed, yaw = live.heading_rad[tick, 4], live.speed_mps[tick, 4], live.believed_heading_rad[tick, 4]
        assert (twist.header.frame_id, velocity.header.frame_id) == ("robot_4/base_link", "map")
        error = math.remainder(heading - yaw, math.tau)
        assert (twist.twist.linear.x, twist.twist.linear.y) == (pytest.approx(speed * max(0.0, math.cos(error))), 0.0)
        assert twist.twist.angular.z == pytest.approx(max(-2.0, min(2.0, 3 * error)))
        over_ground = velocity.twist.linear.x, velocity.twist.linear.y
        assert over_ground == pytest.approx((speed * math.cos(heading), speed * math.sin(heading)))


def test_markers_and_diagnostics_are_those_of_the_run(run):
    live, markers, statuses = rh.load(run / "out"), [], []
    with AnyReader([run / "bag"]) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            if connection.topic == "/rangehound/markers":
                markers.append({(marker.ns, marker.id): marker for marker in message.markers})
            elif connection.topic == "/diagnostics":
                statuses += message.status
    assert_are_drawn(live, markers)
    assert {status.name for status in statuses} == {"rangehound: estimate"}
    values = [{pair.key: pair.value for pair in status.values} for status in statuses]
    assert [int(value["tick"]) for value in values] == list(range(0, 101, 10))
    assert sum(int(value["rejected since the last status"]) for value in values) == live.rejected.sum()
    for value in values:
        assert float(value["position trace, m^2"]) == pytest.approx(live.position_trace_m2[int(value["tick"])], abs=1e-6)
        assert int(value["fused"]) == live.fused[int(value["tick"])]


def assert_are_drawn(live, markers):
    """The ellipse has the standard deviations of the estimate; rays and circles lead from robots to the target."""
    assert len(markers) == len(live)
    for tick, drawn in enumerate(markers):
        ellipse = drawn["ellipse", 0]
        covariance = live.covariance[tick, :2, :2]
        long, short = ellipse.scale.x / 6, ellipse.scale.y / 6
        assert (short**2, long**2) == pytest.approx(np.linalg.eigvalsh(covariance))
        yaw = 2 * math.atan2(ellipse.pose.orientation.z, ellipse.pose.orientation.w)
        along = np.array([math.cos(yaw), math.sin(yaw)])
        assert along @ covariance @ along == pytest.approx(long**2)
        assert (ellipse.pose.position.x, ellipse.pose.position.y) == tuple(live.position_m[tick])
        for robot in range(live.believed_m.shape[1]):
            ray, circle = drawn["ray", robot], drawn["range", robot]
            assert (ray.action, len(ray.points)) == (0, 2)
            assert (ray.points[0].x, ray.points[0].y) == tuple(live.believed_m[tick, robot])
            assert (ray.points[1].x, ray.points[1].y) == tuple(live.position_m[tick])
            is_measured = math.isfinite(live.range_m[tick, robot])
            assert circle.action == (0 if is_measured else 2)
            if is_measured:
                away = np.array([[point.x, point.y] for point in circle.points]) - live.believed_m[tick, robot]
                np.testing.assert_allclose(np.hypot(*away.T), live.range_m[tick, robot])
                assert circle.color.r == pytest.approx(0.84 if live.range_used[tick, robot] > 1 else 0.5)


def test_another_reader_agrees(run):
    bag = run / "bag"
    reader = pytest.importorskip("mcap_ros2.reader", reason="the package mcap-ros2-support is not installed")
    poses = list(reader.read_ros2_messages(bag / "bag_0.mcap", topics=["/target/pose"]))
    for row, message in zip(estimates(run), poses, strict=True):
        assert_is_row(message.ros_msg.pose, message.ros_msg.header.stamp, row)
    drawn = [message.ros_msg.markers for message in reader.read_ros2_messages(bag / "bag_0.mcap", topics=["/rangehound/markers"])]
    assert_are_drawn(rh.load(run / "out"), [{(marker.ns, marker.id): marker for marker in markers} for markers in drawn])
    count = sum(1 for _ in reader.read_ros2_messages(bag / "bag_0.mcap"))
    with Reader(bag) as other:
        assert count == other.message_count


STORE = get_typestore(Stores.ROS2_JAZZY)
STORE.register(get_types_from_msg("string anchor_id\nuint32 distance\n", "uwb_msgs/msg/One"))
STORE.register(get_types_from_msg("std_msgs/Header header\nuwb_msgs/One[] ranges\n", "uwb_msgs/msg/Many"))
ANCHORS = {"a": (0.0, 0.0), "b": (9.0, 0.0), "c": (0.0, 9.0)}


def header(time_ns, frame):
    stamp = STORE.types["builtin_interfaces/msg/Time"](sec=time_ns // 10**9, nanosec=time_ns % 10**9)
    return STORE.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def messages():
    """Ranges of three anchors as two types, and what the recording has of each: time, anchor, range."""
    one, many = (STORE.types[f"uwb_msgs/msg/{name}"] for name in ("One", "Many"))
    for k in range(60):
        time_ns = 1_700_000_000 * 10**9 + k * 100_000_000
        ranges = {name: math.hypot(3.0 + 0.02 * k - x, 4.0 - y) for name, (x, y) in ANCHORS.items()}
        yield "/many", time_ns, many(header(time_ns, "tag"), [one(name, round(1000 * m)) for name, m in ranges.items()])
        for name, range_m in ranges.items():
            kind = STORE.types["sensor_msgs/msg/Range"]
            yield "/range", time_ns, kind(header(time_ns, name), 0, 0.0, 0.1, 50.0, range_m, 0.0)


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3], ids=["mcap", "sqlite3"])
def test_bags_that_rosbags_writes_are_tracked(storage, program, tmp_path):
    bag = tmp_path / "bag"
    with Writer(bag, version=9, storage_plugin=storage) as writer:
        connections = {}
        for topic, time_ns, message in messages():
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], time_ns, STORE.serialize_cdr(message, kind))
    anchors = tmp_path / "anchors.csv"
    anchors.write_text("sensor_id,x_m,y_m\n" + "".join(f"{name},{x},{y}\n" for name, (x, y) in ANCHORS.items()))
    ways = [
        {"topic": "/range"},
        {"topic": "/many", "columns": "range=ranges[].distance:mm,sensor=ranges[].anchor_id"},
        {"topic": "/many", "field": "ranges[].distance:mm", "columns": "sensor=ranges[].anchor_id"},
        {"topic": "/range", "field": "range"},
    ]
    for way in ways:
        tracked = rh.track(bag, anchors=str(anchors), range_std_m=0.05, show_progress=False, **way)
        assert len(tracked.report["sensors"]) == 3, way
        assert tracked.state[-1][:2] == pytest.approx((3.0 + 0.02 * 59, 4.0), abs=0.05), way
    done = call(program, tmp_path, "track", bag, "--topic", "/range", "--anchors", anchors, "--in-process", "--no-record", "--json", "--out", "out")
    assert json.loads(done)["verdict"]
    with pytest.raises(rh.InputError, match="expected --topic with one of /many .uwb_msgs/msg/Many: ranges...distance., /range"):
        rh.track(bag, anchors=str(anchors))
