#!/usr/bin/env python3
"""Write the ranges of a ROS 2 bag (MCAP or sqlite3) as a CSV file that `rangehound track` reads.

    pip install rosbags
    bag_to_csv.py BAG --list
    bag_to_csv.py BAG --topic /uwb/range --out ranges.csv
    bag_to_csv.py BAG --topic /uwb/ranging --range 'ranges[].distance' --unit mm \\
        --sensor 'ranges[].anchor_id' --anchors anchors.csv --out ranges.csv

BAG is the bag's folder (or one .mcap or .db3 file of it). The first command lists topics whose messages have fields
that look like ranges, the second is enough for sensor_msgs/Range, the third is for a message of one's own.

Fields are paths from the message: `header.stamp`, `ranges[].distance` (each element of an array), `distances[2]`
(one of them). Where --range goes through an array, --sensor and --position may go through arrays of the same length,
or have one value for all.
"""

from __future__ import annotations

import argparse
import csv
import math
import re
import sys
from pathlib import Path

LENGTHS_M = {"m": 1.0, "cm": 0.01, "mm": 0.001}
RANGE_TYPE = "sensor_msgs/msg/Range"
LOOKS_LIKE_RANGE = re.compile(r"(range|dist|distance|ranging)s?(_m|_cm|_mm)?$", re.IGNORECASE)


class Problem(Exception):
    """What is wrong, in one line for the user."""


