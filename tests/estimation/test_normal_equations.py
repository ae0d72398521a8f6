"""Sums of products in bounded memory, and leaky sums of rows."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gcs_sysid.estimation.rows.regression import LeakySums, NormalEquations


def rows(n, width=4, seed=1):
    return np.random.default_rng(seed).normal(size=(n, width))


def close(found, expected):
    # Sums of the same terms in another order.
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-11)


@pytest.mark.parametrize("n", [1, 9, 10, 11, 80, 81, 400, 1234])
def test_batches_are_the_sums_of_consecutive_rows(n):
    z = rows(n)
    moments = NormalEquations((4, 4), rows_per_batch=10, max_batches=8)
    moments.add(z)
    close(moments.total, z.T @ z)
    assert moments.rows == n == moments.counts.sum()
    assert len(moments.batches) == len(moments.counts) <= 8
    edges = np.concatenate([[0], np.cumsum(moments.counts)])
    for k, batch in enumerate(moments.batches):
        close(batch, z[edges[k] : edges[k + 1]].T @ z[edges[k] : edges[k + 1]])
    # All but the last are full and equally long, ten rows times a power of two.
    full = moments.counts[0] if len(moments.counts) > 1 else 10
    assert np.all(moments.counts[:-1] == full)
    assert full % 10 == 0
    assert np.log2(full / 10) % 1 == 0


def test_memory_is_bounded_while_batches_grow():
    moments = NormalEquations((2, 2), rows_per_batch=1, max_batches=8)
    sizes = set()
    for k in range(1, 3000):
        moments.add(np.ones((1, 2)))
        assert moments.rows == k
        assert len(moments.batches) <= 8
        sizes.add(int(moments.counts[0]))
    assert sizes == {1, 2, 4, 8, 16, 32, 64, 128, 256, 512}


@pytest.mark.parametrize(("rows_dropped", "left"), [(5, 90), (6, 80), (15, 80), (16, 70)])
def test_whole_batches_are_forgotten_and_as_few_as_will_do(rows_dropped, left):
    z = rows(110)
    moments = NormalEquations((4, 4), 10, max_batches=32)
    moments.add(z[:95])
    moments.drop_last(rows_dropped)
    assert moments.rows == left
    # What comes next falls into batches that hold nothing of what is forgotten.
    moments.add(z[left:])
    assert moments.counts.tolist() == [10] * 11
    for k, batch in enumerate(moments.batches):
        close(batch, z[10 * k : 10 * k + 10].T @ z[10 * k : 10 * k + 10])


def test_leaky_sum_is_the_recursion():
    z = rows(60)
    leak = LeakySums(row_time=0.05, memories=[0.3])
    expected, s = [], np.zeros(4)
    for row in z:
        s = np.exp(-0.05 / 0.3) * s + row
        expected.append(s)
    close(leak.update(z[None])[0, 0], expected)


@settings(max_examples=40, deadline=None)
@given(
    cuts=st.lists(st.integers(0, 80), max_size=8), missing=st.lists(st.integers(0, 79), max_size=5)
)
def test_leaky_sum_starts_anew_after_what_is_missing(cuts, missing):
    z = rows(80)
    z[missing, 2] = np.nan
    expected, s = [], np.zeros(4)
    for row in z:
        if np.isnan(row).any():
            s = np.zeros(4)
            continue
        s = np.exp(-0.05 / 0.3) * s + row
        expected.append(s)
    leak = LeakySums(0.05, [0.3])
    edges = [0, *sorted(cuts), 80]
    parts = [leak.update(z[None, edges[k] : edges[k + 1]])[0, 0] for k in range(len(edges) - 1)]
    close(np.concatenate(parts), np.reshape(expected, (-1, 4)))
