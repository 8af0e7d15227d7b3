"""Runs in this process, with parts that are functions."""

import json
import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import rangehound as rh


@pytest.mark.parametrize("name", ["paper", "pairs", "mixed"])
def test_the_estimates_are_those_of_the_program_to_the_bit(name, program, root, tmp_path):
    file = {"paper": root / "scenarios/paper.toml"}.get(name)
    if file is None:
        file = tmp_path / f"{name}.toml"
        keys = {
            "pairs": {"robots": {"count": 2, "sensor": "camera"}, "sensor": {"camera": {"bearing_std_rad": 0.02}}},
            "mixed": {"robots": {"localiser": "gps"}, "localiser": {"gps": {"std_m": 0.5, "correlation_s": 10.0}}},
        }[name]
        file.write_text(rh.Scenario(keys).to_toml())
    args = ["run", file, "--in-process", "--ticks", "150", "--seed", "8", "--json", "--no-record", "--out", tmp_path / "out"]
    done = subprocess.run([program, *args], capture_output=True, text=True, timeout=120)
    report = json.loads(done.stdout)
    run = rh.simulate(file, ticks=150, seed=8)
    assert run.digest == report["digest"]
    for key in ("position_rmse_m", "anees", "nis_mean", "position_trace_m2", "ranges", "verdict", "planner", "seed"):
        assert run.report[key] == report[key], key
    loaded = rh.load(tmp_path / "out")
    assert loaded.digest == run.digest and loaded.scenario.seed == 8
    for array, values in run.arrays.items():
        np.testing.assert_array_equal(loaded.arrays[array], values, err_msg=array)


def test_the_arrays_have_the_shapes_that_the_class_promises():
    run = rh.simulate(ticks=20, planner="certified", gap=True)
    t, m, n = 21, 3, 4
    shapes = {
        "tick": (t,), "time_s": (t,), "state": (t, n), "covariance": (t, n, n), "truth": (t, n), "robot_m": (t, m, 2),
        "believed_m": (t, m, 2), "range_m": (t, m), "bearing_rad": (t, m), "range_used": (t, m), "heading_rad": (t, m),
        "speed_mps": (t, m), "nis": (t,), "fused": (t,), "gap": (t,), "trace_excess": (t,), "least_trace_m2": (t,),
    }
    assert {name: run.arrays[name].shape for name in shapes} == shapes
    assert np.isnan(run.range_m[0]).all() and (run.fused[1:] == m).all()
    step = np.stack([np.cos(run.heading_rad), np.sin(run.heading_rad)], -1) * run.speed_mps[..., None] * run.scenario.dt_s
    np.testing.assert_allclose(run.robot_m[1:], run.robot_m[:-1] + step[:-1], atol=1e-9)
    np.testing.assert_allclose(run.range_m[1:], np.linalg.norm(run.truth[1:, None, :2] - run.robot_m[1:], axis=-1), atol=6)
    assert (run.position_trace_m2[1:] >= run.least_trace_m2[:-1] * (1 - 1e-9)).all()


def test_a_planner_that_is_a_function_runs_as_the_built_in_one():
    for name in ("certified", "greedy", "pursue"):
        own = rh.simulate(ticks=100, planner=lambda situation: situation.plan(name))
        assert own.digest == rh.simulate(ticks=100, planner=name).digest
        pair = rh.simulate(ticks=100, planner=lambda s: (s.plan(name).headings_rad, s.plan(name).speeds_mps))
        assert pair.digest == own.digest
        assert (own.gap >= 0).all() and (name != "certified" or own.gap.max() < 1e-8)


def test_a_worse_planner_has_a_gap_that_evaluate_computes_too():
    seen = []

    def east(situation):
        headings = np.zeros(situation.robots)
        seen.append(situation.evaluate(headings))
        assert situation.worth(headings) == seen[-1]
        return headings

    run = rh.simulate(ticks=50, planner=east)
    assert np.median(run.gap) > 1e-8
    objective, trace_m2, gap = np.array(seen).T
    np.testing.assert_array_equal(objective, run.objective)
    np.testing.assert_array_equal(gap, run.gap)
    assert run.robot_m[-1, 0, 0] > run.robot_m[0, 0, 0] + 40
    assert (trace_m2 > 0).all()


def test_a_situation_is_the_prediction_from_the_estimate():
    seen = []
    run = rh.simulate(ticks=5, planner=lambda s: seen.append(s) or s.plan())
    dt = run.scenario.dt_s
    for tick, situation in enumerate(seen):
        assert (situation.tick, situation.robots, situation.step_s) == (tick, 3, dt)
        x = run.state[tick]
        np.testing.assert_allclose(situation.state, [x[0] + dt * x[2], x[1] + dt * x[3], x[2], x[3]])
        np.testing.assert_array_equal(situation.target_m, situation.state[:2])
        np.testing.assert_array_equal(situation.covariance_m2, situation.covariance[:2, :2])
        np.testing.assert_array_equal(situation.positions_m, run.believed_m[tick])
    assert (seen[0].max_speeds_mps == 10).all() and (seen[1].range_stds_m == 1).all()
    assert np.isnan(seen[0].bearing_stds_rad).all()


