"""One test of a change: whatever is tested together, one false alarm in a hundred."""

import numpy as np
import pytest

from gcs_sysid.significance import (
    FALSE_ALARM_RATE,
    chance,
    holm,
    joint_chance,
    normal_limit,
    student_chance,
    student_limit,
)


def test_one_difference_is_as_likely_alone_as_with_none_beside():
    for difference in (0.3, -2.0, 4.0):
        alone = chance(difference, 0.7)
        assert joint_chance(np.array([difference]), np.array([[0.49]])) == pytest.approx(alone)
        assert holm([alone]) == [alone]
        assert student_chance(difference / 0.7, 1e9) == pytest.approx(alone, rel=1e-6)


def test_limits_are_exceeded_at_the_rate():
    assert chance(normal_limit(), 1.0) == pytest.approx(FALSE_ALARM_RATE)
    assert student_chance(student_limit(3.0), 3.0) == pytest.approx(FALSE_ALARM_RATE)


@pytest.mark.parametrize("common", [0.0, 0.9])
def test_an_unchanged_vehicle_is_called_changed_once_in_a_hundred_times(common):
    n, draws = 12, 20_000
    covariance = np.full((n, n), common) + (1.0 - common) * np.eye(n)
    off = np.random.default_rng(1).standard_normal((draws, n)) @ np.linalg.cholesky(covariance).T
    by_holm = np.mean([min(holm([chance(x, 1.0) for x in row])) < 0.01 for row in off[:4000]])
    together = np.mean([joint_chance(row, covariance) < FALSE_ALARM_RATE for row in off[:4000]])
    assert by_holm < 1.6 * FALSE_ALARM_RATE
    assert 0.4 * FALSE_ALARM_RATE < together < 1.6 * FALSE_ALARM_RATE
