"""The computations of the node of ROS 2, without ROS: messages of a tick, measurements of messages, the controller."""

import math
import re

import numpy as np
import pytest
import rangehound as rh
from rangehound.ros2 import measurements, messages, session, unicycle
from rangehound.ros2.measurements import Newest, Odometry, Refused
from rangehound.ros2.observer import robot_ids

LIMITS = unicycle.Limits(max_speed_mps=2.0, max_turn_rate_radps=1.5, heading_gain_per_s=3.0)


def test_without_rclpy_the_package_is_imported_and_the_node_refused_in_one_line(python):
    script = (
        "import sys; sys.modules['rclpy'] = None\n"
        "import rangehound, rangehound.ros2.observer, rangehound.ros2.robot\n"
        "from rangehound.ros2.session import run_node\n"
        "sys.argv[1:] = ['--name', 'none']\nsys.exit(run_node(rangehound.ros2.observer.main))"
    )
    done = python(script)
    assert done.returncode == 2 and done.stderr.count("\n") == 1, done.stderr
    assert "rclpy cannot be imported" in done.stderr and "expected a sourced ROS 2 environment" in done.stderr


def test_importing_the_package_does_not_import_rclpy(python):
    done = python("import sys, rangehound, rangehound.ros2\nprint([name for name in sys.modules if 'rclpy' in name])")
    assert done.stdout == "[]\n", done.stderr


def test_a_stamp_is_the_time_to_the_nanosecond_and_within_its_bounds():
    assert messages.stamp_of(0.3) == (0, 300_000_000)
    assert messages.stamp_of(1_700_000_000.25) == (1_700_000_000, 250_000_000)
    assert messages.stamp_of(0.9999999999) == (1, 0)
    assert messages.stamp_of(0.3, 1_000_000_000) == (1, 300_000_000)
    assert messages.stamp_of(-0.25) == (-1, 750_000_000)
    assert messages.stamp_of(math.nan) == (0, 0) and messages.stamp_of(math.inf)[0] == 2**31 - 1


def test_the_target_faces_along_its_velocity_with_the_first_order_covariance_of_that():
    state = np.array([1.0, 2.0, 3.0, 4.0])
    noise = np.random.default_rng(4)
    root = noise.normal(size=(4, 4)) * 0.02
    covariance = root @ root.T
    pose = messages.target_of(state, covariance, has_velocity=True).pose
    assert (pose.x, pose.y) == (1.0, 2.0) and pose.yaw == math.atan2(4.0, 3.0)
    full = pose.covariance.reshape(6, 6)
    np.testing.assert_array_equal(full[:2, :2], covariance[:2, :2])
    samples = noise.multivariate_normal(state, covariance, 200_000)
    yaw = np.arctan2(samples[:, 3], samples[:, 2])
    sampled = np.cov(np.column_stack([samples[:, :2], yaw]).T)
    np.testing.assert_allclose(full[np.ix_([0, 1, 5], [0, 1, 5])], sampled, rtol=0.05, atol=1e-6)
    assert not full[2:5].any() and not full[:, 2:5].any()
    assert (np.linalg.eigvalsh(full) >= -1e-12).all()


@pytest.mark.parametrize("speed_mps, has_velocity", [(0.0, True), (1e-3, True), (5.0, False)])
def test_a_yaw_of_which_nothing_is_known_has_the_variance_of_any_angle(speed_mps, has_velocity):
    covariance = np.eye(4)
    covariance[0, 2] = covariance[2, 0] = 0.5
    pose = messages.target_of(np.array([0.0, 0.0, 0.0, speed_mps]), covariance, has_velocity).pose
    full = pose.covariance.reshape(6, 6)
    assert full[5, 5] == pytest.approx(math.pi**2 / 3) and not full[:2, 5].any()


def test_the_targets_velocity_is_that_in_its_own_frame():
    covariance = np.diag([1.0, 1.0, 0.04, 0.09])
    target = messages.target_of(np.array([0.0, 0.0, 0.0, -2.0]), covariance, has_velocity=True)
    full = target.velocity_covariance.reshape(6, 6)
    assert target.speed_mps == 2.0
    np.testing.assert_allclose([full[0, 0], full[1, 1]], [0.09, 0.04])
    assert full[5, 5] == 1e6
    unknown = messages.target_of(np.zeros(2), np.eye(2), has_velocity=False)
    assert unknown.speed_mps == 0.0 and unknown.velocity_covariance[0] == 1e6


