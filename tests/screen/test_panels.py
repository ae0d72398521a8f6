import math
from dataclasses import replace

import numpy as np
import pytest

from gcs_sysid.results.history import History, known_history, settled_range
from gcs_sysid.results.snapshot import Gain
from gcs_sysid.screen import formatting
from gcs_sysid.screen.bars import advice_lines, verdict_lines
from gcs_sysid.screen.formatting import HEIGHT
from gcs_sysid.screen.main_view import blocks
from gcs_sysid.screen.panels import facts, health_lines, horizon, message_line
from gcs_sysid.screen.plots import overlay, reduced_history, shade, strip, ticks_of
from gcs_sysid.screen.snapshot_view import (
    MessageRate,
    gain_text,
    headline,
    level_of,
    named,
    standing_of,
)
from gcs_sysid.screen.view import View

from . import fake


def history(value, std=0.1):
    n = len(value)
    return History(
        t=np.linspace(0.0, 10.0, n),
        value={"m": np.asarray(value, float)},
        std={"m": np.full(n, std)},
    )


def test_decimation_keeps_a_single_spike():
    value = np.ones(5000)
    value[1234] = 7.0
    value[4321] = -3.0
    curve = reduced_history(history(value), "m", 70)
    assert curve.t.size == 70
    assert curve.high.max() == 7.0
    assert curve.low.min() == -3.0


def test_gaps_and_unknown_values_are_left_out():
    value = np.ones(100)
    value[:50] = np.nan
    curve = reduced_history(history(value, std=math.inf), "m", 20)
    assert curve.t[0] >= 5.0
    assert np.isnan(curve.band_low).all()
    assert not shade(curve, (0.0, 10.0), (0.0, 2.0), (20, 10)).any()


def range_of(values, std, *also):
    t, value, half = known_history(history(values, std=std), "m")
    return settled_range(t, (value, value), (value - half, value + half), also)


def test_range_follows_the_later_half_and_the_truth():
    value = np.concatenate([np.linspace(100.0, 1.0, 500), np.full(600, 1.0)])
    low, high = range_of(value, 0.01, 1.5)
    assert 0.5 < low < 1.0
    assert 1.5 < high < 2.0


def dots(lines):
    """(rows, columns) of the dots of lines of braille."""
    order = ((0, 3), (1, 4), (2, 5), (6, 7))
    out = np.zeros((4 * len(lines), 2 * len(lines[0])), dtype=bool)
    for i, line in enumerate(lines):
        for j, char in enumerate(line):
            cell = 0 if char == " " else ord(char) - 0x2800
            for r, bits in enumerate(order):
                for c, bit in enumerate(bits):
                    out[4 * i + r, 2 * j + c] = cell >> bit & 1
    return out


def test_a_line_is_joined_from_edge_to_edge():
    x = np.arange(40)
    line = np.linspace(-1.0, 1.0, 40)
    drawn = dots(formatting.curve(x, line, line, (-1.0, 1.0), (20, 5), 2))
    assert drawn[-1, 0]
    assert drawn[0, -1]
    assert drawn.any(axis=0).all()
    steep = np.where(x < 20, -1.0, 1.0)
    drawn = dots(formatting.curve(x, steep, steep, (-1.0, 1.0), (20, 5), 2))
    assert drawn[:, 19:21].any(axis=1).all()  # from bottom to top without a hole
    assert drawn[:, :19].sum() == drawn[:, :19].any(axis=0).sum()


def test_what_lies_outside_is_not_drawn():
    x, far = np.arange(40), np.full(40, 1e9)
    assert not dots(formatting.curve(x, far, far, (-1.0, 1.0), (20, 5), 2)).any()
    jump = np.where(x < 20, 1e9, 0.0)
    drawn = dots(formatting.curve(x, jump, jump, (-1.0, 1.0), (20, 5), 2))
    assert not drawn[:, :19].any()
    assert drawn[:, 21:].any(axis=0).all()


def test_a_long_gap_is_not_drawn_over():
    x = np.array([0, 1, 2, 30, 31])
    drawn = dots(formatting.curve(x, np.zeros(5), np.zeros(5), (-1.0, 1.0), (20, 2), 3))
    assert np.flatnonzero(drawn.any(axis=0)).tolist() == x.tolist()


def test_measured_and_predicted_lie_where_they_belong():
    t = np.linspace(0.0, 10.0, 400)
    curve = strip(t, np.sin(t), 0.0, 10.0, 1.0, (60, 4))
    assert {len(line) for line in curve} == {60}
    drawn = overlay(curve, t, np.full(400, -1.0), 0.0, 10.0, 1.0)
    assert {len(line) for line in drawn} == {60}
    assert [line.count("•") for line in drawn] == [0, 0, 0, 30]


