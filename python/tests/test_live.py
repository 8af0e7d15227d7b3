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


def test_killed_observers_change_nothing(program, by_hand, name, tmp_path):
    keys = dict(ticks=3000, clock="lockstep", timeout_s="forever", planner="greedy")
    # A robot that is slow until the observers have been killed: the run must not end before.
    hurry = tmp_path / "hurry"
    slow_robot = (
        "import os, time\n"
        "def slowly(heading_rad, speed_mps):\n"
        f"    if not os.path.exists({str(hurry)!r}): time.sleep(0.005)\n"
        "rh.Robot(name, 2, carry_out=slowly).run()"
    )
    # Each is a process that only attaches: what it would import, its parent has.
    observers = (
        "import os, signal, rangehound as rh\n"
        "killed = 0\n"
        "for _ in range(100):\n"
        "    seen, tell = os.pipe()\n"
        "    child = os.fork()\n"
        "    if child == 0:\n"
        "        for tick in rh.attach(name): os.write(tell, b'.')\n"
        "        os._exit(0)\n"
        "    os.close(tell)\n"
        "    assert os.read(seen, 1) == b'.'\n"
        "    os.kill(child, signal.SIGKILL)\n"
        "    killed += os.WTERMSIG(os.waitpid(child, 0)[1]) == signal.SIGKILL\n"
        "    os.close(seen)\n"
        "print(killed)"
    )
    with rh.run(name=name, out=tmp_path / "out", program=program, external=[2], **keys) as run:
        *_, observing = by_hand(scripts=[slow_robot, observers])
        out, err = observing.communicate()
        assert out == "100\n", err
        hurry.touch()
        digest = run.report()["digest"]
    assert digest == rh.simulate(rh.Scenario(**keys)).digest


def test_a_second_run_of_one_name_is_refused_and_the_first_goes_on(program, name, tmp_path):
    with rh.run(name=name, out=tmp_path / "out", program=program, ticks=100_000) as run:
        with pytest.raises(rh.InputError, match=f"run {name} (--name)?.*running"):
            rh.run(name=name, out=tmp_path / "other", program=program, ticks=100)
        assert {node["state"] for node in run.status()["nodes"]} == {"running"}
        run.stop()
        with pytest.raises(rh.RunError, match="stopped before its last tick"):
            run.report()
        # Another run may have the name by now.
        with rh.run(name=name, out=tmp_path / "other", program=program, ticks=100_000) as other:
            with pytest.raises(rh.RunError, match="has ended"):
                run.kill("robot-1")
            assert other.status()["nodes"]


def test_an_observer_ends_when_all_processes_of_its_run_have_been_killed(program, name, tmp_path):
    with rh.run(name=name, out=tmp_path / "out", program=program, ticks=100_000) as run:
        ticks = run.attach()
        next(ticks)
        # The supervisor first: it would start the others again.
        nodes = sorted(run.status()["nodes"], key=lambda node: node["name"] != "run")
        for node in nodes:
            os.kill(node["pid"], signal.SIGKILL)
        assert nodes[0]["name"] == "run" and len(list(ticks)) < 90_000
    # The next creator removes what they have left.
    with rh.run(name=name, out=tmp_path / "next", program=program, ticks=3) as run:
        run.report()


def test_an_observer_sleeps_while_nothing_happens(program, name, python, tmp_path):
    """It waits for a robot that never comes. One that polled every 20 ms would wake a hundred times."""
    script = (
        "import sys, threading, time, rangehound as rh\n"
        "ticks = rh.attach(sys.argv[1], from_start=True)\n"
        "watcher = threading.Thread(target=lambda: list(ticks), daemon=True)\n"
        "watcher.start()\n"
        "time.sleep(0.5)\n"
        "def wakes():\n"
        "    with open(f'/proc/self/task/{watcher.native_id}/status') as file:\n"
        "        return next(int(line.split()[1]) for line in file if line.startswith('voluntary_ctxt_switches'))\n"
        "before = wakes()\n"
        "time.sleep(2)\n"
        "print(wakes() - before)"
    )
    with rh.run(name=name, out=tmp_path / "out", program=program, ticks=100, clock="lockstep", timeout_s="forever", external=[2]):
        done = python(script, name)
    assert done.returncode == 0, done.stderr
    print(f"wakes in 2 s: {done.stdout.strip()}")
    assert int(done.stdout) < 60


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


def test_a_robot_that_was_refused_can_be_run_again_in_the_same_process(by_hand, name):
    script = (
        "import json\n"
        "run = rh._native.Observer(name, False, False, 60.0)\n"
        "while not any(node['name'] == 'robot-1' and node['pid'] for node in json.loads(run.status())['nodes']): pass\n"
        "for id in (99, 1, 2):\n"
        "    try: rh.Robot(name, id).run()\n"
        "    except rh.InputError as error: print(error)\n"
        "try: rh.Robot(name, 2).run()\n"
        "except rh.InputError as error: print(error)"
    )
    *_, other, robot = by_hand(["sim"], *robots(0, 1), scripts=["rh.fusion(name)", script], ticks=50, clock="lockstep", timeout_s="forever")
    out, err = robot.communicate()
    lines = out.splitlines()
    assert [line for line in lines if "expected 0 to 2" in line] == lines[:1], (out, err)
    assert "robot-1" in lines[1] and "has been a node before" in lines[2] and len(lines) == 3, lines


