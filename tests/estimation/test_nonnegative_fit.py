"""Least squares without negative unknowns, against SciPy's."""

import numpy as np
import pytest
from scipy.optimize import nnls

from gcs_sysid.estimation.nonnegative_fit import fit_nonnegative


@pytest.mark.parametrize("p", range(1, 9))
def test_it_finds_what_scipy_does(p):
    random = np.random.default_rng(p)
    bound = 0
    for _ in range(200):
        A = random.normal(size=(random.integers(p, 2 * p + 4), p)) * 10.0 ** random.uniform(
            -2, 2, p
        )
        b = A @ np.maximum(random.normal(size=p), 0.0) + 0.5 * random.normal(size=len(A))
        found, expected = fit_nonnegative(A, b), nnls(A, b)[0]
        np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-12)
        bound += np.count_nonzero(found == 0.0)
    assert bound > 20 * p


def test_columns_that_are_nearly_alike():
    random = np.random.default_rng(0)
    for _ in range(200):
        A = np.abs(random.normal(size=(8, 1)) + 1e-4 * random.normal(size=(8, 4)))
        b = random.normal(size=8) + A.sum(axis=1)
        found, expected = fit_nonnegative(A, b), nnls(A, b)[0]
        assert found.min() >= 0.0
        left, least = (np.linalg.norm(A @ x - b) for x in (found, expected))
        assert left == pytest.approx(least, rel=1e-9)


def test_the_same_column_twice_and_none_at_all():
    A = np.ones((4, 2))
    assert fit_nonnegative(A, np.full(4, 3.0)).sum() == pytest.approx(3.0)
    assert fit_nonnegative(A, np.full(4, -3.0)).tolist() == [0.0, 0.0]
    assert fit_nonnegative(A, np.zeros(4)).tolist() == [0.0, 0.0]
    assert fit_nonnegative(np.zeros((4, 2)), np.ones(4)).tolist() == [0.0, 0.0]
