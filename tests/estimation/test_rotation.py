"""The rotational fit's own corrections, on rows whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from gcs_sysid.estimation.fit.inference import follow_rotation
from gcs_sysid.estimation.fit.priors import N_UNKNOWNS, Prior
from gcs_sysid.estimation.rows.actuator_dynamics import PLAIN, WIDTH
from gcs_sysid.estimation.rows.regression import NormalEquations
from gcs_sysid.model import rigid_body as rb
from tests.estimation.rows_fit import fit_rows
from tests.known_theta import prior_of, sizes, theta_from

ROWS = 4000
VALUES = (80.0, 81.0, 143.0, 6.6, 12.4, -8.1, 0.1, 0.05, 0.03, 20.0, 0.3)
THETA, SIZE = theta_from(*VALUES), np.abs(sizes(*VALUES))
TORQUES = (0, 1, 3)
"""Columns of roll, pitch and yaw torque."""


def inputs(rng):
    """(ROWS, N_SIGNALS) of a vehicle that turns about all axes."""
    slow = lfilter([0.3], [1.0, -0.95], rng.standard_normal((ROWS, 8)), axis=0)
    rotors = slow[:, 3:7] * [60.0, 60.0, 2e3, 1e4] + [3.0, 7.0, 7e4, 0.0]
    H = 20.0 * slow[:, 7]
    rates = slow[:, :3]
    gyroscopic = np.column_stack([rates[:, 1] * H, rates[:, 0] * H, 10.0 * np.gradient(H)])
    return np.column_stack([rotors, rb.rate_signals(rates), gyroscopic])


def moments_of(seed=1, rows_per_batch=40, input_noise=0.0, sigma=1.0):
    """Batches and counts of rows, and the moments that noise of the torques adds to a row.

    Args:
        seed: of all that is drawn.
        rows_per_batch: rows in a batch.
        input_noise: standard deviation on the torques, in shares of theirs.
        sigma: of the outputs' white noise.
    """
    rng = np.random.default_rng(seed)
    x = inputs(rng)
    y = x @ rb.forward_matrix(THETA).T + sigma * rng.standard_normal((ROWS, 3))
    std = np.zeros(rb.N_SIGNALS)
    std[list(TORQUES)] = input_noise * x[:, TORQUES].std(axis=0)
    seen = x.copy()
    seen[:, TORQUES] += std[list(TORQUES)] * rng.standard_normal((ROWS, 3))
    moments = NormalEquations((1, WIDTH, WIDTH), rows_per_batch)
    moments.add(np.column_stack([seen, y])[None])
    noise = np.zeros((1, WIDTH, WIDTH))
    noise[0, : rb.N_SIGNALS, : rb.N_SIGNALS] = np.diag(std**2)
    return moments.batches, moments.counts, noise


def of_axes(moments):
    """(K, width, width) moments, the same for all axes."""
    return np.repeat(moments[:, None], 3, axis=1)


NONE = np.zeros((1, WIDTH, WIDTH))


def followed(batches, start, noise=NONE, prior=None):
    """The fit to all rows that goes on from another."""
    (fit,) = follow_rotation(
        of_axes(batches.sum(axis=0)), np.array([ROWS]), PLAIN, of_axes(noise), start, prior=prior
    )
    return fit


SLIGHT = prior_of({i: (THETA[i], 10.0 * SIZE[i]) for i in range(rb.N_THETA)})
"""Says next to nothing, and takes the way of a prior."""


@pytest.mark.parametrize("prior", [None, SLIGHT], ids=["data alone", "with a prior"])
def test_known_noise_of_the_inputs_is_taken_out_to_first_order(prior):
    # Noise of a tenth makes least squares underrate torques by 1 %, inertia is that much too large.
    batches, counts, noise = moments_of(input_noise=0.1, sigma=0.01)
    raw = fit_rows(batches, counts, PLAIN, NONE, prior=prior)
    told = fit_rows(batches, counts, PLAIN, noise, prior=prior)
    off = {name: fit.theta[:3] / THETA[:3] - 1.0 for name, fit in (("raw", raw), ("told", told))}
    assert np.all(off["raw"] > 0.005)
    # The noise as drawn is off by 1 / sqrt(2000).
    assert np.all(np.abs(off["told"]) < 0.15 * off["raw"])


@pytest.mark.parametrize("prior", [None, SLIGHT], ids=["data alone", "with a prior"])
def test_a_fit_that_follows_takes_that_noise_out_too(prior):
    batches, counts, noise = moments_of(input_noise=0.1, sigma=0.01)
    start = fit_rows(batches, counts, PLAIN, noise, prior=prior)
    fit = followed(batches, start, noise, prior)
    assert np.all(np.abs(fit.theta - start.theta) < 1e-3 * start.std)
    np.testing.assert_allclose(fit.std, start.std, rtol=1e-6)


def test_doubt_of_the_noise_widens_by_what_the_correction_moved():
    batches, counts, noise = moments_of(input_noise=0.1, sigma=0.01)
    sure = fit_rows(batches, counts, PLAIN, noise)
    doubted = fit_rows(batches, counts, PLAIN, noise, doubt=0.5)
    moved = sure.theta - fit_rows(batches, counts, PLAIN, NONE).theta
    np.testing.assert_allclose(doubted.theta, sure.theta)
    # One standard deviation of the noise is half of it: so is that of what it moves, times
    # Student's factor, which for a hundred batches of equal weight is 1.05.
    added = np.sqrt(np.diag(doubted.covariance) - np.diag(sure.covariance))
    widening = sure.warm_start.widening
    np.testing.assert_allclose(added[:3], 0.5 * np.abs(moved * widening)[:3], rtol=0.02)


def moved_fit(fit, sigmas, index=0):
    """As if the search had ended so many standard deviations away in one unknown."""
    assert fit.warm_start is not None
    unknowns = fit.warm_start.unknowns.copy()
    unknowns[index] += sigmas * fit.std[index]
    return replace(fit, warm_start=replace(fit.warm_start, unknowns=unknowns))


@pytest.mark.parametrize("prior", [None, SLIGHT], ids=["data alone", "with a prior"])
def test_a_long_step_is_searched_not_taken_blindly(prior):
    # Inertia a tenth off: one step leaves 0.1^2 of it and more, 1.2 %; the search's two, a third.
    batches, counts, _ = moments_of(sigma=0.3)
    fit = fit_rows(batches, counts, PLAIN, NONE, prior=prior)
    far = 0.1 * fit.theta[0] / fit.std[0]
    assert far > 10.0
    found = followed(batches, moved_fit(fit, far), prior=prior)
    assert np.abs(found.theta - fit.theta)[0] < 6e-3 * fit.theta[0]


def test_intervals_of_few_batches_are_students():
    # Eight batches of equal weight: 64 / 15.6 = 4.1 degrees of freedom, 2.74 for 1.96; of the share
    # that their scatter determines.
    few = fit_rows(*moments_of(rows_per_batch=ROWS // 8)[:2], PLAIN, NONE)
    many = fit_rows(*moments_of(rows_per_batch=ROWS // 400)[:2], PLAIN, NONE)
    assert np.all((few.warm_start.widening[:3] > 1.08) & (few.warm_start.widening[:3] < 1.55))
    assert many.warm_start.widening[:3] == pytest.approx(1.02, abs=0.02)
    # It is on the standard deviations, once.
    batches = moments_of(rows_per_batch=ROWS // 8)[0]
    plain = replace(few.warm_start, widening=np.ones_like(few.warm_start.widening))
    narrow = followed(batches, replace(few, warm_start=plain))
    np.testing.assert_allclose(few.std, narrow.std * few.warm_start.widening, rtol=1e-3)


def test_what_axes_explain_is_told_by_axis():
    rng = np.random.default_rng(6)
    x = inputs(rng)
    motion = x @ rb.forward_matrix(THETA).T
    sigma = np.array([0.1, 0.5, 1.0]) * motion.std(axis=0)
    moments = NormalEquations((1, WIDTH, WIDTH), 40)
    moments.add(np.column_stack([x, motion + sigma * rng.standard_normal((ROWS, 3))])[None])
    fit = fit_rows(moments.batches, moments.counts, PLAIN, NONE)
    power = (motion**2).mean(axis=0)
    np.testing.assert_allclose(fit.r_squared, power / (power + sigma**2), atol=0.02)
    # 4000 rows tell a variance to 2.2 %, one standard deviation.
    np.testing.assert_allclose(np.diag(fit.residual_covariance), sigma**2, rtol=0.09)
    assert fit.rows == ROWS


def test_a_strong_prior_that_pulls_out_of_the_physical_is_held_back():
    # Izz beyond Ixx + Iyy is no body: the step is shortened, the estimate stays physical.
    batches, counts, _ = moments_of(sigma=20.0)
    mean = np.zeros(N_UNKNOWNS)
    mean[2] = 2.0 * (THETA[0] + THETA[1])
    information = np.zeros((N_UNKNOWNS, N_UNKNOWNS))
    information[2, 2] = 1e4
    fit = fit_rows(batches, counts, PLAIN, NONE, prior=Prior(mean, information))
    assert rb.is_physical(fit.theta)


def test_a_fit_that_follows_weighs_its_prior_as_the_fit_does():
    """A start two deviations off, and a prior as strong as the data: one step leads there."""
    batches, counts, _ = moments_of(sigma=0.1)
    alone = fit_rows(batches, counts, PLAIN, NONE)
    mean = THETA + 1.5 * alone.std
    prior = prior_of({i: (mean[i], alone.std[i]) for i in range(rb.N_THETA)})
    fit = fit_rows(batches, counts, PLAIN, NONE, prior=prior)
    assert np.any(np.abs(fit.theta - alone.theta) > 0.5 * fit.std)
    for start in (fit, alone):
        warm_start = replace(fit.warm_start, unknowns=start.warm_start.unknowns)
        found = followed(batches, replace(fit, warm_start=warm_start), prior=prior)
        assert np.all(np.abs(found.theta - fit.theta) < 0.1 * fit.std)
        np.testing.assert_allclose(found.std, fit.std, rtol=0.02)


def test_instants_are_followed_as_each_would_be_alone():
    """Of these starts the first is near enough for a blind step, the others are searched."""
    batches, _, _ = moments_of(sigma=0.3)
    rows = np.array([40, 2000, 3000, 4000])
    totals = np.stack([batches[: n // 40, 0].sum(axis=0) for n in rows])
    start = fit_rows(batches, np.full(len(batches), 40), PLAIN, NONE)
    start = moved_fit(start, 12.0)
    totals, noise = of_axes(totals), of_axes(np.repeat(NONE, 4, axis=0))
    together = follow_rotation(totals, rows, PLAIN, noise, start)
    for i, fit in enumerate(together):
        (alone,) = follow_rotation(totals[i : i + 1], rows[i : i + 1], PLAIN, noise[:1], start)
        np.testing.assert_allclose(fit.theta, alone.theta, rtol=1e-9)
        np.testing.assert_allclose(fit.covariance, alone.covariance, rtol=1e-6, atol=1e-12)
        assert fit.rows == rows[i]
