"""The node of ROS 2 beside genuine ROS 2: what it publishes, and real robots that another process plays.

The other processes know ROS alone: `ros2_player.py` and `ros2_listener.py`, which share `ros2_spin.py`.
"""

import importlib.util
import json
import os
import pathlib
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import rangehound as rh

HERE = pathlib.Path(__file__).parent

#: Ends a test that hangs, s: far above what it takes.
WATCHDOG_S = 400

NEEDED = ["rclpy", "geometry_msgs", "nav_msgs", "sensor_msgs", "diagnostic_msgs", "visualization_msgs"]
MISSING = [package for package in NEEDED if importlib.util.find_spec(package) is None]

pytestmark = [
    pytest.mark.skipif(bool(MISSING), reason=f"no ROS 2 in this environment: {', '.join(MISSING)} cannot be imported"),
    pytest.mark.usefixtures("watchdog"),
]

POSE, TWIST = "geometry_msgs/PoseWithCovarianceStamped", "geometry_msgs/TwistStamped"


#: The player repeats itself: on a busy machine a tick waits until it is heard.
LONG_WAIT = ["-p", "lockstep_wait_s:=60.0"]


@pytest.fixture
def ros(tmp_path, traceless):
    """Starts processes in a ROS of their own on this host; ends what is left of them."""
    started = []
    # The range LOCALHOST would bring shared memory back.
    own = {"ROS_DOMAIN_ID": str(1 + os.getpid() % 100), "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
           "FASTDDS_DEFAULT_PROFILES_FILE": str(HERE / "ros2_loopback.xml"), "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
           "ROS_LOG_DIR": str(tmp_path / "log"), "PYTHONUNBUFFERED": "1"}

    def start(*args, waits=False):
        pipes = dict(stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        started.append(subprocess.Popen([sys.executable, *map(str, args)], cwd=tmp_path, env={**os.environ, **own}, **pipes))
        if waits:
            assert started[-1].stdout.readline() == "ready\n", started[-1].stderr.read()
        return started[-1]

    yield start
    for process in started:
        if process.poll() is None:
            process.terminate()
            try:
                process.communicate(timeout=15)
            except subprocess.TimeoutExpired:
                process.kill()
                process.communicate()


def node(ros, name, *args):
    return ros("-m", "rangehound.ros2", "--name", name, *args)


def listener(ros, *flags, **topics):
    args = [f"/{topic.replace('__', '/')}={kind}" for topic, kind in topics.items()]
    return ros(HERE / "ros2_listener.py", *flags, *args, waits=True)


def heard(process):
    process.send_signal(signal.SIGTERM)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    return json.loads(out.splitlines()[-1])


def seconds(message):
    stamp = message["header"]["stamp"]
    return stamp["sec"] + stamp["nanosec"] * 1e-9


def ended(process, code=0):
    _, err = process.communicate(timeout=60)
    assert process.returncode == code, (process.returncode, err)
    return err


def children(process):
    """The processes of its robots, by id."""
    found = {}
    for folder in pathlib.Path("/proc").glob("[0-9]*"):
        try:
            args = (folder / "cmdline").read_bytes().decode().split("\0")
        except OSError:
            continue
        if "rangehound.ros2.robot" in args and args[args.index("--end-with") + 1] == str(process.pid):
            found[int(args[args.index("--id") + 1])] = int(folder.name)
    return found


def play(ros, tmp_path, scenario, oracle, **more):
    """Starts a player of all robots, for the target and the noise of a simulated run."""
    noise = oracle.range_m - np.linalg.norm(oracle.truth[:, None, :2] - oracle.robot_m, axis=-1)
    arrays = dict(truth=oracle.truth[:, :2], noise=np.nan_to_num(noise), start=oracle.robot_m[0], dt_s=scenario.dt_s, **more)
    np.savez(tmp_path / "played.npz", **arrays)
    return ros(HERE / "ros2_player.py", tmp_path / "played.npz", waits=True)


def test_three_robots_of_ros_track_as_well_as_our_own_and_no_message_is_lost(program, name, ros, tmp_path):
    scenario = rh.Scenario(ticks=1000, clock="lockstep", timeout_s="forever", planner="certified", seed=3)
    oracle = rh.simulate(scenario)
    player = play(ros, tmp_path, scenario, oracle)
    topics = dict(target__pose=POSE, target__odom="nav_msgs/Odometry", robot_1__pose=POSE, robot_1__cmd_vel=TWIST)
    ears = listener(ros, **topics)
    with rh.run(scenario, name=name, out=tmp_path / "out", program=program, external=[0, 1, 2]) as run:
        bridge = node(ros, name, "--robots", "all", "--from-start", "--ros-args", "-p", "max_turn_rate_radps:=10.0", "-p", "heading_gain_per_s:=10.0", *LONG_WAIT)
        report = run.report()
    ended(bridge)
    messages = heard(ears)
    player.send_signal(signal.SIGTERM)
    out, err = player.communicate(timeout=60)
    played = json.loads(out)

    live = rh.load(tmp_path / "out")
    np.testing.assert_array_equal(live.truth, oracle.truth)
    # The ranges are fused that the player has published, each once, at its own tick.
    assert report["ranges"]["fused"] == 3000 and (live.fused[1:] == 3).all()
    error = report["position_rmse_m"] / oracle.report["position_rmse_m"]
    print(f"position RMSE: {report['position_rmse_m']:.4f} m with ROS, {oracle.report['position_rmse_m']:.4f} m without: {error:.4f}")
    assert 0.95 < error < 1.05
    assert played["commands"] == [1000] * 3
    # The last command of each robot is to stop.
    assert played["last"] == [[0.0, 0.0]] * 3

    poses = messages["/target/pose"]
    assert [len(messages[f"/{topic.replace('__', '/')}"]) for topic in list(topics)[:3]] == [1001] * 3
    # ROS takes a stamp of 0 for one that is not set: a run begins at 1 s.
    np.testing.assert_allclose([seconds(pose) for pose in poses], live.time_s + 1.0, atol=2e-9)
    np.testing.assert_array_equal([[pose["pose"]["pose"]["position"][axis] for axis in "xy"] for pose in poses], live.position_m)
    covariances = np.array([pose["pose"]["covariance"] for pose in poses]).reshape(-1, 6, 6)
    np.testing.assert_array_equal(covariances[:, :2, :2], live.covariance[:, :2, :2])
    speeds = [odometry["twist"]["twist"]["linear"]["x"] for odometry in messages["/target/odom"]]
    np.testing.assert_allclose(speeds, np.linalg.norm(live.state[:, 2:4], axis=1))
    places = [[pose["pose"]["pose"]["position"][axis] for axis in "xy"] for pose in messages["/robot_1/pose"]]
    np.testing.assert_array_equal(places, live.believed_m[:, 1])
    assert {message["header"]["frame_id"] for message in poses} == {"map"}


def test_each_message_of_a_real_robot_is_received_once(program, name, ros, tmp_path):
    """In real time, from a process that repeats nothing."""
    sender = ros(HERE / "ros2_sender.py", 1000, 0.01, 0, 1, waits=True)
    reliable = [f"qos_overrides./robot_{i}/{topic}.subscription.reliability:=reliable" for i in range(2) for topic in ("odom", "range")]
    deep = [f"qos_overrides./robot_{i}/{topic}.subscription.depth:=1000" for i in range(2) for topic in ("odom", "range")]
    overrides = [word for parameter in reliable + deep for word in ("-p", parameter)]
    with rh.run(name=name, out=tmp_path / "out", program=program, ticks=100_000, dt_s=0.01, clock="realtime", external=[0, 1]) as run:
        bridge = node(ros, name, "--robots", "0,1", "--ros-args", *overrides)
        out, err = sender.communicate(timeout=WATCHDOG_S)
        assert sender.returncode == 0, err
        counts = json.loads(out)
        run.stop()
        ended(bridge)
    received = {f"{what} received": "1000" for what in ("ranges", "odometry")}
    assert len(counts) == 2 and all(values.items() >= received.items() for values in counts.values()), counts
    live = rh.load(tmp_path / "out")
    # They take part: only measurements of the same tick replace each other.
    assert (np.isfinite(live.range_m[:, :2]).sum(axis=0) > 100).all()


def test_the_commands_of_the_book_lead_robots_of_ros(book, program, name, ros, tmp_path):
    (commands,) = book.blocks("docs/ros2.md")
    # The player answers in lock step.
    assert commands.count("--ticks 6000") == 1
    commands = commands.replace("--ticks 6000", "--ticks 100 --clock lockstep --timeout forever")
    scenario = rh.Scenario(HERE.parents[1] / "scenarios/recommended.toml", ticks=100, clock="lockstep", timeout_s="forever")
    oracle = rh.simulate(scenario)
    play(ros, tmp_path, scenario, oracle)
    # A shell in the same ROS, in place of Python.
    typed = ros("-c", "import os, sys; os.execvp('bash', ['bash', '-c', sys.argv[1]])", book.script(commands, run="team"))
    ended(typed)
    live = rh.load(tmp_path / "runs" / name)
    np.testing.assert_array_equal(live.truth, oracle.truth)
    # A tick that waits for a second for a robot goes on without it.
    assert live.report["ticks"] == 100 and live.report["ranges"]["fused"] > 250


def test_uncertain_robots_with_cameras_and_frames_of_their_own_say_what_ros_says(program, name, ros, tmp_path):
    sensor = {"both": {"range_std_m": 1.0, "bearing_std_rad": 0.05}}
    robots = [{"start_m": [15.0, 0.0], "sensor": "both"}, {"start_m": [0.0, -15.0], "sensor": "both"}]
    keys = dict(ticks=60, clock="lockstep", timeout_s="forever", planner="certified", sensor=sensor, robot=robots)
    scenario = rh.Scenario(keys)
    oracle = rh.simulate(scenario)
    noise = np.random.default_rng(2).normal(scale=0.05, size=(61, 2))
    covariance = np.array([[0.04, 0.01, 0.0], [0.01, 0.09, 0.0], [0.0, 0.0, 0.0025]])
    play(ros, tmp_path, scenario, oracle, bearing_noise=noise, covariance=covariance, origin=[3.0, -4.0, np.pi / 2])
    with rh.run(scenario, name=name, out=tmp_path / "out", program=program, external=[0, 1]) as run:
        bridge = node(ros, name, "--robots", "all", "--ros-args", "-p", "odom_origin:=[3.0, -4.0, 1.5707963267948966]", *LONG_WAIT)
        report = run.report()
    ended(bridge)
    live = rh.load(tmp_path / "out")
    assert report["ranges"]["fused"] == 2 * 2 * 60 and report["position_rmse_m"] < 2.0
    sight = live.truth[1:, None, :2] - live.believed_m[1:]
    bearing = np.arctan2(sight[..., 1], sight[..., 0]) - live.believed_heading_rad[1:] + noise[1:]
    np.testing.assert_allclose(np.exp(1j * live.bearing_rad[1:]), np.exp(1j * bearing), atol=1e-9)
    assert (live.bearing_std_rad[1:] == 0.05).all()
    # Turned by a right angle.
    np.testing.assert_allclose(live.believed_covariance_m2[1:-1, 0], np.broadcast_to([[0.09, -0.01], [-0.01, 0.04]], (59, 2, 2)), atol=1e-12)
    np.testing.assert_allclose(live.believed_heading_std_rad[1:], 0.05)
    np.testing.assert_allclose(live.believed_m[0], [[15.0, 0.0], [0.0, -15.0]], atol=1e-9)


def test_a_killed_robots_process_is_started_again_and_the_run_goes_on(program, name, ros, tmp_path):
    own = os.getpriority(os.PRIO_PROCESS, 0)
    scenario = rh.Scenario(ticks=400, clock="lockstep", timeout_s="forever", planner="certified", seed=4)
    oracle = rh.simulate(scenario)
    play(ros, tmp_path, scenario, oracle)
    with rh.run(scenario, name=name, out=tmp_path / "out", program=program, external=[0, 1, 2]) as run:
        bridge = node(ros, name, "--robots", "all", "--ros-args", "-p", "max_turn_rate_radps:=10.0")
        for tick in run.attach():
            if tick.tick == 100:
                killed = children(bridge)[1]
                os.kill(killed, signal.SIGKILL)
            if tick.tick == 300:
                robots = children(bridge)
                assert robots[1] != killed
                # Robots are in the control loop, the node's thread that publishes is not.
                assert [os.getpriority(os.PRIO_PROCESS, robot) for robot in robots.values()] == [own] * 3
                assert os.getpriority(os.PRIO_PROCESS, bridge.pid) == own + 10
        report = run.report()
    assert "the process of robot 1 ended with code -9; it is started again" in ended(bridge)
    assert report["ticks"] == 400 and report["position_rmse_m"] < 1.5 * oracle.report["position_rmse_m"]


def test_the_robots_of_a_killed_node_end_and_stop_and_another_node_goes_on(program, name, ros, tmp_path):
    scenario = rh.Scenario(ticks=300, clock="lockstep", timeout_s="forever", planner="certified", seed=4)
    player = play(ros, tmp_path, scenario, rh.simulate(scenario))
    with rh.run(scenario, name=name, out=tmp_path / "out", program=program, external=[0, 1, 2]) as run:
        bridge = node(ros, name, "--robots", "all")
        for tick in run.attach():
            if tick.tick == 100:
                break
        robots = children(bridge)
        assert sorted(robots) == [0, 1, 2]
        bridge.kill()
        bridge.communicate()
        while any(os.path.exists(f"/proc/{pid}") for pid in robots.values()):
            time.sleep(0.05)
        second = node(ros, name, "--robots", "0-2")
        report = run.report()
    ended(second)
    player.send_signal(signal.SIGTERM)
    assert report["ticks"] == 300 and json.loads(player.communicate(timeout=60)[0])["last"] == [[0.0, 0.0]] * 3


def test_a_killed_node_changes_no_bit_of_a_run(program, name, ros, by_hand, tmp_path):
    keys = dict(ticks=20_000, clock="lockstep", timeout_s="forever", planner="greedy")
    # A robot that is slow until the nodes have been killed: the run must not end before.
    hurry = tmp_path / "hurry"
    slow_robot = (
        "import os, time\n"
        "def slowly(heading_rad, speed_mps):\n"
        f"    if not os.path.exists({str(hurry)!r}):\n"
        "        time.sleep(0.02)\n"
        "rh.Robot(name, 2, carry_out=slowly).run()"
    )
    with rh.run(name=name, out=tmp_path / "out", program=program, external=[2], **keys) as run:
        by_hand(scripts=[slow_robot])
        for _ in range(2):
            ears = listener(ros, target__pose=POSE)
            killed = node(ros, name)
            assert ears.stdout.readline() == "first\n"
            killed.kill()
            killed.communicate()
            heard(ears)
        hurry.touch()
        digest = run.report()["digest"]
    assert digest == rh.simulate(rh.Scenario(**keys)).digest


def test_simulated_robots_have_all_topics_and_the_run_ends_the_node(program, name, ros, tmp_path):
    markers, diagnostics, clock = "visualization_msgs/MarkerArray", "diagnostic_msgs/DiagnosticArray", "rosgraph_msgs/Clock"
    ears = listener(ros, "use_sim_time", team__robot_0__cmd_vel=TWIST, team__rangehound__markers=markers, diagnostics=diagnostics, clock=clock, team__target__pose=POSE)
    with rh.run(name=name, out=tmp_path / "out", program=program, ticks=100_000, clock="realtime", planner="certified") as run:
        watched = node(ros, name, "--ros-args", "-r", "__ns:=/team", "-p", "map_frame:=world", "-p", "markers_rate_hz:=1000.0")
        assert ears.stdout.readline() == "first\n"
        time.sleep(3)
        run.stop()
        output = ended(watched)
    got = heard(ears)
    if importlib.util.find_spec("tf2_msgs") is None:
        assert output.count("tf2_msgs is not installed: /tf is not published") == 1, output
    live = rh.load(tmp_path / "out")
    newest = int(round((seconds(got["/team/target/pose"][-1]) - 1.0) / 0.1))
    assert newest == len(live) - 1 and got["/team/target/pose"][0]["header"]["frame_id"] == "world"
    assert got["/clock"][-1]["clock"] == got["/team/target/pose"][-1]["header"]["stamp"]
    # A node with simulated time has that of the newest tick.
    assert got["now_s"] == pytest.approx(seconds(got["/team/target/pose"][-1]))
    twist = got["/team/robot_0/cmd_vel"][-2]
    assert twist["header"]["frame_id"] == "robot_0/base_link" and abs(twist["twist"]["angular"]["z"]) <= 2.0
    named = {(marker["ns"], marker["id"]) for marker in got["/team/rangehound/markers"][-1]["markers"]}
    assert named == {("ellipse", 0), *((kind, i) for kind in ("heading", "ray", "range") for i in range(3))}
    circle = next(one for one in got["/team/rangehound/markers"][-1]["markers"] if (one["ns"], one["id"]) == ("range", 2))
    radius = np.hypot(*(np.array([[point["x"], point["y"]] for point in circle["points"]]) - live.believed_m[newest, 2]).T)
    np.testing.assert_allclose(radius, live.range_m[newest, 2])
    states = {status["name"]: status["message"] for status in got["/diagnostics"][-1]["status"]}
    assert {"rangehound: sim", "rangehound: fusion", "rangehound: robot-2", "rangehound: estimate"} <= set(states)


def test_in_real_time_a_robot_without_odometry_stops_and_bad_ranges_are_refused(program, name, ros, tmp_path):
    """The test is the robot: it publishes odometry and ranges by the wall clock."""
    script = (
        "import json, math, signal, sys, time, rclpy\n"
        "from geometry_msgs.msg import TwistStamped\nfrom nav_msgs.msg import Odometry\nfrom sensor_msgs.msg import Range\n"
        "from rclpy.node import Node\n"
        "rclpy.init()\nnode, began, twists = Node('one'), time.monotonic(), []\n"
        "at = node.create_publisher(Odometry, 'robot_2/odom', 10)\nranged = node.create_publisher(Range, 'robot_2/range', 10)\n"
        "bad = iter([math.nan, -1.0, math.inf, 1e9] * 1000)\n"
        "def show():\n"
        "    odometry = Odometry(); odometry.header.frame_id = 'map'; odometry.header.stamp = node.get_clock().now().to_msg()\n"
        "    odometry.pose.pose.position.x = 15.0; odometry.pose.covariance[0] = odometry.pose.covariance[7] = 0.01\n"
        "    measured = Range(header=odometry.header, max_range=100.0); measured.range = next(bad)\n"
        "    ranged.publish(measured)\n"
        "    is_lost = any(twist[1] for twist in twists) and len(twists) > 60\n"
        "    if not is_lost: at.publish(odometry)\n"
        "node.create_subscription(TwistStamped, 'robot_2/cmd_vel', lambda m: twists.append((m.twist.angular.z, m.twist.linear.x)), 100)\n"
        "node.create_timer(0.05, show)\nprint('ready', flush=True)\n"
        "while time.monotonic() - began < float(sys.argv[1]): rclpy.spin_once(node, timeout_sec=0.1)\n"
        "print(json.dumps(twists))\n"
    )
    (tmp_path / "robot.py").write_text(script)
    robot = ros(tmp_path / "robot.py", "14", waits=True)
    with rh.run(name=name, out=tmp_path / "out", program=program, ticks=80, clock="realtime", external=[2]) as run:
        bridge = node(ros, name, "--robots", "2")
        report = run.report()
    output = ended(bridge)
    twists = json.loads(robot.communicate(timeout=60)[0])
    assert report["ticks"] == 80
    for cause in ("NaN", "negative", "nothing was detected", "max_range 100 m"):
        assert output.count(cause) == 1, output
    live = rh.load(tmp_path / "out")
    assert np.isnan(live.range_m[:, 2]).all() and np.nanmax(np.abs(live.believed_m[5:-3, 2] - [15.0, 0.0])) == 0.0
    assert any(twist != [0.0, 0.0] for twist in twists) and twists[-1] == [0.0, 0.0]
    # It stood still for longer than the last commands of a run: from the loss on.
    assert all(twist == [0.0, 0.0] for twist in twists[-10:]), twists[-20:]


def test_frames_are_those_of_the_target_and_of_robots_that_have_reported():
    """tf2_msgs is no wheel: a list in place of its message."""
    from types import SimpleNamespace

    from builtin_interfaces.msg import Time
    from geometry_msgs.msg import TransformStamped
    from rangehound.ros2.observer import Node, Topic

    sent = []
    publisher = SimpleNamespace(publish=lambda message: sent.extend(message.transforms), get_subscription_count=lambda: 1)
    topic = Topic(publisher, SimpleNamespace(transforms=[]))
    assert topic.look()
    frames = [TransformStamped(child_frame_id=name) for name in ("target", "robot_0/base_link", "robot_2/base_link")]
    run = rh.simulate(ticks=5)
    arrays = {name: values[3:4].copy() for name, values in run.arrays.items()}
    arrays["believed_m"][0, 2] = np.nan
    node = SimpleNamespace(_frames=(topic, frames), _facts={"has_velocity": True}, _simulated=[0, 2])
    node._target_of = lambda tick: Node._target_of(node, tick)
    Node._publish_frames(node, rh.Tick(arrays), Time(sec=7))
    assert [frame.child_frame_id for frame in sent] == ["target", "robot_0/base_link"]
    moved = sent[1].transform.translation
    assert [moved.x, moved.y] == list(run.believed_m[3, 0]) and sent[0].header.stamp.sec == 7
    assert [sent[0].transform.translation.x, sent[0].transform.translation.y] == list(run.position_m[3])


def test_the_quality_of_service_of_one_topic_is_overridden_and_no_other(ros):
    script = (
        "from rangehound.ros2.session import Session\nfrom sensor_msgs.msg import Range\nfrom rclpy.qos import qos_profile_sensor_data\n"
        "with Session('one', ['--ros-args', '-p', 'qos_overrides./robot_0/range.subscription.reliability:=reliable']) as session:\n"
        "    for robot in (0, 1): session.subscribe(Range, f'robot_{robot}/range', qos_profile_sensor_data, lambda message: None)\n"
        "    of = session.node.get_subscriptions_info_by_topic\n"
        "    print([of(f'/robot_{robot}/range')[0].qos_profile.reliability.name for robot in (0, 1)])"
    )
    out, err = ros("-c", script).communicate(timeout=60)
    assert out == "['RELIABLE', 'BEST_EFFORT']\n", err


@pytest.mark.parametrize(
    "args, cause",
    [
        (["--robots", "7"], "expected all, or robots from 0 to 2"),
        (["--ros-args", "-p", "markers_rate_hz:=-1.0"], "markers_rate_hz is -1.0: expected a finite number that is not negative"),
        (["--ros-args", "-p", "map_frame:=3"], "parameter map_frame"),
        (["--ros-args", "-r", "nonsense"], "--ros-args"),
    ],
)
def test_wrong_arguments_are_refused_with_the_cause(program, name, ros, tmp_path, args, cause):
    with rh.run(name=name, out=tmp_path / "out", program=program, ticks=10_000):
        bridge = node(ros, name, *args)
        output = ended(bridge, code=2)
    assert cause in output and "Traceback" not in output, output


def test_a_run_that_is_not_there_is_one_line_and_signals_end_the_node(program, name, ros, tmp_path):
    output = ended(node(ros, name, "--wait-s", "0.2"), code=2)
    assert f"no run {name} after 0.2 s" in output
    with rh.run(name=name, out=tmp_path / "out", program=program, ticks=10_000) as run:
        for number in (signal.SIGINT, signal.SIGTERM):
            ears = listener(ros, target__pose=POSE)
            watched = node(ros, name)
            assert ears.stdout.readline() == "first\n"
            watched.send_signal(number)
            assert "Traceback" not in ended(watched)
            assert heard(ears)["/target/pose"]
        assert run.status()["nodes"]


def test_a_late_node_publishes_what_has_been_and_all_that_it_says_is_in_the_bag(program, name, ros, tmp_path):
    """Ticks that were over before the node and its listener were there, at once; and a bag of the same run."""
    rosbags = pytest.importorskip("rosbags.highlevel", reason="the package rosbags is not installed")
    robots = {"count": 2, "localiser": "gps"}
    keys = dict(ticks=1200, dt_s=0.02, robots=robots, localiser={"gps": {"std_m": 0.3, "heading_std_rad": 0.1, "correlation_s": 5.0}})
    topics = dict(target__pose=POSE, target__odom="nav_msgs/Odometry", **{f"robot_{i}__{topic}": kind for i in range(2) for topic, kind in (("pose", POSE), ("cmd_vel", TWIST))})
    with rh.run(name=name, out=tmp_path / "out", program=program, **keys) as run:
        for tick in run.attach():
            if tick.tick >= 300:
                break
        ears = listener(ros, rangehound__markers="visualization_msgs/MarkerArray", **topics)
        watched = node(ros, name, "--from-start", "--ros-args", "-p", "markers_rate_hz:=1000.0")
        run.report()
    ended(watched)
    got = heard(ears)
    done = subprocess.run([program, "record", tmp_path / "out", "--ros2", tmp_path / "bag"], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    live = rh.load(tmp_path / "out")
    stamps = [round((seconds(pose) - 1.0) / 0.02) for pose in got["/target/pose"]]
    assert stamps[:301] == list(range(301)) and stamps == list(range(len(live)))
    del got["now_s"]
    marked = got.pop("/rangehound/markers")
    recorded = {topic: [] for topic in [*got, "/rangehound/markers"]}
    with rosbags.AnyReader([tmp_path / "bag"]) as reader:
        for connection, _, raw in reader.messages():
            if connection.topic in recorded:
                recorded[connection.topic].append(plain(reader.deserialize(raw, connection.msgtype)))
    for topic, messages in got.items():
        assert messages and messages == recorded[topic], topic
    # The node has the newest markers alone; the bag has those of each fifth tick.
    drawn = {seconds(message["markers"][0]): message for message in recorded["/rangehound/markers"]}
    both = [message for message in marked if seconds(message["markers"][0]) in drawn]
    assert both and all(message == drawn[seconds(message["markers"][0])] for message in both)


def plain(value):
    """A message of rosbags as the listener has it."""
    if hasattr(value, "__msgtype__"):
        # Constants are in capitals.
        return {key: plain(one) for key, one in vars(value).items() if not key.startswith("__") and not key.isupper()}
    if isinstance(value, list):
        return [plain(one) for one in value]
    return value.tolist() if isinstance(value, np.ndarray) else value


def test_diagnostics_name_silent_robots_and_count_rejected_measurements(program, name, ros, by_hand, tmp_path):
    """Nobody starts the killed robot again, which is one of ours. Another one measures nonsense now and then."""
    outliers = "rh.Robot(name, 2, measure=lambda robot, tick, range_m, _: range_m + (50.0 if tick % 3 == 0 else 0.0)).run()"
    ears = listener(ros, diagnostics="diagnostic_msgs/DiagnosticArray")
    keys = dict(ticks=100_000, dt_s=0.05, clock="realtime", timeout_s=1.0, filter={"gate_sigma": 4.0, "distrust": False})
    with rh.run(name=name, out=tmp_path / "out", program=program, external=[1, 2], **keys) as run:
        robot, other = by_hand(["robot", "--id", "1"], scripts=[outliers], **keys)
        watched = node(ros, name)
        assert ears.stdout.readline() == "first\n"
        robot.kill()
        robot.wait()
        killed_at = next(rh.attach(name)).tick
        for tick in rh.attach(name):
            # Diagnostics come once in a second.
            if tick.tick >= killed_at + 60:
                break
        run.stop()
        # Processes that others have started end with the run.
        assert other.wait(timeout=60) == 0
        ended(watched)
    statuses = [status for message in heard(ears)["/diagnostics"] for status in message["status"]]
    robots = [status for status in statuses if status["name"] == "rangehound: robot-1"]
    assert (robots[-2]["level"], robots[-2]["message"]) == ([2], "gone")
    assert any(status["level"] == [0] for status in statuses if status["name"] == "rangehound: robot-0")
    estimates = [{pair["key"]: pair["value"] for pair in status["values"]} for status in statuses if status["name"] == "rangehound: estimate" and status["values"]]
    assert float(estimates[-1]["range to heading, us"]) > 0 and int(estimates[-1]["missing"]) >= 1
    assert "1" in estimates[-1]["silent robots"].split()
    assert max(int(estimate["rejected since the last status"]) for estimate in estimates) > 0
