"""Many runs: `compare`."""

from __future__ import annotations

import json
from typing import Any, Callable, Mapping, Sequence

import numpy as np

from . import _native, figures
from ._native import InputError
from ._progress import progress
from .scenario import scenario_of

#: Planners that serve a team of any size.
PLANNERS = ("certified", "adaptive", "standard", "greedy", "pursue", "random")


class Comparison:
    """Figures of planners on the same targets. `figures` has the keys of `compare.json`; `print` shows the table."""

    def __init__(self, comparison: str, table: str) -> None:
        self.figures: dict[str, Any] = json.loads(comparison)
        self._table = table

    @property
    def planners(self) -> dict[str, dict[str, Any]]:
        """The figures of each planner, by its name."""
        return {planner["name"]: planner for planner in self.figures["planners"]}

    def frame(self) -> Any:
        """A pandas frame with a row for each planner, and columns such as `position_rmse_m.all`."""
        pandas = figures._needs("pandas")
        rows = [{k: v for k, v in planner.items() if k not in ("series", "gap_distribution")} for planner in self.planners.values()]
        return pandas.json_normalize(rows).set_index("name")

    def plot(self, what: str = "trace", ax: Any = None) -> Any:
        """Draws the median "trace", the "rmse" or the "anees" over time on matplotlib axes, and returns them."""
        series = {"trace": "position trace, m²", "rmse": "RMS position error, m", "anees": "ANEES"}
        if what not in series:
            raise InputError(f"plot is {what!r}: expected one of {', '.join(series)}")
        ax = figures.axes(ax)
        time_s = np.asarray(self.figures["time_s"])
        for name, planner in self.planners.items():
            values = planner["series"]
            row = {"trace": values["trace_m2"]["median"], "rmse": values["rmse_m"], "anees": values["anees"]}[what]
            ax.plot(time_s, np.asarray(row, dtype=float), linewidth=1, label=name)
        ax.set(xlabel="time, s", ylabel=series[what], yscale="linear" if what == "anees" else "log")
        ax.legend(fontsize="small")
        return ax

    def __str__(self) -> str:
        return self._table

    def __repr__(self) -> str:
        return f"Comparison(planners={list(self.planners)}, runs={self.figures['runs']}, ticks={self.figures['ticks']})"


def compare(
    scenario: Any = None,
    planners: Sequence[str | Callable[..., Any]] | Mapping[str, str | Callable[..., Any]] = PLANNERS,
    *,
    runs: int = 100,
    ticks: int = 300,
    seed: int | None = None,
    sensors: Sequence[str] | Mapping[str, str | Callable[..., Any] | None] = (),
    targets: Mapping[str, Callable[..., Any] | None] | None = None,
    nuisances: Sequence[str] = (),
    sensor: Callable[..., Any] | None = None,
    target: Callable[..., Any] | None = None,
    threads: int | None = None,
    show_progress: bool | None = None,
) -> Comparison:
    """Compares planners over many runs: the figures of `rangehound compare`.

    Run i of each planner has the seed `seed + i`, and so the same target, noise and prior. A planner is a name, or a
    function as for `simulate`; a dict gives names to functions. `gap` of a planner's figures is the distance to the
    certified optimum of the same situations. `sensor` and `target` are functions as for `simulate`, the same for all
    planners. `sensors` are names of the scenario's sensors, or a dict of names and functions in which `None` stands for the
    scenario's own; `targets` is such a dict of target models. Each planner runs with each of them. Functions run on several threads, one at a time; they must not keep state from one run to the next. Ctrl-C
    ends the call.
    """
    if isinstance(planners, (str, bytes)) or callable(planners):
        planners = [planners]  # type: ignore[list-item]
    if not isinstance(planners, Mapping):
        planners = {p if isinstance(p, str) else getattr(p, "__name__", type(p).__name__): p for p in planners}
    for name, planner in planners.items():
        if isinstance(planner, str) and planner != name:
            raise InputError(f"planners has {name!r} for {planner!r}: expected the planner's own name")
    if not isinstance(sensors, Mapping):
        sensors = {name: name for name in sensors}
    with progress("run", show_progress) as report:
        return Comparison(
            *_native.compare(
                scenario_of(scenario), _compared(planners), sensors=_compared(sensors), targets=_compared(targets or {}),
                nuisances=list(nuisances), sensor=sensor, target=target, runs=runs, ticks=ticks, seed=seed, threads=threads,
                progress=report,
            )
        )


def _compared(things: Mapping[str, Any]) -> list[tuple[str, str | None, Any]]:
    """For each name: what the scenario calls it, and the function in its place."""
    return [(name, thing, None) if isinstance(thing, str) else (name, None, thing) for name, thing in things.items()]
