#!/usr/bin/env python3
"""Tests of bag_to_csv.py with bags that it makes itself, in both storage formats. Needs the package rosbags."""

from __future__ import annotations

import contextlib
import io
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path
from types import SimpleNamespace

import numpy
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import bag_to_csv

SCRIPT = Path(__file__).with_name("bag_to_csv.py")
STORE = get_typestore(Stores.ROS2_HUMBLE)
STORE.register(get_types_from_msg("string anchor_id\nuint32 distance\n", "uwb_msgs/msg/One"))
STORE.register(
    get_types_from_msg(
        "std_msgs/Header header\nuwb_msgs/One[] ranges\nfloat32[] distances_m\nint32[] ids\n", "uwb_msgs/msg/Many"
    )
)
TYPES = STORE.types
BOTH = [StoragePlugin.SQLITE3, StoragePlugin.MCAP]


def header(time_ns: int, frame: str):
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=time_ns // 10**9, nanosec=time_ns % 10**9)
    return TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def one_range(time_ns: int, frame: str, range_m: float):
    kind = TYPES["sensor_msgs/msg/Range"]
    extra = {"variance": 0.0} if "variance" in kind.__dataclass_fields__ else {}
    return kind(header(time_ns, frame), radiation_type=0, field_of_view=0.0, min_range=0.1, max_range=50.0, range=range_m, **extra)


def many_ranges(time_ns: int, ranges: dict[str, int]):
    one = TYPES["uwb_msgs/msg/One"]
    return TYPES["uwb_msgs/msg/Many"](
        header(time_ns, "tag"),
        ranges=[one(anchor_id=name, distance=mm) for name, mm in ranges.items()],
        distances_m=numpy.array([mm / 1000 for mm in ranges.values()], dtype=numpy.float32),
        ids=numpy.array([int(name, 16) for name in ranges], dtype=numpy.int32),
    )


def odometry(time_ns: int, x_m: float, y_m: float):
    geometry = {name: TYPES[f"geometry_msgs/msg/{name}"] for name in ("Point", "Quaternion", "Pose", "PoseStamped")}
    pose = geometry["Pose"](geometry["Point"](x_m, y_m, 0.5), geometry["Quaternion"](0.0, 0.0, 0.0, 1.0))
    return geometry["PoseStamped"](header(time_ns, "map"), pose)


