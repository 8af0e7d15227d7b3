"""A team of mobile robots tracks a moving target by ranges and bearings.

Everything is computed by the steps of rangehound's own nodes. Units stand in names: `_s`, `_m`, `_rad`, `_mps`.
Robots are numbered from 0; arrays of runs have a row for each tick, from tick 0, whose estimate is the prior.

============================  =========================================================
`Scenario`                    one experiment, checked
`plan`                        the headings of one step, with a bound for all others
`Filter`                      the estimate, tick by tick
`simulate`                    a run, also with a planner, sensor or target of your own
`track`, `calibrate`          recorded ranges and bearings
`compare`                     planners on the same targets
`load`                        the folder of a run
`run`, `attach`               a live run: start it, watch its ticks
`Robot`, `Radio`, `fusion`    nodes of a live run with functions of your own
============================  =========================================================
"""

from ._native import InputError, Plan, RunError, Situation, __version__, plan
from .filter import Filter
from .live import LiveRun, Radio, Robot, Tick, attach, fusion, run
from .recordings import Calibration, calibrate, track
from .runs import Run, load, simulate
from .scenario import Scenario
from .study import Comparison, compare

__all__ = [
    "Calibration", "Comparison", "Filter", "InputError", "LiveRun", "Plan", "Radio", "Robot", "Run", "RunError",
    "Scenario", "Situation", "Tick", "__version__", "attach", "calibrate", "compare", "fusion", "load", "plan", "run", "simulate", "track",
]
