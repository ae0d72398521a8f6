"""Coverage of the corrected covariance on a linear problem with colored noise."""

import numpy as np
import pytest
from scipy.signal import lfilter

from gcs_sysid.estimation.noise.uncertainty import (
    inflation,
    meat,
    shrunk_inflation,
    slow_inflation,
    student_factor,
    symmetric_roots,
    watched_factor,
)

N, BATCH, RUNS = 2000, 40, 400


def ar1(rng, rho, shape):
    fresh = rng.standard_normal(shape)
    return lfilter([np.sqrt(1 - rho**2)], [1.0, -rho], fresh, axis=0)


def coverage(rho):
    """Share of runs whose 95 % interval holds the truth: plain and corrected, over two unknowns."""
    rng = np.random.default_rng(1)
    truth = np.array([2.0, -1.0])
    plain, corrected = [], []
    for _ in range(RUNS):
        X = ar1(rng, rho, (N, 2))
        y = X @ truth + ar1(rng, rho, N)
        estimate = np.linalg.lstsq(X, y, rcond=None)[0]
        residual = y - X @ estimate
        inverse_root = symmetric_roots(X.T @ X / np.var(residual), 0.0)[1]
        scores = (X * residual[:, None] / np.var(residual)).reshape(-1, BATCH, 2).sum(axis=1)
        spread = slow_inflation(np.sqrt(N / BATCH) * scores @ inverse_root)
        error = np.abs(estimate - truth)
        plain.append(error < 1.96 * np.sqrt(np.diag(inverse_root @ inverse_root)))
        corrected.append(error < 1.96 * np.sqrt(np.diag(inverse_root @ spread @ inverse_root)))
    return np.mean(plain), np.mean(corrected)


@pytest.mark.parametrize("rho", [0.0, 0.8, 0.9, 0.99])
def test_intervals_are_true_with_colored_noise(rho):
    plain, corrected = coverage(rho)
    # 800 intervals at 95 %: one standard deviation of the share is 0.8 %.
    assert 0.88 <= corrected <= 0.98
    assert plain < (0.75 if rho else 0.98)
    assert corrected > plain + (0.15 if rho else 0.0)


@pytest.mark.parametrize("scores", [np.zeros((1, 3)), np.full((2, 3), 1e-3)])
def test_never_below_what_white_residuals_would_give(scores):
    np.testing.assert_allclose(slow_inflation(scores, 9.0), 9.0 * np.eye(3), atol=1e-12)


@pytest.mark.parametrize("batches", [8, 20])
def test_intervals_hold_with_few_batches(batches):
    """A mean of white noise in few batches: t, not normal."""
    rng = np.random.default_rng(3)
    rows, runs = 40, 3000
    y = rng.standard_normal((runs, batches, rows))
    mean = y.mean(axis=(1, 2))
    # Without the floor at white residuals, which here alone would be exact.
    scores = (y - mean[:, None, None]).sum(axis=2)
    lags = [(1 - n / 3) * (scores[:, n:] * scores[:, :-n]).sum(axis=1) for n in (1, 2)]
    std = np.sqrt((scores**2).sum(axis=1) + 2.0 * sum(lags)) / (batches * rows)
    std *= np.sqrt(batches / (batches - 1.0))
    wide = std * student_factor(np.ones((batches, 1)))
    plain, corrected = (np.mean(np.abs(mean) < 1.96 * s) for s in (std, wide))
    assert corrected > plain + 0.01
    assert 0.92 <= corrected <= 0.97


def test_a_watched_mean_stays_within_its_interval():
    """Looked at ten times a second for a minute: fixed intervals are left in a third of runs."""
    rng = np.random.default_rng(4)
    times = np.arange(3.0, 60.0, 0.1)
    steps = rng.standard_normal((4000, len(times))) * np.sqrt(np.diff(times, prepend=0.0))
    off = np.abs(np.cumsum(steps, axis=1)) / np.sqrt(times)
    factors = np.array([watched_factor(t / 3.0) for t in times])
    plain, watched = ((off > 1.96 * wide).any(axis=1).mean() for wide in (1.0, factors))
    assert 0.25 < plain < 0.40
    assert 0.005 < watched < 0.05


