"""Airframe files that are written: they load, and say what was told."""

import dataclasses

import pytest

from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import Airframe, Rotor
from gcs_sysid.setup_help.airframe_file import (
    airframe_text,
    check_airframe,
    checked,
    layout_rotors,
    reversed_spins,
)
from gcs_sysid.setup_help.checks import Sign

QUAD = layout_rotors("px4-quad-x", 0.25)


@pytest.mark.parametrize("anchor", ["mass", "k_T", "T_max"])
def test_all_that_can_be_told_is_read_back(anchor):
    answers = Airframe(
        'the "big" \\ one ü',
        QUAD,
        **{anchor: 1.0 / 3.0},
        imu_position=(0.02, -0.01, -0.03),
        priors={"k_M": (6.1e-6, 1e-7), "cg_x": (-0.01, 0.002)},
    )
    airframe = checked(airframe_text(answers), "text")
    assert airframe.name == answers.name
    assert airframe.anchor() == (anchor, 1.0 / 3.0)
    assert airframe.imu_position == answers.imu_position
    assert airframe.priors == answers.priors
    assert airframe.rotor_input == "auto"


def test_rotors_that_cannot_control_a_vehicle_are_refused():
    same = tuple(Rotor(r.x, r.y, 1) for r in QUAD)
    with pytest.raises(InputError, match="roll, pitch, yaw and thrust independently"):
        checked(airframe_text(Airframe("x", same)), "these")


def findings_of(rotors, scale=("mass", 1.5), rotor_input="auto"):
    given = {} if scale is None else dict([scale])
    text = airframe_text(Airframe("x", rotors, rotor_input=rotor_input, **given))
    return {finding.topic: finding for finding in check_airframe(checked(text, "x"))}


def test_slips_are_noticed():
    good = findings_of(QUAD)
    assert {finding.sign for finding in good.values()} == {Sign.OK}
    assert "px4-quad-x and ardupilot-quad-x" in good["motor order"].text

    order = findings_of((QUAD[2], *QUAD[:2], QUAD[3]))["motor order"]
    assert order.sign is Sign.WARNING
    assert "numbered differently" in order.text

    turned = findings_of(reversed_spins(QUAD))["motor order"]
    assert turned.sign is Sign.WARNING
    assert "every spin the other way" in turned.text

    hexa = list(layout_rotors("px4-hexa-x", 0.3))
    hexa[4] = dataclasses.replace(hexa[4], spin=-hexa[4].spin)
    one = findings_of(tuple(hexa))
    assert "spin of motor 5 differs" in one["motor order"].text
    assert "2 ccw and 4 cw" in one["symmetry"].text

    moved = findings_of(tuple(Rotor(r.x + 0.1, r.y, r.spin) for r in QUAD))["symmetry"]
    assert moved.sign is Sign.WARNING
    assert "(0.1, 0) m" in moved.text

    assert findings_of(layout_rotors("px4-quad-x", 25.0))["size"].sign is Sign.WARNING
    assert findings_of(QUAD, None)["scale"].sign is Sign.WARNING
    assert "not grams" in findings_of(QUAD, ("mass", 1500.0))["scale"].text
    assert findings_of(QUAD, ("T_max", 5.0), "speed")["scale"].sign is Sign.PROBLEM
