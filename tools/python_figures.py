#!/usr/bin/env python3
"""Measures what the Python package promises, and prints what is asked and what was measured.

    python3 tools/python_figures.py [WORDS]

Measures the figures whose name has one of these words, or all: some fifteen minutes. Run it with the interpreter of an
environment that has the package, such as target/python-test/bin/python, on a quiet machine. Of `stonesoup` and of ROS 2 the
figures are left out where they are not installed. The program `rangehound` is that of the variable RANGEHOUND, or on the path.
Ends with 1 if a figure is missed.
"""

import contextlib
import json
import os
import pathlib
import signal
import statistics
import subprocess
import sys
import tempfile
import time

import numpy as np
import rangehound as rh

ROOT = pathlib.Path(__file__).resolve().parent.parent

#: Stands in names of runs and of topics: two of these may run beside each other.
NAME = f"figures-{os.getpid()}"


def median_us(call, times=2000):
    """The median time of a call, us."""
    taken = []
    for _ in range(times):
        began_ns = time.perf_counter_ns()
        call()
        taken.append(time.perf_counter_ns() - began_ns)
    return statistics.median(taken) * 1e-3


@contextlib.contextmanager
def folder():
    """A folder in memory: what is measured is not the disk."""
    with tempfile.TemporaryDirectory(prefix="rangehound-figures-", dir="/dev/shm") as path:
        yield pathlib.Path(path)


def script(text, *args, **more):
    """Another interpreter, which imports the package and runs a script."""
    return subprocess.Popen([sys.executable, "-c", "import rangehound as rh\n" + text, *map(str, args)], stdout=subprocess.PIPE, text=True, cwd="/", **more)


def plan():
    """A plan for three robots, above the planner's own time."""
    problem = dict(prior_position_covariance=np.array([[4, 0.5], [0.5, 2]]), target=np.zeros(2), time_step_s=0.1,
                   positions=np.array([[20.0, 0.0], [0.0, 15.0], [-9.0, -9.0]]), max_speed=10.0, range_std=1.0)
    own = []
    call_us = median_us(lambda: own.append(rh.plan(**problem).plan_us), 20_000)
    return call_us - statistics.median(own), "us above the Rust call, M = 3", 2.0


def simulate():
    """1 000 ticks of three robots, beside `run --in-process`: its time from its start to its end, less that of a run of one tick."""
    program = os.environ.get("RANGEHOUND", "rangehound")

    def run_s(ticks, out):
        began_s = time.perf_counter()
        args = ["run", "--in-process", "--ticks", str(ticks), "--no-record", "--out", str(out)]
        subprocess.run([program, *args], check=True, capture_output=True)
        return time.perf_counter() - began_s

    # Of many ticks, because the program also starts, and writes files.
    ticks = 100_000
    with folder() as path:
        programs_s = [run_s(ticks, path / "out") - run_s(1, path / "out") for _ in range(5)]
    ours_s = []
    for _ in range(5):
        began_s = time.perf_counter()
        rh.simulate(ticks=ticks, show_progress=False)
        ours_s.append(time.perf_counter() - began_s)
    return statistics.median(ours_s) / statistics.median(programs_s), "x `run --in-process`, which writes files", 1.2


def empty_planner():
    """A planner that does nothing, beside the cheapest of the built-in ones."""
    headings = np.zeros(3)

    def tick_us(planner):
        taken = []
        for _ in range(7):
            began_s = time.perf_counter()
            rh.simulate(ticks=20_000, planner=planner, gap=False, show_progress=False)
            taken.append((time.perf_counter() - began_s) * 1e6 / 20_000)
        return statistics.median(taken)

    built_in_us = min(tick_us("pursue"), tick_us("random"))
    return tick_us(lambda situation: headings) - built_in_us, "us a tick above the cheapest built-in planner", 5.0


