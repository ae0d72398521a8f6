"""The thrust curve without one third of the flight each."""

from types import SimpleNamespace

import numpy as np
import pytest

from gcs_sysid.estimation.fit import whitened_fit as module
from gcs_sysid.estimation.fit.priors import N_UNKNOWNS, Unknown
from gcs_sysid.estimation.fit.problem import Problem
from gcs_sysid.estimation.fit.whitened_fit import curve_scatter
from gcs_sysid.estimation.rows.motor_linearization import LocalDynamics

BASIS = LocalDynamics(np.array([0.0, 0.05, 0.5, 0.0, 0.0]), "speed", 0.004)
COUNTS = np.full(30, 80)
STD = 0.02


@pytest.fixture
def found(monkeypatch):
    """What the flight is like without each third: batches left and curves found."""
    said = SimpleNamespace(curves=[0.5, 0.5, 0.5], left=None)

    def minimized(problem, unknowns, limit):
        said.left = problem.moments[:, 0, 0, 0], problem.rows
        unknowns = unknowns.copy()
        unknowns[:, Unknown.CURVE] = said.curves
        return SimpleNamespace(unknowns=unknowns), np.ones(3, dtype=bool)

    monkeypatch.setattr(module, "minimize", minimized)
    return said


def scattered(basis=BASIS, counts=COUNTS):
    width = basis.width
    batches = np.zeros((len(counts), 3, width, width))
    batches[:, 0, 0, 0] = np.arange(len(counts))
    problem = Problem(batches.sum(axis=0)[None], 1, basis, None, np.zeros((1, 3, width, width)))
    covariance = np.zeros((N_UNKNOWNS, N_UNKNOWNS))
    covariance[Unknown.CURVE, Unknown.CURVE] = STD**2
    covariance[0, Unknown.CURVE] = covariance[Unknown.CURVE, 0] = -3.0 * STD**2
    fit = SimpleNamespace(
        unknowns=np.zeros(N_UNKNOWNS), deviations=np.zeros(0), extended_covariance=covariance
    )
    return problem, curve_scatter(problem, fit, batches, counts, np.zeros((3, width, width)))


def test_what_goes_beyond_the_interval_is_added_and_all_goes_with_it(found):
    found.curves = [0.4, 0.5, 0.6]
    problem, along = scattered()
    places = list(problem.free)
    excess = np.sqrt(2.0 * np.var(found.curves) - STD**2)
    assert along[places.index(Unknown.CURVE)] == pytest.approx(excess)
    assert along[places.index(0)] == pytest.approx(-3.0 * excess)
    assert np.count_nonzero(along) == 2


def test_scatter_within_the_interval_adds_nothing(found):
    found.curves = [0.49, 0.5, 0.51]
    assert not scattered()[1].any()


def test_nothing_where_the_curve_is_given_or_the_flight_is_short(found):
    found.curves = [0.0, 0.5, 1.0]
    given = LocalDynamics(BASIS.at, "speed", 0.004, curve=False)
    assert not scattered(given)[1].any()
    assert not scattered(counts=COUNTS[:2])[1].any()
