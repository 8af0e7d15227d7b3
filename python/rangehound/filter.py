"""The filter of the fusion centre."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from . import _native
from .scenario import scenario_of

if TYPE_CHECKING:
    from typing_extensions import Self


class Filter(_native.Filter):
    """The estimate of a scenario, tick by tick: prediction, gate, update, as in a run.

    The state x is (n,), position first, with covariance P (n, n). A step predicts and fuses:

        x' = Phi x,  P' = Phi P Phi^T + G Qd G^T
        P = (P'^-1 + sum_i h_i h_i^T / sigma_i^2)^-1,  x = x' + P sum_i h_i nu_i / sigma_i^2

    with h_i the gradient of measurement i, nu_i its innovation and sigma_i its standard deviation. Target model, prior,
    gate and noise are the scenario's; keywords are those of `Scenario`. At first the estimate is the prior (tick 0).
    """

    __slots__ = ()

    def __new__(cls, scenario: Any = None, /, **keys: Any) -> Self:
        scenario = scenario_of(scenario)
        return super().__new__(cls, scenario.replace(**keys) if keys else scenario)

    def __repr__(self) -> str:
        x_m, y_m = self.state[:2]
        return f"Filter(tick={self.tick}, position_m=[{x_m:.3f}, {y_m:.3f}])"

