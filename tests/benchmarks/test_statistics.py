import numpy as np
import pytest

from benchmarks.accuracy import statistics


def test_intervals_hold_as_often_as_normal_ones_should():
    errors = np.random.default_rng(1).standard_normal((20000, 10))
    assert statistics.held(errors, np.ones((20000, 10))) == pytest.approx(95.0, abs=0.7)


def test_the_bound_is_the_least_that_normal_errors_come_to():
    std = np.array([1.0, 1.1, 1.2, 1.0, 1.0, 1.0, 1.0, 1.0, np.nan, 1.0])
    mean, largest = statistics.least(std)
    random = np.random.default_rng(2)
    together = random.standard_normal((20000, 1)) * np.nan_to_num(std)
    assert statistics.summary(together) == pytest.approx((mean, largest), rel=0.02)
    apart = random.standard_normal((20000, 10)) * np.nan_to_num(std)
    assert statistics.summary(apart)[0] > 1.05 * mean
    assert statistics.summary(apart)[1] > 1.05 * largest


def test_settled_is_from_when_the_error_stays_small():
    t = np.array([-1.0, 1.0, 2.0, 3.0])
    errors = np.array([[9.0, 2.0, 9.0, 2.0], [1.0, 1.0, 1.0, 1.0], [np.nan, 1.0, 1.0, 9.0]])
    found = statistics.settled(t, errors[:, :, None])
    assert found[:, 0].tolist() == [3.0, 0.0, np.inf]
