"""The color of what a fit leaves, of rows of the window."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from gcs_sysid.estimation.checks.validation import whiteness_of
from gcs_sysid.estimation.online.online import OnlineEstimator
from gcs_sysid.estimation.record.tuning import EstimatorTuning

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
    whiteness, p = colors(truth, flight, 12, lambda noise: noise)
    np.testing.assert_allclose(whiteness.mean(axis=0), 1.0, atol=0.12)
    # 36 verdicts at 5 %: 1.8 expected; 7 or more by chance three times in a thousand.
    assert (p < 0.05).sum() <= 6


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
