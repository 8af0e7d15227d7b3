"""One step of a planner."""

import json
import subprocess

import numpy as np
import pytest
import rangehound as rh

PROBLEM = dict(
    prior_position_covariance=np.array([[4, 0.5], [0.5, 2]]), target=np.zeros(2), time_step_s=0.1,
    positions=np.array([[8.0, 1.0], [-4.0, 6.0], [3.0, -7.0]]), max_speed=10.0, range_std=1.0,
)


def test_the_answer_is_that_of_the_program_to_the_bit(program):
    robots = [{"position": list(p), "max_speed": 10.0, "range_std": s} for p, s in zip(PROBLEM["positions"], (0.5, 1, 2))]
    line = {"prior_position_covariance": [[4, 0.5], [0.5, 2]], "target": [0, 0], "time_step_s": 0.1, "robots": robots}
    for planner in ("certified", "adaptive", "grid", "greedy", "pursue", "horizon"):
        asked = json.dumps({**line, "planner": planner})
        answer = json.loads(subprocess.run([program, "plan"], input=asked, capture_output=True, text=True, timeout=60).stdout)
        plan = rh.plan(**{**PROBLEM, "range_std": np.array([0.5, 1, 2])}, planner=planner)
        for key in ("planner", "objective", "lower_bound", "certified", "position_trace_m2", "lower_bound_trace_m2"):
            assert getattr(plan, key) == answer[key], (planner, key)
        assert plan.headings_rad.tolist() == answer["headings_rad"]
        assert plan.speeds_mps.tolist() == answer["speeds_mps"]


def test_lists_and_arrays_of_any_layout_give_one_answer():
    expected = rh.plan(**PROBLEM).headings_rad
    lists = {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in PROBLEM.items()}
    assert (rh.plan(**lists).headings_rad == expected).all()
    reversed_twice = {**PROBLEM, "positions": np.asfortranarray(PROBLEM["positions"])[::-1][::-1]}
    assert (rh.plan(**reversed_twice).headings_rad == expected).all()
    whole = {**PROBLEM, "positions": PROBLEM["positions"].astype(np.int32), "target": np.zeros(2, np.float32)}
    assert (rh.plan(**whole).headings_rad == expected).all()


def test_nan_gives_a_robot_no_such_sensor():
    plan = rh.plan(**{**PROBLEM, "range_std": [1, np.nan, np.nan]}, bearing_std_rad=[np.nan, 0.01, 0.02])
    assert plan.certified and plan.position_trace_m2 >= plan.lower_bound_trace_m2 * (1 - 1e-9)
    with pytest.raises(rh.InputError, match=r"robots\[1\].range_std is missing: expected"):
        rh.plan(**{**PROBLEM, "range_std": [1, np.nan, 1]})


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"target": [0, 0, 0]}, r"target has the shape \[3\]: expected \[2\]"),
        ({"range_std": [1, 1]}, r"range_std has the shape \[2\]: expected \[3\]"),
        ({"positions": "here"}, "positions is not an array of numbers"),
        ({"prior_position_covariance": [[1, 2], [2, 1]]}, "expected a positive definite matrix"),
        ({"max_speed": np.inf}, "max_speed is inf: expected a number from"),
        ({"planner": "best"}, 'planner is "best": expected one of'),
        ({"criterion": "none"}, "criterion is"),
    ],
)
def test_faults_name_the_argument(wrong, message):
    with pytest.raises(rh.InputError, match=message):
        rh.plan(**{**PROBLEM, **wrong})


def test_no_robots_have_no_headings():
    assert rh.plan(**{**PROBLEM, "positions": np.zeros((0, 2))}).headings_rad.shape == (0,)
