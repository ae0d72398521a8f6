"""Array helpers."""

import tracemalloc

import numpy as np
import pytest

from gcs_sysid.arrays import by_parts


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
