"""Live runs in Foxglove and Rerun: the messages of `run.mcap`, and a run that does not notice."""

import base64
import contextlib
import csv
import json
import re
import socket
import struct
import subprocess
import sys
import time

import numpy as np
import pytest
import rangehound as rh

pytestmark = pytest.mark.usefixtures("watchdog")

TOPICS = {
    "/world", "/range", "/heading", "/drive", "/estimate", "/truth", "/scene", "/scene/robots", "/scene/target", "/scene/estimate",
}


@pytest.fixture
def foxglove(command, name):
    """Starts the server of a run: its process, and the address that it prints."""
    pytest.importorskip("foxglove", reason="foxglove-sdk is not installed")
    pytest.importorskip("websockets", reason="websockets is not installed")

    def start(*args):
        server = command("foxglove", "--name", name, "--port", 0, *args)
        line = server.stdout.readline()
        found = re.fullmatch(rf"run {name}: in Foxglove, open the connection (ws://127.0.0.1:\d+), or https?://\S+\n", line)
        assert found, line + server.stderr.read()
        return server, found[1]

    return start


@contextlib.contextmanager
def subscribed(address, topics=TOPICS):
    """A client that has subscribed to topics, and the advertised channels by topic."""
    from websockets.sync.client import connect

    with connect(address, subprotocols=["foxglove.sdk.v1"], max_size=None, close_timeout=1) as client:
        channels = {}
        while set(channels) < topics:
            data = client.recv(timeout=60)
            if isinstance(data, str) and json.loads(data)["op"] == "advertise":
                channels.update({channel["topic"]: channel for channel in json.loads(data)["channels"]})
        wanted = [{"id": channels[topic]["id"], "channelId": channels[topic]["id"]} for topic in topics]
        client.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
        yield client, channels


def received(client, channels, enough=None):
    """Messages until there are so many, or until the server ends: topic, time in ns, bytes. Times that the server tells, too."""
    from websockets.exceptions import ConnectionClosed

    topics = {channel["id"]: topic for topic, channel in channels.items()}
    messages, times = [], []
    try:
        while enough is None or len(messages) < enough:
            data = client.recv(timeout=60)
            if isinstance(data, bytes) and data[0] == 1:
                subscription, time_ns = struct.unpack_from("<IQ", data, 1)
                messages.append((topics[subscription], time_ns, data[13:]))
            elif isinstance(data, bytes) and data[0] == 2:
                times.append(struct.unpack_from("<Q", data, 1)[0])
    except ConnectionClosed:
        pass
    return messages, times


def recorded(path):
    """The channels of a file by topic, and its messages: topic, time in ns, bytes."""
    reader = pytest.importorskip("mcap.reader", reason="mcap is not installed")
    with open(path, "rb") as file:
        mcap = reader.make_reader(file)
        channels = {channel.topic: (channel, schema) for schema, channel, _ in mcap.iter_messages()}
        return channels, [(channel.topic, message.log_time, message.data) for _, channel, message in mcap.iter_messages()]


def came_late(message):
    """True for a range that fusion took in a later tick: the file has it, a viewer of the live run has not."""
    from rangehound.rerun import decoder

    topic, time_ns, data = message
    if topic != "/range":
        return False
    number = next(i for i, channel in enumerate(rh._native.channels()) if channel[0] == topic)
    taken = decoder()(number, data)[1]
    return taken.taken_at_tick > taken.tick


