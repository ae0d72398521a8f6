"""Noise models: what is found in a spectrum, and whether the filter's innovations are white."""

from dataclasses import replace

import numpy as np
import pytest

from gcs_sysid.estimation.offline.innovations import (
    AxisNoise,
    fit_noise,
    initial_std,
    make_whitener,
)

DT, N = 0.004, 10_000
TRUE = AxisNoise(2e-3, None, 0.0, 0.05, moment_std=3.0, moment_tau=0.5)


def walk(noise, seed):
    """(n, 3) gyro of a body that a moment of this noise turns, and its increments."""
    rng = np.random.default_rng(seed)
    kept = np.exp(-DT / noise.moment_tau)
    d, rate = np.zeros(3), np.zeros(3)
    rates = np.empty((N, 3))
    for k in range(N):
        rates[k] = rate
        rate = rate + DT * (d + noise.process_std * rng.standard_normal(3))
        d = kept * d + noise.moment_std * np.sqrt(1.0 - kept**2) * rng.standard_normal(3)
    gyro = rates + noise.white_std * rng.standard_normal((N, 3))
    return gyro, np.diff(gyro, axis=0)


def innovations(gyro, noise):
    """(n, 3) of unit variance, where the noise is as told."""
    axes = (noise,) * 3
    known = np.zeros((3, 3))
    by_rate = np.broadcast_to(np.eye(3), (N - 1, 3, 3))
    whitener = make_whitener(axes, known, by_rate, initial_std(axes, known, DT), DT)
    return whitener.whiten(gyro[..., None], np.zeros((N - 1, 3, 1)))[100:, :, 0]


@pytest.fixture(scope="module")
def disturbed():
    return walk(TRUE, 1)


@pytest.mark.slow
def test_a_slow_moment_is_found_in_the_spectrum(disturbed):
    _, increments = disturbed
    for found in fit_noise([increments], np.zeros(3), np.zeros(3), DT):
        assert found.moment_std == pytest.approx(TRUE.moment_std, rel=0.3)
        assert found.moment_tau == pytest.approx(TRUE.moment_tau, rel=0.6)
        assert found.white_std == pytest.approx(TRUE.white_std, rel=0.1)


@pytest.mark.slow
def test_no_moment_is_found_where_there_is_none():
    quiet = replace(TRUE, moment_std=0.0)
    _, increments = walk(quiet, 2)
    found = fit_noise([increments], np.zeros(3), np.zeros(3), DT)
    assert [axis.moment_std for axis in found] == [0.0] * 3


def test_innovations_are_white_with_the_moment_as_a_state(disturbed):
    gyro, _ = disturbed
    v = innovations(gyro, TRUE)
    assert np.mean(v * v) == pytest.approx(1.0, abs=0.05)
    assert np.abs(np.mean(v[1:] * v[:-1], axis=0)).max() < 0.05
    without = innovations(gyro, replace(TRUE, moment_std=0.0))
    assert np.abs(np.mean(without[1:] * without[:-1], axis=0)).min() > 0.2
