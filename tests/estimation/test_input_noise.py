"""Noise of rotor speeds and of commands: how large, and what rows see of it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from gcs_sysid.estimation.fit.priors import Unknown
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.record import input_noise
from gcs_sysid.estimation.record.input_noise import CommandNoise, SpeedNoise
from gcs_sysid.estimation.rows.actuator_dynamics import WIDTH, ActuatorDynamics
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.signals.smoothers import WindowSmoother

GEOMETRY = np.array([[0.25, -0.25, 0.25, -0.25], [0.25, -0.25, -0.25, 0.25], [1, 1, -1, -1]])
LEVEL = 130.0
STD, UNSEEN = np.array([0.5, 1.0, 2.0, 4.0]), np.array([0.01, 0.1, 0.0])


def followed(noise_of, dt, std=STD, n=20_000, motion=True, common=0.0):
    rng = np.random.default_rng(1)
    t = np.arange(n)[:, None] * dt
    slow = 20.0 * np.sin(2.0 * np.pi * 0.5 * t) if motion else 0.0
    white = rng.standard_normal((n, 4)) * std + common * rng.standard_normal((n, 1))
    found = noise_of(GEOMETRY, dt)
    found.update(LEVEL + slow + white)
    return found


def test_noise_of_speeds_is_what_a_parabola_leaves():
    # 20 000 third differences, of which neighbors share most, tell a deviation to 1 %.
    np.testing.assert_allclose(followed(SpeedNoise, 0.004).std, STD, rtol=0.03)
    # Torque about yaw jumps, and all rotors with it.
    yaw = followed(SpeedNoise, 0.004, common=5.0 * GEOMETRY[2])
    np.testing.assert_allclose(yaw.std, STD, rtol=0.03)


def test_what_is_missing_breaks_the_row():
    rng = np.random.default_rng(2)
    whole, broken = SpeedNoise(GEOMETRY, 0.004), SpeedNoise(GEOMETRY, 0.004)
    values = LEVEL + rng.standard_normal((4000, 4))
    values[2000:] += 500.0  # another level after the gap
    holed = np.insert(values, 2000, np.nan, axis=0)
    for start in range(0, 4001, 7):
        broken.update(holed[start : start + 7])
    np.testing.assert_allclose(broken.std, 1.0, rtol=0.06)
    whole.update(values)
    assert whole.std[0] > 3.0
    again = SpeedNoise(GEOMETRY, 0.004)
    again.update(values[:2000])
    again.restart()
    again.update(values[2000:])
    np.testing.assert_allclose(again.std, broken.std)


@pytest.mark.parametrize("memory", [0.0, 0.3])
def test_rows_show_noise_of_speeds_as_told(memory):
    """Moments of rows of noise alone: torques by 2 Omega, H' by the derivative."""
    dt, n = 0.01, 60_000
    rng = np.random.default_rng(3)
    speeds = LEVEL * np.array([1.0, 1.1, 0.9, 1.0]) + STD * rng.standard_normal((n, 4))
    found = SpeedNoise(GEOMETRY, dt)
    basis = ActuatorDynamics((0.0,))
    assert not found.row_moments(basis, WindowSmoother(dt, 10), memory).any()
    found.update(speeds)
    smoother = WindowSmoother(dt, 10)
    said = found.row_moments(basis, smoother, memory)
    mixer = rb.mixer(GEOMETRY)
    squares = speeds**2
    H = speeds @ GEOMETRY[2]
    rows = smoother.update(np.column_stack([squares @ mixer, H]), 0)
    summed = np.column_stack([rows.average[:, :4], rows.derivative[:, 4]])
    summed = summed - summed.mean(axis=0)
    if memory:
        keep = np.exp(-smoother.step * dt / memory)
        for k in range(1, len(summed)):
            summed[k] += keep * summed[k - 1]
    seen = summed[200:].T @ summed[200:] / len(summed[200:])
    at = [0, 1, 2, 3, 4]
    scale = np.sqrt(np.diag(seen))
    np.testing.assert_allclose(
        said[np.ix_(at, at)] / np.outer(scale, scale),
        seen / np.outer(scale, scale),
        atol=0.13 if memory else 0.06,
    )
    rest = np.delete(np.arange(len(said)), at)
    assert not said[rest].any()
    assert not said[:, rest].any()
    # Averages and derivatives of a symmetric window do not hang together.
    assert not said[:4, 4].any()


