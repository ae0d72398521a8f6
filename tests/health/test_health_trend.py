"""Several flights side by side: slopes, units and what is surely a trend."""

import math

import numpy as np
import pytest

from gcs_sysid.health.balance import Center
from gcs_sysid.health.health_trend import Series, series_of, trend_text
from gcs_sysid.health.hover_tuning import TUNING
from gcs_sysid.health.vehicle_health import Health
from gcs_sysid.model.estimate import Estimate


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


def test_one_flight_has_no_trend():
    assert trend_text([Health("a.tlog"), Health("b.tlog")]) == []


def test_flights_in_different_winds_show_one_cg():
    lever, still = np.array([0.05, 0.06]), np.array([0.004, -0.002])
    flights = [
        in_wind(still + lever * force, force, lever * (1.0 + error), std)
        for force, error, std in (
            (np.array([-0.2, 0.1]), 0.02, 0.002),
            (np.array([-0.5, 0.3]), -0.02, 0.002),
            (np.array([0.1, 0.0]), 1.5, 0.5),  # hardly shows the lever
        )
    ]
    forward, right = series_of(flights)[:2]
    assert np.ptp(forward.values) < 0.5
    assert np.ptp(right.values) < 0.5
    mean = np.array([-0.2, 0.4 / 3.0])
    assert forward.values[0] == pytest.approx(4.0 + 50.0 * mean[0], abs=0.5)
    # What the accelerometer's bias may do from flight to flight stays in.
    assert forward.stds == pytest.approx(
        [0.05e3 * TUNING.accelerometer_std / 2.0**0.5] * 3, rel=0.1
    )


def in_wind(cg, force, lever, lever_std):
    """A flight whose wind moved its center of thrust, as health tells it."""
    scatter = np.full(2, 1e-4)
    center = Center(
        cg, np.diag(scatter**2), np.zeros(2), lever * force, cg, scatter, lever,
        np.full(2, lever_std), force, 0.0,
    )  # fmt: skip
    places = [Estimate(float(v), float(np.hypot(1e-4, 0.005)), "m", std_given=0.005) for v in cg]
    return Health("flight", cg=tuple(places), center=center)
