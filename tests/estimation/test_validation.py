"""Validation: a fit on the first part predicts the rest, unless the vehicle is another one."""

import numpy as np
import pytest

from gcs_sysid.estimation.rotation import N_X, WIDTH
from gcs_sysid.estimation.validation import validate
from gcs_sysid.model import rigid_body as rb

THETA = np.array([80.0, 82.0, 143.0, 6.0, 12.0, -8.0, 0.1, 0.05, 0.03, 0.0, 0.0])
BATCHES, ROWS = 30, 40


def batches_of(later_theta, noise=0.02):
    """Rows of random inputs; from 60 % of the flight on another vehicle may have made them."""
    random = np.random.default_rng(1)
    size = np.array([600, 600, 7e4, 1.5e4, *[0.5] * 6, *[0.7] * 3, 30, 30, 100])
    out = np.empty((BATCHES, 1, 1, WIDTH, WIDTH))
    for k in range(BATCHES):
        x = random.standard_normal((ROWS, N_X)) * size
        theta = THETA if k < 0.6 * BATCHES else later_theta
        y = x @ rb.forward_matrix(theta).T
        y += noise * y.std(axis=0) * random.standard_normal(y.shape)
        z = np.hstack([x, y])
        out[k, 0, 0] = z.T @ z
    return out


def run(later_theta, noise=0.02):
    counts = np.full(BATCHES, ROWS)
    moments = batches_of(later_theta, noise)
    return validate(moments, counts, np.zeros(1), np.zeros((1, WIDTH, WIDTH)))


def test_the_same_vehicle_is_predicted_to_the_noise():
    found = run(THETA)
    # Noise of 2 % of the signal leaves 1 - 0.02^2 of the power explained.
    assert found.r_squared == pytest.approx(1.0 - 0.02**2, abs=3e-4)
    assert found.theil == pytest.approx(0.01, abs=0.003)
    assert found.fitted_share == pytest.approx(0.6)


def test_another_vehicle_is_not_predicted():
    heavier = THETA.copy()
    heavier[:6] *= 1.5
    found = run(heavier)
    # Inertia half as large again answers with two thirds: an error of half the signal.
    assert np.all(found.r_squared < 0.8)
    assert np.all(found.theil > 0.15)


def test_a_flight_too_short_to_be_divided_is_not_validated():
    moments = batches_of(THETA)[:9]
    assert validate(moments, np.full(9, ROWS), np.zeros(1), np.zeros((1, WIDTH, WIDTH))) is None