def test_the_poses_of_robots_are_those_of_the_run():
    run = rh.simulate(ticks=30, planner="certified")
    pose = messages.robot_pose(run.believed_m[9, 1], 1.5, run.believed_covariance_m2[9, 1], run.believed_heading_rad[9, 1], 0.5)
    assert pose[:4] == (*run.believed_m[9, 1], 1.5, run.believed_heading_rad[9, 1]) and pose.covariance[35] == 0.25


def test_the_arrays_of_a_run_have_the_covariances_that_robots_reported():
    run = rh.simulate(ticks=20, planner="greedy")
    assert run.believed_covariance_m2.shape == (21, 3, 2, 2) and not run.believed_covariance_m2.any()
    assert run.believed_heading_rad.shape == run.believed_heading_std_rad.shape == (21, 3)


@pytest.mark.parametrize(
    "range_m, cause",
    [(math.nan, "NaN"), (math.inf, "nothing was detected"), (-math.inf, "infinite"), (-0.1, "negative"), (0.1, "min_range 0.2"), (31.0, "max_range 30 m")],
)
def test_ranges_that_are_none_are_refused_with_the_cause(range_m, cause):
    with pytest.raises(Refused, match=cause):
        measurements.range_of(range_m, 0.2, 30.0, 0.0, 0.5)


def test_a_range_has_the_deviation_of_its_message_or_else_the_scenarios():
    assert measurements.range_of(12.0, 0.0, 30.0, 0.0, 0.5) == (12.0, 0.5)
    assert measurements.range_of(12.0, 0.0, 30.0, 0.04, 0.5) == (12.0, 0.2)
    for variance_m2 in (-1.0, math.nan, math.inf):
        with pytest.raises(Refused, match="variance"):
            measurements.range_of(12.0, 0.0, 30.0, variance_m2, 0.5)
    with pytest.raises(Refused, match="outside"):
        measurements.range_of(12.0, math.nan, math.nan, 0.0, 0.5)


def test_a_bearing_is_the_direction_in_the_robots_frame():
    assert measurements.bearing_of(0.0, 2.0) == math.pi / 2
    for x, y in ((0.0, 0.0), (math.nan, 1.0), (1.0, math.inf)):
        with pytest.raises(Refused):
            measurements.bearing_of(x, y)


def covariance(**entries):
    full = [0.0] * 36
    for place, value in entries.items():
        full[int(place[1:])] = value
    return full


def test_odometry_is_read_with_its_covariance_and_refused_if_it_is_none():
    half = math.sqrt(0.5)
    read = measurements.odometry_of((1.0, 2.0), (0.0, 0.0, half, half), covariance(_0=0.04, _1=0.01, _7=0.09, _35=0.25), (1.0, 0.0, math.nan))
    assert (read.x_m, read.y_m, read.covariance_m2, read.yaw_std_rad, read.velocity) == (1.0, 2.0, (0.04, 0.01, 0.09), 0.5, (1.0, 0.0, 0.0))
    assert math.isclose(read.yaw_rad, math.pi / 2)
    unit, none = (0.0, 0.0, 0.0, 1.0), covariance()
    faults = [
        ((math.nan, 0.0), unit, none), ((0.0, math.inf), unit, none), ((0.0, 0.0), (0.0, 0.0, 0.0, 0.0), none),
        ((0.0, 0.0), (math.nan, 0.0, 0.0, 1.0), none), ((0.0, 0.0), unit, covariance(_0=-1.0)),
        ((0.0, 0.0), unit, covariance(_0=1.0, _7=1.0, _1=2.0)), ((0.0, 0.0), unit, covariance(_0=math.nan)),
        ((0.0, 0.0), unit, covariance(_35=math.inf)),
    ]
    for fault in faults:
        with pytest.raises(Refused):
            measurements.odometry_of(*fault, (0.0, 0.0, 0.0))


def test_odometry_of_another_frame_is_turned_and_moved():
    odometry = Odometry(1.0, 0.0, 0.0, (0.04, 0.0, 0.09), 0.1, (2.0, 0.0, 0.0))
    placed = measurements.placed(odometry, (10.0, 20.0, math.pi / 2))
    np.testing.assert_allclose((placed.x_m, placed.y_m, placed.yaw_rad, *placed.covariance_m2), (10.0, 21.0, math.pi / 2, 0.09, 0.0, 0.04), atol=1e-12)
    later = measurements.moved(placed, 0.5)
    np.testing.assert_allclose((later.x_m, later.y_m), (10.0, 22.0))
    arc = measurements.moved(Odometry(0.0, 0.0, 0.0, (0.0,) * 3, 0.0, (1.0, 0.0, 0.1)), 1.0)
    np.testing.assert_allclose((arc.x_m, arc.y_m), (math.sin(0.1) / 0.1, (1 - math.cos(0.1)) / 0.1), atol=1e-3)


