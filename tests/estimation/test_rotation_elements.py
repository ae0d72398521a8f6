"""The rotational fit where delay, lag and curve are unknown too: its search and its outcome."""

import numpy as np
import pytest

from gcs_sysid.estimation.fit.inference import Outcome
from gcs_sysid.estimation.fit.priors import Unknown
from gcs_sysid.estimation.fit.problem import Problem
from gcs_sysid.estimation.rows.actuator_dynamics import ActuatorDynamics
from gcs_sysid.estimation.rows.regression import NormalEquations
from gcs_sysid.model import rigid_body as rb
from tests.estimation.rows_fit import fit_rows
from tests.known_theta import prior_of, theta_from

ROWS = 4000
THETA = theta_from(80.0, 81.0, 143.0, 6.6, 12.4, -8.1, 0.1, 0.05, 0.03, 20.0, 0.3)
SLIGHT = prior_of({i: (THETA[i], 10.0 * (abs(THETA[i]) or 1.0)) for i in range(rb.N_THETA)})
"""Says next to nothing."""
COMMANDS = ActuatorDynamics((-0.01, 0.0, 0.01), (0.0, 0.05, 0.1), (0.0, 1.0), motors=True)
SPEEDS = ActuatorDynamics((-0.01, 0.0, 0.01))
AT = np.array([0.004, 0.03, 0.4, 0.0, 0.0])


def moments_of_elements(basis, at, sigma=0.5, n=ROWS):
    """Batches and counts of rows of elements whose outputs are those of THETA at coordinates."""
    rng = np.random.default_rng(8)
    rows = rng.normal(size=(n, basis.width))
    signals = rng.normal(size=(n, 5)) * [60.0, 60.0, 2e3, 1e4, 10.0]
    # Elements hang together as filters of one signal do.
    late = np.tile(signals, basis.late // 5)
    rows[:, : basis.late] = late * (1.0 + 0.2 * rng.normal(size=late.shape))
    x = (rows @ basis.map_at(at).T)[:, : rb.N_SIGNALS]
    rows[:, -3:] = x @ rb.forward_matrix(THETA).T + sigma * rng.normal(size=(n, 3))
    moments = NormalEquations((1, basis.width, basis.width), 40)
    moments.add(rows[None])
    return moments.batches, moments.counts


@pytest.mark.parametrize(
    ("share", "widened"),
    [
        (1.0, False),
        (0.5, False),  # twice the motion: the model explains about nothing
        (0.33, True),  # three times: worse than nothing
    ],
)
def test_curve_and_lag_of_a_false_minimum_are_hardly_known(share, widened):
    batches, _ = moments_of_elements(COMMANDS, AT)
    problem = Problem(batches.sum(axis=0), ROWS, COMMANDS, None)
    theta = THETA.copy()
    theta[:6] *= share
    point = problem.evaluate(np.append(theta, AT)[None])
    outcome, p = Outcome(problem, point), problem.p
    (fit,) = outcome.fits(np.eye(p), np.ones(p), [True])
    assert bool(fit.r_squared.min() < -0.5) is (share == 0.33)
    usual = np.linalg.inv(point.hessian[0])
    more = fit.full_covariance[np.ix_(problem.free, problem.free)] - usual
    if not widened:
        np.testing.assert_allclose(more, 0.0, atol=1e-9 * np.abs(usual).max())
        return
    # To half of the curve's range and 50 ms, and all that goes with them.
    assert fit.full_covariance[Unknown.CURVE, Unknown.CURVE] > 0.5**2
    assert fit.full_covariance[Unknown.LAG, Unknown.LAG] > 0.05**2
    d = np.sqrt(more.diagonal())
    assert np.linalg.eigvalsh(more / np.outer(d, d)).min() > -1e-9


@pytest.mark.parametrize("delay", [-0.016, 0.016])
def test_a_delay_at_the_end_of_its_range_holds_with_a_prior_too(delay):
    """What still pulls it outward must not move the rest."""
    at = np.array([delay, 0.0, 1.0, 0.0, 0.0])
    batches, counts = moments_of_elements(SPEEDS, at, sigma=0.1)
    alone, given = (
        fit_rows(batches, counts, SPEEDS, np.zeros((1, SPEEDS.width, SPEEDS.width)), prior)
        for prior in (None, SLIGHT)
    )
    for fit in (alone, given):
        assert fit.warm_start.unknowns[Unknown.DELAY] == np.copysign(0.01, delay)
    assert np.all(np.abs(given.theta - alone.theta) < 0.1 * alone.std)
