"""Several flights side by side: slopes, units and what is surely a trend."""

import math

import numpy as np
import pytest

from gcs_sysid.health.health_trend import Series, trend_text
from gcs_sysid.health.vehicle_health import Health


def test_slope_of_a_straight_line_and_of_scatter():
    line = Series("CG forward", "mm", (1.0, 3.0, math.nan, 7.0), (0.1, 0.1, math.nan, 0.1))
    slope, std = line.slope()
    assert slope == pytest.approx(2.0)
    # Weighted least squares over flights 0, 1 and 3: 1 / sqrt(sum of squares about their mean).
    assert std == pytest.approx(0.1 / math.sqrt(14.0 / 3.0))
    with pytest.raises(ValueError, match="2 flights"):
        Series("", "", (1.0, 2.0), (0.1, 0.1)).slope()


def test_flights_that_scatter_more_than_each_shows_make_no_trend():
    random = np.random.default_rng(1)
    found = 0
    for _ in range(300):
        values = tuple(random.standard_normal(6).tolist())
        slope, std = Series("", "", values, (0.01,) * 6).slope()
        found += abs(slope) > 3.0 * std
    # With the flights' own deviations every one of these would be called a trend.
    assert found < 0.08 * 300


def test_small_numbers_get_a_power_of_ten():
    series = Series("k_T", "N s^2", (4.6e-6, 4.7e-6), (1e-8, 1e-8)).in_power()
    assert series.values == pytest.approx((4.6, 4.7))
    assert series.stds == pytest.approx((0.01, 0.01))
    assert series.unit == "10⁻⁶ N s^2"
    assert Series("CG", "mm", (12.0, 3.0), (1.0, 1.0)).in_power().unit == "mm"


def test_one_flight_has_no_trend():
    assert trend_text([Health("a.tlog"), Health("b.tlog")]) == []