def test_a_value_is_used_once_and_only_while_it_is_young():
    newest = Newest()
    assert newest.take(0.0, 1.0) is None
    assert newest.put(1.0, "a") and newest.take(1.2, 0.5) == "a" and newest.take(1.2, 0.5) is None
    assert newest.look(1.2, 0.5) == "a" and newest.look(1.6, 0.5) is None
    assert not newest.put(1.0, "again") and not newest.put(0.9, "late")
    assert newest.put(2.0, "b") and newest.take(2.6, 0.5) is None and newest.take(1.0, 0.5) is None
    assert newest.put(3.0, None) and newest.take(3.0, 0.5) is None
    # A clock that was set back.
    assert newest.put(0.5, "c") and newest.take(0.5, 0.5) == "c"


def test_the_controller_turns_on_the_spot_then_drives_and_keeps_its_limits():
    assert unicycle.twist(0.0, 1.0, 0.0, LIMITS) == (1.0, 0.0)
    assert unicycle.twist(0.0, 9.0, 0.0, LIMITS)[0] == 2.0
    forward_mps, turn_radps = unicycle.twist(math.pi, 1.0, 0.1, LIMITS)
    assert forward_mps == 0.0 and turn_radps == 1.5
    # The shorter way round.
    assert unicycle.twist(3.0, 1.0, -3.0, LIMITS)[1] < 0.0
    for values in ((math.nan, 1.0, 0.0), (0.0, math.inf, 0.0), (0.0, 1.0, math.nan), (1.0, 0.0, 0.0), (1.0, -1.0, 0.0)):
        assert unicycle.twist(*values, LIMITS) == (0.0, 0.0)


def test_with_the_controller_a_heading_error_decays_as_documented():
    yaw_rad, dt_s = 0.4, 1e-4
    for _ in range(10_000):
        yaw_rad += unicycle.twist(0.0, 1.0, yaw_rad, LIMITS)[1] * dt_s
    assert math.isclose(yaw_rad, 0.4 * math.exp(-3.0), rel_tol=1e-3)


def test_robots_are_named_by_numbers_and_ranges():
    assert robot_ids("0,2-3", 4) == [0, 2, 3] and robot_ids("all", 3) == [0, 1, 2] and robot_ids(None, 3) == []
    for text in ("", "x", "3", "2-1", "1-", "-1", "0,", "1.5"):
        with pytest.raises(rh.InputError, match="expected all, or robots"):
            robot_ids(text, 3)


def test_words_after_ros_args_are_for_ros():
    args = ["--name", "a", "--ros-args", "-p", "x:=1", "--", "--from-start"]
    assert session.split_ros_args(args) == (["--name", "a", "--from-start"], ["--ros-args", "-p", "x:=1"])
    assert session.split_ros_args(["--name", "a"]) == (["--name", "a"], [])


def test_the_configuration_of_rviz_names_topics_that_the_node_publishes(root):
    yaml = pytest.importorskip("yaml")
    text = (root / "docs/ros2.rviz").read_text()
    manager = yaml.safe_load(text)["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == "map"
    shown = [display["Topic"]["Value"] for display in manager["Displays"] if "Topic" in display]
    page = (root / "docs/ros2.md").read_text()
    published = re.findall(r"^\| `(/[\w/]+)` \| \w+_msgs/", page, re.MULTILINE)
    assert "/rangehound/markers" in shown and "/target/odom" in shown
    for topic in shown:
        assert re.sub(r"robot_\d", "robot_N", topic) in published, topic


def test_the_page_has_the_topics_and_the_parameters_that_the_nodes_have(root):
    page = (root / "docs/ros2.md").read_text()
    for module in ("observer", "robot"):
        source = (root / f"python/rangehound/ros2/{module}.py").read_text()
        for parameter in re.findall(r"(?:parameter|number)\(\"(\w+)\"", source):
            assert parameter in source.split("_HELP = ")[1].split('"""')[1], parameter
            assert f"`{parameter}`" in page, parameter
        for topic in re.findall(r'f?"((?:target|rangehound|robot_\{robot\})/\w+)"', source):
            assert f"`/{topic.replace('{robot}', 'N')}`" in page, topic
