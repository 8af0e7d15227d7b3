"""Live runs: observers, robots and fusions with functions, and the processes of a run."""

import contextlib
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import rangehound as rh

pytestmark = pytest.mark.usefixtures("watchdog")


def robots(*ids):
    return [["robot", "--id", str(id)] for id in ids]


def test_a_run_with_killed_nodes_reports_the_digest_of_one_process(program, name, tmp_path):
    keys = dict(ticks=400, clock="lockstep", timeout_s="forever", planner="certified")
    with rh.run(name=name, out=tmp_path / "out", program=program, **keys) as run:
        seen = []
        for tick in run.attach(from_start=True):
            seen.append(tick)
            if tick.tick == 50:
                run.kill("robot-1")
        report = run.report()
    alone = rh.simulate(**{"scenario": rh.Scenario(**keys)})
    assert report["digest"] == alone.digest
    assert [tick.tick for tick in seen] == list(range(401))
    np.testing.assert_array_equal([tick.state for tick in seen], alone.state)
    np.testing.assert_array_equal([tick.heading_rad for tick in seen], alone.heading_rad)
    loaded = rh.load(tmp_path / "out")
    assert loaded.digest == alone.digest and loaded.report["nodes"] == report["nodes"]
    assert {node["name"]: node["kills"] for node in loaded.report["nodes"]}["robot-1"] == 1


def test_an_observer_waits_for_the_truth_if_asked_and_ends_with_the_run(program, name, tmp_path):
    with rh.run(name=name, out=tmp_path / "out", program=program, ticks=80, dt_s=0.02) as run:
        ticks = list(run.attach(from_start=True, truth=True))
        assert ticks[-1].tick == 80 and not any(np.isnan(tick.error_m) for tick in ticks[:-1])
        assert ticks[3].truth.shape == (4,) and ticks[3].robot_m.shape == (3, 2)
        assert run.report()["ticks"] == 80


def test_killed_observers_change_nothing(program, name, tmp_path):
    keys = dict(ticks=3000, clock="lockstep", timeout_s="forever", planner="greedy")
    script = f"import rangehound as rh\nfor tick in rh.attach({name!r}): print(tick.tick, flush=True)"
    with rh.run(name=name, out=tmp_path / "out", program=program, **keys) as run:
        for _ in range(5):
            child = subprocess.Popen([sys.executable, "-c", script], cwd="/", stdout=subprocess.PIPE, text=True)
            child.stdout.readline()
            child.kill()
            child.communicate()
        digest = run.report()["digest"]
    assert digest == rh.simulate(rh.Scenario(**keys)).digest


def test_the_processes_of_a_run_can_be_looked_at_and_the_run_ended(program, name, tmp_path):
    with rh.run(name=name, out=tmp_path / "out", program=program, ticks=100_000) as run:
        for tick in run.attach(from_start=True):
            if tick.tick == 3:
                break
        assert {"sim", "fusion", "robot-0"} <= {node["name"] for node in run.status()["nodes"]}
        with pytest.raises(rh.InputError, match="robot-9"):
            run.kill("robot-9")
        run.restart("robot-2")
    assert run._process.returncode is not None


def test_a_python_robot_takes_part_with_the_protocol_of_the_others(by_hand, name, tmp_path):
    keys = dict(ticks=200, clock="lockstep", timeout_s="forever", planner="certified")
    script = "rh.Robot(name, 2, measure=None).run()\nprint('ended')"
    *_, robot = by_hand(["sim"], ["fusion"], *robots(0, 1), scripts=[script], **keys)
    out, err = robot.communicate()
    assert out == "ended\n", err
    run = rh.load(tmp_path / "out")
    assert run.digest == rh.simulate(rh.Scenario(**keys)).digest


def test_a_killed_python_robot_is_replaced_and_changes_no_bit(by_hand, name, tmp_path):
    keys = dict(ticks=8000, clock="lockstep", timeout_s="forever", planner="greedy")
    script = "rh.Robot(name, 2).run()\nprint('ended')"
    started = by_hand(["sim"], ["fusion"], *robots(0, 1), scripts=[script], **keys)
    for _ in range(10):
        for tick in rh.attach(name):
            break
        started[-1].kill()
        started[-1].communicate()
        by_hand(scripts=[script], **keys)
    out, err = started[-1].communicate()
    assert out == "ended\n", err
    assert rh.load(tmp_path / "out").digest == rh.simulate(rh.Scenario(**keys)).digest


def test_the_functions_of_a_robot_measure_say_where_it_is_and_drive(by_hand, name, tmp_path):
    script = (
        "driven = []\n"
        "def measure(robot, tick, range_m, bearing_rad): return (range_m, 0.25)\n"
        "def pose(time_s, x_m, y_m, heading_rad): return (x_m, y_m, heading_rad, 0.5)\n"
        "def carry_out(heading_rad, speed_mps): driven.append(speed_mps)\n"
        "rh.Robot(name, 2, measure=measure, pose=pose, carry_out=carry_out).run()\n"
        "print(len(driven) > 50, driven[-1])"
    )
    *_, robot = by_hand(["sim"], ["fusion"], *robots(0, 1), scripts=[script], ticks=100, clock="lockstep")
    out, err = robot.communicate()
    assert out == "True 0.0\n", err
    run = rh.load(tmp_path / "out")
    assert (run.range_std_m[5:-1, 2] == 0.25).all() and (run.range_std_m[5:-1, 0] == 1.0).all()


