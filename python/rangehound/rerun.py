"""A live run in Rerun: `python -m rangehound.rerun --name RUN`.

It shows the messages of `run.mcap`: those of `/scene` in the field, and the error and the trace over time.
"""

from __future__ import annotations

import argparse
import atexit
import contextlib
import os
import socket
import ssl
import time
import urllib.parse
from typing import Any, Callable

import numpy as np

from . import _command, _native

#: Kinds of lines in a `foxglove.LinePrimitive`.
LINE_STRIP, LINE_LOOP, LINE_LIST = range(3)

#: How long the trails stay visible, s.
TRAIL_S = 5.0

#: The usual port of a viewer, and how long one may take to answer, s.
VIEWER_PORT, CONNECT_S = 9876, 5.0

#: Time between two attempts to reach a viewer that does not listen yet, s.
RETRY_S = 0.1

#: The first words of a client of HTTP/2, which has no settings; the length of a frame's head, and its type in the answer.
HTTP2_HELLO = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes([0, 0, 0, 4, 0, 0, 0, 0, 0])
HTTP2_HEAD_LEN, HTTP2_SETTINGS = 9, b"\x04"

#: How long a viewer may take to get the last ticks, s.
FLUSH_S = 10.0


def parser() -> _command.Parser:
    flags = _command.Parser(
        "rerun",
        "Shows a live run in the Rerun viewer, from its first tick on. It ends with the run; the viewer stays.",
        "examples:\n  python -m rangehound.rerun --name demo                        starts a viewer\n"
        "  python -m rangehound.rerun --name demo --save demo.rrd        writes a file, for `rerun demo.rrd`\n"
        "  python -m rangehound.rerun --name demo --connect rerun+http://127.0.0.1:9876/proxy",
    )
    where = flags.add_mutually_exclusive_group()
    where.add_argument("--save", metavar="FILE", help="write a file instead of starting a viewer")
    where.add_argument("--connect", metavar="URL", help="send to a viewer that runs already")
    return flags


def show(flags: argparse.Namespace) -> None:
    """Shows a run until its end."""
    rerun = _command.needed("rerun", "rerun")
    decode = decoder()
    if flags.save and os.path.exists(flags.save):
        raise _native.InputError(f"{flags.save} exists already (--save): expected the name of a new file")
    stream = _native.MessageStream(flags.name, _command.WAIT_S)
    recording = rerun.RecordingStream(f"rangehound {flags.name}")
    try:
        if flags.save:
            recording.save(flags.save)
            print(f"run {flags.name}: writes {flags.save}: open it with `rerun {flags.save}`", flush=True)
        else:
            if not flags.connect:
                recording.spawn(port=VIEWER_PORT, connect=False)
            url = flags.connect or f"rerun+http://127.0.0.1:{VIEWER_PORT}/proxy"
            # Before Rerun connects: with what does not answer it would wait for ever.
            expect_viewer(url)
            recording.connect_grpc(url)
            print(f"run {flags.name}: sends to the viewer at {url}", flush=True)
    except (OSError, RuntimeError, ValueError) as error:
        message = " ".join(str(error).split())
        raise _native.InputError(f"cannot use Rerun: {message}: expected a viewer, or a file that can be written") from error
    recording.send_blueprint(blueprint(rerun))
    picture = Picture(rerun, recording)
    _command.give_way()
    try:
        for time_ns, messages in stream:
            picture.add(time_ns, [decode(channel, message) for channel, message in messages])
    finally:
        try:
            recording.flush(timeout_sec=FLUSH_S)
        except (OSError, RuntimeError, ValueError) as error:
            # The end of this recording, also by its destructor, would wait for this viewer for ever.
            atexit.register(lambda _: os._exit(1), recording)
            raise _native.RunError(f"the viewer has not taken all ticks: {' '.join(str(error).split())}") from error
        recording.disconnect()


