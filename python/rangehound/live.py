"""Live runs: start one, watch its ticks, and take part with functions of your own."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import threading
import time
import traceback
from typing import TYPE_CHECKING, Any, Callable, Iterator, Sequence

import numpy as np

from . import _native
from ._native import InputError, RunError
from .scenario import scenario_of

if TYPE_CHECKING:
    import subprocess

#: How long a run may take to end after it has been asked to, s.
_END_S = 30.0

#: How often it is looked whether a run with a planner of one's own goes on, and how long its fusion may take to leave it, s.
_LOOK_S, _LEAVE_S = 0.1, 1.0


class Tick:
    """One tick of a live run. Attributes are those of `Run` without their first axis: `state` is (n,), `robot_m` (M, 2).

    What is not recorded yet is NaN: true positions come at the end of a tick, after its estimate.
    """

    def __init__(self, arrays: dict[str, np.ndarray]) -> None:
        self.arrays = {name: values[0] for name, values in arrays.items()}

    def __getattr__(self, name: str) -> Any:
        arrays = self.__dict__.get("arrays", {})
        if name in arrays:
            return arrays[name]
        raise AttributeError(f"a tick has no {name}: expected one of {', '.join(arrays)}")

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self.arrays]

    @property
    def position_m(self) -> np.ndarray:
        """Estimated position, (2,), m."""
        return self.arrays["state"][:2]

    @property
    def error_m(self) -> float:
        """Distance of the estimate from the true position, m; NaN if the truth is not known, or not yet."""
        truth = self.arrays["truth"]
        return float(np.linalg.norm(self.position_m - truth[:2])) if len(truth) >= 2 else float("nan")

    def __repr__(self) -> str:
        x_m, y_m = self.position_m
        return f"Tick({self.tick}, position_m=[{x_m:.3f}, {y_m:.3f}])"


def attach(
    name: str, *, from_start: bool = False, truth: bool = False, timeout_s: float = 10.0
) -> Iterator[Tick]:
    """Iterates over the ticks of a live run, from its newest or its first one to its end.

    It waits for the run up to `timeout_s`, and for each tick until fusion has recorded it. `truth=True` waits for the true
    positions too, which the simulator records at the end of the tick. The run does not wait for an observer.
    """
    for arrays in _native.Observer(name, from_start, truth, timeout_s):
        yield Tick(arrays)


class Radio:
    """A radio on a serial port, whose ranges are those of a robot: the formats and their limits are in `docs/hardware.md`.

    `port` is a device, a FIFO or a file. `format` is "plain", "dwm1001", "linktrack" or "mauwb"; all but plain need `anchor`,
    the id of the anchor whose range is the robot's. `bias_m` and `scale` are those of `measured = (1 + scale) true + bias_m`.
    A range older than `max_age_s` is not used (default: the time step).
    """

    def __init__(
        self,
        port: str | os.PathLike[str],
        format: str = "plain",
        *,
        anchor: str | None = None,
        tag: str | None = None,
        bias_m: float = 0.0,
        scale: float = 0.0,
        max_age_s: float | None = None,
    ) -> None:
        self.port, self.format, self.anchor, self.tag = os.fspath(port), format, anchor, tag
        self.bias_m, self.scale, self.max_age_s = bias_m, scale, max_age_s


class Robot:
    """A robot of a live run, in this process, with the protocol of `rangehound robot`.

    `measure(robot, tick, range_m, bearing_rad)` is as `sensor` of `simulate`; a real sensor ignores the last two.
    `pose(time_s, x_m, y_m, heading_rad)` returns `(x_m, y_m)`, and heading_rad, std_m and heading_std_rad if they are
    known, or `(x_m, y_m, heading_rad, xx_m2, xy_m2, yy_m2, heading_std_rad)` with the covariance of the position. `carry_out(heading_rad, speed_mps)` drives, and returns `None`, or the heading and the speed that were driven.
    Functions that are missing are those of the scenario. All are on the control path: fusion waits for them.
    `radio` measures the ranges instead of a function.
    """

    def __init__(
        self,
        name: str,
        id: int,
        *,
        radio: Radio | None = None,
        measure: Callable[..., Any] | None = None,
        pose: Callable[..., Any] | None = None,
        carry_out: Callable[..., Any] | None = None,
    ) -> None:
        if radio is not None and measure is not None:
            raise InputError("radio and measure are given: expected one of them")
        self.name, self.id = name, id
        self._parts: dict[str, Any] = {"radio": radio, "measure": measure, "pose": pose, "carry_out": carry_out}

    def run(self) -> None:
        """Takes part until the run ends. The last command is always to stop. An exception of a function ends the robot."""
        _native.run_robot(self.name, self.id, **self._parts)


def fusion(name: str, planner: Callable[..., Any] | None = None) -> None:
    """The fusion of a live run, in this process, with a planner of your own: `planner(situation)` as for `simulate`.

    It leads until the run ends. If the planner raises an exception, the robots keep their headings for three ticks and
    then stop, and this call raises it. If it takes longer than a time step, headings come late, and the report counts them.
    If it takes longer than three steps in real time, or than the time-out in lock step, this call raises `RunError`.
    """
    _native.run_fusion(name, planner=planner)


class LiveRun:
    """A run with a process for each node, started by `run`."""

    def __init__(self, process: subprocess.Popen[str], name: str, program: str, log: Any) -> None:
        self.name = name
        self._process, self._program, self._log = process, program, log
        self._report: dict[str, Any] | None = None
        #: The error that has ended the process of a planner of one's own.
        self._problem: str | None = None

    def kill(self, node: str) -> None:
        """Kills a node with SIGKILL: "sim", "fusion", "robot-1". Another process takes its place."""
        self._command("kill", node)

    def restart(self, node: str) -> None:
        """Asks a node to end; the supervisor starts another."""
        self._command("restart", node)

    def stop(self) -> None:
        """Ends the run before its last tick."""
        self._command("stop")

    def status(self) -> dict[str, Any]:
        """The nodes and their states."""
        return json.loads(self._command("status", "--json"))

    def attach(self, **how: Any) -> Iterator[Tick]:
        """As the function `attach`."""
        return attach(self.name, **how)

    def wait(self) -> dict[str, Any]:
        """Waits for the end of the run, and returns its report: the keys of `report.json`."""
        return self.report()

    def report(self) -> dict[str, Any]:
        """The report: waits for the end of the run."""
        if self._report is None:
            out, _ = self._process.communicate()
            if self._problem is not None:
                raise RunError(self._problem)
            self._log.seek(0)
            lines = self._log.read().strip().splitlines()
            if self._process.returncode != 0:
                line = lines[-1].removeprefix("rangehound: ") if lines else f"exit code {self._process.returncode}"
                raise (InputError if self._process.returncode == 2 else RunError)(line)
            self._report = json.loads(out)
        return self._report

    def close(self) -> None:
        """Ends the run if it still goes on."""
        if self._process.poll() is None:
            self._process.terminate()
            import subprocess

            try:
                self._process.communicate(timeout=_END_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.communicate()

    def _lead(self, planner: Callable[..., Any]) -> None:
        """Keeps a fusion with this planner, in a process of its own. One that is killed is started again; an error ends the run."""
        # A function need not be importable, so the process is a copy of this one.
        import multiprocessing

        context = multiprocessing.get_context("fork")
        while self._process.poll() is None:
            receiver, sender = context.Pipe(duplex=False)
            fusion = context.Process(target=_plan, args=(self.name, planner, sender), daemon=True)
            fusion.start()
            sender.close()
            while not receiver.poll(_LOOK_S):
                if self._process.poll() is not None:
                    # A run that was stopped does not tell those that it has not started.
                    fusion.join(timeout=_LEAVE_S)
                    fusion.terminate()
                    return
            with contextlib.suppress(EOFError):
                self._problem = receiver.recv()
                self._process.terminate()
            fusion.join()
            if fusion.exitcode == 0 or self._problem is not None:
                return

    def __enter__(self) -> "LiveRun":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _command(self, *args: str) -> str:
        import subprocess

        if self._process.poll() is not None:
            # Another run may have its name by now.
            raise RunError(f"run {self.name} has ended: expected one that still goes on")
        done = subprocess.run([self._program, *args, "--name", self.name], capture_output=True, text=True)
        if done.returncode != 0:
            lines = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
            raise (InputError if done.returncode == 2 else RunError)(lines[-1].removeprefix("rangehound: "))
        return done.stdout


def _plan(name: str, planner: Callable[..., Any], sender: Any) -> None:
    """The process of a fusion: sends what has gone wrong."""
    # Ctrl-C is for the process that has started the run, and ends it in order.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    try:
        fusion(name, planner)
    except Exception as error:
        traceback.print_exc()
        problem = str(error).partition("\n")[0]
        sender.send(problem if isinstance(error, (InputError, RunError)) else f"the planner raised {type(error).__name__}: {problem}")
        sys.exit(1)


def run(
    scenario: Any = None,
    *,
    name: str,
    out: str | os.PathLike[str] | None = None,
    planner: str | Callable[..., Any] | None = None,
    standby: int = 0,
    external: Sequence[int | str] = (),
    record: bool = False,
    program: str | os.PathLike[str] | None = None,
    **keys: Any,
) -> LiveRun:
    """Starts a run with a process for each node, as `rangehound run` does, and returns at once.

    Keywords are those of `Scenario`, such as `clock="lockstep"`. `planner` is a name, or a function as for `simulate`: fusion is
    then a copy of this process, which is started again if it is killed. If the function raises an exception or is too slow, the
    run ends, and `report` says why. The robots `external` are not started: they are processes of yours, such as `Robot`, and the
    run waits for them; "fusion" among them is one of yours, too. `out` is the run folder (default: `runs/NAME`). `program`
    is the program `rangehound` (default: that of the variable `RANGEHOUND`, or on the path).

    >>> with rh.run(name="demo", ticks=300) as run:
    ...     run.kill("robot-1")
    ...     print(run.report()["verdict"])
    """
    # Here, because they would be a tenth of the time of the import.
    import shutil
    import subprocess
    import tempfile

    program = os.fspath(program or os.environ.get("RANGEHOUND") or shutil.which("rangehound") or "")
    if not program or not os.access(program, os.X_OK):
        raise InputError(f"no program {program or 'rangehound'}: expected it on the path, in RANGEHOUND, or as program=...")
    if isinstance(planner, str):
        keys["planner"] = planner
    elif callable(planner):
        external = [*external, "fusion"]
    elif planner is not None:
        raise InputError(f"planner is {planner!r}: expected a name or a function")
    scenario = scenario_of(scenario)
    scenario = scenario.replace(**keys) if keys else scenario
    if scenario.is_recording:
        raise InputError("the scenario plays a recording: expected a simulated one: `track` plays recordings")
    args = [program, "run", "--name", name, "--json", "--standby", str(standby), "--end-with", str(os.getpid())]
    args += ["--record" if record else "--no-record"]
    args += ["--external", ",".join(map(str, external))] if len(external) > 0 else []
    args += ["--out", os.fspath(out)] if out is not None else []
    log = tempfile.TemporaryFile("w+", encoding="utf-8")
    with tempfile.NamedTemporaryFile("w", suffix=".toml", encoding="utf-8") as file:
        file.write(scenario.to_toml())
        file.flush()
        process = subprocess.Popen([*args, file.name], stdout=subprocess.PIPE, stderr=log, text=True)
        live = LiveRun(process, name, program, log)
        _wait_until_created(live)
    if callable(planner):
        threading.Thread(target=live._lead, args=(planner,), name="planner", daemon=True).start()
    return live


def _wait_until_created(live: LiveRun) -> None:
    """Waits until the run can be joined, and is that of this process and not another of its name: its scenario has been read then."""
    while live._process.poll() is None:
        try:
            status = json.loads(_native.Observer(live.name, False, False, 0.05).status())
        except InputError:
            continue
        if any(node["pid"] == live._process.pid for node in status["nodes"]):
            return
        time.sleep(0.02)
    live.report()