def test_noise_of_speeds_in_one_sample_is_what_signals_scatter():
    """Roll, pitch, thrust and yaw torque, and H, of samples of noise alone."""
    speeds = LEVEL + STD * np.random.default_rng(3).standard_normal((60_000, 4))
    found = SpeedNoise(GEOMETRY, 0.004)
    assert found.of_signals.shape == (5, 5)
    assert not found.of_signals.any()
    found.update(speeds)
    seen = np.cov(np.column_stack([speeds**2 @ rb.mixer(GEOMETRY), speeds @ GEOMETRY[2]]).T)
    said = found.of_signals
    scale = np.outer(*2 * [np.sqrt(np.diag(seen))])
    # 60 000 samples tell a covariance to 0.4 % of the scatter, half of it by third differences.
    np.testing.assert_allclose(said / scale, seen / scale, atol=0.04)


def test_noise_of_commands_is_told_with_what_rotors_share():
    found = followed(CommandNoise, 0.02, std=0.01 * np.ones(4), common=0.02, motion=False)
    expected = 0.01**2 * np.eye(4) + 0.02**2
    np.testing.assert_allclose(found.covariance, expected, rtol=0.07)
    np.testing.assert_allclose(found.std, np.sqrt(np.diag(found.covariance)))
    # Slow motion hardly shows in a difference over six samples.
    assert followed(CommandNoise, 0.02, std=np.full(4, 1.0)).std == pytest.approx(1.0, rel=0.06)


@pytest.mark.parametrize("dt", [0.05, 0.033, 0.02])
def test_jumps_between_readings_bias_by_what_the_interval_says(dt):
    """Torque about roll that always jumps at one place between readings, motors of 40 ms."""
    each, inertia = 40, 2e4
    theta, off = np.full(rb.N_THETA, inertia), []
    fit = RotationFit(theta, 1e-6 * np.eye(len(theta)), np.eye(3), np.ones(3), 1, converged=True)
    fit.full_covariance[Unknown.DELAY, Unknown.DELAY] = 1e-18
    for phase in range(0, each, 4):
        steps = np.roll(np.random.default_rng(5).standard_normal(300).repeat(5 * each), phase)
        keep = np.exp(-dt / each / 0.04)
        alpha = lfilter([1.0 - keep], [1.0, -keep], steps)
        read, rate = alpha[::each], np.cumsum(alpha)[::each] * dt / each
        noise = SpeedNoise(GEOMETRY, dt)
        noise.update(np.sqrt(1e6 - np.sign(GEOMETRY[1]) * inertia * read[:, None]))
        signals = np.column_stack([read, rate - rate.mean()])
        rows = WindowSmoother(dt, max(4, round(0.1 / dt))).update(signals, 0)
        x = np.column_stack([rows.average[:, 0], rows.derivative[:, 0]])
        slope, late = np.linalg.lstsq(x, rows.derivative[:, 1], rcond=None)[0]
        window = np.zeros((WIDTH, WIDTH))
        for i, x_i in ((rb.SIGNALS.index("p"), rows.average), (rb.N_SIGNALS, rows.derivative)):
            window[i, i] = x_i[:, 1] @ x_i[:, 1]
        wide = input_noise.with_sparse_readings(fit, noise, window)
        var = wide.full_covariance[Unknown.DELAY, Unknown.DELAY]
        off.append([(slope - 1.0) * inertia / wide.std[0], late / var**0.5])
        assert noise.folded_share > 0.0
        left = input_noise.with_sparse_readings(replace(fit, r_squared=1.0 - UNSEEN), noise, window)
        seen = (left.covariance - wide.covariance)[:3, :3] / inertia**2  # 1 - R^2 may all be noise
        np.testing.assert_allclose(seen, np.diag(UNSEEN**2) / 3.0 * (dt > 0.025), atol=1e-12)
    assert np.all(np.sqrt(np.mean(np.square(off), axis=0)) < 2.0)
    assert np.all(np.max(np.abs(off), axis=0) > 1.0)  # no wider than it need be
