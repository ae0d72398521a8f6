"""Validation: a fit on the first part predicts the rest, unless the vehicle is another one."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from gcs_sysid.estimation.checks.validation import validate, whiteness_of
from gcs_sysid.estimation.fit.problem import N_X
from gcs_sysid.estimation.online.online import OnlineEstimator
from gcs_sysid.estimation.record.tuning import EstimatorTuning
from gcs_sysid.estimation.rows.actuator_dynamics import PLAIN, WIDTH
from gcs_sysid.model import rigid_body as rb

THETA = rb.theta_of(
    {
        "Ixx": 80.0,
        "Iyy": 82.0,
        "Izz": 143.0,
        "Ixy": 6.0,
        "Iyz": 12.0,
        "Ixz": -8.0,
        "cg_x": 0.1,
        "cg_y": 0.05,
        "moment_ratio": 0.03,
    }
)
BATCHES, ROWS = 30, 40


def batches_of(later_theta, noise=0.02):
    """Rows of random inputs; from 60 % of the flight on another vehicle may have made them."""
    random = np.random.default_rng(1)
    size = np.array([600, 600, 7e4, 1.5e4, *np.full(len(rb.RATE_SIGNALS), 0.6), 30, 30, 100])
    out = np.empty((BATCHES, 1, WIDTH, WIDTH))
    for k in range(BATCHES):
        x = random.standard_normal((ROWS, N_X)) * size
        theta = THETA if k < 0.6 * BATCHES else later_theta
        y = x @ rb.forward_matrix(theta).T
        y += noise * y.std(axis=0) * random.standard_normal(y.shape)
        z = np.hstack([x, y])
        out[k, 0] = z.T @ z
    return out


def run(later_theta, noise=0.02):
    return judged(batches_of(later_theta, noise))


def judged(moments):
    counts = np.full(len(moments), ROWS)
    return validate(moments, counts, PLAIN, np.zeros((1, WIDTH, WIDTH)), np.ones(1))


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
    assert judged(batches_of(THETA)[:5]) is None


def test_one_leak_alone_does_not_tell_the_color():
    found = run(THETA)
    assert np.isnan(found.whiteness).all()
    assert np.isnan(found.whiteness_p).all()


DT = 0.005
RPM = 2.0 * np.pi / 60.0


def colors(truth, flight, seeds, disturb):
    """(seeds, 3) whiteness and p-values of the window, with noise that `disturb` makes of white."""
    found = []
    for seed in range(seeds):
        random = np.random.default_rng(seed)
        noise = disturb(0.02 * random.standard_normal(flight.gyro.shape))
        samples = replace(
            flight,
            gyro=flight.gyro + noise,
            rates=flight.rates + noise,
            speeds=np.round(flight.speeds / RPM) * RPM,
        )
        estimator = OnlineEstimator(truth.geometry, DT, EstimatorTuning(smoother="window"))
        estimator.update(samples)
        found.append(estimator.fit().validation)
    return np.array([f.whiteness for f in found]), np.array([f.whiteness_p for f in found])


@pytest.mark.slow
def test_one_batch_shows_no_whiteness():
    power = np.ones((1, 3))
    assert np.isnan(whiteness_of(power, power, np.array([100]))[1]).all()


def test_white_gyro_noise_passes(truth, flight):
    whiteness, p = colors(truth, flight, 24, lambda noise: noise)
    np.testing.assert_allclose(whiteness.mean(axis=0), 1.0, atol=0.12)
    # 72 verdicts at 5 %: 3.6 expected; 11 or more by chance once in a thousand.
    assert (p < 0.05).sum() <= 10


@pytest.mark.parametrize(("hertz", "low", "high"), [(1.0, 1.5, 9.0), (5.0, 0.3, 0.9)])
def test_an_oscillating_torque_is_flagged(truth, flight, hertz, low, high):
    """One that moves the vehicle at half the size of the gyro's noise."""
    swing = 0.01 * np.sin(2.0 * np.pi * hertz * DT * np.arange(len(flight.gyro)))[:, None]
    whiteness, p = colors(truth, flight, 3, lambda noise: noise + swing)
    assert (p < 0.05).all()
    assert ((low < whiteness) & (whiteness < high)).all()


def test_low_frequency_gyro_noise_is_flagged(truth, flight):
    def lowpass(noise):
        return lfilter([0.22], [1.0, -np.exp(-5.0 * DT)], noise, axis=0)

    whiteness, p = colors(truth, flight, 3, lowpass)
    assert (p < 0.05).all()
    assert (whiteness > 2.0).all()
