"""The sequential tests and what normalizes them, number by number."""

from itertools import pairwise

import numpy as np
import pytest

from gcs_sysid.estimation.changes.sequential_tests import Cusum, Level, RecentMean


def column(*values):
    return np.array(values, dtype=float)[:, None]


def test_a_sum_counts_what_is_beyond_the_allowance_up_to_the_clip():
    test = Cusum(1, allowance=4.0, clip=9.0, threshold=11.0)
    # 5, then 5 + 3 = 8, 8 + 5 = 13: beyond 11 at the third.
    assert test.update(column(100.0, 7.0, 9.0), 50) == (2, 0, 50)
    # An alarm leaves the sum as it was before these values.
    assert not test.rising.any()


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_sum_goes_on_from_call_to_call_and_knows_where_it_left_zero(sign):
    test = Cusum(2, 4.0, 9.0, 11.0)
    values = np.zeros((5, 2))
    values[3:, 1] = sign * 9.5
    assert test.update(values, 100) is None
    assert test.rising.tolist() == [False, True]
    # 10 so far; a value of 4 holds it, missing ones are no news, and one more ends it.
    assert test.update(np.array([[0.0, sign * 4.0], [np.nan, np.nan]]), 105) is None
    assert test.update(np.array([[0.0, sign * 5.5]]), 107) == (0, 1, 103)


def test_a_sum_that_falls_to_zero_begins_anew():
    test = Cusum(1, 4.0, 9.0, 11.0)
    assert test.update(column(9.0, -1.0, 9.0, 9.0), 0) is None  # 5, 0, 5, 10
    assert test.update(column(5.0), 4) is None  # 11: at the threshold, not beyond it
    assert test.update(column(4.1), 5) == (0, 0, 2)
    test.clear()
    assert not test.rising.any()
    assert test.update(column(9.0, 9.0, 9.0), 10) == (2, 0, 10)


def test_both_sides_are_summed_apart():
    test = Cusum(1, 4.0, 9.0, 11.0)
    # Up and down in turn: each side falls by more than it gains.
    assert test.update(column(*[9.0, -9.0] * 20), 0) is None


def test_the_earliest_channel_alarms():
    values = np.zeros((6, 3))
    values[2:, 0] = 9.0
    values[1:, 1] = -9.0
    values[1:, 2] = 9.0
    assert Cusum(3, 4.0, 9.0, 11.0).update(values, 0) == (3, 1, 1)


def test_what_is_within_the_allowance_never_rises():
    test = Cusum(1, 4.0, 9.0, 11.0)
    assert test.update(column(*[4.0] * 50), 0) is None
    assert not test.rising.any()


FLOOR = np.full(1, 0.01)


def test_a_level_starts_from_medians_and_moves_by_its_share():
    level = Level(1, least_gain=0.25)
    first = column(1.0, 2.0, 3.0, 4.0, 50.0)
    level.update(first, FLOOR)
    # Median 3, deviations' median 1, times 1.5; then all of the frame counts, up to 6 away.
    d = np.clip(first - 3.0, -6.0, 6.0)
    assert level.frames.tolist() == [1]
    assert level.mean[0] == pytest.approx(3.0 + d.mean())
    assert level.variance[0] == pytest.approx(np.mean(d**2))
    mean, variance = level.mean[0], level.variance[0]
    # The second frame is a half of all, the sixth no less than the least share.
    level.update(column(*[mean + 1.0] * 5), FLOOR)
    assert level.mean[0] == pytest.approx(mean + 0.5)
    assert level.variance[0] == pytest.approx(0.5 * variance + 0.5)
    for _ in range(3):
        level.update(column(*[level.mean[0]] * 5), FLOOR)
    mean = level.mean[0]
    level.update(column(*[mean + 0.1] * 5), FLOOR)
    assert level.frames.tolist() == [6]
    assert level.mean[0] == pytest.approx(mean + 0.25 * 0.1)


def test_a_signal_without_noise_has_the_floor():
    level = Level(1, 0.25)
    level.update(column(*[7.0] * 4), FLOOR)
    assert level.std(FLOOR)[0] == 0.01
    # What is far off counts as four levels of at least the floor.
    level.update(column(*[8.0] * 4), FLOOR)
    assert level.mean[0] == pytest.approx(7.0 + 0.5 * 0.04)


def test_a_channel_with_half_of_a_frame_missing_is_held():
    level = Level(2, 0.25)
    level.update(np.tile([1.0, 2.0], (4, 1)), np.full(2, 0.01))
    before = level.mean.copy()
    frame = np.full((4, 2), 1.02)
    frame[:2, 0] = np.nan  # half of it
    frame[:1, 1] = np.nan
    frame[1:, 1] = 2.02
    level.update(frame, np.full(2, 0.01))
    assert level.mean[0] == before[0]
    # Three of four: the mean of what is there, half of the way in the second frame.
    assert level.mean[1] == pytest.approx(2.01)
    assert level.frames.tolist() == [1, 2]


