"""What studies make of a flight, on flights of seconds."""

import numpy as np
import pytest

from benchmarks.accuracy import cases
from testbed.article_flights import fly, measure
from testbed.study import Kept


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


def test_only_what_this_version_kept_is_read(tmp_path):
    for name, version in (("mems 1", 2), ("white", 1)):
        Kept(tmp_path, version).write(name, {"outcomes": [version]})
    now = Kept(tmp_path, 2)
    assert list(now.all()) == ["mems 1"]
    assert now.read("mems 1")["outcomes"] == [2]
    assert now.read("white") is now.read("nothing") is None


def test_rounding_differs_from_seed_to_seed():
    flight = fly("all-axes", 100, 2.0)
    first, second = (measure(flight, "none", 0.0, seed).speeds for seed in (1, 2))
    assert np.abs(first - second).max() > 0.01
    assert np.abs(first - flight.speeds[0]).max() <= 0.5 * 2.0 * np.pi / 60.0 + 1e-9