def stone_soup():
    """A step of the filter with ten ranges, beside the extended Kalman filter of Stone Soup with the same ranges at once."""
    from datetime import datetime, timedelta

    from stonesoup.base import Property
    from stonesoup.models.measurement.nonlinear import NonLinearGaussianMeasurement
    from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
    from stonesoup.predictor.kalman import KalmanPredictor
    from stonesoup.types.array import StateVector
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.state import GaussianState
    from stonesoup.updater.kalman import ExtendedKalmanUpdater

    class Ranges(NonLinearGaussianMeasurement):
        """Ranges of several robots; the derivatives are in closed form."""

        places_m: np.ndarray = Property()

        @property
        def ndim_meas(self):
            return len(self.places_m)

        def _ways(self, state):
            ways_m = np.asarray(state.state_vector, dtype=float)[[0, 2], 0] - self.places_m
            return ways_m, np.hypot(*ways_m.T)

        def function(self, state, noise=False, **_):
            return StateVector(self._ways(state)[1])

        def jacobian(self, state, **_):
            ways_m, ranges_m = self._ways(state)
            slopes = np.zeros((len(ranges_m), 4))
            slopes[:, [0, 2]] = ways_m / ranges_m[:, None]
            return slopes

    count, dt_s, psd = 10, 0.1, 1.0
    scenario = rh.Scenario(ticks=300, dt_s=dt_s, robots={"count": count}, target={"noise_psd": psd}, filter={"gate_sigma": "none"}, planner="certified")
    run = rh.simulate(scenario, show_progress=False)
    motion = CombinedLinearGaussianTransitionModel([ConstantVelocity(psd), ConstantVelocity(psd)])
    predictor, updater = KalmanPredictor(motion), ExtendedKalmanUpdater(None)
    order = [0, 2, 1, 3]  # Theirs is x, vx, y, vy.
    began = datetime(2020, 1, 1)
    state = GaussianState(StateVector(run.state[0][order]), run.covariance[0][np.ix_(order, order)], timestamp=began)
    ours = rh.Filter(scenario)
    theirs_ns, ours_ns, apart = [], [], 0.0
    for tick in range(1, len(run)):
        ranges_m, places_m = run.range_m[tick], run.believed_m[tick]
        before_ns = time.perf_counter_ns()
        ours.step(ranges_m, positions_m=places_m)
        between_ns = time.perf_counter_ns()
        predicted = predictor.predict(state, timestamp=began + timedelta(seconds=tick * dt_s))
        model = Ranges(ndim_state=4, mapping=(0, 2), noise_covar=np.eye(count) * run.range_std_m[tick, 0] ** 2, places_m=places_m)
        state = updater.update(SingleHypothesis(predicted, Detection(StateVector(ranges_m), timestamp=predicted.timestamp, measurement_model=model)))
        after_ns = time.perf_counter_ns()
        ours_ns.append(between_ns - before_ns)
        theirs_ns.append(after_ns - between_ns)
        apart = max(apart, float(np.abs(np.asarray(state.state_vector, dtype=float)[order, 0] - ours.state).max()))
    assert apart < 1e-6, f"the estimates are {apart} apart: the filters are not the same"
    ratio = statistics.median(theirs_ns) / statistics.median(ours_ns)
    return ratio, f"x as fast, M = 10 ({statistics.median(ours_ns) * 1e-3:.1f} us; estimates within {apart:.0e})", -50.0


OBSERVER = """
import json, resource, sys, time
held_ns, began_s = [], time.monotonic()
for tick in rh.attach(sys.argv[1]):
    held_ns.append(time.clock_gettime_ns(time.CLOCK_BOOTTIME) - int(tick.sent_ns))
used = resource.getrusage(resource.RUSAGE_SELF)
print(json.dumps([held_ns[50:], (used.ru_utime + used.ru_stime) / (time.monotonic() - began_s)]))
"""

_observed = {}


def observed():
    """An observer of a run with 100 Hz for half a minute: the time from sending to holding an estimate, and its share of a core."""
    if not _observed:
        with folder() as path, rh.run(name=NAME, out=path / "out", dt_s=0.01, ticks=3000, clock="realtime"):
            watching = script(OBSERVER, NAME)
            held_ns, share = json.loads(watching.communicate()[0])
        _observed.update(p99_ms=float(np.percentile(held_ns, 99)) * 1e-6, share=100 * share)
    return _observed


def observer_delay():
    return observed()["p99_ms"], "ms p99 from sending to holding an estimate, 100 Hz", 1.0


def observer_share():
    return observed()["share"], "% of a core, with its start", 3.0


