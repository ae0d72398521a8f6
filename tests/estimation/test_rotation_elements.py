"""The rotational fit where delay, lag and curve are unknown too: its search and its outcome."""

import numpy as np
import pytest

from gcs_sysid.estimation.fit import window_fit
from gcs_sysid.estimation.fit.inference import Outcome
from gcs_sysid.estimation.fit.priors import Unknown
from gcs_sysid.estimation.fit.problem import JointProblem
from gcs_sysid.estimation.fit.search import MAX_ITERATIONS
from gcs_sysid.estimation.fit.solver import minimize
from gcs_sysid.estimation.fit.window_fit import fit_rotation
from gcs_sysid.estimation.rows.actuator_dynamics import WIDTH, ActuatorDynamics
from gcs_sysid.estimation.rows.regression import NormalEquations
from gcs_sysid.model import rigid_body as rb
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


def quiet(basis, leaks=1):
    return np.zeros((leaks, basis.width, basis.width))


@pytest.mark.parametrize("prior", [None, prior_of({0: (THETA[0], 0.5)})], ids=["none", "prior"])
@pytest.mark.parametrize("index", [0, 4, Unknown.DELAY, Unknown.LAG])
def test_what_is_left_is_twice_the_rise_of_the_likelihood(prior, index):
    batches, _ = moments_of_elements(COMMANDS, AT)
    problem = JointProblem(batches.sum(axis=0), ROWS, COMMANDS, prior)
    best, _ = minimize(problem, np.append(THETA, AT)[None], MAX_ITERATIONS)
    std = 1.0 / np.sqrt(best.hessian[0].diagonal()[problem.free.tolist().index(index)])
    unknowns = best.unknowns.copy()
    unknowns[:, index] += 0.3 * std
    point = problem.evaluate(unknowns)
    left = Outcome(problem, point).left
    np.testing.assert_allclose(left, ROWS * (point.cost - best.cost), rtol=0.02)
    assert Outcome(problem, best).left < 1e-6


def astray(unknowns, *, converged=True):
    """A search that ended at these unknowns of each leak."""
    ended = np.full(len(unknowns), converged)
    return lambda problem, starts: (problem.evaluate(unknowns), ended)


def test_a_search_that_ended_at_no_minimum_goes_on(monkeypatch):
    batches, counts = moments_of_elements(COMMANDS, AT)
    fit = fit_rotation(batches, counts, COMMANDS, quiet(COMMANDS))
    off = fit.warm_start.unknowns.copy()
    off[0] *= 1.1
    monkeypatch.setattr(window_fit, "search", astray(off[None], converged=False))
    again = fit_rotation(batches, counts, COMMANDS, quiet(COMMANDS))
    assert again.converged
    assert not again.warm_start.stuck
    np.testing.assert_allclose(again.theta, fit.theta, atol=1e-3 * fit.std.min())


@pytest.mark.parametrize("bad", [0, 1])
def test_a_memory_whose_search_got_stuck_is_not_chosen(monkeypatch, bad):
    batches, counts = moments_of_elements(COMMANDS, AT)
    fit = fit_rotation(batches, counts, COMMANDS, quiet(COMMANDS))
    both = np.stack([fit.warm_start.unknowns] * 2)
    both[bad, 0] *= 1.1
    monkeypatch.setattr(window_fit, "search", astray(both))
    chosen = fit_rotation(np.repeat(batches, 2, axis=1), counts, COMMANDS, quiet(COMMANDS, 2))
    assert chosen.leak == 1 - bad
    assert not chosen.warm_start.stuck


@pytest.mark.parametrize(
    ("share", "stuck", "widened"),
    [
        (1.0, False, False),
        (0.5, False, False),  # twice the motion: the model explains about nothing
        (0.33, False, True),  # three times: worse than nothing
        (1.0, True, True),
    ],
)
def test_curve_and_lag_of_a_false_minimum_are_hardly_known(share, stuck, widened):
    batches, _ = moments_of_elements(COMMANDS, AT)
    problem = JointProblem(batches.sum(axis=0), ROWS, COMMANDS, None)
    theta = THETA.copy()
    theta[:6] *= share
    point = problem.evaluate(np.append(theta, AT)[None])
    outcome, p = Outcome(problem, point), problem.p
    (fit,) = outcome.fits(np.eye(p), np.ones(p), [True], [0], np.array([stuck]))
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
        fit_rotation(batches, counts, SPEEDS, np.zeros((1, WIDTH, WIDTH)), prior=prior)
        for prior in (None, SLIGHT)
    )
    for fit in (alone, given):
        assert fit.warm_start.unknowns[Unknown.DELAY] == np.copysign(0.01, delay)
    assert np.all(np.abs(given.theta - alone.theta) < 0.1 * alone.std)