def test_a_level_that_is_forgotten_starts_from_medians_again():
    level = Level(2, 0.25)
    for value in (1.0, 1.0, 1.0):
        level.update(np.full((4, 2), value), np.full(2, 0.01))
    level.forget(np.array([True, False]))
    level.update(np.full((4, 2), 9.0), np.full(2, 0.01))
    assert level.mean[0] == pytest.approx(9.0)
    assert level.mean[1] == pytest.approx(1.0 + 0.25 * 0.04)


@pytest.mark.parametrize("frames", [1, 2, 3, 4, 5])
def test_a_level_moves_by_sums_as_by_the_frame_itself(frames):
    """Mean and mean square say the same of a frame that nothing is clipped of."""
    rng = np.random.default_rng(3)
    by_frame, by_sums = Level(2, least_gain=0.25), Level(2, least_gain=0.25)
    for level in (by_frame, by_sums):
        for seed in range(frames):
            first = np.random.default_rng(seed).normal([5.0, -2.0], [1.0, 0.1], size=(50, 2))
            level.update(first, np.full(2, 0.01))
    for _ in range(4):
        frame = rng.uniform([4.0, -2.1], [6.5, -1.8], size=(50, 2))
        by_frame.update(frame, np.full(2, 0.01))
        by_sums.move(frame.mean(axis=0), (frame**2).mean(axis=0))
        np.testing.assert_allclose(by_sums.mean, by_frame.mean, rtol=1e-12)
        np.testing.assert_allclose(by_sums.variance, by_frame.variance, rtol=1e-9)
        assert by_sums.frames.tolist() == by_frame.frames.tolist()


LOW, HIGH = np.full(1, -10.0), np.full(1, 10.0)


def test_a_baseline_is_the_mean_until_just_before():
    keep = np.exp(-1.0 / 5.0)
    values = column(1.0, 4.0, -2.0, 100.0, 3.0)
    mean, expected = 1.0, []
    for value in np.clip(values[:, 0], -10.0, 10.0):
        expected.append(mean)
        mean = keep * mean + (1.0 - keep) * value
    whole = RecentMean(1, 5.0)
    np.testing.assert_allclose(whole.update(values, LOW, HIGH)[:, 0], expected)
    assert whole.last[0] == pytest.approx(mean)
    # Grouped otherwise, and with what is missing passed over.
    parts = RecentMean(1, 5.0)
    holed = np.insert(values, 2, np.nan, axis=0)
    found = [parts.update(part, LOW, HIGH) for part in (holed[:1], holed[1:4], holed[4:])]
    found = np.concatenate(found)[:, 0]
    assert np.isnan(found[2])
    np.testing.assert_allclose(np.delete(found, 2), expected)
    assert parts.last[0] == pytest.approx(mean)
    whole.update(values, LOW, HIGH)
    parts.update(values, LOW, HIGH)
    assert parts.last[0] == pytest.approx(whole.last[0])


def test_a_channel_of_a_baseline_that_is_silent_stays_unknown():
    baseline = RecentMean(2, 5.0)
    values = np.column_stack([np.ones(3), np.full(3, np.nan)])
    found = baseline.update(values, np.full(2, -10.0), np.full(2, 10.0))
    np.testing.assert_allclose(found[:, 0], 1.0)
    assert np.isnan(found[:, 1]).all()
    assert np.isnan(baseline.last[1])


def test_a_baseline_looks_ahead_without_taking_what_it_sees():
    values = np.random.default_rng(2).normal(size=(6, 2))
    seen, taken = RecentMean(2, 5.0), RecentMean(2, 5.0)
    for baseline in (seen, taken):
        baseline.update(np.array([[3.0, -1.0], [2.0, 0.5]]), np.full(2, -10.0), np.full(2, 10.0))
    last = seen.last.copy()
    ahead = seen.ahead(values)
    np.testing.assert_array_equal(seen.last, last)
    np.testing.assert_allclose(
        ahead[:-1], taken.update(values, np.full(2, -10.0), np.full(2, 10.0)), rtol=1e-12
    )
    np.testing.assert_allclose(ahead[-1], taken.last, rtol=1e-12)


def test_lengths_of_blocks_do_not_matter_to_a_baseline():
    values = np.random.default_rng(7).normal(size=(21, 1))
    whole, parts = RecentMean(1, 5.0), RecentMean(1, 5.0)
    expected = whole.update(values, LOW, HIGH)
    edges = np.cumsum([0, 1, 5, 4, 4, 5, 2])
    found = [parts.update(values[a:b], LOW, HIGH) for a, b in pairwise(edges)]
    np.testing.assert_allclose(np.concatenate(found), expected, rtol=1e-12)