def expect_viewer(url: str) -> None:
    """Raises `OSError` if nothing at the address of a viewer speaks HTTP/2, as viewers do. A viewer may just be starting."""
    place = urllib.parse.urlsplit(url)
    if place.scheme not in ("rerun", "rerun+http", "rerun+https"):
        raise ValueError(f"{url} is no address such as rerun+http://127.0.0.1:{VIEWER_PORT}/proxy")
    until_s = time.monotonic() + CONNECT_S
    with contextlib.ExitStack() as opened:
        line = opened.enter_context(connected((place.hostname or "127.0.0.1", place.port or VIEWER_PORT), until_s))
        if place.scheme != "rerun+http":
            # Rerun itself looks at the certificate.
            context = ssl.create_default_context()
            context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
            context.set_alpn_protocols(["h2"])
            line = opened.enter_context(context.wrap_socket(line, server_hostname=place.hostname))
        line.sendall(HTTP2_HELLO)
        head = b""
        while len(head) < HTTP2_HEAD_LEN:
            line.settimeout(max(until_s - time.monotonic(), 1e-3))
            try:
                head += (received := line.recv(HTTP2_HEAD_LEN - len(head)))
            except TimeoutError:
                raise OSError(f"{place.netloc} has not answered as a viewer does for {CONNECT_S:.0f} s") from None
            if not received:
                break
        if head[3:4] != HTTP2_SETTINGS:
            raise OSError(f"{place.netloc} does not answer as a viewer does")


def connected(address: tuple[str, int], until_s: float) -> socket.socket:
    """A connection to an address that refuses it for a while."""
    while True:
        try:
            return socket.create_connection(address, timeout=CONNECT_S)
        except ConnectionRefusedError:
            if time.monotonic() >= until_s:
                raise
            time.sleep(RETRY_S)


def decoder() -> Callable[[int, bytes], tuple[str, Any]]:
    """A function that decodes a message of a channel by the channel's schema, and returns it after its topic."""
    pools = _command.needed("google.protobuf.descriptor_pool", "rerun")
    from google.protobuf import descriptor_pb2, message_factory

    kinds = []
    for topic, _, name, _, schema in _native.channels():
        pool = pools.DescriptorPool()
        for file in descriptor_pb2.FileDescriptorSet.FromString(schema).file:
            pool.Add(file)
        kinds.append((topic, message_factory.GetMessageClass(pool.FindMessageTypeByName(name))))

    def decode(channel: int, message: bytes) -> tuple[str, Any]:
        topic, kind = kinds[channel]
        return topic, kind.FromString(message)

    return decode


def blueprint(rerun: Any) -> Any:
    """The field beside the error and the trace."""
    views = rerun.blueprint
    past = rerun.VisibleTimeRange(
        "run_time",
        start=rerun.TimeRangeBoundary.cursor_relative(seconds=-TRAIL_S),
        end=rerun.TimeRangeBoundary.cursor_relative(),
    )
    field = views.Spatial3DView(
        origin="/field", name="field", overrides={"/field/trail/lines": views.VisibleTimeRanges([past])}
    )
    curves = [views.TimeSeriesView(origin=f"/{name}", name=name) for name in ("error_m", "position_trace_m2")]
    return views.Blueprint(views.Horizontal(field, views.Vertical(*curves)), views.TimePanel(timeline="run_time"))