def arguments(argv: list[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="bag_to_csv.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    add("bag", type=Path, help="folder of a rosbag2, or one .mcap or .db3 file")
    add("--list", action="store_true", help="list topics, types, message counts and range-like fields")
    add("--topic", action="append", default=[], help="topic with ranges; may be given several times")
    add("--range", metavar="FIELD", help="field with the range [sensor_msgs/Range: range]")
    add("--unit", choices=LENGTHS_M, help="unit of the range; needed unless the type or the field's name says it")
    add(
        "--sensor",
        metavar="FIELD",
        help="field with the sensor's name, or `topic`, or `index` (place in the array), or =NAME "
        "[sensor_msgs/Range: header.frame_id]",
    )
    add("--stamp", metavar="FIELD", default="header.stamp", help="field with the time, or `log` for the time of recording [header.stamp]")
    add(
        "--position",
        metavar="[TOPIC:]FIELD",
        help="where the sensor was, m: a field with x, y and maybe z; of another topic, its newest message counts",
    )
    add("--anchors", type=Path, metavar="FILE", help="where the sensors are: CSV with sensor_id,x_m,y_m[,z_m]")
    add("--msg", action="append", default=[], metavar="TYPE=FILE", help="definition of a message type that an old sqlite3 bag does not hold, such as my_msgs/msg/Uwb=Uwb.msg")
    add("--out", type=Path, metavar="FILE", help="the CSV file; it must not exist [standard output]")
    return parser.parse_args(argv)


def open_bag(path: Path, definitions: list[str]):
    """A reader of the bag, not yet opened."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError:
        raise Problem("needs the Python package rosbags: pip install rosbags") from None
    if not path.exists():
        raise Problem(f"{path}: no such bag")
    store = get_typestore(Stores.LATEST)
    for definition in definitions:
        name, separator, file = definition.partition("=")
        if not separator:
            raise Problem(f"--msg {definition}: expected TYPE=FILE")
        store.register(get_types_from_msg(Path(file).read_text(encoding="utf-8"), name))
    return AnyReader([path], default_typestore=store)


def values(message: object, path: str) -> list | object:
    """The value of a field, or a list of values where the path goes through an array."""
    found, is_list = [message], False
    for part in path.split("."):
        match = re.fullmatch(r"(\w+)(?:\[(\d*)\])?", part)
        if match is None:
            raise Problem(f"{path}: expected a path of fields such as header.frame_id or ranges[].distance")
        name, index = match.groups()
        for value in found:
            if not hasattr(value, name):
                fields = [name for name in getattr(value, "__dataclass_fields__", {}) if not name.startswith("__")]
                fields = ", ".join(fields) or "none"
                raise Problem(f"{path}: no field {name}; the fields there are: {fields}")
        found = [getattr(value, name) for value in found]
        if index is None:
            continue
        if not all(hasattr(value, "__len__") and not isinstance(value, str) for value in found):
            raise Problem(f"{path}: {name} is no array")
        if index == "":
            found, is_list = [item for value in found for item in value], True
        else:
            if any(len(value) <= int(index) for value in found):
                raise Problem(f"{path}: {name} has no element {index} in some message")
            found = [value[int(index)] for value in found]
    return found if is_list else found[0]


def each(value: object, count: int, path: str) -> list:
    """One value for each range."""
    if not isinstance(value, list):
        return [value] * count
    if len(value) != count:
        raise Problem(f"{path}: {len(value)} values for {count} ranges of one message")
    return value


def number(value: object, path: str) -> float:
    """A number, or a clear complaint: an array without [] is none."""
    if hasattr(value, "__len__"):
        raise Problem(f"{path}: expected a number; for each element of an array write {path}[]")
    try:
        return float(value)
    except (TypeError, ValueError):
        raise Problem(f"{path}: expected a number, got {value!r:.40}") from None


def stamp_ns(message: object, path: str, log_ns: int) -> int:
    """When a message was measured, ns."""
    if path == "log":
        return log_ns
    value = values(message, path)
    if hasattr(value, "sec") and hasattr(value, "nanosec"):
        return int(value.sec) * 1_000_000_000 + int(value.nanosec)
    raise Problem(f"--stamp {path}: expected a field of type builtin_interfaces/Time, or log")


def point(value: object, path: str) -> tuple[float, ...]:
    """x, y and maybe z of a field."""
    names = [name for name in "xyz" if hasattr(value, name)]
    if names[:2] != ["x", "y"]:
        raise Problem(f"--position {path}: expected a field with x and y, such as pose.pose.position")
    return tuple(number(getattr(value, name), f"{path}.{name}") for name in names)


def read_anchors(path: Path) -> dict[str, tuple[float, ...]]:
    """Where each sensor is."""
    with path.open(encoding="utf-8-sig", newline="") as file:
        reader = csv.DictReader(file, skipinitialspace=True)
        columns = reader.fieldnames or []
        if missing := {"sensor_id", "x_m", "y_m"} - set(columns):
            raise Problem(f"{path}: expected columns sensor_id,x_m,y_m[,z_m]; missing: {', '.join(sorted(missing))}")
        names = [name for name in ("x_m", "y_m", "z_m") if name in columns]
        anchors = {}
        for row in reader:
            try:
                position = tuple(float(row[name]) for name in names)
            except (TypeError, ValueError):
                raise Problem(f"{path}: line {reader.line_num}: expected numbers in {', '.join(names)}") from None
            if None in row or not all(map(math.isfinite, position)) or row["sensor_id"] in anchors:
                raise Problem(f"{path}: line {reader.line_num}: expected one row of {len(columns)} fields for each sensor")
            anchors[row["sensor_id"]] = position
    return anchors


def range_fields(reader, msgtype: str, prefix: str = "", depth: int = 0) -> list[str]:
    """Paths of fields that look like ranges."""
    if depth > 4 or msgtype not in reader.typestore.fielddefs:
        return []
    found = []
    for name, (kind, what) in reader.typestore.fielddefs[msgtype][1]:
        # 1: a base type, 2: another message, 3 and 4: arrays of those.
        is_array, inner = kind.value in (3, 4), what[0] if kind.value in (3, 4) else (kind, what)
        path = f"{prefix}{name}{'[]' if is_array else ''}"
        if inner[0].value == 2:
            found += range_fields(reader, inner[1], f"{path}.", depth + 1)
        elif LOOKS_LIKE_RANGE.search(name) and inner[1][0] != "string" and not name.startswith(("min_", "max_")):
            found.append(path)
    return found


def list_topics(reader, out) -> None:
    """One line for each topic."""
    for connection in sorted(reader.connections, key=lambda connection: connection.topic):
        fields = ", ".join(range_fields(reader, connection.msgtype)) or "-"
        print(f"{connection.topic}\t{connection.msgtype}\t{connection.msgcount}\t{fields}", file=out)


def unit_of(path: str, msgtype: str, given: str | None) -> float:
    """Metres in the unit of a range field."""
    if given:
        return LENGTHS_M[given]
    if msgtype == RANGE_TYPE:
        return 1.0
    match = re.search(r"_(m|cm|mm)(\[\d*\])?$", path)
    if match is None:
        raise Problem(f"the unit of {path} cannot be told: add --unit m, --unit cm or --unit mm")
    return LENGTHS_M[match.group(1)]


class Rows:
    """The rows of the CSV file, and what was left out."""

    def __init__(self, args: argparse.Namespace):
        self.args = args
        self.anchors = read_anchors(args.anchors) if args.anchors else None
        self.newest_position = None
        self.rows: list[tuple] = []
        self.left_out: dict[str, int] = {}
        position = args.position or ""
        self.position_topic, _, self.position_field = position.rpartition(":")
        if args.position and args.anchors:
            raise Problem("--position and --anchors both say where the sensors are: give one of them")

    def leave_out(self, why: str) -> None:
        self.left_out[why] = self.left_out.get(why, 0) + 1

    def take_position(self, message: object) -> None:
        self.newest_position = point(values(message, self.position_field), self.position_field)

    def take(self, connection, log_ns: int, message: object) -> None:
        """Adds the ranges of one message."""
        args, msgtype = self.args, connection.msgtype
        is_plain = msgtype == RANGE_TYPE
        path = args.range or ("range" if is_plain else None)
        sensor = args.sensor or ("header.frame_id" if is_plain else None)
        if path is None or sensor is None:
            missing = "--range FIELD" if path is None else "--sensor FIELD"
            raise Problem(f"{connection.topic}: {msgtype} needs {missing}; --list shows fields that look like ranges")
        unit_m = unit_of(path, msgtype, args.unit)
        found = values(message, path)
        ranges = found if isinstance(found, list) else [found]
        count = len(ranges)
        if sensor == "topic":
            names = [connection.topic] * count
        elif sensor == "index":
            names = [str(index) for index in range(count)]
        elif sensor.startswith("="):
            names = [sensor[1:]] * count
        else:
            names = [str(name) for name in each(values(message, sensor), count, sensor)]
        time_ns = stamp_ns(message, args.stamp, log_ns)
        if args.position and not self.position_topic:
            positions = [point(value, args.position) for value in each(values(message, args.position), count, args.position)]
        else:
            positions = [self.newest_position] * count
        for name, value, position in zip(names, ranges, positions):
            range_m = number(value, path) * unit_m
            if is_plain and path == "range" and not message.min_range <= range_m <= message.max_range:
                self.leave_out("outside the sensor's min_range and max_range")
            elif not math.isfinite(range_m) or range_m <= 0.0:
                self.leave_out("no range (0, negative, NaN or infinite)")
            elif not name.strip():
                self.leave_out("no sensor's name")
            elif self.anchors is not None and name not in self.anchors:
                self.leave_out(f"sensors that are not in {args.anchors}")
            elif args.position and position is None:
                self.leave_out("before the first position")
            else:
                place = self.anchors[name] if self.anchors is not None else position or ()
                self.rows.append((time_ns, name, place, range_m))

    def write(self, out) -> None:
        """Writes all rows in order of time."""
        if not self.rows:
            why = "; ".join(f"{count} x {reason}" for reason, count in self.left_out.items()) or "no message"
            raise Problem(f"no range in {', '.join(self.args.topic)}: {why}")
        if self.args.stamp != "log" and self.rows[0][0] == self.rows[-1][0] == 0:
            raise Problem(f"--stamp {self.args.stamp} is never set in this bag: use --stamp log")
        self.rows.sort(key=lambda row: row[0])
        places = {len(place) for _, _, place, _ in self.rows}
        if len(places) > 1:
            raise Problem("--position: some have a z, some do not")
        writer = csv.writer(out, lineterminator="\n")
        coordinates = ["sensor_x_m", "sensor_y_m", "sensor_z_m"][: places.pop()]
        writer.writerow(["time_s", "sensor_id", *coordinates, "range_m"])
        for time_ns, name, place, range_m in self.rows:
            sign, whole_ns = ("-", -time_ns) if time_ns < 0 else ("", time_ns)
            time_s = f"{sign}{whole_ns // 1_000_000_000}.{whole_ns % 1_000_000_000:09d}"
            # Of the 32 or 64 bits of a range, no more digits than a micrometre.
            writer.writerow([time_s, name, *(f"{value:.6f}" for value in place), f"{range_m:.6f}"])


def convert(args: argparse.Namespace) -> None:
    """Does what the command line says."""
    reader = open_bag(args.bag, args.msg)
    with reader:
        if args.list:
            list_topics(reader, sys.stdout)
            return
        topics = {connection.topic for connection in reader.connections}
        if not args.topic:
            raise Problem("expected --topic TOPIC; --list shows what is in the bag")
        rows = Rows(args)
        wanted = [*args.topic, *filter(None, [rows.position_topic])]
        for topic in wanted:
            if topic not in topics:
                raise Problem(f"no topic {topic} in the bag; it has {', '.join(sorted(topics))}")
        if args.out and args.out.exists():
            raise Problem(f"{args.out} exists: remove it, or give another --out")
        connections = [connection for connection in reader.connections if connection.topic in wanted]
        for connection, log_ns, raw in reader.messages(connections=connections):
            message = reader.deserialize(raw, connection.msgtype)
            if connection.topic == rows.position_topic:
                rows.take_position(message)
            if connection.topic in args.topic:
                rows.take(connection, log_ns, message)
    if args.out:
        with args.out.open("x", encoding="utf-8", newline="") as out:
            rows.write(out)
    else:
        rows.write(sys.stdout)
    sensors = len({name for _, name, _, _ in rows.rows})
    print(f"{len(rows.rows)} ranges of {sensors} sensors", file=sys.stderr)
    for why, count in rows.left_out.items():
        print(f"left out: {count} x {why}", file=sys.stderr)


def main(argv: list[str] | None = None) -> int:
    """Runs; 0, or 2 with one line of what is wrong."""
    args = arguments(argv)
    try:
        convert(args)
        return 0
    except Problem as problem:
        complaint = str(problem)
    except BrokenPipeError:
        return 0
    except Exception as error:  # A damaged bag may make its reader fail in any way.
        complaint = f"{args.bag}: {type(error).__name__}: {error}"
    print(f"bag_to_csv.py: {' '.join(complaint.split())}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