def test_a_killed_python_robot_is_replaced_and_changes_no_bit(by_hand, name, tmp_path):
    keys = dict(ticks=20_000, clock="lockstep", timeout_s="forever", planner="greedy")
    script = "rh.Robot(name, 2).run()\nprint('ended')"
    started = by_hand(["sim"], ["fusion"], *robots(0, 1), scripts=[script], **keys)
    reached = 0
    for _ in range(10):
        # The robot takes part: without it there is no further tick.
        reached = next(tick.tick for tick in rh.attach(name) if tick.tick > reached + 5)
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
        ("rh.Radio('/dev/null', 'morse')", "radio: format is \"morse\": expected "),
        ("rh.Radio('/dev/null', 'dwm1001')", "--anchor is missing"),
        ("rh.Radio('/dev/null', max_age_s=float('nan'))", "max_age_s is NaN"),
        ("rh.Radio('/dev/null', scale=-1.0)", "expected"),
    ):
        err = python(f"import rangehound as rh\nrh.Robot({name!r}, 0, radio={radio}).run()").stderr.splitlines()[-1]
        assert err.startswith("rangehound.InputError: ") and expected in err, err
    with pytest.raises(rh.InputError, match="radio and measure are given"):
        rh.Robot(name, 0, radio=rh.Radio("/dev/null"), measure=print)


def test_an_exception_of_a_robots_function_ends_it_and_the_run_goes_on_without(by_hand, name, tmp_path):
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


@pytest.mark.parametrize("slow", ["time.sleep(2)", "time.sleep(1e6)"])
def test_a_planner_that_is_slow_or_hangs_is_one_error(by_hand, name, tmp_path, slow):
    script = (
        "import time\n"
        "def east(situation):\n"
        f"    if situation.tick == 10: {slow}\n"
        "    return [0.0] * situation.robots\n"
        "rh.fusion(name, planner=east)"
    )
    keys = dict(ticks=40, dt_s=0.2, clock="realtime")
    started = by_hand(["sim"], *robots(0, 1, 2), scripts=[script], **keys)
    _, err = started[-1].communicate()
    assert "RunError: the planner has taken" in err and "s at tick 10: expected at most 0.6" in err, err
    by_hand(["fusion"], **keys)
    assert started[0].wait() == 0
    started[-1].wait()
    run = rh.load(tmp_path / "out")
    assert run.report["ticks"] == 40
    # The team holds its course for three ticks, then it stands until the next fusion leads.
    steps_m = np.diff(run.robot_m, axis=0)
    is_driven, is_standing = np.abs(steps_m - [2.0, 0.0]).max(axis=(1, 2)) < 1e-9, np.abs(steps_m).max(axis=(1, 2)) == 0
    print("driven:", is_driven.astype(int), "standing:", is_standing.astype(int))
    assert is_driven[7:13].all() and is_standing[14:18].all()


def test_the_team_of_a_planner_that_hangs_is_led_by_another_while_its_process_lives(by_hand, name, program, tmp_path):
    """As in a notebook, whose kernel goes on."""
    script = (
        "import time\n"
        "def hangs(situation):\n"
        "    if situation.tick == 20: time.sleep(1e6)\n"
        "    return [0.0] * situation.robots\n"
        "try: rh.fusion(name, planner=hangs)\n"
        "except rh.RunError as error: print(error, flush=True)\n"
        "time.sleep(1e6)"
    )
    keys = dict(ticks=120, dt_s=0.05, clock="realtime")
    started = by_hand(["sim"], *robots(0, 1, 2), scripts=[script], **keys)
    hung = started[-1]
    assert "the planner has taken" in hung.stdout.readline()
    by_hand(["fusion"], **keys)
    assert started[-1].wait() == 0 and started[0].wait() == 0
    # The process that hangs keeps nothing of the run.
    assert hung.poll() is None and name not in subprocess.run([program, "status"], capture_output=True, text=True).stdout
    hung.kill()
    run = rh.load(tmp_path / "out")
    assert run.report["ticks"] == 120 and (run.speed_mps[-5:-1] > 0).all()


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


def test_a_run_is_led_by_a_function_also_after_its_process_was_killed(program, name, tmp_path):
    keys = dict(ticks=2000, clock="lockstep", timeout_s="forever")

    def own(situation):
        return situation.plan("greedy" if situation.tick % 2 else "certified")

    with rh.run(name=name, out=tmp_path / "out", program=program, planner=own, **keys) as run:
        for tick in run.attach(from_start=True):
            if tick.tick == 300:
                run.kill("fusion")
        digest = run.report()["digest"]
    assert digest == rh.simulate(rh.Scenario(**keys), planner=own, gap=False).digest


def test_an_exception_of_a_runs_planner_ends_the_run_and_is_reported(program, name, tmp_path):
    def broken(situation):
        if situation.tick == 20:
            raise LookupError("lost")
        return [0.0] * situation.robots

    with rh.run(name=name, out=tmp_path / "out", program=program, planner=broken, ticks=100_000, clock="lockstep", timeout_s="forever") as run:
        with pytest.raises(rh.RunError, match="the planner raised LookupError: lost"):
            run.report()
    with rh.run(name=name, out=tmp_path / "stopped", program=program, planner=lambda situation: [0.0] * situation.robots, ticks=100_000) as run:
        next(run.attach())
        run.stop()
    with pytest.raises(rh.InputError, match="expected a name or a function"):
        rh.run(name=name, program=program, planner=3)
