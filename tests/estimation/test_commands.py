"""Commands as the rotors' input: lag, curve and delay are found with everything else."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from gcs_sysid.estimation.basis import RotorBasis
from gcs_sysid.estimation.online import OnlineEstimator
from gcs_sysid.estimation.speed_noise import SpeedNoise
from gcs_sysid.estimation.tuning import COMMANDS

DT = 0.005
FULL = 1.2
"""Of the greatest thrust flown, what full command gives."""


def commands_of(flight, truth, lag, curve):
    """(n, rotors) commands that give the flight's thrusts, and T_max / k_T."""
    shares = flight.speeds**2
    full = FULL * shares.max()
    shares = shares / full
    w = (
        shares
        if curve == 0.0
        else (np.sqrt((1.0 - curve) ** 2 + 4.0 * curve * shares) - (1.0 - curve)) / (2.0 * curve)
    )
    a = np.exp(-DT / lag)
    before = np.vstack([w[:1], w[:-1]])
    # A command acts until the next; what the motor reaches at a stamp is what was flown there.
    return (w - a * before) / (1.0 - a), full


@pytest.mark.parametrize(
    ("lag", "curve"),
    [
        pytest.param(0.03, 0.0, marks=pytest.mark.thorough),
        (0.05, 0.4),
        pytest.param(0.09, 1.0, marks=pytest.mark.thorough),
    ],
)
def test_lag_and_curve_are_found_with_the_rest(truth, flight, lag, curve):
    commands, full = commands_of(flight, truth, lag, curve)
    gyro = flight.gyro + 0.01 * np.random.default_rng(1).standard_normal(flight.gyro.shape)
    estimator = OnlineEstimator(truth.geometry, DT, COMMANDS)
    estimator.update(replace(flight, gyro=gyro, rates=gyro, speeds=commands))
    fit = estimator.fit().rotation
    found_delay, found_lag, found_curve = fit.coordinates
    assert found_lag == pytest.approx(lag, abs=0.001)
    # These commands are in force from half a step before their stamps on, in the mean.
    assert found_delay == pytest.approx(0.5 * DT, abs=0.001)
    assert found_curve == pytest.approx(curve, abs=0.02)
    # Everything is relative to T_max instead of k_T; lengths are what they were.
    relative = truth.theta.copy()
    relative[[0, 1, 2, 3, 4, 5, 9]] /= full
    error = np.abs(fit.theta - relative)
    assert np.all(error[:2] < 0.01 * relative[:2])
    assert error[2] < 0.03 * relative[2]
    assert np.all(error[6:8] < 1e-4)


def test_given_lag_and_curve_are_kept(truth, flight):
    commands, _ = commands_of(flight, truth, 0.05, 0.4)
    given = replace(COMMANDS, lags=(0.05,), curves=(0.4,))
    estimator = OnlineEstimator(truth.geometry, DT, given)
    estimator.update(replace(flight, speeds=commands))
    fit = estimator.fit().rotation
    assert fit.coordinates[1:].tolist() == [0.05, 0.4]
    assert fit.coordinates_std[1:].tolist() == [0.0, 0.0]


@pytest.mark.parametrize("where", [(0.0, 0.05, 0.3), (-0.012, 0.008, -0.1), (0.027, 0.12, 1.0)])
def test_maps_make_any_filter_of_the_elements(where):
    """A chirp through a motor, window and all: as the elements' mixture says."""
    basis = RotorBasis(
        COMMANDS.delays, COMMANDS.lags, COMMANDS.curves, commands=True, half_width=0.2
    )
    delay, lag, _ = where
    span = basis._span
    weights = span.weights(np.array([delay]), np.array([lag]))[0]
    wanted = np.exp(1j * span.omega * delay) / (1.0 + 1j * span.omega * lag)
    made = sum(
        weight
        * np.exp(1j * span.omega * basis.delays[e.delay])
        / (1.0 + 1j * span.omega * basis.lags[e.lag])
        for weight, e in zip(weights, basis.elements, strict=True)
    )
    passed = span._passed / span._passed.max()
    assert np.abs((made - wanted) * passed).max() < 1e-3
    assert weights.sum() == pytest.approx(1.0)
    # Derivatives by the free coordinates.
    step = np.array([1e-6, 1e-6, 1e-4])
    maps = basis.maps(np.array([where]))[0]
    for i in range(3):
        move = np.eye(3)[i] * step
        ahead, behind = (basis.maps((np.array(where) + s * move)[None])[0, 0] for s in (1, -1))
        np.testing.assert_allclose((ahead - behind) / (2 * step[i]), maps[1 + i], atol=1e-3)


@pytest.mark.parametrize("dt", [0.008, 0.012, 0.02, 0.05])
def test_what_a_stream_of_commands_misses_follows_the_rate_loops_low_pass(dt):
    """Noise held from sample to sample has more power than the noise it stands for."""
    cutoff, fine, span = 40.0, 0.001, 0.6
    white = np.random.default_rng(5).normal(0.0, 0.01, (600_000, 4))
    noise = sosfilt(butter(2, cutoff, fs=1.0 / fine, output="sos"), white, axis=0)
    each = round(dt / fine)
    seen = SpeedNoise(np.ones((3, 4)), dt, commands=True, loop_cutoff=cutoff)
    seen.update(0.5 + noise[::each])
    true = noise.reshape(-1, round(span / fine), 4).mean(axis=1)
    held = noise[::each].reshape(-1, round(span / dt), 4).mean(axis=1)
    excess = (held * (held - true)).mean()
    missed = (seen.std**2).mean() / round(span / dt)
    assert missed == pytest.approx(excess, rel=0.25, abs=0.06 * (held * held).mean())