KILLED = """
import os, signal, sys
for _ in range(int(sys.argv[2])):
    seen, tell = os.pipe()
    child = os.fork()
    if child == 0:
        for tick in rh.attach(sys.argv[1]): os.write(tell, b'.')
        os._exit(0)
    os.close(tell)
    assert os.read(seen, 1) == b'.'
    os.kill(child, signal.SIGKILL)
    assert os.waitpid(child, 0)[1] == signal.SIGKILL
    os.close(seen)
print('killed')
"""


def killed_observers():
    """A thousand observers of a run in lock step are killed, each at its first tick: bits of the estimates that differ, and files left."""
    keys = dict(ticks=1_000_000, clock="lockstep", timeout_s="forever", planner="greedy")
    with folder() as path:
        with rh.run(name=NAME, out=path / "out", **keys) as run:
            assert script(KILLED, NAME, 1000).communicate()[0] == "killed\n"
            assert run._process.poll() is None, "the run ended before the last observer was killed"
            run.stop()
            with contextlib.suppress(rh.RunError):
                run.report()
        live = rh.load(path / "out")
        alone = rh.simulate(rh.Scenario(**keys), ticks=int(live.tick[-1]), show_progress=False)
    left = [file for file in os.listdir("/dev/shm") if NAME in file]
    return float((live.digest != alone.digest) + len(left)), f"differences and files left after 1000 kills, {len(live)} ticks", 0.0


def fresh_headings():
    """A robot in Python in a run with 100 Hz, a minute, three times."""
    shares = []
    for _ in range(3):
        with folder() as path, rh.run(name=NAME, out=path / "out", dt_s=0.01, ticks=6000, clock="realtime", external=[2]) as run:
            robot = script("import sys\nrh.Robot(sys.argv[1], 2, carry_out=lambda heading_rad, speed_mps: None).run()", NAME)
            headings = run.report()["headings"]
            robot.communicate()
        # The report sums over three robots: all that was not fresh counts as this one's.
        of_one = sum(headings[key] for key in ("fresh", "late", "none")) / 3
        shares.append(100 * (1 - (headings["late"] + headings["none"]) / of_one))
    return statistics.median(shares), f"% fresh headings at least, median of {', '.join(f'{share:.2f}' for share in shares)}", -99.5


def ros_messages():
    """Messages that a subscriber of another process lacks of a run with ten robots and 100 Hz that the node shows."""
    ticks, found_by, lost = 2000, 500, 0
    with folder() as path, ears() as listener, ros_run(path, ticks) as run:
        with node():
            run.report()
        listener.terminate()
        heard = json.loads(listener.communicate()[0].splitlines()[-1])["/target/pose"]
        stamps = [round((pose["header"]["stamp"]["sec"] - 1 + pose["header"]["stamp"]["nanosec"] * 1e-9) / 0.01) for pose in heard]
        lost = len(set(range(found_by, ticks + 1)) - set(stamps))
    return float(lost), f"messages lost of {ticks - found_by + 1}, M = 10, 100 Hz", 0.0


def ros_inbound():
    """Messages that the node lacks of ten real robots, of a process that sends each odometry and each range once, at 100 Hz."""
    count, robots = 1000, range(10)
    topics = [f"qos_overrides./robot_{i}/{topic}.subscription" for i in robots for topic in ("odom", "range")]
    overrides = [word for topic in topics for each in ("reliability:=reliable", f"depth:={count}") for word in ("-p", f"{topic}.{each}")]
    with folder() as path, sender(count, robots) as sends, ros_run(path, 100_000, external=list(robots)) as run:
        with node("--robots", "all", "--ros-args", *overrides):
            values = json.loads(sends.communicate(timeout=300)[0].splitlines()[-1]).values()
            run.stop()
    received = [int(each[f"{what} received"]) for each in values for what in ("odometry", "ranges")]
    return float(2 * len(robots) * count - sum(received)), f"messages lost of {2 * len(robots)} times {count} from real robots, M = 10, 100 Hz", 0.0


def ros_loop():
    """How much longer the loop takes with the node attached. In one run the node is stopped and continued, in turns."""
    alone_percent = longer_percent(contextlib.nullcontext())
    heard_percent = longer_percent(ears())
    return alone_percent, f"% more from range to heading at p50, nobody subscribes; with a subscriber {heard_percent:+.1f} %", 5.0


