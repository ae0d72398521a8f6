"""Sums of products in bounded memory, and leaky sums of rows."""

from copy import deepcopy

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gcs_sysid.arrays import complete_rows, runs
from gcs_sysid.estimation.rows.normal_equations import NormalEquations
from gcs_sysid.estimation.rows.regression import LeakySums


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


@settings(max_examples=40, deadline=None)
@given(cuts=st.lists(st.integers(0, 300), max_size=12))
def test_grouping_of_rows_does_not_matter(cuts):
    z = rows(300)
    whole, parts = (NormalEquations((4, 4), 7, max_batches=16) for _ in range(2))
    whole.add(z)
    edges = [0, *sorted(cuts), 300]
    for k in range(len(edges) - 1):
        parts.add(z[edges[k] : edges[k + 1]])
    np.testing.assert_array_equal(parts.counts, whole.counts)
    close(parts.batches, whole.batches)


def test_leading_shape():
    z = np.random.default_rng(2).normal(size=(3, 50, 2))
    moments = NormalEquations((3, 2, 2), 10)
    moments.add(z)
    close(moments.total, [a.T @ a for a in z])


def test_the_newest_batches_can_be_forgotten():
    z = rows(95)
    moments = NormalEquations((4, 4), 10, max_batches=32)
    moments.add(z)
    moments.drop_last(7)  # the half-full batch of 5 and the whole one before it
    assert moments.rows == 80
    close(moments.total, z[:80].T @ z[:80])
    moments.add(z[80:])
    close(moments.total, z.T @ z)
    moments.drop_last(1000)
    assert moments.rows == 0


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


@pytest.mark.parametrize("begun", [0, 25])
def test_reserved_memory_is_zero_and_what_was_there_stays(begun):
    z = rows(400)
    reserved, plain = (NormalEquations((4, 4), 10, max_batches=6000) for _ in range(2))
    reserved.add(z[:begun])
    reserved.reserve()
    reserved.add(z[begun:])
    plain.add(z)
    np.testing.assert_array_equal(reserved.counts, plain.counts)
    close(reserved.batches, plain.batches)
    assert not reserved._batches[len(reserved.batches) :].any()


def test_a_copy_goes_its_own_way():
    z = rows(75)
    moments = NormalEquations((4, 4), 10, max_batches=16)
    moments.add(z[:35])
    other = deepcopy(moments)
    other.add(z[35:])
    assert (moments.rows, other.rows) == (35, 75)
    close(moments.total, z[:35].T @ z[:35])
    close(other.total, z.T @ z)
    assert moments.counts.tolist() == [10, 10, 10, 5]
    close(other.batches[3], z[30:40].T @ z[30:40])
    close(moments.batches[3], z[30:35].T @ z[30:35])


def test_sums_that_stay_together_fill_batches_as_rows_do():
    z = rows(100)
    moments = NormalEquations((4, 4), 10, max_batches=4)
    # Four rows are no full batch, four and six are, and so are twelve at once.
    for start, end, counts in (
        (0, 4, [4]),
        (4, 10, [10]),
        (10, 22, [10, 12]),
        (22, 32, [10, 12, 10]),
        (32, 42, [10, 12, 10, 10]),
        (42, 61, [22, 20, 19]),  # no room is left: neighbors are merged, batches hold twice as much
        (61, 62, [22, 20, 20]),
        (62, 63, [22, 20, 20, 1]),
    ):
        part = z[start:end]
        moments.add_sum(part.T @ part, end - start)
        assert moments.counts.tolist() == counts
        assert moments.rows == end
        close(moments.total, z[:end].T @ z[:end])
        edges = np.concatenate([[0], np.cumsum(counts)])
        for k, batch in enumerate(moments.batches):
            close(batch, z[edges[k] : edges[k + 1]].T @ z[edges[k] : edges[k + 1]])


def test_some_columns_alone_are_what_their_rows_would_have_given():
    z = np.random.default_rng(4).normal(size=(3, 57, 5))
    moments, expected = NormalEquations((3, 5, 5), 10, 8), NormalEquations((2, 3, 3), 10, 8)
    moments.add(z[:, :35])
    expected.add(z[[0, 2]][:, :35, [4, 0, 1]])
    narrow = moments.narrowed([0, 2], [4, 0, 1])
    for found in (narrow, deepcopy(narrow)):
        assert found.counts.tolist() == [10, 10, 10, 5]
        assert found.rows == 35
        close(found.total, expected.total)
        close(found.batches, expected.batches)
    # What comes next goes to one of them alone.
    narrow.add(z[[0, 2]][:, 35:, [4, 0, 1]])
    expected.add(z[[0, 2]][:, 35:, [4, 0, 1]])
    close(narrow.batches, expected.batches)
    close(narrow.total, expected.total)
    assert moments.counts.tolist() == [10, 10, 10, 5]
    close(moments.total, np.swapaxes(z[:, :35], 1, 2) @ z[:, :35])


def test_leaky_sum_is_the_recursion():
    z = rows(60)
    leak = LeakySums(row_time=0.05, memories=[0.3])
    expected, s = [], np.zeros(4)
    for row in z:
        s = np.exp(-0.05 / 0.3) * s + row
        expected.append(s)
    close(leak.update(z[None])[0, 0], expected)


def test_leaks_of_several_memories_are_those_of_each():
    z = np.random.default_rng(5).normal(size=(2, 70, 4))
    memories = [0.0, 0.3, 1.0]
    together = LeakySums(0.05, memories).update(z)
    for found, memory in zip(together, memories, strict=True):
        close(found, LeakySums(0.05, [memory]).update(z)[0])


def test_leak_without_memory_passes_rows():
    z = rows(20)
    z[3, 1] = np.nan
    leak = LeakySums(0.05, [0.0])
    np.testing.assert_array_equal(leak.update(z[None])[0, 0], np.delete(z, 3, axis=0))


@settings(max_examples=40, deadline=None)
@given(
    cuts=st.lists(st.integers(0, 80), max_size=8),
    missing=st.lists(st.integers(0, 79), max_size=5),
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


def test_restart_of_a_leak():
    leak = LeakySums(0.05, [0.3])
    leak.update(rows(10)[None])
    leak.restart()
    np.testing.assert_array_equal(leak.update(rows(1)[None])[0, 0], rows(1))


def test_runs_and_complete_rows():
    mask = np.array([1, 1, 0, 1, 0, 0], dtype=bool)
    assert runs(mask) == [
        (slice(0, 2), True),
        (slice(2, 3), False),
        (slice(3, 4), True),
        (slice(4, 6), False),
    ]
    assert runs(mask[:0]) == []
    values = np.array([[1.0, 2.0], [np.nan, 1.0], [np.inf, 0.0]])
    assert complete_rows(values).tolist() == [True, False, False]


def test_a_row_that_misses_in_one_hypothesis_is_dropped_from_all():
    z = np.random.default_rng(3).normal(size=(2, 30, 4))
    z[1, 7, 0] = np.nan
    found = LeakySums(0.05, [0.3]).update(z)[0]
    assert found.shape == (2, 29, 4)
    single = z[0].copy()
    single[7] = np.nan
    close(found[0], LeakySums(0.05, [0.3]).update(single[None])[0, 0])