def test_a_client_gets_what_the_file_has_and_the_server_ends_with_the_run(foxglove, name, program, tmp_path):
    pytest.importorskip("mcap", reason="mcap is not installed")
    with rh.run(name=name, out=tmp_path / "out", program=program, record=True, ticks=100_000, dt_s=0.05) as run:
        server, address = foxglove()
        with subscribed(address) as (client, channels):
            live, times = received(client, channels, enough=1000)
            run.stop()
            rest = received(client, channels)
        assert server.wait() == 0, server.stderr.read()
        with pytest.raises(rh.RunError, match="stopped before its last tick"):
            run.report()
    live, times = live + rest[0], times + rest[1]
    in_file, messages = recorded(tmp_path / "out/run.mcap")
    assert set(channels) == set(in_file) == TOPICS
    for topic, (channel, schema) in in_file.items():
        advertised = channels[topic]
        assert (advertised["encoding"], advertised["schemaName"]) == (channel.message_encoding, schema.name)
        assert advertised["schemaEncoding"] == schema.encoding and base64.b64decode(advertised["schema"] + "==") == schema.data

    assert {topic for topic, _, _ in live} == TOPICS
    assert times == sorted({time_ns for _, time_ns, _ in live})
    # The last tick may be missing in the file of a run that has been stopped.
    first_ns, last_ns = live[0][1], min(live[-1][1], messages[-1][1])
    expected = {message for message in messages if first_ns <= message[1] <= last_ns and not came_late(message)}
    shown = {message for message in live if message[1] <= last_ns}
    assert len(expected) > 900 and not expected - shown
    assert all(topic == "/range" for topic, _, _ in shown - expected)

    from rangehound.rerun import decoder

    number, decode = [channel[0] for channel in rh._native.channels()].index("/estimate"), decoder()
    with open(tmp_path / "out/estimate.csv", newline="") as file:
        rows = {float(row["time_s"]): row for row in csv.DictReader(file)}
    estimates = [decode(number, data)[1] for topic, _, data in live if topic == "/estimate"]
    for estimate in estimates:
        row = rows[estimate.time_s]
        assert list(estimate.state[:2]) == [float(row["x_m"]), float(row["y_m"])]
    assert len(estimates) > 50


def test_killed_servers_and_clients_that_do_not_read_change_nothing(foxglove, by_hand, name, tmp_path):
    keys = dict(ticks=1500, clock="lockstep", timeout_s="forever", planner="greedy")
    # A robot that takes its time: otherwise the run may be over before the last server has started.
    script = "import time\nrh.Robot(name, 2, carry_out=lambda heading_rad, speed_mps: time.sleep(0.004)).run()"
    nodes = by_hand(["sim"], ["fusion"], ["robot", "--id", "0"], ["robot", "--id", "1"], scripts=[script], **keys)
    for _ in range(2):
        server, address = foxglove()
        with subscribed(address) as (client, _):
            client.recv(timeout=60)
            server.kill()
            server.wait()
    server, address = foxglove()
    with subscribed(address):
        assert [node.wait() for node in nodes] == [0] * 5
        assert server.wait() == 0, server.stderr.read()
    assert rh.load(tmp_path / "out").digest == rh.simulate(rh.Scenario(**keys)).digest


def test_a_client_may_come_go_and_come_back(foxglove, name, program, tmp_path):
    with rh.run(name=name, out=tmp_path / "out", program=program, ticks=200, dt_s=0.05) as run:
        server, address = foxglove()
        last_ns = -1
        for _ in range(3):
            with subscribed(address, {"/estimate"}) as (client, _):
                data = ""
                while isinstance(data, str) or data[0] != 1:
                    data = client.recv(timeout=60)
            time_ns = struct.unpack_from("<Q", data, 5)[0]
            assert time_ns > last_ns
            last_ns = time_ns
            time.sleep(0.3)
        run.stop()
        assert server.wait() == 0, server.stderr.read()


