"""The offline estimator on flights whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline
from scipy.signal import lfilter

from gcs_sysid.estimation.changes.tracking import Tracker
from gcs_sysid.estimation.offline.innovations import BIAS_STD, AxisNoise
from gcs_sysid.estimation.offline.likelihood import (
    NoInformationError,
    cramer_rao_bound,
    maximize_likelihood,
)
from gcs_sysid.estimation.offline.offline import fit_offline
from gcs_sysid.estimation.offline.propagation import SPLINE_END
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.estimation.record.tuning import EstimatorTuning
from gcs_sysid.model import rigid_body as rb
from tests.known_theta import sizes

SIZE = sizes(80.0, 80.0, 140.0, 7.0, 12.0, 8.0, 0.1, 0.05, 0.03, 20.0, 0.3)
"""Rough size of theta's entries: what an error is measured against."""


def with_noise(samples, noise):
    return replace(samples, gyro=samples.gyro + noise, rates=samples.rates + noise)


def white(samples, sigma, seed):
    return sigma * np.random.default_rng(seed).standard_normal(samples.gyro.shape)


def high_pass(samples, sigma, corner, dt, seed):
    """White noise of this size through s / (s + corner), settled."""
    drawn = np.random.default_rng(seed).standard_normal((len(samples.gyro) + 500, 3))
    return sigma * lfilter([1.0, -1.0], [1.0, -np.exp(-corner * dt)], drawn, axis=0)[500:]


@pytest.fixture(scope="module")
def slow(flight):
    """30 s at 40 Hz, and its sample time."""
    return flight.part(slice(None, None, 5)), 0.025


@pytest.fixture(scope="module")
def start(truth):
    """As far off as a poor online fit."""
    return truth.theta * (1.0 + 0.02 * np.random.default_rng(3).uniform(-1.0, 1.0, rb.N_THETA))


@pytest.fixture(scope="module")
def white_fit(truth, slow, start):
    """With white noise: what was flown, and its fit."""
    noisy = with_noise(slow[0], white(slow[0], 0.02, 5))
    return noisy, maximize_likelihood(noisy, truth.geometry, slow[1], start)


@pytest.fixture(scope="module")
def colored_fit(truth, slow, start):
    """With noise of high frequencies."""
    noisy = with_noise(slow[0], high_pass(slow[0], 0.02, 5.0, slow[1], seed=1))
    return noisy, maximize_likelihood(noisy, truth.geometry, slow[1], start)


@pytest.mark.slow
@pytest.mark.parametrize(
    "every", [*(pytest.param(k, marks=pytest.mark.thorough) for k in (1, 5)), 10]
)
def test_exact_without_noise(truth, flight, start, every):
    """At 20 Hz too, where the fastest signal turns by half a radian a sample."""
    dt = 0.005 * every
    fit = maximize_likelihood(flight.part(slice(None, None, every)), truth.geometry, dt, start)
    assert fit.converged
    assert np.abs((fit.theta - truth.theta) / SIZE).max() < 2e-4


@pytest.mark.thorough
def test_intervals_and_bound_tell_the_errors(truth, slow, start):
    samples, dt = slow
    squares, inside = [], []
    for seed in range(10):
        noisy = with_noise(samples, white(samples, 0.02, seed))
        fit = maximize_likelihood(noisy, truth.geometry, dt, start)
        assert fit.converged
        error = fit.theta - truth.theta
        squares.append(error @ np.linalg.solve(fit.covariance[: rb.N_THETA, : rb.N_THETA], error))
        inside.append(np.abs(error) < 1.96 * fit.std)
        # White noise is recognised, so that the interval is the bound (or just above it).
        assert np.all(fit.bound <= fit.std * (1.0 + 1e-9))
        for axis in fit.noise:
            # 1200 samples tell a standard deviation to 2 %: five of those, and one for what a
            # needless color would move.
            assert axis.white_std == pytest.approx(0.02, rel=0.12)
    # Ten sums of eleven squares: chi-square of 110, of which 99.9 % lie between 68 and 164.
    assert 68.0 < np.sum(squares) < 164.0
    assert np.mean(inside) > 0.88