@pytest.mark.parametrize(
    ("scores", "expected"),
    [
        # 1 + 4 + 16, and 2 x 0.5 x (2 + 8); times 3 / (3 - 2 / 6) for one unknown fitted.
        ([[1.0], [2.0], [4.0]], [[31.0 * 9.0 / 8.0]]),
        # The same in one of two unknowns, which leave 3 - 4 / 6 of three.
        ([[1.0, 0.0], [2.0, 0.0], [4.0, 0.0]], [[31.0 * 9.0 / 7.0, 0.0], [0.0, 0.0]]),
        # Off the diagonal: 1 + 0.5 (s1 s0' + s0 s1'), one of it from each order.
        ([[1.0, 1.0], [0.0, 2.0], [0.0, 0.0]], [[9 / 7, 18 / 7], [18 / 7, 63 / 7]]),
    ],
)
def test_scatter_of_the_score_is_newey_and_wests(scores, expected):
    np.testing.assert_allclose(meat(np.array(scores)), expected)


def test_an_unseen_direction_keeps_a_huge_finite_variance():
    # A million standard deviations of a direction that is seen; not more than was given as ridge.
    inverse_root = symmetric_roots(np.diag([1.0, 0.0]))[1]
    np.testing.assert_allclose(np.diag(inverse_root), [1.0, 1e6])
    assert np.all(np.isfinite(symmetric_roots(np.diag([1.0, -1e-18]), 0.0)[1]))


def normalized_errors(rho, shrunk, batches=57, runs=150, unknowns=12):
    """(runs,) e' P^-1 e of linear fits whose noise is of first order with coefficient rho."""
    rng = np.random.default_rng(7)
    found = np.empty(runs)
    for i in range(runs):
        X = ar1(rng, rho, (batches * BATCH, unknowns))
        noise = ar1(rng, rho, len(X))
        bread = np.linalg.inv(X.T @ X)
        error = bread @ (X.T @ noise)
        scores = (X * (noise - X @ error)[:, None]).reshape(batches, BATCH, unknowns).sum(axis=1)
        root = symmetric_roots(bread, 0.0)[0]
        if shrunk:
            spread, told = shrunk_inflation(root, scores)
            assert ((told >= 0.0) & (told <= 1.0)).all()
        else:
            spread = inflation(root, meat(scores))
        found[i] = error @ np.linalg.solve(root @ spread @ root, error)
    return found


@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_shrunk_scatter_makes_the_covariance_right(rho):
    """Chi-square of 12, white noise or colored; all scatter above 1 is too wide, or too narrow."""
    right = normalized_errors(rho, True)
    taken = normalized_errors(rho, False)
    # Standard deviation of a mean: 0.4 where noise is white.
    assert right.mean() == pytest.approx(12.0, abs=1.0)
    assert abs(taken.mean() - 12.0) > 1.2


def test_a_direction_that_stands_out_stays():
    rng = np.random.default_rng(3)
    scores = rng.standard_normal((57, 12)) / np.sqrt(57.0)
    scores[:, 4] *= 4.0
    spread, told = shrunk_inflation(np.eye(12), scores)
    assert 8.0 < spread[4, 4] < 25.0
    assert np.delete(np.diag(spread), 4).max() < 2.5
    assert told[4] > 0.9 > np.delete(told, 4).max()


@pytest.mark.parametrize("batches", [1, 3, 8])
def test_few_batches_prove_little(batches):
    """What cannot be proved stays as wide as it was: nearly all is told by the scatter."""
    scores = np.random.default_rng(4).standard_normal((batches, 12)) / np.sqrt(batches)
    spread, told = shrunk_inflation(np.eye(12), scores)
    assert np.linalg.eigvalsh(spread).min() >= 1.0 - 0.5 * batches / 24.0
    assert (told >= 1.0 - batches / 24.0).all()
