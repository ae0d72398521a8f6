"""What the pilot reads."""

import math
from dataclasses import replace
from typing import Any

import pytest

from gcs_sysid.coach.choice import Choice, excess, is_enough, shares
from gcs_sysid.coach.manoeuvre_library import Manoeuvre, damped_words, sentence
from gcs_sysid.judgement.status import NOTHING
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import CORE_OF
from gcs_sysid.model.rotor_input import RotorInput

D20, D45 = math.radians(20.0), math.radians(45.0)


@pytest.mark.parametrize(
    ("manoeuvre", "words"),
    [
        (
            Manoeuvre("roll and yaw", roll=D20, yaw=D20),
            "roll and yaw together, ±20°, about 1 Hz, 10 s",
        ),
        (
            Manoeuvre("pitch and slow yaw", pitch=D20, yaw=D45, yaw_pace=0.5),
            "pitch and yaw together: pitch ±20°, about 1 Hz, yaw ±45°, half as fast, 10 s",
        ),
        (Manoeuvre("yaw", yaw=D45, seconds=6.0), "yaw to and fro, ±45°, about 1 Hz, 6 s"),
        (
            Manoeuvre("roll and pitch", roll=D20, pitch=D20, pace=0.7),
            "circle the stick: roll and pitch, ±20°, about 0.7 Hz, 10 s",
        ),
        (Manoeuvre("climb", climb=1.0, pace=0.5), "up and down, ±1 m, about 0.5 Hz, 10 s"),
    ],
)
def test_motion(manoeuvre, words):
    assert sentence(manoeuvre, [], {}, {}) == words


def test_gains_name_the_widest_first():
    text = sentence(
        Manoeuvre("roll and yaw", roll=D20, yaw=D20),
        ["k_M", "Izz", "Ixx", "Iyy"],
        {"k_M": None, "Izz": 0.12, "Ixx": 0.041, "Iyy": 0.04},
        {"k_M": 0.034, "Izz": 0.03, "Ixx": 0.0051, "Iyy": 0.01},
    )
    assert text == (
        "roll and yaw together, ±20°, about 1 Hz, 10 s: k_M to about 3.4 %, "
        "Izz from 12 % to about 3.0 %, Ixx from 4.1 % to about 0.5 %"
    )


def values(**changed):
    usual = dict.fromkeys(CORE_OF["speed"], Estimate(1.0, 0.01, status="identified"))
    return usual | {"mass": Estimate(1.0, 0.0, status="given")} | changed


def test_what_is_given_does_not_count():
    assert "mass" not in shares(values(), 1.0, RotorInput.SPEED)
    assert shares(values(k_M=NOTHING), 1.0, RotorInput.SPEED)["k_M"] is None


def test_what_may_be_zero_is_measured_against_what_it_matters_to():
    numbers = {"Ixx": 4.0, "Ixy": 0.0, "cg_x": 0.0, "cg_y": -2.0}
    known = {name: Estimate(value, 0.01, status="identified") for name, value in numbers.items()}
    found = shares(values(**known), 0.5, RotorInput.SPEED)
    assert found["Ixy"] == pytest.approx(0.0196 / (0.05 * 2.0), rel=1e-3)
    assert found["cg_x"] == pytest.approx(0.0196 / (0.05 * 0.5), rel=1e-3)
    assert found["cg_y"] == pytest.approx(0.0098, rel=1e-3)


def test_enough_is_when_every_interval_is():
    assert is_enough({"a": 0.02, "b": 0.01}, 0.02)
    assert not is_enough({"a": 0.02, "b": 0.021}, 0.02)
    assert not is_enough({"a": 0.02, "b": None}, 0.02)
    assert not is_enough({}, 0.02)
    assert excess({"a": 0.02, "b": 0.01}, 0.02) == 0.0
    assert excess({"a": None}, 0.02) > excess({"a": 0.5}, 0.02) > 0.0


def test_a_damped_swing_is_reported_with_its_size_and_pace():
    asked = Manoeuvre("roll", roll=math.radians(22.0), pace=0.5)
    assert damped_words(asked, 12.0 / 22.0) == "swing too small (±12° of ±22° at 0.5 Hz)"


def test_only_what_misses_the_target_is_named():
    now = {"Ixy": 0.027, "Ixz": 0.017, "Izz": None, "k_M": 0.015}
    expected = {"Ixy": 0.024, "Ixz": 0.015, "Izz": 0.05, "k_M": 0.010}
    motion: Any = None  # of no concern here
    choice = Choice(Manoeuvre("yaw", yaw=D45), motion, now, expected, motion)
    assert choice.names == ["Izz", "Ixy", "Ixz", "k_M"]
    assert choice.names_above(0.02) == ["Izz", "Ixy"]
    there = replace(choice, now=now | {"Ixy": 0.019, "Izz": 0.01})
    assert there.names_above(0.02) == there.names == ["Ixz", "k_M"]
