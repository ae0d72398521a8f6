"""Array helpers."""

import tracemalloc

import numpy as np
import pytest
from scipy.optimize import nnls

from gcs_sysid.arrays import by_parts, nonnegative


@pytest.mark.parametrize("count", [0, 1, 32, 70])
def test_parts_make_the_whole(count):
    stack = np.random.default_rng(5).normal(size=(count, 7, 7))
    assert np.array_equal(by_parts(lambda some: some.sum(axis=2), stack), stack.sum(axis=2))


def test_what_is_needed_in_between_is_never_there_for_all():
    stack = np.ones((500, 50, 50))
    tracemalloc.start()
    try:
        out = by_parts(lambda some: (some @ some).sum(axis=2), stack)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert out.shape == (500, 50)
    assert peak < 0.2 * stack.nbytes  # at once: more than all of it


@pytest.mark.parametrize(("rows", "columns"), [(0, 2), (1, 1), (2, 7), (7, 2), (8, 7)])
def test_nonnegative_values_leave_as_little_as_those_of_scipy(rows, columns):
    rng = np.random.default_rng(7)
    for _ in range(50):
        alike = rng.uniform(0.01, 1.0, (rows, columns)) ** rng.integers(1, 4)
        target = alike @ rng.standard_normal(columns) + 0.1 * rng.standard_normal(rows)
        found = nonnegative(alike, target)
        assert (found >= 0.0).all()
        left = np.linalg.norm(alike @ found - target)
        if rows:
            assert left == pytest.approx(nnls(alike, target)[1], rel=1e-9, abs=1e-12)