def test_a_sensor_that_is_a_function_gives_the_ranges():
    run = rh.simulate(ticks=50, sensor=lambda robot, tick, range_m, bearing_rad: (range_m + robot, 0.5))
    true_m = np.linalg.norm(run.truth[:, None, :2] - run.robot_m, axis=-1)
    np.testing.assert_allclose(run.range_m[1:], true_m[1:] + np.arange(3), atol=1e-9)
    assert (run.range_std_m[1:] == 0.5).all()
    silent = rh.simulate(ticks=20, sensor=lambda robot, tick, range_m, _: None if robot == 1 else range_m)
    assert np.isnan(silent.range_m[:, 1]).all() and (silent.fused[1:] == 2).all()
    both = rh.simulate(ticks=20, sensor=lambda r, t, range_m, _: (np.nan, 1.0, 0.1, 0.2))
    assert (both.bearing_rad[1:] == 0.1).all() and np.isnan(both.range_m).all()


def test_a_target_that_is_a_function_moves_so():
    def circle(tick, state, noise):
        angle = 0.1 * (tick + 1)
        return [10 * np.cos(angle), 10 * np.sin(angle), -10 * np.sin(angle), 10 * np.cos(angle)]

    run = rh.simulate(ticks=60, target=circle)
    np.testing.assert_allclose(np.linalg.norm(run.truth[1:, :2], axis=1), 10)
    noises = [[], []]
    for kept in noises:
        rh.simulate(ticks=10, seed=3, target=lambda tick, state, noise: kept.append(noise) or state)
    np.testing.assert_array_equal(*noises)


@pytest.mark.parametrize(
    ("planner", "message"),
    [
        (lambda s: [0.0], "has 1 headings: expected 3 finite headings"),
        (lambda s: [0.0, np.nan, 0.0], "has NaN rad, 10 m/s for robot 1: expected"),
        (lambda s: "east", "is not an array of numbers"),
        (lambda s: None, "is not an array of numbers|has 1 headings"),
    ],
)
def test_an_answer_that_is_no_headings_is_refused(planner, message):
    with pytest.raises(rh.InputError, match=message):
        rh.simulate(ticks=5, planner=planner)


def test_an_exception_of_a_function_is_raised_and_it_is_not_called_again():
    calls = []

    def broken(*_):
        calls.append(1)
        raise LookupError("lost")

    for part in ("planner", "sensor", "target"):
        calls.clear()
        with pytest.raises(LookupError, match="lost"):
            rh.simulate(ticks=50, **{part: broken})
        assert len(calls) == 1


def test_bad_answers_of_sensors_and_targets_are_refused():
    for answer in (-1.0, (1.0, 0.0), (1.0, 2.0, 3.0), "far"):
        with pytest.raises(rh.InputError, match="the answer of the sensor of robot 0 at tick 1"):
            rh.simulate(ticks=5, sensor=lambda *_: answer)
    with pytest.raises(rh.InputError, match=r"target at tick 0 has the shape \[2\]: expected \[4\]"):
        rh.simulate(ticks=5, target=lambda *_: [0, 0])
    with pytest.raises(rh.InputError, match="expected a finite state"):
        rh.simulate(ticks=5, target=lambda *_: [0, 0, np.inf, 0])


def test_other_threads_go_on_during_a_long_call():
    counted = [0]
    end = threading.Event()

    def count():
        while not end.is_set():
            counted[0] += 1
            time.sleep(0.001)

    thread = threading.Thread(target=count)
    thread.start()
    rh.simulate(ticks=60_000, planner="greedy")
    end.set()
    thread.join()
    assert counted[0] > 10


