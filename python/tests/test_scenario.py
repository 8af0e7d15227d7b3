"""Scenarios from files, dicts and keywords."""

import pickle

import numpy as np
import pytest
import rangehound as rh


def test_a_scenario_from_a_file_equals_the_one_from_its_keys(root):
    of_file = rh.Scenario(root / "scenarios/paper.toml")
    assert rh.Scenario(of_file.to_dict()).to_dict() == of_file.to_dict() == rh.Scenario().to_dict()
    assert (of_file.name, of_file.robots, of_file.state_dim, of_file.planner) == ("paper", 3, 4, "adaptive")


def test_keywords_replace_parts_of_tables_and_leave_the_rest():
    scenario = rh.Scenario(ticks=7, robots={"count": 5}, planner="greedy")
    assert (scenario.ticks, scenario.robots, scenario.planner) == (7, 5, "greedy")
    assert scenario.to_dict()["robots"]["speed_mps"] == rh.Scenario().to_dict()["robots"]["speed_mps"]
    assert rh.Scenario(robots=4).robots == 4
    other = scenario.replace(seed=9)
    assert (other.seed, other.ticks, scenario.seed) == (9, 7, 5)


def test_arrays_and_paths_are_values():
    scenario = rh.Scenario({"prior": {"mean": np.zeros(4), "covariance": np.diag([1.0, 2.0, 3.0, 4.0])}})
    assert scenario.to_dict()["prior"]["covariance"][1] == [0, 2, 0, 0]


def test_a_scenario_survives_pickling():
    scenario = rh.Scenario(ticks=11)
    assert pickle.loads(pickle.dumps(scenario)).to_dict() == scenario.to_dict()


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"tiks": 3}, "unknown field `tiks` in the scenario, key tiks: expected one of"),
        ({"ticks": -3}, "key ticks: expected a whole number"),
        ({"robots": {"count": 0}}, "robots.count is 0 in the scenario: expected"),
        ({"dt_s": float("nan")}, "NaN or infinite: expected finite numbers"),
        ({"planner": "best"}, 'planner.name is "best" in the scenario: expected one of'),
        ({"robots": {"speed_mps": object()}}, "a object is given: expected numbers"),
    ],
)
def test_faults_are_one_line_that_names_the_key(keys, message):
    with pytest.raises(rh.InputError) as error:
        rh.Scenario(keys)
    assert message in str(error.value) and "\n" not in str(error.value)
    assert isinstance(error.value, ValueError)


def test_a_file_that_is_missing_is_named(tmp_path):
    with pytest.raises(rh.InputError, match="cannot read .*none.toml: .*: expected a scenario file"):
        rh.Scenario(tmp_path / "none.toml")
