"""Prior knowledge in the rotational fit, on rows whose truth is known."""

import numpy as np
import pytest
from scipy.signal import lfilter

from gcs_sysid.estimation.fit.priors import N_UNKNOWNS, Prior, Unknown
from gcs_sysid.estimation.online.online import OnlineEstimator
from gcs_sysid.estimation.record.tuning import EstimatorTuning
from gcs_sysid.estimation.rows.actuator_dynamics import N_COORDINATES, PLAIN, WIDTH
from gcs_sysid.estimation.rows.regression import NormalEquations
from gcs_sysid.model import rigid_body as rb
from tests.estimation.rows_fit import fit_rows
from tests.known_theta import THETA, prior_of

IZZ, RATIO = 2, rb.MOMENT_RATIO
ROWS, PER_BATCH = 4000, 40  # a hundred batches: their scatter is known well


def inputs(rng, tumbling):
    """(ROWS, N_SIGNALS) of a vehicle that turns about all axes, or about yaw nearly alone."""
    slow = lfilter([0.3], [1.0, -0.95], rng.standard_normal((ROWS, 8)), axis=0)
    rate, torque = (1.0, 60.0) if tumbling else (0.02, 6.0)
    rates = slow[:, :3] * [rate, rate, 1.0]
    rotors = slow[:, 3:7] * [torque, torque, 2e3, 1e4] + [3.0, 7.0, 7e4, 0.0]
    H = 20.0 * slow[:, 7]
    gyroscopic = np.column_stack([rates[:, 1] * H, rates[:, 0] * H, 10.0 * np.gradient(H)])
    return np.column_stack([rotors, rb.rate_signals(rates), gyroscopic])


def fit(seed, prior=None, tumbling=True, color=1, theta=THETA, sigma=1.0):
    """Fit rows whose residual is white, or a moving average over `color` of them."""
    rng = np.random.default_rng(seed)
    x = inputs(rng, tumbling)
    fresh = sigma * rng.standard_normal((ROWS + color - 1, 3))
    kernel = np.full(color, 1.0 / np.sqrt(color))
    noise = np.column_stack([np.convolve(e, kernel, "valid") for e in fresh.T])
    moments = NormalEquations((1, WIDTH, WIDTH), PER_BATCH)
    moments.add(np.column_stack([x, x @ rb.forward_matrix(theta).T + noise])[None])
    none = np.zeros((1, WIDTH, WIDTH))
    return fit_rows(moments.batches, moments.counts, PLAIN, none, prior)


def test_a_known_moment_ratio_makes_the_yaw_inertia_known():
    """Yaw alone tells their quotient and nothing else."""
    alone = fit(1, tumbling=False)
    assert alone.std[IZZ] > 0.1 * THETA[IZZ]
    share = 0.03
    known = fit(1, prior_of({RATIO: (THETA[RATIO], share * THETA[RATIO])}), False)
    assert known.std[IZZ] / THETA[IZZ] == pytest.approx(share, rel=0.2)
    assert abs(known.theta[IZZ] - THETA[IZZ]) < 3.0 * known.std[IZZ]
    # The flight alone would not have told: both rest on the prior.
    for index in (IZZ, RATIO):
        assert known.data_std[index] > 4.0 * known.std[index]
    assert known.data_std[3] < 1.1 * known.std[3]  # Ixy owes it nothing


def test_a_prior_that_says_next_to_nothing_changes_nothing():
    plain = fit(2)
    wide = fit(
        2, prior_of({i: (3.0 * THETA[i], 1e6 * (THETA[i] or 1.0)) for i in range(rb.N_THETA)})
    )
    assert np.all(np.abs(wide.theta - plain.theta) < 1e-4 * plain.std)
    np.testing.assert_allclose(wide.std, plain.std, rtol=1e-4)
    np.testing.assert_allclose(plain.data_std, plain.std, rtol=1e-9)


@pytest.mark.parametrize("color", [1, 12])
def test_prior_and_flight_are_weighed_by_what_they_know(color):
    """Intervals hold as many as they say, one by one and jointly, by colored rows or not."""
    size = fit(0, color=color).std
    inside, squares, tightened = [], [], []
    for seed in range(40):
        rng = np.random.default_rng(100 + seed)
        mean = np.append(THETA + size * rng.standard_normal(rb.N_THETA), 0.0)
        prior = prior_of({i: (mean[i], size[i]) for i in range(rb.N_THETA)})
        found = fit(seed, prior, color=color)
        error = found.theta - THETA
        inside.append(np.abs(error) < 1.96 * found.std)
        squares.append(error @ np.linalg.solve(found.covariance, error) / rb.N_THETA)
        tightened.append(found.std / found.data_std)
    assert 0.9 < np.mean(inside) < 0.99
    assert 0.6 < np.mean(squares) < 1.6
    assert np.max(tightened) < 0.95


def test_a_prior_about_a_combination_leaves_the_rest_open():
    """Izz / moment_ratio and nothing else: what yaw tells, and a prior may tell as well."""
    direction = np.zeros(N_UNKNOWNS)
    direction[IZZ], direction[RATIO] = 1.0 / THETA[IZZ], -1.0 / THETA[RATIO]
    prior = Prior(
        np.append(THETA, np.zeros(N_COORDINATES)), np.outer(direction, direction) / 1e-3**2
    )
    plain, known = fit(3, sigma=3.0), fit(3, prior, sigma=3.0)
    quotient = direction @ known.full_covariance @ direction
    assert np.sqrt(quotient) == pytest.approx(1e-3, rel=0.1)
    assert known.std[IZZ] > 0.3 * plain.std[IZZ]
    assert known.std[IZZ] < 1.01 * plain.std[IZZ]


def test_an_impossible_prior_does_not_make_an_impossible_vehicle():
    """An Izz above Ixx + Iyy is no rigid body's."""
    found = fit(4, prior_of({IZZ: (2.0 * THETA[IZZ], 0.01)}))
    assert rb.is_physical(found.theta)


@pytest.mark.slow
def test_the_online_estimator_uses_its_prior_in_every_fit(truth, flight):
    estimator = OnlineEstimator(truth.geometry, 0.005, EstimatorTuning())
    estimator.update(flight.part(slice(0, 3000)))
    free = estimator.fit().rotation
    given = 1.01 * truth.theta[RATIO]
    estimator.prior = prior_of({RATIO: (given, 1e-9), Unknown.DELAY: (0.001, 1e-9)})
    for quick in (True, True, False):
        found = estimator.fit(quick=quick).rotation
        assert found.theta[RATIO] == pytest.approx(given, rel=1e-3)
        assert found.delay == pytest.approx(0.001, abs=1e-6)
        assert found.std[RATIO] < 0.1 * found.data_std[RATIO]
    assert abs(free.theta[RATIO] - given) > 1e-3 * given