def test_a_radio_on_a_port_measures_for_a_robot(by_hand, name, tmp_path):
    os.mkfifo(tmp_path / "uwb")
    script = f"rh.Robot(name, 2, radio=rh.Radio({str(tmp_path / 'uwb')!r}, bias_m=0.5)).run()\nprint('ended')"
    *_, robot = by_hand(["sim"], ["fusion"], *robots(0, 1), scripts=[script], ticks=40, dt_s=0.05, clock="realtime")
    with open(tmp_path / "uwb", "w") as radio:
        while robot.poll() is None:
            with contextlib.suppress(BrokenPipeError):
                radio.write("nonsense\n17.25\n")
                radio.flush()
            time.sleep(0.01)
    out, err = robot.communicate()
    assert out == "ended\n", err
    heard = rh.load(tmp_path / "out").range_m[:, 2]
    heard = heard[~np.isnan(heard)]
    assert len(heard) > 10 and (heard == 16.75).all()


def test_faults_of_a_radio_are_one_line(by_hand, name, python):
    by_hand(["sim"], ticks=100)
    for radio, expected in (
        ("rh.Radio('/none')", "radio: /none: No such file or directory"),
        ("rh.Radio('/dev/null', 'morse')", "radio: format: "),
        ("rh.Radio('/dev/null', 'dwm1001')", "--anchor is missing"),
        ("rh.Radio('/dev/null', max_age_s=float('nan'))", "max_age_s is NaN"),
        ("rh.Radio('/dev/null', scale=-1.0)", "expected"),
    ):
        err = python(f"import rangehound as rh\nrh.Robot({name!r}, 0, radio={radio}).run()").stderr.splitlines()[-1]
        assert err.startswith("rangehound.InputError: ") and expected in err, err
    with pytest.raises(rh.InputError, match="radio and measure are given"):
        rh.Robot(name, 0, radio=rh.Radio("/dev/null"), measure=print)


def test_what_the_function_of_a_robot_raises_ends_it_and_the_run_goes_on_without(by_hand, name, tmp_path):
    script = "def measure(robot, tick, *_): return 1 / (20 - tick)\nrh.Robot(name, 2, measure=measure).run()"
    sim, fusion, _, _, robot = by_hand(["sim"], ["fusion"], *robots(0, 1), scripts=[script], ticks=60, timeout_s=0.3, clock="lockstep")
    _, err = robot.communicate()
    assert robot.returncode == 1 and err.rstrip().endswith("ZeroDivisionError: division by zero")
    assert sim.wait() == 0 and fusion.wait() == 0
    assert rh.load(tmp_path / "out").report["ticks"] == 60


def test_a_fusion_with_a_function_plans_as_the_built_in_one(by_hand, name, tmp_path):
    keys = dict(ticks=150, clock="lockstep", timeout_s="forever")
    script = "rh.fusion(name, planner=lambda situation: situation.plan('certified'))\nprint('ended')"
    *_, fusion = by_hand(["sim"], *robots(0, 1, 2), scripts=[script], **keys)
    out, err = fusion.communicate()
    assert out == "ended\n", err
    assert rh.load(tmp_path / "out").digest == rh.simulate(rh.Scenario(planner="certified", **keys)).digest


def test_if_a_planner_raises_the_team_holds_its_course_and_another_fusion_takes_over(by_hand, name, tmp_path):
    script = (
        "def east(situation):\n"
        "    if situation.tick == 30: raise LookupError('lost')\n"
        "    return [0.0] * situation.robots\n"
        "rh.fusion(name, planner=east)"
    )
    keys = dict(ticks=90, dt_s=0.05, clock="realtime")
    started = by_hand(["sim"], *robots(0, 1, 2), scripts=[script], **keys)
    sim, fusion = started[0], started[-1]
    _, err = fusion.communicate()
    assert err.rstrip().endswith("LookupError: lost"), err
    by_hand(["fusion"], **keys)
    assert sim.wait() == 0
    started[-1].wait()
    run = rh.load(tmp_path / "out")
    assert (run.heading_rad[30] == 0).all() and (run.speed_mps[30] == 10).all()
    assert run.report["ticks"] == 90


@pytest.mark.parametrize("slow", ["time.sleep(1)", "time.sleep(1e6)"])
def test_a_planner_that_is_slow_or_hangs_is_one_error(by_hand, name, tmp_path, slow):
    script = (
        "import time\n"
        "def east(situation):\n"
        f"    if situation.tick == 30: {slow}\n"
        "    return [0.0] * situation.robots\n"
        "rh.fusion(name, planner=east)"
    )
    keys = dict(ticks=90, dt_s=0.05, clock="realtime")
    started = by_hand(["sim"], *robots(0, 1, 2), scripts=[script], **keys)
    _, err = started[-1].communicate()
    assert "RunError: the planner has taken" in err and "s at tick 30: expected at most 0.15" in err, err
    by_hand(["fusion"], **keys)
    assert started[0].wait() == 0
    started[-1].wait()
    assert rh.load(tmp_path / "out").report["ticks"] == 90


def test_faults_are_one_line(name, program):
    with pytest.raises(rh.InputError, match=f"no run {name} after 0.1 s: expected a run that has been started"):
        next(rh.attach(name, timeout_s=0.1))
    with pytest.raises(rh.InputError, match="expected it on the path, in RANGEHOUND"):
        rh.run(name=name, program="/none")
    with pytest.raises(rh.InputError, match="--out"):
        rh.run(name=name, program=program, out="/proc/none")


def test_an_interrupt_ends_a_waiting_node(python, name):
    script = "import sys, rangehound as rh\nprint('ready', flush=True)\nrh.Robot(sys.argv[1], 0).run()"
    child = subprocess.Popen([sys.executable, "-c", script, name], cwd="/", stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert child.stdout.readline() == "ready\n"
    time.sleep(0.5)
    child.send_signal(signal.SIGINT)
    _, err = child.communicate(timeout=60)
    assert "KeyboardInterrupt" in err
