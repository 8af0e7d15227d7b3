"""The native half: see the modules of the package."""

from os import PathLike
from typing import Any, Callable, Sequence, final

from typing_extensions import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

__version__: str

class InputError(ValueError):
    """Input that the user must mend: what is wrong, and what was expected."""

class RunError(RuntimeError):
    """A failure while running."""

class Scenario:
    def __new__(
        cls,
        path: str | PathLike[str] | None = None,
        keys: str | None = None,
        over: str | None = None,
        folder: str | PathLike[str] | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> Self: ...
    def keys(self) -> str: ...
    def to_toml(self) -> str:
        """The text of a scenario file."""
    @property
    def folder(self) -> PathLike[str]: ...
    @property
    def name(self) -> str: ...
    @property
    def ticks(self) -> int:
        """Time steps after tick 0."""
    @property
    def dt_s(self) -> float:
        """Length of a time step, s."""
    @property
    def seed(self) -> int: ...
    @property
    def robots(self) -> int:
        """Number of robots M, or of a recording's sensors."""
    @property
    def robot_names(self) -> list[str]: ...
    @property
    def state_dim(self) -> int:
        """Dimension n of the target's state."""
    @property
    def planner(self) -> str: ...
    @property
    def is_recording(self) -> bool: ...
    @property
    def notes(self) -> list[str]:
        """How its recording was read: what was skipped, and what is in doubt."""

@final
class Plan:
    """The headings of one step, and the objective that they reach."""

    @property
    def planner(self) -> str: ...
    @property
    def headings_rad(self) -> NDArray[np.float64]:
        """(M,), rad counter-clockwise from the x axis."""
    @property
    def speeds_mps(self) -> NDArray[np.float64]:
        """(M,), m/s."""
    @property
    def objective(self) -> float:
        """The minimised quantity: `|S|`, 1/m^2, for ranges of constant noise; the criterion's value for other sensors."""
    @property
    def lower_bound(self) -> float:
        """No headings reach less of the objective."""
    @property
    def certified(self) -> bool:
        """True if the bound is proven to be reached."""
    @property
    def position_trace_m2(self) -> float:
        """Trace of the position covariance after the robots' next measurements, m^2."""
    @property
    def lower_bound_trace_m2(self) -> float:
        """No headings lead to a lesser trace, m^2."""
    @property
    def plan_us(self) -> float:
        """Time of the planning alone, us."""

@final
class Situation:
    """The inputs of a planner before a step: M robots, and a state of dimension n."""

    @property
    def tick(self) -> int: ...
    @property
    def robots(self) -> int: ...
    @property
    def step_s(self) -> float:
        """How long the robots move before they measure, s."""
    @property
    def target_m(self) -> NDArray[np.float64]:
        """Where the target is predicted to be when the robots measure next, (2,), m."""
    @property
    def covariance_m2(self) -> NDArray[np.float64]:
        """Covariance of that, (2, 2), m^2."""
    @property
    def state(self) -> NDArray[np.float64]:
        """The predicted state, (n,), position first."""
    @property
    def covariance(self) -> NDArray[np.float64]:
        """Covariance of the predicted state, (n, n)."""
    @property
    def positions_m(self) -> NDArray[np.float64]:
        """Position of each robot as it knows it, (M, 2), m."""
    @property
    def position_covariances_m2(self) -> NDArray[np.float64]:
        """Covariance of each robot's position, (M, 2, 2), m^2."""
    @property
    def max_speeds_mps(self) -> NDArray[np.float64]:
        """Speed limit of each robot, (M,), m/s."""
    @property
    def range_stds_m(self) -> NDArray[np.float64]:
        """Standard deviation of each robot's range at distance 0, (M,), m; NaN without ranges."""
    @property
    def bearing_stds_rad(self) -> NDArray[np.float64]:
        """Standard deviation of each robot's bearing, (M,), rad; NaN without bearings."""
    def plan(self, planner: str = "certified", *, seed: int | None = None) -> Plan:
        """The plan of a built-in planner for this situation."""
    def evaluate(self, headings_rad: ArrayLike, speeds_mps: ArrayLike | None = None) -> tuple[float, float, float]:
        """Evaluates headings (M,), rad, and speeds (M,), m/s: objective, position trace, m^2, gap to the optimum."""
    def worth(self, headings_rad: ArrayLike, speeds_mps: ArrayLike | None = None) -> tuple[float, float, float]:
        """The same as `evaluate`: its former name."""

class Filter:
    def __new__(cls, scenario: Scenario) -> Self: ...
    def step(
        self,
        ranges_m: ArrayLike | None = None,
        *,
        positions_m: ArrayLike | None = None,
        range_stds_m: ArrayLike | None = None,
        bearings_rad: ArrayLike | None = None,
        bearing_stds_rad: ArrayLike | None = None,
        headings_rad: ArrayLike | None = None,
        position_covariances_m2: ArrayLike | None = None,
        time_s: float | None = None,
    ) -> None:
        """One tick: predicts over a time step, then fuses what is given.

        `ranges_m` and `bearings_rad` are (M,), NaN where a robot has none; `positions_m` (M, 2) stay until they are given
        again. Without standard deviations those of the scenario hold. Bearings count from `headings_rad`.
        `position_covariances_m2` is (M, 2, 2). `time_s` is for the filter of a recording alone.
        """
    def plan(self) -> Plan:
        """The headings for the next measurements, by the scenario's planner."""
    @property
    def tick(self) -> int: ...
    @property
    def time_s(self) -> float: ...
    @property
    def state(self) -> NDArray[np.float64]:
        """(n,), position first: m, m/s, ..."""
    @property
    def covariance(self) -> NDArray[np.float64]:
        """Covariance P of the state, (n, n)."""
    @property
    def nis(self) -> float:
        """Normalised innovation squared of the last update: chi-square with `fused` degrees of freedom."""
    @property
    def fused(self) -> int: ...
    @property
    def rejected(self) -> int: ...
    @property
    def distrusted(self) -> list[int]:
        """Robots whose ranges are distrusted."""
    @property
    def digest(self) -> str:
        """Hash over the bits of all estimates so far: that of a run with the same measurements is equal."""

def plan(
    *,
    prior_position_covariance: ArrayLike,
    target: ArrayLike,
    time_step_s: float,
    positions: ArrayLike,
    max_speed: ArrayLike,
    range_std: ArrayLike | None = None,
    range_std_per_m: ArrayLike | None = None,
    bearing_std_rad: ArrayLike | None = None,
    max_range_m: ArrayLike | None = None,
    field_of_view_rad: ArrayLike | None = None,
    position_covariance: ArrayLike | None = None,
    heading_std_rad: ArrayLike | None = None,
    stand_off_m: float | None = None,
    stand_off_sigma: float | None = None,
    separation_m: float | None = None,
    planner: str | None = None,
    criterion: str | None = None,
    seed: int | None = None,
    tick: int = 0,
) -> Plan: ...
def simulate(
    scenario: Scenario,
    *,
    planner: Callable[..., Any] | None = None,
    sensor: Callable[..., Any] | None = None,
    target: Callable[..., Any] | None = None,
    seed: int | None = None,
    ticks: int | None = None,
    gap: bool = False,
    truth: str | PathLike[str] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[dict[str, NDArray[Any]], str]: ...
def load(
    folder: str | PathLike[str],
    *,
    truth: str | PathLike[str] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Scenario | None, dict[str, NDArray[Any]], str]: ...
def compare(
    scenario: Scenario,
    planners: list[tuple[str, str | None, Callable[..., Any] | None]],
    *,
    sensors: list[tuple[str, str | None, Callable[..., Any] | None]] = ...,
    targets: list[tuple[str, str | None, Callable[..., Any] | None]] = ...,
    nuisances: list[str] = ...,
    sensor: Callable[..., Any] | None = None,
    target: Callable[..., Any] | None = None,
    runs: int,
    ticks: int,
    seed: int | None = None,
    threads: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[str, str]: ...
def calibrate(
    keys: str,
    *,
    truth: str | PathLike[str] | None = None,
    reading: Callable[[int, int], None] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[str, str, list[list[tuple[float, float]]]]: ...
def calibrated(keys: str, toml: str, *, reading: Callable[[int, int], None] | None = None) -> str: ...

@final
class Observer:
    def __new__(cls, name: str, from_start: bool, waits_for_truth: bool, timeout_s: float) -> Self: ...
    @property
    def name(self) -> str: ...
    @property
    def folder(self) -> PathLike[str]: ...
    def describe(self) -> dict[str, Any]: ...
    def status(self) -> str: ...
    def is_over(self) -> bool:
        """True once the run has ended, or its processes are gone."""
    def __iter__(self) -> Self: ...
    def __next__(self) -> dict[str, NDArray[Any]]: ...

@final
class MessageStream:
    def __new__(cls, name: str, timeout_s: float) -> Self: ...
    def is_over(self) -> bool: ...
    def skip(self) -> None:
        """Passes over the ticks that are logged already."""
    def __iter__(self) -> Self: ...
    def __next__(self) -> tuple[int, list[tuple[int, bytes]]]:
        """The next complete tick: time of the run, ns, and each message with the number of its channel."""

def channels() -> list[tuple[str, str, str, str, bytes]]:
    """Topic, message encoding, and name, encoding and data of the schema."""

def run_robot(
    name: str,
    id: int,
    *,
    radio: Any = None,
    measure: Callable[..., Any] | None = None,
    pose: Callable[..., Any] | None = None,
    carry_out: Callable[..., Any] | None = None,
) -> None: ...
def run_fusion(name: str, *, planner: Callable[..., Any] | None = None) -> None: ...
def ros_target(
    state: ArrayLike, covariance: ArrayLike, has_velocity: bool
) -> tuple[tuple[float, float, float, float, NDArray[np.float64]], float, NDArray[np.float64]]:
    """Pose (x, y, z, yaw, covariance (36,)), speed, and covariance of the velocity in the target's own frame, (36,)."""

def ros_robot(
    position_m: tuple[float, float, float], covariance_m2: ArrayLike, heading_rad: float, heading_std_rad: float
) -> tuple[float, float, float, float, NDArray[np.float64]]:
    """x, y, z, yaw, covariance (36,)."""

def ros_markers(
    position_m: Sequence[float],
    covariance_m2: Sequence[Sequence[float]],
    robots: Sequence[tuple[Sequence[float], float, bool, float, float]],
) -> list[tuple[str, int, int, bool, list[float], float, list[float], list[float], list[list[float]]]]:
    """For each robot: place, range, whether that was not fused, commanded heading and speed. For each marker: namespace, id, type,
    whether it is shown, position, yaw, scale, colour, points."""

def ros_status(
    *,
    tick: int,
    ticks: int,
    fused: int,
    missing: int,
    rejected: int,
    silent: Sequence[int],
    distrusted: Sequence[int],
    sent_ns: Sequence[int],
    trace_m2: float,
) -> tuple[int, str, str, list[tuple[str, str]]]:
    """Level, name, message, and pairs of keys and values."""

def ros_twist(
    heading_rad: float,
    speed_mps: float,
    yaw_rad: float,
    max_speed_mps: float,
    max_turn_rate_radps: float,
    heading_gain_per_s: float,
) -> list[float]:
    """Forward speed, m/s, and turn rate, rad/s."""
