"""Array helpers."""

import tracemalloc

import numpy as np
import pytest

from gcs_sysid.arrays import mapped


@pytest.mark.parametrize("shape", [(), (1,), (70,), (2, 33), (70, 0)])
def test_mapped_moments_are_those_of_one_product(shape):
    random = np.random.default_rng(5)
    P, M = random.normal(size=(3, 7)), random.normal(size=(*shape, 7, 7))
    assert mapped(P, M) == pytest.approx(P @ M @ P.T, rel=1e-12, abs=1e-12)


def test_mapping_many_moments_takes_little_more_than_the_outcome():
    P, M = np.ones((10, 50)), np.ones((500, 50, 50))
    tracemalloc.start()
    try:
        out = mapped(P, M)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 2.0 * out.nbytes  # at once: six times
