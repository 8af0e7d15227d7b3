"""Runs as arrays: `simulate` and `load`."""

from __future__ import annotations

import json
import os
from typing import Any, Callable

import numpy as np

from . import _native, figures
from ._native import InputError
from ._progress import progress
from .scenario import Scenario, scenario_of


class Run:
    """The ticks of a run, T of them, M robots, and a state of dimension n. Each array is an attribute.

    ==========================  ============  ==================================================================
    `tick`, `time_s`            (T,)          tick, from 0; time, s
    `state`                     (T, n)        estimate, position first: m, m/s, ...
    `covariance`                (T, n, n)     its covariance P
    `truth`                     (T, n)        true state; (T, 0) if it is unknown
    `robot_m`                   (T, M, 2)     true position of each robot, m
    `believed_m`                (T, M, 2)     its position as it reported it, m; NaN if it did not report
    `believed_covariance_m2`    (T, M, 2, 2)  the covariance of that as it reported it, m^2
    `believed_heading_rad`      (T, M)        its heading as it reported it, rad. `believed_heading_std_rad`
    `believed_height_m`         (T, M)        its height above the plane of the target, m
    `range_m`                   (T, M)        reported range, m, calibrated; NaN if there is none. `range_std_m`
    `bearing_rad`               (T, M)        the same from the robot's heading. `bearing_std_rad`
    `range_used`                (T, M)        0 nothing measured, 1 fused, 2 rejected, 3 distrusted. `bearing_used`
    `heading_rad`               (T, M)        commanded heading from this tick to the next. `speed_mps`
    `nis`                       (T,)          normalised innovation squared, `fused` degrees of freedom
    `fused`, `rejected`         (T,)          numbers of measurements; `missing`: of robots that did not report
    `objective`                 (T,)          what the planner made small; `lower_bound`, -inf without a proof
    `least_trace_m2`            (T,)          no headings of this tick lead to a lesser position trace at the next; 0 without a proof
    `sent_ns`                   (T,)          time of `CLOCK_BOOTTIME` at which the headings were sent, ns; 0 if it was not taken.
                                              `last_range_ns`: at which the tick's last range was sent
    `gap`                       (T,)          objective above the certified optimum, relative; with `gap=True` alone
    `trace_excess`              (T,)          planned position trace above the least, relative; with `gap=True` alone
    ==========================  ============  ==================================================================

    `report` has the keys of `report.json`, and `scenario` is the experiment.
    """

    def __init__(self, scenario: Scenario | None, arrays: dict[str, np.ndarray], report: str) -> None:
        self.scenario = scenario
        self.arrays = arrays
        self.report: dict[str, Any] = json.loads(report)

    def __getattr__(self, name: str) -> np.ndarray:
        arrays = self.__dict__.get("arrays", {})
        if name in arrays:
            return arrays[name]
        if name in ("gap", "trace_excess"):
            raise AttributeError(f"this run has no {name}: expected a run of simulate(..., gap=True)")
        raise AttributeError(f"a run has no {name}: expected one of {', '.join(arrays)}")

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self.arrays]

    def __len__(self) -> int:
        return len(self.arrays["tick"])

    @property
    def position_m(self) -> np.ndarray:
        """Estimated position, (T, 2), m."""
        return self.arrays["state"][:, :2]

    @property
    def position_trace_m2(self) -> np.ndarray:
        """Trace of the position covariance, (T,), m^2."""
        covariance = self.arrays["covariance"]
        return covariance[:, 0, 0] + covariance[:, 1, 1]

    @property
    def error_m(self) -> np.ndarray:
        """Distance of the estimate from the true position, (T,), m; NaN where the truth is unknown."""
        truth = self.arrays["truth"]
        if truth.shape[1] < 2:
            return np.full(len(self), np.nan)
        return np.linalg.norm(self.position_m - truth[:, :2], axis=1)

    @property
    def is_valid(self) -> bool:
        """Whether the result can be believed: the verdict of the report."""
        return bool(self.report["verdict"]["valid"])

    @property
    def is_sound(self) -> bool:
        """Earlier name of `is_valid`."""
        return self.is_valid

    @property
    def digest(self) -> str:
        """Hash over the bits of all estimates: equal for equal runs."""
        return str(self.report["digest"])

    def frame(self) -> Any:
        """The run as a pandas frame with a row for each tick; arrays of robots have columns such as `range_m_0`."""
        return figures.frame_of(self.arrays)

    def plot(self, what: str = "field", ax: Any = None) -> Any:
        """Draws the run on matplotlib axes and returns them: "field", "error" on its 95 % band, or "trace"."""
        drawn = {"field": figures.field, "error": figures.error, "trace": figures.trace}
        if what not in drawn:
            raise InputError(f"plot is {what!r}: expected one of {', '.join(drawn)}")
        return drawn[what](self, ax)

    def __repr__(self) -> str:
        rmse = self.report.get("position_rmse_m")
        error = "" if rmse is None else f", position_rmse_m={rmse:.3f}"
        return f"Run({self.report['scenario']!r}, ticks={self.report['ticks']}, robots={self.report['robots']}{error}, valid={self.is_valid})"


def simulate(
    scenario: Any = None,
    planner: str | Callable[..., Any] | None = None,
    *,
    seed: int | None = None,
    ticks: int | None = None,
    sensor: Callable[..., Any] | None = None,
    target: Callable[..., Any] | None = None,
    gap: bool | None = None,
    show_progress: bool | None = None,
) -> Run:
    """Runs a scenario in this process: the estimates of `rangehound run --in-process`, bit for bit.

    `planner` is a name, or a function `f(situation)` that returns a heading for each robot, (M,), rad, or headings and
    speeds, or a `Plan`. `sensor` is a function `f(robot, tick, range_m, bearing_rad)` of the true values, NaN where the
    robot's sensor sees nothing. It returns `None`, a range, `(range_m, std_m)` or `(range_m, std_m, bearing_rad,
    std_rad)`. `target` is a function `f(tick, state, noise)` that returns the next true state, (n,); `noise` has standard
    normal numbers, (n,), which depend on seed and tick only. `sensor` and `target` do not change what the filter assumes.

    `gap=True` measures each plan against the certified optimum of the same situation; it is the default with a planner
    that is a function.

    Raises `InputError` for invalid input, and whatever a function raises. Ctrl-C ends the call.
    """
    scenario = scenario_of(scenario)
    function = None
    if callable(planner):
        function = planner
    elif planner is not None:
        scenario = scenario.replace(planner={"name": planner})
    if gap is None:
        gap = function is not None
    with progress("tick", show_progress) as report:
        arrays, summary = _native.simulate(
            scenario, planner=function, sensor=sensor, target=target, seed=seed, ticks=ticks, gap=gap, progress=report
        )
    if seed is not None or ticks is not None:
        scenario = scenario.replace(seed=seed, ticks=ticks)
    return Run(scenario, arrays, summary)


def load(
    folder: str | os.PathLike[str], *, truth: str | os.PathLike[str] | None = None, show_progress: bool | None = None
) -> Run:
    """Loads the folder of a run, such as `runs/paper`: one that has ended, or one that still runs.

    The report is computed from the logs; its `nodes` are those of `report.json`, which is written at the end.
    `truth` is a file with the true track of a recording: `time_s,x_m,y_m`.
    """
    with progress("tick", show_progress) as report:
        scenario, arrays, summary = _native.load(os.fspath(folder), truth=truth, progress=report)
    return Run(Scenario(scenario) if scenario is not None else None, arrays, summary)