@pytest.mark.slow
def test_color_is_found_and_used(truth, colored_fit, white_fit):
    (_, fit), (_, plain) = colored_fit, white_fit
    for axis in fit.noise:
        assert axis.corner == pytest.approx(5.0, rel=0.35)
        assert axis.zero > 0.98
    assert np.all(fit.whiteness > 1e-4)
    assert np.abs((fit.theta - truth.theta) / fit.std).max() < 4.0
    # Noise that avoids the low frequencies, where the motion is, harms less.
    assert np.all(fit.bound < plain.bound)


@pytest.mark.slow
@pytest.mark.parametrize("color", [pytest.param(None, marks=pytest.mark.thorough), 5.0])
def test_bound_equals_the_dense_computation(truth, slow, color):
    """Against finite differences of the simulated record and its full covariance matrix."""
    samples, dt = slow[0].part(slice(120)), slow[1]
    n = len(samples.gyro)
    sigma, process = 0.02, 0.1
    axis = AxisNoise(sigma, color, 0.0 if color is None else 1.0, process)
    bound = cramer_rao_bound(samples, truth.geometry, dt, truth.theta, (axis, axis, axis))

    t = np.arange(n) * dt
    spline = make_interp_spline(t, samples.speeds, k=5)
    n, t = n - 2 * SPLINE_END, t[SPLINE_END:-SPLINE_END]
    slope = spline.derivative()

    def rates(theta, first):
        Q = rb.forward_matrix(theta)

        def change(now, w):
            rotors, H = rb.rotor_signals(truth.geometry, spline(now))
            dH = slope(now) @ truth.geometry[2]
            return Q @ [*rotors, *rb.rate_signals(w), w[1] * H, w[0] * H, dH]

        return solve_ivp(change, (t[0], t[-1]), first, "DOP853", t, rtol=1e-9, atol=1e-10).y.T

    def slopes(function, at, steps):
        columns = []
        for k, step in enumerate(steps):
            off = np.zeros(len(at))
            off[k] = step
            columns.append((function(at + off) - function(at - off)) / (2.0 * step))
        return np.stack(columns, axis=-1)

    first = samples.rates[SPLINE_END]
    by_theta = slopes(lambda v: rates(v, first), truth.theta, 1e-3 * SIZE)
    by_first = slopes(lambda v: rates(truth.theta, v), first, np.full(3, 1e-4))  # (n, 3, 3)

    # Gyro noise: from its impulse response, begun long before.
    a = 0.0 if color is None else np.exp(-color * dt)
    response = lfilter([1.0, -axis.zero], [1.0, -a], np.eye(n + 800)[0])
    lags = [sigma**2 * response[: n + 800 - k] @ response[k:] for k in range(n)]
    lag = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    S = np.einsum("tu,ij->tiuj", np.array(lags)[lag], np.eye(3))
    # Acceleration noise arrives at each sample and is carried on by the motion.
    for k in range(1, n):
        carried = np.zeros((n, 3, 3))
        carried[k:] = by_first[k:] @ np.linalg.inv(by_first[k])
        S += (process * dt) ** 2 * np.einsum("tik,ujk->tiuj", carried, carried)
    # First rates and bias, with their priors, as part of the noise.
    S += (100.0 * sigma) ** 2 * np.einsum("tik,ujk->tiuj", by_first, by_first)
    S += BIAS_STD**2 * np.einsum("tu,ij->tiuj", np.ones((n, n)), np.eye(3))
    X = by_theta.reshape(3 * n, rb.N_THETA) * SIZE
    information = X.T @ np.linalg.solve(S.reshape(3 * n, 3 * n), X)
    dense = SIZE * np.sqrt(np.diag(np.linalg.inv(information)))
    np.testing.assert_allclose(bound, dense, rtol=0.01)


