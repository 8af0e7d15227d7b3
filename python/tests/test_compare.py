"""Many runs."""

import json
import subprocess

import pytest
import rangehound as rh


def test_the_figures_are_those_of_the_program(program, tmp_path):
    args = ["compare", "--runs", "4", "--ticks", "60", "--planners", "certified,greedy", "--json", "--out", tmp_path / "out"]
    done = subprocess.run([program, *args], capture_output=True, text=True, timeout=120)
    expected = json.loads(done.stdout)
    compared = rh.compare(planners=["certified", "greedy"], runs=4, ticks=60)
    for ours, theirs in zip(compared.figures["planners"], expected["planners"], strict=True):
        for key in ours.keys() - {"planning_us"}:
            assert ours[key] == theirs[key], key


def test_a_function_stands_beside_the_built_in_planners_and_has_its_gap():
    def own(situation):
        return situation.plan("greedy")

    compared = rh.compare(planners=["certified", "greedy", own], runs=6, ticks=60, threads=2)
    assert list(compared.planners) == ["certified", "greedy", "own"]
    for key in ("position_rmse_m", "gap", "trace_excess_percent", "anees"):
        expected = compared.planners["greedy"][key]
        assert compared.planners["own"][key] == pytest.approx(expected, rel=1e-6, abs=1e-12), key
    assert compared.planners["own"]["gap"]["max"] > compared.planners["certified"]["gap"]["max"]
    assert "own" in str(compared) and "\x1b" not in str(compared)
    named = rh.compare(planners={"mine": own}, runs=2, ticks=20)
    assert list(named.planners) == ["mine"]


def test_a_sensor_and_a_target_are_functions_of_all_planners_and_those_of_simulate():
    def straight(tick, state, noise):
        return [state[0] + 0.3, state[1], 3.0, 0.0]

    def exact(robot, tick, range_m, bearing_rad):
        return range_m, 0.01

    compared = rh.compare(planners=["certified", "greedy"], runs=3, ticks=40, seed=5, target=straight, sensor=exact, threads=2)
    for planner in ("certified", "greedy"):
        runs = [rh.simulate(ticks=40, planner=planner, seed=5 + k, target=straight, sensor=exact) for k in range(3)]
        errors_m = [run.error_m[1:] for run in runs]
        expected = sum((error_m**2).mean() for error_m in errors_m) / 3
        assert compared.planners[planner]["position_rmse_m"]["all"] == pytest.approx(expected**0.5, rel=1e-9)
    assert [entry["name"] for entry in compared.figures["planning_time"]] == ["certified", "greedy"]

    def lost(tick, state, noise):
        raise LookupError("no target")

    with pytest.raises(LookupError, match="no target"):
        rh.compare(planners=["greedy"], runs=50, ticks=40, target=lost)


def test_an_exception_of_a_function_ends_all_runs():
    def broken(situation):
        if situation.tick == 30:
            raise LookupError("lost")
        return situation.plan("greedy")

    with pytest.raises(LookupError, match="lost"):
        rh.compare(planners=["greedy", broken], runs=1_000, ticks=60)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (dict(planners=["best"]), 'planners has "best": expected functions, or names'),
        (dict(planners=["greedy", "greedy", len]), "built-in|shape|headings|no array|has no len"),
        (dict(runs=0), "runs is 0: expected at least one run"),
        (dict(seed=2**64 - 1), "seed is 18446744073709551615: expected at most"),
        (dict(planners=[]), "nothing to compare"),
    ],
)
def test_faults_are_one_line(given, message):
    with pytest.raises((rh.InputError, rh.RunError, TypeError), match=message):
        rh.compare(**{"runs": 2, "ticks": 5, **given})


def test_a_comparison_has_a_frame_and_figures():
    pytest.importorskip("pandas")
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("svg")
    compared = rh.compare(planners=["certified", "greedy"], runs=3, ticks=20)
    assert compared.frame().loc["greedy", "gap.max"] == compared.planners["greedy"]["gap"]["max"]
    for what in ("trace", "rmse", "anees"):
        assert len(compared.plot(what).get_lines()) == 2


def test_sensors_and_targets_that_are_functions_stand_beside_the_scenarios_own():
    def exact(robot, tick, range_m, bearing_rad):
        return range_m, 0.01

    def straight(tick, state, noise):
        return [state[0] + 0.3, state[1], 3.0, 0.0]

    keys = dict(planners=["greedy"], runs=3, ticks=40)
    own, replaced = rh.compare(**keys), rh.compare(sensor=exact, target=straight, **keys)
    both = rh.compare(sensors={"exact": exact, "own": None}, targets={"straight": straight, "own": None}, **keys)
    assert list(both.planners) == ["exact straight", "exact own", "own straight", "own own"]
    figures = lambda compared, name: compared.planners[name]["position_rmse_m"]  # noqa: E731
    assert figures(both, "own own") == figures(own, "greedy")
    assert figures(both, "exact straight") == figures(replaced, "greedy")
    assert figures(both, "exact own")["all"] < figures(both, "own own")["all"]
    with pytest.raises(rh.InputError, match="planners has greedy twice"):
        rh._native.compare(rh.Scenario(), [("greedy", "greedy", None)] * 2, runs=1, ticks=2)