def test_a_run_in_rerun_has_estimates_field_and_both_timelines(command, root, name, program, tmp_path):
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    from rerun.chunk import RrdReader

    scenario, file = rh.Scenario(root / "scenarios/mixed_sensors.toml", ticks=100_000, dt_s=0.05), tmp_path / "run.rrd"
    with rh.run(scenario, name=name, out=tmp_path / "out", program=program) as run:
        viewer = command("rerun", "--name", name, "--save", file)
        assert viewer.stdout.readline() == f"run {name}: writes {file}: open it with `rerun {file}`\n", viewer.stderr.read()
        for tick in run.attach(from_start=True):
            if tick.tick == 60:
                break
        run.stop()
        out, err = viewer.communicate()
        assert (viewer.returncode, out) == (0, ""), err
        with pytest.raises(rh.RunError, match="stopped before its last tick"):
            run.report()
    finished = rh.load(tmp_path / "out")
    columns = {}
    for chunk in RrdReader(file).stream().to_chunks():
        if chunk.is_static:
            continue
        batch = chunk.to_record_batch().to_pydict()
        columns.setdefault(chunk.entity_path, []).append(batch)
    shown = set(columns)
    assert {"/field/target/balls", "/field/estimate/balls", "/field/estimate/ellipses", "/field/robots/arrows", "/field/ranges/lines", "/field/bearings/lines", "/field/trail/lines"} <= shown

    def series(path):
        points = {}
        for batch in columns[path]:
            assert {"tick", "run_time"} <= set(batch)
            value = next(key for key in batch if "scalars" in key.lower())
            points.update({tick: number[0] for tick, number in zip(batch["tick"], batch[value])})
        return points

    def newest(path, component):
        batch = max(columns[path], key=lambda batch: batch["tick"][-1])
        return batch["tick"][-1], np.array(batch[component][-1])

    tick, arrows_m = newest("/field/robots/arrows", "Arrows3D:origins")
    np.testing.assert_allclose(arrows_m[:, :2], finished.robot_m[tick], rtol=1e-6)
    tick, half_sizes_m = newest("/field/estimate/ellipses", "Ellipsoids3D:half_sizes")
    variances_m2 = np.linalg.eigvalsh(finished.covariance[tick, :2, :2])
    np.testing.assert_allclose(np.sort(half_sizes_m[0, :2]), 3 * np.sqrt(variances_m2), rtol=1e-5)

    for path, expected in (("/error_m", finished.error_m), ("/position_trace_m2", finished.position_trace_m2)):
        points = series(path)
        assert set(range(59)) <= set(points)
        np.testing.assert_allclose([points[tick] for tick in range(59)], expected[:59], rtol=1e-12)


def test_faults_of_viewers_are_one_line(command, name, python, tmp_path):
    def error_of(*args):
        process = command(*args)
        out, err = process.communicate()
        assert (process.returncode, out, err.count("\n")) == (2, "", 1), (args, out, err)
        return err

    for viewer, package in (("foxglove", "foxglove"), ("rerun", "rerun")):
        hidden = f"import sys, runpy; sys.modules['{package}'] = None; sys.argv[1:] = ['--name', 'x']; runpy.run_module('rangehound.{viewer}', run_name='__main__')"
        done = python(hidden)
        assert done.returncode == 2 and done.stderr == f"python -m rangehound.{viewer}: {package} is not installed: install it with pip install 'rangehound[{viewer}]'\n"
        assert "--name" in error_of(viewer)
    pytest.importorskip("foxglove", reason="foxglove-sdk is not installed")
    assert error_of("foxglove", "--name", name).endswith(f"no run {name} after 10 s: expected a run that has been started\n")
    assert "name" in error_of("foxglove", "--name", "a/b")
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    there = tmp_path / "there.rrd"
    there.write_text("mine")
    assert "exists already (--save)" in error_of("rerun", "--name", name, "--save", there)


def test_a_viewer_that_is_not_there_is_one_line(command, name, program, tmp_path):
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    with rh.run(name=name, out=tmp_path / "out", program=program, ticks=100_000):
        for args in (["--connect", "rerun+http://127.0.0.1:1/proxy"], ["--connect", "nowhere"], ["--save", "/none/x.rrd"]):
            viewer = command("rerun", "--name", name, *args)
            _, err = viewer.communicate()
            lines = [line for line in err.splitlines() if line.startswith("python -m")]
            assert viewer.returncode == 2 and len(lines) == 1 and "cannot use Rerun: " in lines[0] and lines[0].endswith(": expected a viewer, or a file that can be written"), err


