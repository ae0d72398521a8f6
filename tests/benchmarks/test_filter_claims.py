"""The measures of filter error, on a few seconds of flight."""

import numpy as np
import pytest

from benchmarks import filter_claims
from sim_bridge.ensemble import fly_ensemble
from sim_bridge.missions import PAPER
from sim_bridge.vehicle_files import load_vehicle

CASE = filter_claims.Case(250, "white")


@pytest.fixture(scope="module")
def flight():
    return fly_ensemble(load_vehicle("paper"), PAPER, 1000.0, 5.0)


@pytest.fixture
def short(flight, monkeypatch):
    """The first five seconds stand for the whole."""
    truth = np.gradient(flight.gyro[0], flight.interval, axis=0)
    monkeypatch.setattr(filter_claims, "physics", lambda: flight)
    monkeypatch.setattr(filter_claims, "acceleration", lambda: truth)


@pytest.mark.slow
@pytest.mark.usefixtures("short")
def test_best_lag_is_the_one_that_a_derivative_has():
    t = filter_claims.clean(CASE.rate).t
    late = filter_claims.true_acceleration(t, 0.037)
    assert filter_claims.best_lag(CASE, late) == pytest.approx(0.037)


@pytest.mark.usefixtures("short")
def test_errors_of_a_late_but_perfect_derivative_are_only_its_lag():
    t = filter_claims.clean(CASE.rate).t
    late = filter_claims.true_acceleration(t, 0.04)
    method = filter_claims.Method("late", lambda v, dt: np.hstack([late, late]), lambda dt: 0.04)
    as_it_comes, lag_out = filter_claims.errors(CASE, method, late)
    assert as_it_comes > 0.1
    assert lag_out == pytest.approx(0.0, abs=1e-20)


@pytest.mark.usefixtures("short")
def test_methods_rank_as_in_the_whole_flight():
    gyros = filter_claims.signals(filter_claims.noisy(CASE, [1, 2]))
    backward, central, default = (
        filter_claims.errors(CASE, method, gyros)[1]
        for method in (filter_claims.BACKWARD, filter_claims.CENTRAL, filter_claims.DEFAULT)
    )
    assert default < central < backward


@pytest.mark.usefixtures("short")
def test_attitude_squares_of_a_seed_add_up():
    one, other = (
        filter_claims.attitude_squares(filter_claims.noisy(CASE, [seed])) for seed in (1, 2)
    )
    both = filter_claims.attitude_squares(filter_claims.noisy(CASE, [1, 2]))
    assert both["raw"] == pytest.approx(one["raw"] + other["raw"])
    assert both["tool"][0] == pytest.approx(one["tool"][0] + other["tool"][0])
    assert both["formula"] == pytest.approx(np.add(one["formula"], other["formula"]))


def test_shares_are_of_all_groups_together():
    def group(raw, formula, tool):
        gains = [formula] * len(filter_claims.GAINS)
        squares = {"raw": raw, "formula": gains, "reference": [raw, raw], "tool": [tool, tool]}
        return {str(CASE): {"attitude": squares, "acceleration": {"a": [raw, tool]}}}

    groups = [group(1.0, 0.5, 0.1), group(3.0, 0.5, 0.3)]
    left = filter_claims.attitude_left(groups, CASE)
    assert left["printed"] == pytest.approx(0.25)
    assert left["tool"] == pytest.approx(0.1)
    assert filter_claims.acceleration_left(groups, CASE)["a"] == pytest.approx((2.0, 0.2))
