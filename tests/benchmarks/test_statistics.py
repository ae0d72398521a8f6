import numpy as np
import pytest

from benchmarks.accuracy import statistics


def test_summary_is_median_of_the_mean_and_95th_percentile_of_the_largest():
    errors = np.zeros((101, 10))
    errors[:, 0] = -np.arange(101.0)
    assert statistics.summary(errors) == pytest.approx((5.0, 95.0))


def test_intervals_hold_as_often_as_normal_ones_should():
    errors = np.random.default_rng(1).standard_normal((20000, 10))
    assert statistics.held(errors, np.ones((20000, 10))) == pytest.approx(95.0, abs=0.7)


def test_the_bound_is_what_normal_errors_come_to():
    std = np.array([1.0, 2.0, 3.0, 1.0, 1.0, 1.0, 1.0, 1.0, np.nan, 1.0])
    errors = np.random.default_rng(2).standard_normal((20000, 10)) * np.nan_to_num(std)
    mean, largest = statistics.least(std)
    assert np.abs(errors).mean() == pytest.approx(mean, rel=0.01)
    assert np.percentile(np.abs(errors[:, 2]), 95) == pytest.approx(largest, rel=0.02)
    assert largest <= statistics.summary(errors)[1]


def test_settled_is_from_when_the_error_stays_small():
    t = np.array([-1.0, 1.0, 2.0, 3.0])
    errors = np.array([[9.0, 2.0, 9.0, 2.0], [1.0, 1.0, 1.0, 1.0], [np.nan, 1.0, 1.0, 9.0]])
    found = statistics.settled(t, errors[:, :, None])
    assert found[:, 0].tolist() == [3.0, 0.0, np.inf]
