"""Thrust and drag over mass, on rows whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from gcs_sysid.estimation.fit.translation import (
    ACCELEROMETER_BIAS_STD,
    GAIN_DRIFT,
    TILT_ERROR_SHARE,
    AccelerometerGain,
    TranslationFit,
    accelerometer_gain,
    fit_accelerometer,
    fit_momentum,
    follow_momentum,
)
from gcs_sysid.model.parameters import GRAVITY

KAPPA, DELTA, WIND = 1.4e-4, 0.17, (3.0, -2.0)
PER_BATCH = 40


def momentum_rows(seed=1, n=1600, sigma=0.05, sideways=1.0):
    """(3, n, 4) rows [thrust direction times sum O, velocity, 1, output] of world axes."""
    rng = np.random.default_rng(seed)
    slow = lfilter([0.3], [1.0, -0.95], rng.standard_normal((n, 6)), axis=0)
    thrust = GRAVITY / KAPPA * (1.0 + 0.1 * slow[:, 0])
    down = np.column_stack([0.2 * slow[:, 1], 0.2 * slow[:, 2], np.ones(n)])
    down /= np.linalg.norm(down, axis=1, keepdims=True)
    lift = thrust[:, None] * down
    v = 2.0 * slow[:, 3:]
    wind = np.array([*WIND, 0.0])
    factor = np.array([sideways, sideways, 1.0])
    out = -KAPPA * factor * lift - DELTA * (v - wind)
    out += sigma * rng.standard_normal((n, 3))
    return np.stack([lift, v, np.ones_like(v), out], axis=-1).transpose(1, 0, 2)


def moments(rows, per_batch=PER_BATCH):
    """(k, ..., 4, 4) and (k,) of rows (..., n, 4)."""
    n = rows.shape[-2]
    parts = [rows[..., k : k + per_batch, :] for k in range(0, n, per_batch)]
    products = np.stack([np.swapaxes(p, -1, -2) @ p for p in parts])
    return products, np.array([p.shape[-2] for p in parts])


@pytest.mark.parametrize("sideways", [1.0, 0.9])
def test_thrust_drag_and_wind_are_found_exactly_without_noise(sideways):
    """Horizontal thrust falls short by per cents where attitude and velocity lag each other."""
    fit = fit_momentum(*moments(momentum_rows(sigma=0.0, sideways=sideways)))
    assert fit.kappa == pytest.approx(KAPPA, rel=1e-9)
    assert fit.delta == pytest.approx(DELTA, rel=1e-7)


def test_axes_are_weighed_by_what_they_leave():
    rows = momentum_rows(sigma=0.0)
    rng = np.random.default_rng(4)
    sigma = np.array([0.02, 0.3, 0.1])
    rows[..., 3] += sigma[:, None] * rng.standard_normal((3, rows.shape[1]))
    fit = fit_momentum(*moments(rows))
    # 1600 rows tell a variance to 3.5 %.
    np.testing.assert_allclose(fit.warm_start.weights, sigma**-2.0, rtol=0.12)
    # The least squares of all rows with those weights, written out.
    lift, v, one, out = np.moveaxis(rows, -1, 0)
    zero = np.zeros_like(one[0])
    A = [
        np.column_stack([zero, v[0], lift[0], one[0], zero]),
        np.column_stack([zero, v[1], lift[1], zero, one[0]]),
        np.column_stack([lift[2], v[2], zero, zero, zero]),
    ]
    w = np.sqrt(np.repeat(fit.warm_start.weights, rows.shape[1]))
    found = np.linalg.lstsq(w[:, None] * np.vstack(A), w * out.ravel(), rcond=None)[0]
    assert -found[0] == pytest.approx(fit.kappa, rel=1e-8)
    assert -found[1] == pytest.approx(fit.delta, rel=1e-8)


def test_intervals_tell_the_errors():
    off, stds = [], []
    for seed in range(120):
        fit = fit_momentum(*moments(momentum_rows(seed)))
        off.append([fit.kappa - KAPPA, fit.delta - DELTA])
        # Wind is sideways force enough that attitude errors are allowed for in full.
        white = np.sqrt(fit.kappa_std**2 - (TILT_ERROR_SHARE * fit.kappa) ** 2)
        stds.append([white, fit.delta_std])
    # 120 runs tell a deviation to 6.5 %; intervals are Student's.
    ratio = np.mean(stds, axis=0) / np.std(off, axis=0)
    assert np.all((ratio > 0.95) & (ratio < 1.6)), ratio


@pytest.mark.parametrize("error", [0.02, 0.06])
def test_attitude_errors_are_allowed_for_as_far_as_sideways_forces_show(error):
    """Turned by e, thrust is short by e^2 / 2, of both axes; no more than what 0.03 rad make."""
    # No wind: what is left sideways is attitude error alone.
    rows = momentum_rows(sigma=1e-6)
    rng = np.random.default_rng(9)
    tilt = error * rng.standard_normal((2, rows.shape[1]))
    rows[..., 3] = -KAPPA * rows[..., 0] - DELTA * rows[..., 1]
    rows[:2, :, 3] += GRAVITY * tilt
    rows[2, :, 3] += 1e-6 * rng.standard_normal(rows.shape[1])
    fit = fit_momentum(*moments(rows))
    share = min(0.5 * (tilt**2).sum(axis=0).mean(), TILT_ERROR_SHARE)
    assert fit.kappa_std / fit.kappa == pytest.approx(share, rel=0.02)


def test_a_fit_that_follows_is_the_fit():
    batches, counts = moments(momentum_rows())
    whole = fit_momentum(batches, counts)
    early = fit_momentum(batches[:-4], counts[:-4])
    totals = np.stack([batches[:-4].sum(axis=0), batches.sum(axis=0)])
    rows = np.array([counts[:-4].sum(), counts.sum()])
    first, last = follow_momentum(totals, rows, early)
    assert (first.kappa, first.delta) == pytest.approx((early.kappa, early.delta), rel=1e-9)
    assert first.kappa_std == pytest.approx(early.kappa_std, rel=1e-6)
    # A tenth more of data at the weights of before.
    assert last.kappa == pytest.approx(whole.kappa, abs=0.05 * whole.kappa_std)
    assert last.kappa_std == pytest.approx(whole.kappa_std, rel=0.1)
    assert last.delta_std == pytest.approx(whole.delta_std, rel=0.2)


def test_the_first_batches_of_a_segment_know_how_slowly_velocity_erred_before():
    off, rng = [], np.random.default_rng(8)
    for seed in range(60):
        rows, white = momentum_rows(seed, sigma=0.4), rng.standard_normal(4000)
        rows[2, :, 3] += lfilter([0.2 * np.sqrt(1.0 - 0.998**2)], [1.0, -0.998], white)[-1600:]
        batches, counts = moments(rows)
        known = (None, fit_momentum(batches[10:], counts[10:]).warm_start)
        pair = (fit_momentum(batches[:8], counts[:8], None, before) for before in known)
        off.append([(fit.kappa - KAPPA) / fit.kappa_std for fit in pair])
    alone, known = np.sqrt(np.mean(np.square(off), axis=0))
    assert known < 1.5 < 2.0 < alone


def accelerometer_rows(seed=1, n=1600, bias=0.0, sigma=0.05, variation=0.1, place=None):
    """(n, 6) rows [sum O, what a place in x, y and z adds, 1, f_z]; no rotation without a place."""
    rng = np.random.default_rng(seed)
    slow = lfilter([0.3], [1.0, -0.95], rng.standard_normal(n))
    thrust = GRAVITY / KAPPA * (1.0 + variation * slow)
    force = -KAPPA * thrust + bias + sigma * rng.standard_normal(n)
    added = np.zeros((n, 3))
    if place is not None:
        p, q, r = lfilter([0.3], [1.0, -0.95], rng.standard_normal((n, 3)), axis=0).T
        added = np.column_stack([r * p, q * r, -(p**2) - q**2])
        force += added @ place
    return np.column_stack([thrust, added, np.ones(n), force])


def test_the_accelerometer_tells_thrust_and_its_bias_is_in_the_interval():
    # Hover, so that thrust does not tell the bias: 0.2 m/s^2 of 9.8 are 2 %.
    batches, counts = moments(accelerometer_rows(sigma=0.01, variation=1e-6))
    fit = fit_accelerometer(batches, counts)
    assert fit.kappa == pytest.approx(KAPPA, rel=1e-3)
    assert fit.kappa_std == pytest.approx(ACCELEROMETER_BIAS_STD / GRAVITY * KAPPA, rel=0.03)
    assert fit.source == "accelerometer"
    assert np.isnan(fit.delta)
    assert np.isnan(fit.delta_std)
    # The first seconds' few batches do not tell how thrust varies: the bias is as it is.
    early = fit_accelerometer(batches[:9], counts[:9])
    assert early.kappa_std == pytest.approx(ACCELEROMETER_BIAS_STD / GRAVITY * KAPPA, rel=0.01)


@pytest.mark.parametrize("bias", [0.3, -0.3])
def test_a_thrust_that_varies_tells_the_bias(bias):
    batches, counts = moments(accelerometer_rows(bias=bias, sigma=0.02))
    fit = fit_accelerometer(batches, counts)
    # Without the unknown it would be off by 3 %.
    assert fit.unbiased == pytest.approx(KAPPA * (1.0 - bias / GRAVITY), rel=3e-3)
    assert fit.kappa == pytest.approx(KAPPA, abs=3.0 * fit.kappa_std)
    assert fit.kappa_std < 0.01 * KAPPA
    few = fit_accelerometer(batches[:9], counts[:9])
    assert few.kappa == few.unbiased
    enough = fit_accelerometer(batches[:10], counts[:10])
    assert enough.kappa != enough.unbiased


@pytest.mark.parametrize(("variation", "sigma", "share"), [(0.006, 0.01, 0.05), (0.1, 0.05, 0.015)])
def test_drag_that_follows_thrust_is_in_the_interval(variation, sigma, share):
    """Of 3 mm/s^2 it is 5 % of the slope of a thrust that hardly varies."""
    rows = accelerometer_rows(sigma=sigma, variation=variation)
    rows[:, -1] -= share * (rows[:, -1] - rows[:, -1].mean())
    fit = fit_accelerometer(*moments(rows))
    assert fit.kappa == pytest.approx(KAPPA, abs=1.96 * fit.kappa_std)


@pytest.mark.parametrize("place", [(0.22, 0.0, 0.13), (0.0, -0.1, -0.2), (0.0, 0.0, 0.0)])
def test_rotation_shows_where_the_accelerometer_is(place):
    batches, counts = moments(accelerometer_rows(sigma=0.02, place=place))
    fit = fit_accelerometer(batches, counts, place=0.05)
    assert fit.kappa == pytest.approx(KAPPA, abs=3.0 * fit.kappa_std)
    assert fit.kappa_std < 0.01 * KAPPA
    # Nine batches are too early.
    early = fit_accelerometer(batches[:9], counts[:9], place=0.05)
    exact = fit_accelerometer(batches[:9], counts[:9])
    assert early.kappa == exact.kappa
    assert early.kappa_std > exact.kappa_std


def test_the_bias_is_held_to_what_is_usual():
    """The posterior of slope and bias, written out for white residuals of known size."""
    sigma, bias = 0.5, 0.4
    rows = accelerometer_rows(sigma=sigma, bias=bias, variation=0.02, n=400)
    A, y = rows[:, [0, -2]], rows[:, -1]
    slope, offset = np.linalg.lstsq(A, y, rcond=None)[0]
    residual = y - A @ [slope, offset]
    information = A.T @ A / np.mean(residual**2)
    information[1, 1] += ACCELEROMETER_BIAS_STD**-2.0
    posterior = np.linalg.solve(information, A.T @ y / np.mean(residual**2))
    batches, counts = moments(rows, 1)
    fit = fit_accelerometer(batches, counts)
    # Scatter of 400 batches of a row tells the noise to some per cent, which weighs the two.
    assert fit.kappa == pytest.approx(-posterior[0], rel=5e-3)
    std = np.sqrt(np.linalg.inv(information)[0, 0])
    assert fit.kappa_std == pytest.approx(std, rel=0.15)


def test_a_known_gain_takes_the_biass_place():
    batches, counts = moments(accelerometer_rows(bias=0.3, sigma=0.05)[:120])
    plain = fit_accelerometer(batches, counts)
    gain = AccelerometerGain(1.0 / (1.0 - 0.3 / GRAVITY), 0.001)
    fit = fit_accelerometer(batches, counts, gain)
    assert fit.unbiased == plain.unbiased
    assert fit.kappa == pytest.approx(plain.unbiased * gain.value)
    assert fit.kappa == pytest.approx(KAPPA, rel=3e-3)
    # A mean of 120 numbers of 0.05, three times for the nine rows that share a window.
    white = 3.0 * 0.05 / np.sqrt(120.0) / GRAVITY
    assert fit.kappa_std / fit.kappa == pytest.approx(np.hypot(white, 0.001), rel=0.25)
    exact = moments(accelerometer_rows(sigma=0.0)[:120])
    sure = fit_accelerometer(*exact, AccelerometerGain(2.0, 0.01))
    assert sure.kappa_std == pytest.approx(0.01 * sure.kappa, rel=1e-3)


def test_the_gain_is_momentums_thrust_over_the_accelerometers():
    momentum = TranslationFit(KAPPA, 0.001 * KAPPA, 0.1, 0.01, "momentum")
    own = TranslationFit(1.1 * KAPPA, 0.02 * KAPPA, np.nan, np.nan, "accelerometer")
    own = replace(own, unbiased=0.8 * KAPPA)
    gain = accelerometer_gain(momentum, own)
    assert gain.value == pytest.approx(1.25)
    assert gain.share == pytest.approx(np.hypot(0.001, GAIN_DRIFT))
    for pair in ((None, own), (momentum, None), (own, own)):
        assert accelerometer_gain(*pair) is None


def test_wind_is_no_attitude_error_of_the_vertical_axis():
    """Only what is left sideways without wind counts, whatever the vertical axis leaves."""
    rows = momentum_rows(n=16_000, sigma=1e-6)
    rows[..., 3] = -KAPPA * rows[..., 0] - DELTA * rows[..., 1]
    rng = np.random.default_rng(9)
    rows[:2, :, 3] += 1e-6 * rng.standard_normal((2, rows.shape[1]))
    rows[2, :, 3] += 0.3 * rng.standard_normal(rows.shape[1])
    fit = fit_momentum(*moments(rows))
    # 0.3 m/s^2 in 16 000 rows are 2.4e-4 of gravity; as tilt it would add 4.7e-4.
    white = 0.3 / np.sqrt(16_000.0) / GRAVITY
    assert fit.kappa_std / fit.kappa < 1.3 * white
    # And thrust that acts sideways as it does upwards is none either, drag and all.
    assert fit_momentum(*moments(momentum_rows(sigma=1e-6))).kappa_std > 4e-4 * KAPPA


@pytest.mark.parametrize(
    ("wind", "sideways"), [((0.4, 0.0), 1.0), ((0.0, 0.3), 1.0), ((0.0, 0.0), 0.9)]
)
def test_tilt_is_bounded_with_the_vertical_thrust_and_without_wind(wind, sideways):
    """What a little wind, or thrust that falls short sideways, leaves is allowed for as tilt."""
    rows = momentum_rows(sigma=0.0)
    lift, v = rows[..., 0], rows[..., 1]
    blown = DELTA * np.array(wind)[:, None]
    rows[..., 3] = -KAPPA * lift - DELTA * v
    rows[:2, :, 3] = -sideways * KAPPA * lift[:2] - DELTA * v[:2] + blown
    left = (1.0 - sideways) * KAPPA * lift[:2] + blown
    share = 0.5 * (left**2).sum(axis=0).mean() / GRAVITY**2
    assert share < TILT_ERROR_SHARE
    fit = fit_momentum(*moments(rows))
    assert fit.kappa_std / fit.kappa == pytest.approx(share, rel=1e-3)