def longer_percent(beside):
    """The same with another process, which is stopped and continued, too: the median of pairs of turns."""
    ticks, turn_s, settled_s = 6000, 1.4, 0.4
    with folder() as path, beside as other, ros_run(path, ticks) as run, node() as shows:
        processes = [process for process in (shows, other) if process is not None]
        # Until the node has started.
        time.sleep(3)
        turns, ends_s = [], clock_s() + 0.01 * ticks - 6
        while clock_s() < ends_s:
            for is_on in (False, True):
                for process in processes:
                    process.send_signal(signal.SIGCONT if is_on else signal.SIGSTOP)
                turns.append(clock_s() + settled_s)
                time.sleep(turn_s)
        run.report()
        live = rh.load(path / "out")
    sent_s, took_ns = live.sent_ns * 1e-9, live.sent_ns - live.last_range_ns
    medians = [np.median(took_ns[(sent_s > turn) & (sent_s < turn + turn_s - settled_s)]) for turn in turns]
    return float(np.median([100 * (on / off - 1) for off, on in zip(medians[::2], medians[1::2])]))


def clock_s():
    """The clock of a run's stamps, s."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


def ros_run(path, ticks, **more):
    """A run with ten robots and 100 Hz."""
    import rclpy  # noqa: F401

    return rh.run(name=NAME, out=path / "out", dt_s=0.01, ticks=ticks, robots={"count": 10}, clock="realtime", planner="certified", **more)


def ros_process(*words):
    """Another interpreter, whose ROS talks to this machine alone."""
    own = {"ROS_DOMAIN_ID": "77", "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
           "FASTDDS_DEFAULT_PROFILES_FILE": str(ROOT / "python/tests/ros2_loopback.xml"), "PYTHONUNBUFFERED": "1"}
    return subprocess.Popen([sys.executable, *words], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env={**os.environ, **own})


@contextlib.contextmanager
def node(*args):
    """The node that shows the run. It ends with it."""
    process = ros_process("-m", "rangehound.ros2", "--name", NAME, *args)
    try:
        yield process
        process.communicate()
    finally:
        process.kill()
        for file in pathlib.Path("/dev/shm").glob("lttng-ust-wait-*"):
            file.unlink(missing_ok=True)


def ears():
    """A subscriber."""
    return ros_only("ros2_listener.py", "/target/pose=geometry_msgs/PoseWithCovarianceStamped")


def sender(count, robots):
    """Real robots, which send so many messages each."""
    return ros_only("ros2_sender.py", count, 0.01, *robots)


@contextlib.contextmanager
def ros_only(script, *args):
    """A process that knows ROS alone."""
    process = ros_process(ROOT / "python/tests" / script, *map(str, args))
    try:
        assert process.stdout.readline() == "ready\n"
        yield process
    finally:
        process.kill()
        process.wait()


def importing():
    """The import of the package, less that of numpy."""
    def import_s(name):
        text = f"import time; a = time.perf_counter(); import {name}; print(time.perf_counter() - a)"
        return min(float(subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=True).stdout) for _ in range(7))

    return import_s("rangehound") * 1e3, f"ms, of which numpy {import_s('numpy') * 1e3:.0f}", 150.0


FIGURES = [plan, simulate, empty_planner, stone_soup, importing, observer_delay, observer_share, killed_observers, fresh_headings, ros_messages, ros_inbound, ros_loop]


def main():
    words, missed = sys.argv[1:], False
    print(f"{'figure':<18} {'asked':>9} {'measured':>10}")
    for figure in FIGURES:
        if words and not any(word in figure.__name__ for word in words):
            continue
        try:
            measured, what, limit = figure()
        except ModuleNotFoundError as error:
            print(f"{figure.__name__:<18} not measured: {error.name} is not installed")
            continue
        is_met = measured <= limit if limit >= 0 else measured >= -limit
        missed |= not is_met
        asked = f"<= {limit:g}" if limit >= 0 else f">= {-limit:g}"
        print(f"{figure.__name__:<18} {asked:>9} {measured:>10.3g} {what}{'' if is_met else ': MISSED'}", flush=True)
    sys.exit(missed)


if __name__ == "__main__":
    main()
