"""Recorded ranges and bearings: `track` and `calibrate`."""

from __future__ import annotations

import csv
import json
import os
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Iterator, Mapping

from . import _native, figures
from ._progress import BYTES, progress
from .runs import Run
from .scenario import Scenario, to_json

#: Keys of the table `[recording]` that say how a file is read.
_READING = ("columns", "field", "topic", "position", "msg", "anchors", "target", "format", "rate_hz", "stamp_unit", "strict", "target_height_m")


class Calibration:
    """The result of `calibrate`. Intervals are of 95 %: `value` plus or minus `half_width`."""

    def __init__(self, found: str, toml: str, residuals: list[list[tuple[float, float]]]) -> None:
        keys = json.loads(found)
        self.is_determined: bool = keys["determined"]
        self.sensor_ids: list[str] = keys["sensor_ids"]
        self.sensors: list[dict[str, Any]] = keys["findings"]["sensors"]
        self.accel_psd: dict[str, float] | None = keys["findings"]["accel_psd"]
        self.undetermined: list[str] = keys["findings"]["undetermined"]
        self.residuals = residuals
        self._toml = toml

    def to_toml(self) -> str:
        """The text of `calibration.toml`, for `rangehound track --calibration`."""
        return self._toml

    def frame(self) -> Any:
        """A pandas frame with a row for each sensor."""
        pandas = figures._needs("pandas")
        rows = {}
        for name, sensor in zip(self.sensor_ids, self.sensors):
            row: dict[str, Any] = {"ranges": sensor["ranges"]}
            for key in ("bias_m", "scale", "range_std_m"):
                measured = sensor[key] or {"value": None, "half_width": None}
                row[key], row[f"{key}_half_width"] = measured["value"], measured["half_width"]
            rows[name] = row
        return pandas.DataFrame.from_dict(rows, orient="index")

    def __repr__(self) -> str:
        return f"Calibration(sensors={len(self.sensors)}, is_determined={self.is_determined})"


def track(
    ranges: Any,
    *,
    truth: str | os.PathLike[str] | None = None,
    calibration: Calibration | str | os.PathLike[str] | None = None,
    accel_psd: float | None = None,
    gate_sigma: float | str | None = None,
    distrust: bool | None = None,
    estimate: list[str] | None = None,
    show_progress: bool | None = None,
    **recording: Any,
) -> Run:
    """Tracks a recording: the estimates of `rangehound track --in-process`, bit for bit.

    `ranges` is a file, a pandas frame, or a dict of columns: `time_s`, `sensor_id`, `range_m`, `sensor_x_m`,
    `sensor_y_m` and others that a file may have. Further keywords are keys of the table `[recording]` of a scenario, such
    as `range_std_m=0.15`, `bias_m`, `scale`, `start_m`, `columns`, `anchors`, and `field`, the field of a bag with the range, as `--field`. `calibration`, of `calibrate` or a file of it, gives what they
    leave open.
    `truth` is a file with the true track, to compare with; the tracker never reads it.
    """
    with _file(ranges) as path:
        table = _table(path, recording)
        keys: dict[str, Any] = {
            "name": "track",
            "recording": table,
            "target": {"noise_psd": accel_psd},
            "filter": {"gate_sigma": gate_sigma, "distrust": distrust, "estimate": estimate},
        }
        if calibration is not None:
            toml = calibration.to_toml() if isinstance(calibration, Calibration) else Path(calibration).read_text("utf-8")
            with progress(BYTES, show_progress) as reading:
                keys = json.loads(_native.calibrated(to_json(keys), toml, reading=reading))
        with progress(BYTES, show_progress) as reading:
            scenario = _native.Scenario.__new__(Scenario, keys=to_json(keys), progress=reading)
        with progress("tick", show_progress) as report:
            arrays, summary = _native.simulate(scenario, truth=truth, progress=report)
    return Run(scenario, arrays, summary)


def calibrate(
    ranges: Any,
    *,
    truth: str | os.PathLike[str] | None = None,
    show_progress: bool | None = None,
    **reading: Any,
) -> Calibration:
    """Noise, bias and scale of each sensor of a recording: measured = (1 + scale) true + bias_m.

    `ranges` is as for `track`; without `truth` all is estimated from the ranges alone. Keywords say how the file is read:
    `columns`, `field`, `topic`, `position`, `msg`, `anchors`, `target`, `format`, `rate_hz`, `stamp_unit`, `strict`, `target_height_m`.
    """
    unknown = [key for key in reading if key not in _READING]
    if unknown:
        raise TypeError(f"calibrate has no keyword {unknown[0]!r}: expected one of {', '.join(_READING)}")
    with _file(ranges) as path, progress(BYTES, show_progress) as of_file, progress("model", show_progress) as report:
        keys = to_json({"recording": _table(path, reading)})
        return Calibration(*_native.calibrate(keys, truth=truth, reading=of_file, progress=report))


def _table(path: str, keys: Mapping[str, Any]) -> dict[str, Any]:
    """The table `[recording]`: `field` is a short form of a column, as it is on the command line."""
    table = {"ranges": path, **keys}
    field = table.pop("field", None)
    if field is not None:
        columns = table.get("columns")
        table["columns"] = f"range={field}" if columns is None else f"range={field},{columns}"
    return table


@contextmanager
def _file(ranges: Any) -> Iterator[str]:
    """The path of a recording; columns are written to a temporary file."""
    if isinstance(ranges, (str, os.PathLike)):
        yield os.fspath(ranges)
        return
    import tempfile

    columns: Mapping[str, Any] = ranges
    names = list(columns)
    with tempfile.TemporaryDirectory(prefix="rangehound-") as folder:
        path = os.path.join(folder, "ranges.csv")
        with open(path, "w", encoding="utf-8", newline="") as file:
            out = csv.writer(file, lineterminator="\n")
            out.writerow(names)
            for row in zip(*(columns[name] for name in names), strict=True):
                out.writerow(["" if value is None or value != value else str(value) for value in row])
        yield path