class Picture:
    """Logs ticks on the timelines `tick` and `run_time`."""

    def __init__(self, rerun: Any, recording: Any) -> None:
        self.rerun, self.recording = rerun, recording
        self.shown: set[str] = set()
        recording.log("field", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)

    def add(self, time_ns: int, messages: list[tuple[str, Any]]) -> None:
        """Adds a tick: each message with its topic."""
        one_each = dict(messages)
        estimate, truth = one_each["/estimate"], one_each.get("/truth")
        self.recording.set_time("tick", sequence=estimate.tick)
        self.recording.set_time("run_time", duration=np.timedelta64(time_ns, "ns"))
        n = len(estimate.state)
        self.scalar("position_trace_m2", estimate.covariance[0] + estimate.covariance[n + 1])
        if truth is not None:
            self.scalar("error_m", float(np.hypot(estimate.state[0] - truth.state[0], estimate.state[1] - truth.state[1])))
        if "/scene" in one_each:
            for entity in one_each["/scene"].entities:
                self.entity(entity)

    def scalar(self, path: str, value: float) -> None:
        self.recording.log(path, self.rerun.Scalars(value))

    def entity(self, entity: Any) -> None:
        """Logs an object of the scene. Objects with a lifetime are numbered: here all of a kind are one."""
        path = "field/" + (entity.id.split()[0] if entity.HasField("lifetime") else entity.id)
        opaque = [ball for ball in entity.spheres if ball.color.a == 1.0]
        clear = [ball for ball in entity.spheres if ball.color.a < 1.0]
        fill = self.rerun.components.FillMode
        self.part(path + "/balls", opaque, lambda parts: ellipsoids(self.rerun, parts, fill.Solid))
        # A flat ellipsoid that is drawn as lines is an ellipse.
        self.part(path + "/ellipses", clear, lambda parts: ellipsoids(self.rerun, parts, fill.MajorWireframe))
        self.part(path + "/arrows", entity.arrows, lambda parts: arrows(self.rerun, parts))
        self.part(path + "/names", entity.texts, lambda parts: names(self.rerun, parts))
        self.part(path + "/lines", entity.lines, lambda parts: lines(self.rerun, parts))

    def part(self, path: str, primitives: Any, drawn: Callable[[Any], Any]) -> None:
        """Logs primitives of one kind. Where there are none any more, that replaces what was shown before."""
        if primitives or path in self.shown:
            self.shown.add(path)
            self.recording.log(path, drawn(primitives))


def ellipsoids(rerun: Any, spheres: Any, fill: Any) -> Any:
    return rerun.Ellipsoids3D(
        centers=[position(sphere.pose) for sphere in spheres],
        half_sizes=[[sphere.size.x / 2, sphere.size.y / 2, sphere.size.z / 2] for sphere in spheres],
        quaternions=[rerun.Quaternion(xyzw=quaternion(sphere.pose)) for sphere in spheres],
        colors=[rgba(sphere.color) for sphere in spheres],
        fill_mode=fill,
    )


def arrows(rerun: Any, primitives: Any) -> Any:
    return rerun.Arrows3D(
        origins=[position(arrow.pose) for arrow in primitives],
        vectors=[vector(arrow) for arrow in primitives],
        radii=[arrow.shaft_diameter / 2 for arrow in primitives],
        colors=[rgba(arrow.color) for arrow in primitives],
    )


def names(rerun: Any, texts: Any) -> Any:
    return rerun.Points3D(
        [position(text.pose) for text in texts],
        labels=[text.text for text in texts],
        colors=[rgba(text.color) for text in texts],
        radii=0.0,
    )


def lines(rerun: Any, primitives: Any) -> Any:
    strips = [(strip, rgba(line.color)) for line in primitives for strip in strips_of(line)]
    return rerun.LineStrips3D(
        [strip for strip, _ in strips], colors=[color for _, color in strips], radii=rerun.Radius.ui_points(1.0)
    )


def position(pose: Any) -> list[float]:
    return [pose.position.x, pose.position.y, pose.position.z]


def quaternion(pose: Any) -> list[float]:
    return [pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w]


def vector(arrow: Any) -> list[float]:
    """The arrow from its tail to its tip. It turns about the vertical axis only."""
    angle = 2 * np.arctan2(arrow.pose.orientation.z, arrow.pose.orientation.w)
    length = arrow.shaft_length + arrow.head_length
    return [length * np.cos(angle), length * np.sin(angle), 0.0]


def strips_of(line: Any) -> list[list[list[float]]]:
    """A line as strips of points."""
    points = [[point.x, point.y, point.z] for point in line.points]
    if line.type == LINE_LIST:
        return [points[i : i + 2] for i in range(0, len(points) - 1, 2)]
    return [points + points[:1] if line.type == LINE_LOOP else points]


def rgba(color: Any) -> list[int]:
    return [round(255 * part) for part in (color.r, color.g, color.b, color.a)]


if __name__ == "__main__":
    _command.run(parser(), show)
