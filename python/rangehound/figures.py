"""pandas frames and matplotlib figures, where those are installed."""

from __future__ import annotations

from typing import Any

import numpy as np

#: 95 % of a chi-square with two degrees of freedom.
CHI_SQUARE_95 = 5.991464547107979


def _needs(package: str) -> Any:
    import importlib

    try:
        return importlib.import_module(package)
    except ModuleNotFoundError as error:
        name = package.partition(".")[0]
        raise ModuleNotFoundError(f"{name} is not installed: frames and figures need it: pip install {name}") from error


def frame_of(arrays: dict[str, np.ndarray]) -> Any:
    """A pandas frame with a row for each tick, and a column for each number of a tick."""
    pandas = _needs("pandas")
    columns: dict[str, np.ndarray] = {}
    for name, values in arrays.items():
        flat = values.reshape(len(values), -1) if values.size else values.reshape(len(values), 0)
        if values.ndim == 1:
            columns[name] = values
            continue
        for column, index in enumerate(np.ndindex(*values.shape[1:])):
            columns["_".join([name, *map(str, index)])] = flat[:, column]
    return pandas.DataFrame(columns).set_index("tick")


def axes(ax: Any) -> Any:
    """These axes, or new ones."""
    if ax is not None:
        return ax
    return _needs("matplotlib.pyplot").subplots()[1]


def field(run: Any, ax: Any = None) -> Any:
    """Target, estimate and robots in the plane, with the last 95 % ellipse of the estimate."""
    ax = axes(ax)
    if run.truth.shape[1] >= 2:
        ax.plot(run.truth[:, 0], run.truth[:, 1], color="black", linewidth=1, label="target")
    ax.plot(run.state[:, 0], run.state[:, 1], color="tab:red", linewidth=1, label="estimate")
    for robot in range(run.robot_m.shape[1]):
        path = run.robot_m[:, robot]
        (line,) = ax.plot(path[:, 0], path[:, 1], linewidth=0.8, label=f"robot {robot}")
        ax.plot(*path[-1], marker="o", markersize=4, color=line.get_color())
    scales, directions = np.linalg.eigh(run.covariance[-1, :2, :2])
    angle = np.linspace(0, 2 * np.pi, 100)
    circle = np.sqrt(CHI_SQUARE_95 * np.maximum(scales, 0))[:, None] * np.array([np.cos(angle), np.sin(angle)])
    ellipse = directions @ circle + run.state[-1, :2, None]
    ax.plot(*ellipse, color="tab:red", linewidth=0.8, linestyle="--")
    ax.set(xlabel="x, m", ylabel="y, m", aspect="equal")
    ax.legend(fontsize="small")
    return ax


def error(run: Any, ax: Any = None) -> Any:
    """The position error, and a radius that holds 95 % of the errors of a consistent filter.

    The radius is sqrt(5.99 lambda), with lambda the larger eigenvalue of the position covariance: it is on the safe side.
    """
    ax = axes(ax)
    largest = np.linalg.eigvalsh(run.covariance[:, :2, :2])[:, -1]
    ax.fill_between(run.time_s, 0, np.sqrt(CHI_SQUARE_95 * largest), color="tab:blue", alpha=0.2, label="95 % band")
    ax.plot(run.time_s, run.error_m, color="tab:red", linewidth=1, label="error")
    ax.set(xlabel="time, s", ylabel="position error, m")
    ax.legend(fontsize="small")
    return ax


def trace(run: Any, ax: Any = None) -> Any:
    """The trace of the position covariance, and the least that headings could reach, where the planner has proven it."""
    ax = axes(ax)
    ax.semilogy(run.time_s, run.position_trace_m2, linewidth=1, label=run.report["planner"])
    least = run.least_trace_m2[:-1]
    if (least > 0).any():
        ax.semilogy(run.time_s[1:], np.where(least > 0, least, np.nan), linewidth=0.8, linestyle="--", label="least")
    ax.set(xlabel="time, s", ylabel="position trace, m²")
    ax.legend(fontsize="small")
    return ax
