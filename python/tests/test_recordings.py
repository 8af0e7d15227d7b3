"""Recorded ranges: track and calibrate."""

import csv
import json
import os
import signal
import subprocess
import sys

import numpy as np
import pytest
import rangehound as rh


@pytest.fixture
def ranges(root):
    return root / "scenarios/recording/ranges.csv"


@pytest.fixture
def truth(root):
    return root / "scenarios/recording/truth.csv"


def test_a_track_is_that_of_the_program_to_the_bit(program, ranges, truth, tmp_path):
    args = ["track", ranges, "--truth", truth, "--range-std", "0.15", "--in-process", "--json", "--no-record"]
    done = subprocess.run([program, *args, "--out", tmp_path / "out"], capture_output=True, text=True, timeout=120)
    report = json.loads(done.stdout)
    run = rh.track(ranges, truth=truth, range_std_m=0.15)
    for key in ("digest", "position_rmse_m", "anees", "nis_mean", "ranges", "sensors", "verdict"):
        assert run.report[key] == report[key], key
    assert run.truth.shape == (len(run), 0) and np.isnan(run.error_m).all()


def test_columns_and_frames_are_recordings(ranges):
    expected = rh.track(ranges, range_std_m=0.15)
    with open(ranges, encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    columns = {name: [float(row[name]) if name != "sensor_id" else row[name] for row in rows] for name in rows[0]}
    assert rh.track(columns, range_std_m=0.15).digest == expected.digest
    pandas = pytest.importorskip("pandas")
    assert rh.track(pandas.DataFrame(columns), range_std_m=0.15).digest == expected.digest


def test_a_calibration_is_that_of_the_program_and_is_used_alike(program, ranges, tmp_path):
    out = tmp_path / "calibration"
    done = subprocess.run([program, "calibrate", ranges, "--json", "--out", out], capture_output=True, text=True, timeout=120)
    expected = json.loads(done.stdout)
    found = rh.calibrate(ranges)
    assert (found.sensor_ids, found.sensors) == (expected["sensor_ids"], expected["findings"]["sensors"])
    assert found.to_toml() == (out / "calibration.toml").read_text()
    args = ["track", ranges, "--calibration", out / "calibration.toml", "--in-process", "--json", "--no-record"]
    done = subprocess.run([program, *args, "--out", tmp_path / "out"], capture_output=True, text=True, timeout=120)
    assert rh.track(ranges, calibration=found).digest == json.loads(done.stdout)["digest"]
    assert rh.track(ranges, calibration=out / "calibration.toml").digest == json.loads(done.stdout)["digest"]


def test_the_bytes_of_a_file_that_is_read_are_shown(ranges):
    size = os.path.getsize(ranges)
    keys = json.dumps({"recording": {"ranges": str(ranges)}})
    found = rh.calibrate(ranges)
    ways = [
        lambda show: rh._native.Scenario(keys=keys, progress=show),
        lambda show: rh._native.calibrated(keys, found.to_toml(), reading=show),
        lambda show: rh._native.calibrate(keys, reading=show),
    ]
    for way in ways:
        shown = []
        way(lambda *bytes_read: shown.append(bytes_read))
        assert shown == sorted(set(shown)) and shown[-1] == (size, size)

    def refuse(*_):
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        ways[0](refuse)


def test_a_file_that_is_refused_is_not_shown_as_read(ranges, tmp_path):
    damaged, shown = tmp_path / "damaged.csv", []
    # It is refused at its header, long before its end.
    damaged.write_bytes(b"time_s\n" + 100 * ranges.read_bytes())
    keys = json.dumps({"recording": {"ranges": str(damaged)}})
    with pytest.raises(rh.InputError):
        rh._native.Scenario(keys=keys, progress=lambda *bytes_read: shown.append(bytes_read))
    assert all(done < size for done, size in shown)


def test_an_interrupt_ends_a_calibration_and_its_thread(python):
    script = (
        "import numpy as np, rangehound as rh, os, pathlib, signal, threading\n"
        "t, noise = np.arange(60_000) * 0.05, np.random.default_rng(1).normal(size=60_000)\n"
        "at = 10 * np.exp(2j * np.pi * np.arange(8) / 8)[np.arange(60_000) % 8]\n"
        "ranges = abs(4 * np.sin(0.1 * t) + 3j * np.cos(0.13 * t) - at) + 0.1 * noise\n"
        "rows = dict(time_s=t, sensor_id=[str(i % 8) for i in range(60_000)], sensor_x_m=at.real, sensor_y_m=at.imag, range_m=ranges)\n"
        "def of():\n"
        "    while True:\n"
        "        try: return [(thread / 'comm').read_text().strip() for thread in pathlib.Path('/proc/self/task').iterdir()]\n"
        "        except OSError: pass  # A thread has just ended.\n"
        "def interrupt():\n"
        "    while 'calibrate' not in of(): pass\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "threading.Thread(target=interrupt).start()\n"
        "try:\n"
        "    rh.calibrate(rows, show_progress=False)\n"
        "except KeyboardInterrupt:\n"
        "    print('interrupted', of())\n"
    )
    done = python(script)
    assert done.stdout.startswith("interrupted") and "calibrate" not in done.stdout, (done.stdout, done.stderr)


def test_a_calibration_against_the_true_track_has_a_row_for_each_sensor(ranges, truth):
    pytest.importorskip("pandas")
    found = rh.calibrate(ranges, truth=truth)
    frame = found.frame()
    assert found.is_determined and list(frame.index) == found.sensor_ids
    assert (frame["range_std_m"] > 0).all() and len(found.residuals) == len(found.sensor_ids)


def test_faults_name_file_and_keyword(ranges, tmp_path):
    with pytest.raises(rh.InputError, match="cannot read .*none.csv"):
        rh.track(tmp_path / "none.csv")
    with pytest.raises(rh.InputError, match="unknown field `range_sd_m`"):
        rh.track(ranges, range_sd_m=0.1)
    with pytest.raises(TypeError, match="no keyword 'range_std_m'"):
        rh.calibrate(ranges, range_std_m=0.1)
    with pytest.raises(rh.InputError, match="expected a simulated scenario"):
        rh.simulate({"recording": {"ranges": str(ranges)}}, planner=lambda s: s)


def test_columns_may_have_any_text(ranges):
    with open(ranges, encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    names = {name: f'{name}, the "best"' for name in {row["sensor_id"] for row in rows}}
    columns = {key: [names[row[key]] if key == "sensor_id" else float(row[key]) for row in rows] for key in rows[0]}
    run = rh.track(columns, range_std_m=0.15)
    assert run.digest == rh.track(ranges, range_std_m=0.15).digest
    assert {sensor["name"] for sensor in run.report["sensors"]} == set(names.values())


@pytest.mark.parametrize("call", ["track(pipe)", "calibrate(pipe)", "track(ranges, truth=pipe)", "calibrate(ranges, truth=pipe)"])
def test_an_interrupt_ends_the_reading_of_a_file(call, ranges, tmp_path):
    """A writer that says nothing: the reading has no end."""
    pipe = tmp_path / "pipe.csv"
    os.mkfifo(pipe)
    script = f"import sys, rangehound as rh\n_, ranges, pipe = sys.argv\nprint('ready', flush=True)\nrh.{call}"
    child = subprocess.Popen([sys.executable, "-c", script, ranges, pipe], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert child.stdout.readline() == "ready\n"
        with open(pipe, "w"):
            child.send_signal(signal.SIGINT)
            _, err = child.communicate(timeout=60)
    finally:
        child.kill()
    assert err.rstrip().endswith("KeyboardInterrupt"), err