class BagToCsv(unittest.TestCase):
    """Each test makes a bag, runs the script and looks at what it wrote."""

    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name)

    def bag(self, storage: StoragePlugin, messages: list[tuple[str, int, object]]) -> Path:
        path = self.folder / f"bag-{storage.name.lower()}"
        with Writer(path, version=9, storage_plugin=storage) as writer:
            connections = {}
            for topic, log_ns, message in messages:
                kind = message.__msgtype__
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
                writer.write(connections[topic], log_ns, STORE.serialize_cdr(message, kind))
        return path

    def run_script(self, *words: str | Path) -> SimpleNamespace:
        # In this process: to import rosbags takes longer than all else.
        with contextlib.redirect_stdout(io.StringIO()) as stdout, contextlib.redirect_stderr(io.StringIO()) as stderr:
            code = bag_to_csv.main([str(word) for word in words])
        return SimpleNamespace(returncode=code, stdout=stdout.getvalue(), stderr=stderr.getvalue())

    def csv(self, *words: str | Path) -> list[str]:
        done = self.run_script(*words)
        self.assertEqual(done.returncode, 0, done)
        return done.stdout.splitlines()

    def assert_refused(self, expected: str, *words: str | Path) -> None:
        done = self.run_script(*words)
        self.assertEqual((done.returncode, done.stdout), (2, ""), done)
        self.assertEqual(len(done.stderr.splitlines()), 1, done)
        self.assertIn(expected, done.stderr)

    def test_ranges_of_the_standard_type_need_a_topic_only(self):
        messages = [
            ("/uwb/range", 2_000, one_range(1_700_000_000_250_000_000, "anchor-1", 2.5)),
            ("/uwb/range", 1_000, one_range(1_700_000_000_000_000_001, "022E", 3.25)),
            ("/uwb/range", 3_000, one_range(1_700_000_000_500_000_000, "022E", float("inf"))),
            ("/uwb/range", 4_000, one_range(1_700_000_000_500_000_000, "022E", 60.0)),
        ]
        for storage in BOTH:
            bag = self.bag(storage, messages)
            expected = [
                "time_s,sensor_id,range_m",
                "1700000000.000000001,022E,3.250000",
                "1700000000.250000000,anchor-1,2.500000",
            ]
            self.assertEqual(self.csv(bag, "--topic", "/uwb/range"), expected, storage)
            done = self.run_script(bag, "--topic", "/uwb/range")
            self.assertIn("2 ranges of 2 sensors", done.stderr)
            self.assertIn("left out: 2 x outside", done.stderr)
            logged = self.csv(bag, "--topic", "/uwb/range", "--stamp", "log")
            self.assertEqual(logged[1:], ["0.000001000,022E,3.250000", "0.000002000,anchor-1,2.500000"], storage)

    def test_arrays_of_ones_own_messages_with_anchors_apart(self):
        messages = [
            ("/tag", 1, many_ranges(1_000_000_000, {"0A": 1500, "0B": 2500})),
            ("/tag", 2, many_ranges(1_100_000_000, {"0A": 0, "0C": 3000})),
        ]
        anchors = self.folder / "anchors.csv"
        anchors.write_text("sensor_id,x_m,y_m,z_m\n0A,1,2,3\n0B,4,5,6\n", encoding="utf-8")
        for storage in BOTH:
            bag = self.bag(storage, messages)
            words = [bag, "--topic", "/tag", "--range", "ranges[].distance", "--unit", "mm", "--sensor", "ranges[].anchor_id"]
            expected = [
                "time_s,sensor_id,sensor_x_m,sensor_y_m,sensor_z_m,range_m",
                "1.000000000,0A,1.000000,2.000000,3.000000,1.500000",
                "1.000000000,0B,4.000000,5.000000,6.000000,2.500000",
            ]
            self.assertEqual(self.csv(*words, "--anchors", anchors), expected, storage)
            done = self.run_script(*words, "--anchors", anchors)
            self.assertIn("left out: 1 x no range", done.stderr)
            self.assertIn("left out: 1 x sensors that are not in", done.stderr)
            words = [bag, "--topic", "/tag", "--range", "distances_m[]"]
            self.assertEqual(self.csv(*words, "--sensor", "ids[]")[1], "1.000000000,10,1.500000", storage)
            self.assertEqual(self.csv(*words, "--sensor", "index")[2], "1.000000000,1,2.500000", storage)
            words = [bag, "--topic", "/tag", "--range", "distances_m[1]", "--sensor", "=left"]
            self.assertEqual(self.csv(*words)[1:], ["1.000000000,left,2.500000", "1.100000000,left,3.000000"], storage)
            listed = self.csv(bag, "--list")
            self.assertEqual(listed, ["/tag\tuwb_msgs/msg/Many\t2\tranges[].distance, distances_m[]"], storage)

    def test_the_program_itself(self):
        bag = self.bag(StoragePlugin.MCAP, [("/range", 1, one_range(1_000, "a", 2.0))])
        out = self.folder / "ranges.csv"
        words = [sys.executable, SCRIPT, bag, "--topic", "/range", "--out", out]
        for code, told in [(0, "1 ranges of 1 sensors"), (2, "exists")]:
            done = subprocess.run(words, capture_output=True, text=True, check=False)
            self.assertEqual((done.returncode, done.stdout), (code, ""), done)
            self.assertIn(told, done.stderr)
        self.assertEqual(out.read_text(encoding="utf-8").splitlines()[1], "0.000001000,a,2.000000")
        done = subprocess.run([sys.executable, SCRIPT, "--help"], capture_output=True, text=True, check=False)
        self.assertEqual(done.returncode, 0)
        self.assertIn("--anchors FILE", done.stdout)

    def test_a_moving_sensor_is_where_another_topic_says(self):
        messages = [
            ("/range", 1, one_range(1_000, "beacon", 2.0)),
            ("/pose", 2, odometry(2_000, 1.0, -2.0)),
            ("/range", 3, one_range(3_000, "beacon", 2.5)),
        ]
        bag = self.bag(StoragePlugin.MCAP, messages)
        rows = self.csv(bag, "--topic", "/range", "--position", "/pose:pose.position")
        self.assertEqual(rows[1:], ["0.000003000,beacon,1.000000,-2.000000,0.500000,2.500000"])

    def test_one_file_of_a_bag_is_enough(self):
        for storage, pattern in [(StoragePlugin.SQLITE3, "*.db3"), (StoragePlugin.MCAP, "*.mcap")]:
            bag = self.bag(storage, [("/range", 1, one_range(1_000, "a", 2.0))])
            (file,) = bag.glob(pattern)
            alone = self.folder / file.name
            alone.write_bytes(file.read_bytes())
            self.assertEqual(len(self.csv(alone, "--topic", "/range")), 2, storage)

    def test_mistakes_are_told_in_one_line(self):
        messages = [("/tag", 1, many_ranges(0, {"0A": 1500})), ("/range", 1, one_range(1_000, "a", 2.0))]
        bag = self.bag(StoragePlugin.SQLITE3, messages)
        exists = self.folder / "exists.csv"
        exists.write_text("kept", encoding="utf-8")
        tag = [bag, "--topic", "/tag"]
        for expected, words in [
            ("no such bag", [self.folder / "none"]),
            ("expected --topic", [bag]),
            ("no topic /x in the bag; it has /range, /tag", [bag, "--topic", "/x"]),
            ("needs --range FIELD", tag),
            ("needs --sensor FIELD", [*tag, "--range", "distances_m[]"]),
            ("--unit m, --unit cm or --unit mm", [*tag, "--range", "ranges[].distance", "--sensor", "ids[]"]),
            ("no field x", [*tag, "--range", "ranges[].x", "--unit", "m", "--sensor", "ids[]"]),
            ("write distances_m[]", [*tag, "--range", "distances_m", "--sensor", "=a"]),
            ("has no element 7", [*tag, "--range", "distances_m[7]", "--sensor", "=a"]),
            ("expected a path", [*tag, "--range", "header..b", "--unit", "m", "--sensor", "=a"]),
            ("never set", [*tag, "--range", "distances_m[]", "--sensor", "=a"]),
            ("expected a field of type", [*tag, "--range", "distances_m[]", "--sensor", "=a", "--stamp", "ids[]"]),
            ("exists", [bag, "--topic", "/range", "--out", exists]),
            ("expected TYPE=FILE", [bag, "--topic", "/range", "--msg", "x"]),
        ]:
            with self.subTest(expected):
                self.assert_refused(expected, *words)
        self.assertEqual(exists.read_text(encoding="utf-8"), "kept")
        (file,) = bag.glob("*.db3")
        file.write_bytes(file.read_bytes()[:5000])
        self.assert_refused("bag", bag, "--topic", "/range")


if __name__ == "__main__":
    unittest.main()
