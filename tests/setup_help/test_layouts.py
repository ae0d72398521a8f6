"""Motor numbers and spins against those of PX4 and ArduPilot, and what a slip looks like."""

import math

import pytest

from gcs_sysid.model.airframe import Rotor
from gcs_sysid.session.reported_layout import place_words
from gcs_sysid.setup_help.airframe_file import (
    LAYOUTS,
    layout_rotors,
    reversed_spins,
    same_order,
    same_places,
)

# Degrees clockwise from the front and spin, by motor number. ArduPilot: AP_MotorsMatrix.cpp;
# PX4: the geometries of its generic airframes 4001 to 9001. They agree on all of these.
KNOWN = {
    "quad-x": [(45, "ccw"), (-135, "ccw"), (-45, "cw"), (135, "cw")],
    "quad-plus": [(90, "ccw"), (-90, "ccw"), (0, "cw"), (180, "cw")],
    "hexa-x": [(90, "cw"), (-90, "ccw"), (-30, "cw"), (150, "ccw"), (30, "ccw"), (-150, "cw")],
    "hexa-plus": [(0, "cw"), (180, "ccw"), (-120, "cw"), (60, "ccw"), (-60, "ccw"), (120, "cw")],
    "octo-x": [
        *((22.5, "cw"), (-157.5, "cw"), (67.5, "ccw"), (157.5, "ccw")),
        *((-22.5, "ccw"), (-112.5, "ccw"), (-67.5, "cw"), (112.5, "cw")),
    ],
    "octo-plus": [
        *((0, "cw"), (180, "cw"), (45, "ccw"), (135, "ccw")),
        *((-45, "ccw"), (-135, "ccw"), (-90, "cw"), (90, "cw")),
    ],
    # Betaflight: mixerQuadX of mixer_init.c, propellers turning inward in front.
    "betaflight-quad-x": [(135, "cw"), (45, "ccw"), (-135, "ccw"), (-45, "cw")],
}


@pytest.mark.parametrize("name", LAYOUTS)
def test_motors_are_numbered_and_turn_as_the_autopilot_has_them(name):
    rotors = layout_rotors(name, 0.3)
    known = KNOWN.get(name) or KNOWN[name.partition("-")[2]]
    for rotor, (angle, spin) in zip(rotors, known, strict=True):
        assert math.hypot(rotor.x, rotor.y) == pytest.approx(0.3)
        turned = math.degrees(math.atan2(rotor.y, rotor.x)) - angle
        assert math.remainder(turned, 360.0) == pytest.approx(0.0, abs=1e-6)
        assert rotor.spin == (1 if spin == "ccw" else -1)


@pytest.mark.parametrize("name", LAYOUTS)
def test_a_layout_is_recognised(name):
    rotors = layout_rotors(name, 0.4)
    assert name in same_order(rotors)
    assert name in same_order(reversed_spins(rotors))
    shuffled = (*rotors[1:], rotors[0])
    assert name not in same_order(shuffled)
    assert name in same_places(shuffled)
    assert name not in same_places(turned(rotors, 180.0 / len(rotors)))


def turned(rotors, degrees):
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return tuple(Rotor(r.x * c - r.y * s, r.x * s + r.y * c, r.spin) for r in rotors)


@pytest.mark.parametrize("name", LAYOUTS)
def test_turned_a_little_it_is_still_the_layout(name):
    rotors = turned(layout_rotors(name, 0.3), 5.0)
    assert name in same_order(rotors)
    assert name in same_places(rotors)


@pytest.mark.parametrize(
    ("angle", "words"),
    [
        *((0, "front"), (45, "front right"), (90, "right"), (135, "rear right"), (180, "rear")),
        *((-45, "front left"), (-90, "left"), (-30, "front left"), (60, "right front")),
        *((22.5, "front right"), (67.5, "right front"), (112.5, "right rear"), (5, "front")),
    ],
)
def test_places_in_words(angle, words):
    a = math.radians(angle)
    assert place_words(Rotor(math.cos(a), math.sin(a), 1)) == words