@pytest.mark.thorough
def test_noise_of_speeds_does_not_bias(truth, flight, start):
    """Strong enough that without its correction inertia would be too large by far."""
    samples, dt, level = flight.part(slice(None, 4000, 2)), 0.01, 0.7
    errors, uncorrected = [], []
    for seed in range(3):
        noise = level * np.random.default_rng(seed).standard_normal(samples.speeds.shape)
        noisy = with_noise(samples, white(samples, 0.005, 100 + seed))
        noisy = replace(noisy, speeds=noisy.speeds + noise)
        fit = maximize_likelihood(noisy, truth.geometry, dt, start, speed_std=level)
        assert fit.converged
        errors.append((fit.theta - truth.theta) / fit.std)
        fit = maximize_likelihood(noisy, truth.geometry, dt, start)
        uncorrected.append((fit.theta - truth.theta) / fit.std)
    # Means of three standard normals: 3.3 standard deviations.
    assert np.abs(np.mean(errors, axis=0)[:2]).max() < 1.9
    assert np.all(np.mean(uncorrected, axis=0)[:2] > 2.0)


@pytest.mark.slow
def test_gaps_split_the_record(truth, slow, start, white_fit):
    dt = slow[1]
    noisy, whole = white_fit
    gone = np.zeros(len(noisy.gyro), dtype=bool)
    gone[400:440] = gone[800:810] = True
    gone[820:830] = True  # leaves ten samples between two gaps: too few
    holed = replace(noisy, gyro=np.where(gone[:, None], np.nan, noisy.gyro))
    fit = maximize_likelihood(holed, truth.geometry, dt, start)
    assert fit.rows == len(gone) - gone.sum() - 10 - 3 * 2 * SPLINE_END
    assert fit.seconds == pytest.approx(fit.rows * dt)
    assert np.abs((fit.theta - truth.theta) / fit.std).max() < 4.0
    assert np.all(fit.bound[:6] > 0.98 * whole.bound[:6])
    # 94 % of the record is left, in pieces whose first rates and biases are unknown.
    assert np.all(fit.bound < 2.0 * whole.bound)


@pytest.mark.slow
def test_the_start_does_not_matter(truth, slow, colored_fit):
    noisy, first = colored_fit
    other = maximize_likelihood(noisy, truth.geometry, slow[1], 1.2 * truth.theta)
    assert np.abs((other.theta - first.theta) / first.std).max() < 0.1


@pytest.mark.slow
def test_prior_enters_as_information(truth, slow, start, white_fit):
    dt = slow[1]
    noisy, free = white_fit
    k = rb.MOMENT_RATIO
    mean, weight = truth.theta.copy(), np.zeros((rb.N_THETA, rb.N_THETA))
    weight[k, k] = (0.1 * free.std[k]) ** -2
    held = maximize_likelihood(noisy, truth.geometry, dt, start, prior=(mean, weight))
    assert held.std[k] == pytest.approx(0.1 * free.std[k], rel=0.05)
    assert abs(held.theta[k] - mean[k]) < 0.3 * free.std[k]
    # Izz is known with it, through the yaw equation.
    assert held.std[2] < 0.8 * free.std[2]


def test_nothing_to_fit(truth, slow, start):
    samples, dt = slow
    assert maximize_likelihood(samples.part(slice(20)), truth.geometry, dt, start) is None
    with pytest.raises(ValueError, match="not that of a rigid body"):
        maximize_likelihood(samples, truth.geometry, dt, -start)
    noise = AxisNoise(0.02, None, 0.0, 0.0)
    with pytest.raises(ValueError, match="without a gap"):
        cramer_rao_bound(samples.part(slice(20)), truth.geometry, dt, start, (noise, noise, noise))


def test_noise_of_speeds_beyond_the_motion_leaves_no_information(truth, slow, start):
    """Its expectation, taken from the information, was more than the whole: a traceback."""
    samples, dt = slow
    with pytest.raises(NoInformationError, match="outweighs the motion"):
        maximize_likelihood(samples.part(slice(400)), truth.geometry, dt, start, speed_std=200.0)


def test_why_there_is_no_offline_estimate_is_said(truth):
    tracker = Tracker(truth.geometry, 0.005, EstimatorTuning(), keep=True)
    assert "online estimate to start from" in fit_offline(tracker, Fit(None, None, 0.0))