def test_standing_counts_what_a_complete_identification_consists_of():
    standing = standing_of(fake.snapshot())
    assert [name for name, _ in standing.weak] == ["Iyz", "Izz"]
    assert [name for name, _ in standing.missing] == ["k_M"]
    assert standing.total == 10  # neither the mass, which is given, nor damping and the like
    assert standing.known[0][0] == "Ixz"
    assert standing.reached == 5
    wide = standing_of(replace(fake.snapshot(), target=0.5))
    assert wide.reached == len(wide.known)


@pytest.mark.parametrize("width", [60, 80, 118, 160])
@pytest.mark.parametrize("large", [False, True])
def test_a_wrong_airframe_is_the_headline_before_take_off(width, large):
    why = "wrong airframe mine: motor order: motor 1 is rear left, on the vehicle front right"
    result = replace(fake.result(), verdict="refused", reasons=(why, "too little flight"))
    snapshot = replace(fake.snapshot(), result=result, used_seconds=0.0, flying=False)
    snapshot = replace(snapshot, advice=None)
    assert headline(snapshot) == "WRONG AIRFRAME"
    assert level_of(snapshot) == "refused"
    lines = [
        "".join(text for text, _ in line) for line in verdict_lines(snapshot, width, large=large)
    ]
    assert max(map(len, lines)) <= width
    assert "motor order" in " ".join(lines)
    assert len(lines) == (HEIGHT if large and width > 60 else 1)
    texts = [text for options, _ in blocks(View(snapshot, {}, "Ixx", {}))[0] for text in options]
    assert "WRONG AIRFRAME" in texts
    assert "ON GROUND" not in texts


def test_names_that_do_not_fit_are_counted():
    group = (("Iyz", 0.104), ("Izz", 0.0786), ("damping", None))
    assert named(group, 80) == "Iyz ±10 %, Izz ±7.9 %, damping"
    assert named(group, 20) == "Iyz ±10 %, +2"
    assert named(group, 2) == "3"
    assert named((), 20) == "nothing"


def written(advice, width=78):
    return ["".join(text for text, _ in line) for line in advice_lines(advice, width)]


def test_the_coach_says_what_to_fly_how_far_it_is_and_what_it_brings():
    first, second = written(fake.advice())
    assert first == "▶ FLY  roll and yaw together, ±20°, about 1 Hz, 10 s"
    assert second.startswith("████████  ")
    assert "40 %  6 s left   k_M ? → 5.0 %   Iyz 10 % → 4.0 %" in second
    assert len(second) <= 78
    assert "Izz 7.9 % → 3.0 %" in written(fake.advice(), 118)[1]


def test_a_gain_that_is_reached_is_ticked():
    assert gain_text(Gain("Izz", 0.12, 0.03)) == "Izz 12 % → 3.0 %"
    assert gain_text(Gain("Izz", 0.03, 0.03)) == "Izz 3.0 % ✓"
    assert gain_text(Gain("Izz", 0.015, 0.016)) == "Izz 1.5 % ✓"


@pytest.mark.parametrize(
    ("low", "high", "wanted", "written"),
    [
        (16.32, 16.78, 4, ["16.4", "16.6"]),
        (0.0, 42.0, 5, ["0", "10", "20", "30", "40"]),
        (-0.011, 0.011, 3, ["-0.01", "0.00", "0.01"]),
        (16.31, 16.69, 2, ["16.4", "16.6"]),  # steps of .2 and .5: one would be no scale
        (16.41, 16.59, 1, ["16.45", "16.50", "16.55"]),
    ],
)
def test_ticks_are_round(low, high, wanted, written):
    ticks, labels = ticks_of(low, high, wanted)
    assert labels == written
    assert ticks == pytest.approx([float(label) for label in labels])


def ground(lines):
    return sum(line.count("█") + line.count("▄") / 2 + line.count("▀") / 2 for line in lines)


def test_horizon_sinks_when_the_nose_rises():
    assert ground(horizon(0.0, 0.3, 7)) < ground(horizon(0.0, 0.0, 7))
    assert ground(horizon(0.0, -0.3, 7)) > ground(horizon(0.0, 0.0, 7))


def test_a_slow_message_is_marked_by_a_sign():
    def write(got):
        return "".join(text for text, _ in message_line(MessageRate("HIGHRES_IMU", got, 250.0), 36))

    assert write(249.0).endswith("✓")
    assert write(120.0).endswith("!")
    assert len(write(249.0)) == 36


def test_a_drift_that_no_clock_has_is_unknown():
    """A computer that falls behind makes the vehicle's clock seem slow."""
    link = fake.snapshot().link
    shown = {
        drift: {name: text for name, text, _ in facts(replace(link, clock_ppm=drift))}["clock"]
        for drift in (200.0, -425_834.0, None)
    }
    assert shown == {200.0: "+200 ppm", -425_834.0: "unknown", None: "unknown"}


def test_health_before_any_hover_asks_for_a_hover():
    assert health_lines(None, 80)[0][0][0] == "No hover yet: hover for 10 s."
