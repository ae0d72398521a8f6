"""The sequential tests and what normalizes them, number by number."""

import numpy as np
import pytest

from gcs_sysid.estimation.changes.sequential_tests import Cusum, Level


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
