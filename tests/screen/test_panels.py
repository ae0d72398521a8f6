import math

import numpy as np
import pytest

from gcs_sysid.screen.widgets.attitude import HORIZON_WIDTH, WINGS, deflection, horizon
from gcs_sysid.screen.widgets.convergence import (
    band_points,
    nice_ticks,
    reduce_course,
    value_range,
)
from gcs_sysid.screen.widgets.link import message_line
from gcs_sysid.session.snapshot import Course


def course(value, std=0.1):
    n = len(value)
    return Course(
        t=np.linspace(0.0, 10.0, n),
        value={"m": np.asarray(value, float)},
        std={"m": np.full(n, std)},
    )


def test_decimation_keeps_a_single_spike():
    value = np.ones(5000)
    value[1234] = 7.0
    value[4321] = -3.0
    curve = reduce_course(course(value), "m", 70)
    assert curve.t.size == 70
    assert curve.high.max() == 7.0
    assert curve.low.min() == -3.0


def test_decimation_spans_the_course():
    curve = reduce_course(course(np.arange(1000.0)), "m", 40)
    assert curve.t[0] == 0.0
    assert curve.t[-1] == pytest.approx(10.0)
    assert curve.low[0] == 0.0
    assert curve.high[-1] == 999.0


def test_decimation_scales_value_and_band():
    curve = reduce_course(course(np.full(10, 2.0), std=0.5), "m", 5, scale=1000.0)
    assert curve.high.max() == pytest.approx(2000.0)
    assert curve.band_high.max() == pytest.approx(2000.0 + 1.96 * 500.0, rel=1e-4)


def test_gaps_and_unknown_values_are_left_out():
    value = np.ones(100)
    value[:50] = np.nan
    curve = reduce_course(course(value, std=math.inf), "m", 20)
    assert curve.t[0] >= 5.0
    assert np.isnan(curve.band_low).all()
    assert band_points(curve, 0.0, 2.0, 10) == ([], [])


@pytest.mark.parametrize("value", [[], [np.nan, np.nan]])
def test_no_values_no_curve(value):
    assert reduce_course(course(value), "m", 20) is None


def test_an_unknown_name_has_no_curve():
    assert reduce_course(course([1.0]), "Ixx", 20) is None


def test_range_follows_the_later_half_and_the_truth():
    value = np.concatenate([np.linspace(100.0, 1.0, 500), np.full(600, 1.0)])
    low, high = value_range(reduce_course(course(value, std=0.01), "m", 60), truth=1.5)
    assert 0.5 < low < 1.0
    assert 1.5 < high < 2.0


def test_range_of_a_constant_is_not_empty():
    low, high = value_range(reduce_course(course([0.0, 0.0], std=0.0), "m", 60), None)
    assert low < 0.0 < high


def test_a_vast_band_does_not_hide_the_value():
    low, high = value_range(reduce_course(course([1.0, 1.1], std=1e9), "m", 60), None)
    assert high - low < 20.0


def test_the_band_covers_its_cells_and_no_others():
    curve = reduce_course(course(np.full(10, 5.0), std=1.0 / 1.96), "m", 3)
    x, y = band_points(curve, 0.0, 10.0, 11)
    assert sorted(set(x)) == pytest.approx([0.0, 5.0, 10.0])
    assert sorted(set(y)) == pytest.approx([4.0, 5.0, 6.0])


@pytest.mark.parametrize(
    ("low", "high", "wanted", "written"),
    [
        (16.32, 16.78, 4, ["16.4", "16.6"]),
        (0.0, 42.0, 5, ["0", "10", "20", "30", "40"]),
        (-0.011, 0.011, 3, ["-0.01", "0.00", "0.01"]),
    ],
)
def test_ticks_are_round(low, high, wanted, written):
    ticks, labels = nice_ticks(low, high, wanted)
    assert labels == written
    assert ticks == pytest.approx([float(label) for label in labels])


def ground(lines):
    return sum(line.count("█") + line.count("▄") / 2 + line.count("▀") / 2 for line in lines)


def test_horizon_level_is_half_ground():
    lines = horizon(0.0, 0.0, 7)
    assert {len(line) for line in lines} == {HORIZON_WIDTH}
    assert lines[3].count(WINGS) == 1
    assert lines[0].strip() == ""
    assert set(lines[-1]) == {"█"}


def test_horizon_sinks_when_the_nose_rises():
    assert ground(horizon(0.0, 0.3, 7)) < ground(horizon(0.0, 0.0, 7))
    assert ground(horizon(0.0, -0.3, 7)) > ground(horizon(0.0, 0.0, 7))


def test_ground_rises_on_the_side_of_the_low_wing():
    right_down = horizon(math.radians(30.0), 0.0, 7)
    assert right_down[1][-1] == "█"
    assert right_down[1][0] == " "


def test_horizon_upside_down():
    assert set(horizon(math.pi, 0.0, 7)[0]) == {"█"}


def test_deflection_shows_the_side():
    assert deflection(45.0, 45.0, 10) == "     │━━━━━"
    assert deflection(-18.0, 45.0, 10) == "   ━━│     "
    assert deflection(900.0, 45.0, 10) == "     │━━━━━"


def test_a_slow_message_is_marked_by_a_sign():
    def write(got):
        return "".join(text for text, _ in message_line("HIGHRES_IMU", got, 250.0, 36))

    assert write(249.0).endswith("✓")
    assert write(120.0).endswith("!")
    assert len(write(249.0)) == 36


def test_a_long_message_name_is_cut():
    line = "".join(text for text, _ in message_line("X" * 40, 1.0, None, 36))
    assert len(line) == 34  # two columns less: nothing was asked, so there is no sign
    assert "…" in line