@pytest.mark.parametrize("answer, says", [(b"", "has not answered as a viewer does for 5 s"), (b"HTTP/1.1 400 Bad Request\r\n\r\n", "does not answer as a viewer does")])
def test_an_address_that_is_no_viewer_is_one_line(command, name, program, tmp_path, answer, says):
    """It accepts the connection, and says nothing, or something else."""
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    with socket.create_server(("127.0.0.1", 0)) as other, rh.run(name=name, out=tmp_path / "out", program=program, ticks=100_000):
        viewer = command("rerun", "--name", name, "--connect", f"rerun+http://127.0.0.1:{other.getsockname()[1]}/proxy")
        line, _ = other.accept()
        with line:
            line.sendall(answer)
            _, err = viewer.communicate()
    lines = [line for line in err.splitlines() if line.startswith("python -m")]
    assert viewer.returncode == 2 and len(lines) == 1 and says in lines[0], err


def test_a_viewer_that_takes_nothing_does_not_hold_the_command(command, name, program, tmp_path):
    """It answers as HTTP/2 does, and then says nothing."""
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    with socket.create_server(("127.0.0.1", 0)) as other, rh.run(name=name, out=tmp_path / "out", program=program, ticks=100_000, clock="realtime") as run:
        viewer = command("rerun", "--name", name, "--connect", f"rerun+http://127.0.0.1:{other.getsockname()[1]}/proxy")
        lines = []
        # The first one only looks whether there is a viewer.
        for _ in range(2):
            lines.append(other.accept()[0])
            lines[-1].sendall(bytes([0, 0, 0, 4, 0, 0, 0, 0, 0]))
        # Some ticks that it does not take.
        time.sleep(1)
        run.stop()
        _, err = viewer.communicate()
        for line in lines:
            line.close()
    complaints = [line for line in err.splitlines() if line.startswith("python -m")]
    assert viewer.returncode == 1 and len(complaints) == 1 and "has not taken all ticks" in complaints[0], err


def test_a_port_that_is_taken_is_one_line(foxglove, command, name, program, tmp_path):
    with rh.run(name=name, out=tmp_path / "out", program=program, ticks=100_000):
        _, address = foxglove()
        second = command("foxglove", "--name", name, "--port", address.rpartition(":")[2])
        _, err = second.communicate()
        assert second.returncode == 2 and err.count("\n") == 1 and "expected a free port" in err


def test_a_viewer_that_starts_late_is_found_and_gets_the_run(command, name, program, tmp_path):
    """A viewer without a screen, which listens only after the command has asked for it."""
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    script = (
        "import sys, rerun\n"
        "recording = rerun.RecordingStream('viewer')\n"
        "print('ready', flush=True)\n"
        "sys.stdin.readline()\n"
        f"print(recording.serve_grpc(grpc_port={port}), flush=True)\n"
        "sys.stdin.read()\n"
    )
    pipes = dict(stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    with rh.run(name=name, out=tmp_path / "out", program=program, ticks=100_000, clock="realtime") as run:
        with subprocess.Popen([sys.executable, "-c", script], cwd="/", **pipes) as server:
            assert server.stdout.readline() == "ready\n"
            viewer = command("rerun", "--name", name, "--connect", f"rerun+http://127.0.0.1:{port}/proxy")
            time.sleep(2.5)
            assert viewer.poll() is None, viewer.stderr.read()
            server.stdin.write("now\n")
            server.stdin.flush()
            assert str(port) in server.stdout.readline()
            assert viewer.stdout.readline() == f"run {name}: sends to the viewer at rerun+http://127.0.0.1:{port}/proxy\n", viewer.stderr.read()
            run.stop()
            _, err = viewer.communicate()
            server.stdin.close()
    assert viewer.returncode == 0, err