@pytest.mark.parametrize("planner", ["'certified'", "lambda s: [0, 0, 0]"])
@pytest.mark.parametrize("call", ["simulate(ticks=10_000_000, planner=PLANNER)", "compare(planners=[PLANNER], runs=90_000, ticks=300)"])
def test_an_interrupt_ends_a_long_call(call, planner):
    script = f"import rangehound as rh, sys\nprint('ready', flush=True)\nrh.{call.replace('PLANNER', planner)}\nprint('done')"
    pipes = dict(stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    child = subprocess.Popen([sys.executable, "-c", script], cwd="/", **pipes)
    try:
        assert child.stdout.readline() == "ready\n"
        time.sleep(1.0)
        child.send_signal(signal.SIGINT)
        out, err = child.communicate(timeout=60)
    finally:
        child.kill()
    assert "KeyboardInterrupt" in err and "done" not in out


def test_a_run_has_frames_and_figures():
    pytest.importorskip("pandas")
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("svg")
    import matplotlib.pyplot as plt

    run = rh.simulate(ticks=30)
    frame = run.frame()
    assert len(frame) == 31 and frame["range_m_2"].iloc[4] == run.range_m[4, 2]
    assert frame["covariance_0_1"].iloc[9] == run.covariance[9, 0, 1]
    lines = {line.get_label(): line.get_xydata() for line in run.plot("field").get_lines()}
    np.testing.assert_array_equal(lines["target"], run.truth[:, :2])
    np.testing.assert_array_equal(lines["estimate"], run.position_m)
    np.testing.assert_array_equal(lines["robot 2"], run.robot_m[:, 2])
    error = run.plot("error")
    assert error.get_xlabel() == "time, s" and error.get_ylabel() == "position error, m"
    np.testing.assert_array_equal(error.get_lines()[0].get_xydata(), np.column_stack([run.time_s, run.error_m]))
    band = error.collections[0].get_paths()[0].vertices
    largest = [np.linalg.eigvalsh(covariance[:2, :2])[1] for covariance in run.covariance]
    assert {(round(x, 9), round(y, 6)) for x, y in zip(run.time_s, np.sqrt(5.991464547 * np.array(largest)))} <= {(round(x, 9), round(y, 6)) for x, y in band}
    traces = {line.get_label(): line.get_xydata() for line in run.plot("trace").get_lines()}
    np.testing.assert_array_equal(traces["adaptive"], np.column_stack([run.time_s, np.trace(run.covariance[:, :2, :2], axis1=1, axis2=2)]))
    proven = rh.simulate(ticks=30, planner="certified")
    least = {line.get_label(): line.get_xydata() for line in proven.plot("trace").get_lines()}["least"]
    np.testing.assert_array_equal(least, np.column_stack([proven.time_s[1:], proven.least_trace_m2[:-1]]))
    plt.close("all")
    with pytest.raises(rh.InputError, match="expected one of field, error, trace"):
        run.plot("sky")
    with pytest.raises(AttributeError, match="gap=True"):
        run.gap


def test_without_pandas_and_matplotlib_the_package_works_and_says_what_is_missing(python):
    done = python(
        "import sys\n"
        "for name in ('pandas', 'matplotlib'): sys.modules[name] = None\n"
        "import rangehound as rh\n"
        "run = rh.simulate(ticks=3)\n"
        "try: run.frame()\n"
        "except ModuleNotFoundError as error: print(error)"
    )
    assert done.returncode == 0 and done.stdout.startswith("pandas is not installed: frames and figures need it"), done


def test_no_output_without_a_terminal(python):
    done = python("import rangehound as rh; rh.simulate(ticks=200_000, planner='greedy')")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_a_folder_that_is_no_run_is_named(tmp_path):
    with pytest.raises(rh.InputError, match="expected the folder of a run"):
        rh.load(tmp_path)


def test_a_terminal_shows_the_progress_of_a_long_call():
    import fcntl
    import pty
    import struct
    import termios

    parent, child = pty.openpty()
    fcntl.ioctl(child, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    script = "import rangehound as rh; rh.simulate(ticks=400_000, planner='greedy')"
    running = subprocess.Popen([sys.executable, "-c", script], cwd="/", stderr=child)
    os.close(child)
    shown = b""
    while True:
        try:
            read = os.read(parent, 4096)
        except OSError:  # The other end is closed.
            break
        shown += read
        if not read:
            break
    os.close(parent)
    assert running.wait(timeout=60) == 0
    assert b"/400000" in shown and b"tick/s" in shown


def test_an_interrupt_ends_the_loading_of_a_run_which_shows_its_progress(program, tmp_path):
    ticks = 20_000
    args = ["run", "--in-process", "--ticks", ticks, "--no-record", "--out", tmp_path / "out"]
    subprocess.run([program, *map(str, args)], check=True, capture_output=True, timeout=120)
    shown = []
    assert len(rh._native.load(tmp_path / "out", progress=lambda *done: shown.append(done))[1]["tick"]) == ticks + 1
    assert shown[-1] == (ticks, ticks + 1) and len(shown) == len(set(shown)) > 5

    def interrupt(done, everything):
        shown.append(done)
        signal.raise_signal(signal.SIGINT)

    shown.clear()
    with pytest.raises(KeyboardInterrupt):
        rh._native.load(tmp_path / "out", progress=interrupt)
    assert len(shown) == 1
