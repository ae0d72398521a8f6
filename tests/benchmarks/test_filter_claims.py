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


@pytest.mark.usefixtures("short")
def test_errors_of_a_late_but_perfect_derivative_are_only_its_lag():
    t = filter_claims.clean(CASE.rate).t
    late = filter_claims.true_acceleration(t, 0.04)
    method = filter_claims.Method("late", lambda v, dt: np.hstack([late, late]), lambda dt: 0.04)
    as_it_comes, lag_out = filter_claims.errors(CASE, method, late)
    assert as_it_comes > 0.1
    assert lag_out == pytest.approx(0.0, abs=1e-20)


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
