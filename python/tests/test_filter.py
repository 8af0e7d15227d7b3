"""The filter, tick by tick."""

import numpy as np
import pytest
import rangehound as rh


def test_the_filter_follows_a_run_to_the_bit():
    run = rh.simulate(ticks=80, planner="certified", seed=4)
    filter = rh.Filter(run.scenario)
    assert (filter.state == run.state[0]).all() and (filter.covariance == run.covariance[0]).all()
    for tick in range(1, len(run)):
        filter.step(run.range_m[tick], positions_m=run.believed_m[tick])
        assert (filter.tick, filter.fused, filter.nis) == (tick, run.fused[tick], run.nis[tick])
        assert (filter.state == run.state[tick]).all() and (filter.covariance == run.covariance[tick]).all()
    assert filter.digest == run.digest


def test_the_filter_plans_as_the_run_did():
    run = rh.simulate(ticks=30, planner="certified")
    filter = rh.Filter(run.scenario)
    for tick in range(len(run)):
        if tick > 0:
            filter.step(run.range_m[tick], positions_m=run.believed_m[tick])
        plan = filter.plan()
        assert (plan.headings_rad == run.heading_rad[tick]).all() and plan.objective == run.objective[tick]


def test_one_step_is_the_update_of_the_equations():
    prior = np.diag([4.0, 2.0, 1.0, 1.0])
    scenario = rh.Scenario({"prior": {"mean": np.zeros(4), "covariance": prior}, "target": {"noise_psd": 0.0}, "dt_s": 0.1})
    places, ranges, std = np.array([[8.0, 1.0], [-4.0, 6.0], [3.0, -7.0]]), np.array([8.2, 7.0, 7.9]), 0.5
    filter = rh.Filter(scenario)
    filter.step(ranges, positions_m=places, range_stds_m=std)
    phi = np.eye(4)
    phi[0, 2] = phi[1, 3] = 0.1
    p = phi @ prior @ phi.T
    h = np.zeros((3, 4))
    h[:, :2] = -places / np.linalg.norm(places, axis=1)[:, None]
    s = h @ p @ h.T + std**2 * np.eye(3)
    k = p @ h.T @ np.linalg.inv(s)
    nu = ranges - np.linalg.norm(places, axis=1)
    np.testing.assert_allclose(filter.state, k @ nu, rtol=1e-9)
    np.testing.assert_allclose(filter.covariance, p - k @ s @ k.T, rtol=1e-8, atol=1e-12)
    assert filter.nis == pytest.approx(nu @ np.linalg.solve(s, nu))


def test_robots_without_a_range_are_left_out():
    filter = rh.Filter()
    filter.step([10.0, np.nan, np.nan])
    assert filter.fused == 1
    filter.step()
    assert (filter.tick, filter.fused) == (2, 0)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (dict(ranges_m=[1, 2]), r"ranges_m has the shape \[2\]: expected \[3\]"),
        (dict(ranges_m=[1, 2, np.inf]), "ranges_m has inf"),
        (dict(ranges_m=[1, 2, 3], range_stds_m=0.0), "positive deviation"),
        (dict(positions_m=np.full((3, 2), np.nan)), "NaN or infinite"),
        (dict(bearings_rad=[0, 0, 0]), "measures none in the scenario"),
        (dict(time_s=3.0), "steps all last dt_s"),
    ],
)
def test_faults_name_the_argument(given, message):
    with pytest.raises(rh.InputError, match=message):
        rh.Filter().step(**given)


def test_a_step_that_is_refused_leaves_no_trace():
    places, ranges = np.array([[8.0, 1.0], [-4.0, 6.0], [3.0, -7.0]]), [8.2, 7.0, 7.9]
    fresh = rh.Filter()
    fresh.step(ranges)
    for fault in (dict(positions_m=[[1, 2], [3, 4], [np.nan, 0]]), dict(headings_rad=[1, 2, np.inf]), dict(positions_m=places, ranges_m=[1, 2, np.inf])):
        filter = rh.Filter()
        with pytest.raises(rh.InputError):
            filter.step(**fault)
        filter.step(ranges)
        assert filter.digest == fresh.digest, fault
