"""The article's recursion, corrected for several rows at once."""

import numpy as np
import pytest

from gcs_sysid.estimation.record.article_estimator import BlockRls


@pytest.fixture
def problem():
    rng = np.random.default_rng(1)
    phi = rng.normal(size=(60, 3, 5))
    theta = np.array([1.0, -2.0, 3.0, 0.5, 4.0])
    return phi, phi @ theta + 0.1 * rng.normal(size=(60, 3))


def solved(phi, y, prior):
    """Regularised least squares, from the normal equations."""
    flat, right = phi.reshape(-1, 5), y.reshape(-1)
    information = flat.T @ flat + np.eye(5) / prior
    return np.linalg.solve(information, flat.T @ right), np.linalg.inv(information)


@pytest.mark.parametrize("prior", [1.0, 1e6])
def test_it_is_batch_least_squares(problem, prior):
    phi, y = problem
    rls = BlockRls(5, prior)
    for k in range(len(phi)):
        rls.update(phi[k], y[k])
    theta, P = solved(phi, y, prior)
    # The recursion starts from the prior: its rounding is 1e-16 of that, against P of 0.005.
    np.testing.assert_allclose(rls.theta, theta, rtol=0.0, atol=1e-14 * prior + 1e-12)
    np.testing.assert_allclose(rls.P, P, rtol=0.0, atol=1e-14 * prior + 1e-12)


def test_rows_at_once_and_one_after_another_are_the_same(problem):
    phi, y = problem
    block, single, scalar = BlockRls(5, 10.0), BlockRls(5, 10.0), (np.zeros(5), 10.0 * np.eye(5))
    for k in range(len(phi)):
        block.update(phi[k], y[k])
        for i in range(3):
            single.update(phi[k, i : i + 1], y[k, i : i + 1])
            # The printed gain, right for one row: P phi' / (1 + phi P phi').
            theta, P = scalar
            gain = P @ phi[k, i] / (1.0 + phi[k, i] @ P @ phi[k, i])
            scalar = (
                theta + gain * (y[k, i] - phi[k, i] @ theta),
                P - np.outer(gain, phi[k, i]) @ P,
            )
    np.testing.assert_allclose(block.theta, single.theta, rtol=1e-11)
    np.testing.assert_allclose(block.theta, scalar[0], rtol=1e-11)
    np.testing.assert_allclose(block.P, scalar[1], rtol=0.0, atol=1e-12)
