"""What studies make of a flight, on flights of seconds."""

import numpy as np
import pytest

from benchmarks.accuracy import cases


def test_a_course_counts_wrong_claims_only_while_they_are_claimed():
    t = np.arange(8) * 0.1
    errors, std = np.full((8, 10), 1.0), np.full((8, 10), 1.0)
    identified = np.ones((8, 10), dtype=bool)
    errors[2, 0] = 3.0  # outside, and claimed
    errors[3, 1], identified[3, 1] = 3.0, False  # outside, not claimed
    errors[-1, 2] = -3.0  # outside at the end
    errors[:4, 3] = 9.0  # late, and claimed
    found = cases.followed(t, errors, std, identified)
    assert found["wrong refits"] == [1, 0, 1, 4, *[0] * 6]
    assert found["identified refits"] == [8, 7, *[8] * 8]
    assert found["wrong at end"] == [False, False, True, *[False] * 7]
    assert found["any wrong at any refit"] is True
    assert found["settled"][3] == pytest.approx(0.4)
