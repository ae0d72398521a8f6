"""Usual layouts of rotors, in the motor order of PX4 and of ArduPilot."""

import math
from dataclasses import replace

from gcs_sysid.model.airframe import Airframe, Rotor, load_airframe

# Degrees clockwise from the front, and spin seen from above (+1 counter-clockwise), in motor
# order. PX4's airframes 5001, 7001 and 9001 and ArduPilot's FRAME_TYPE 0 are the same here.
_PLUS = {
    "quad-plus": ((90, +1), (-90, +1), (0, -1), (180, -1)),
    "hexa-plus": ((0, -1), (180, +1), (-120, -1), (60, +1), (-60, +1), (120, -1)),
    "octo-plus": (
        (0, -1), (180, -1), (45, +1), (135, +1), (-45, +1), (-135, +1), (-90, -1), (90, -1),
    ),
}  # fmt: skip
_SHAPES = {
    "quad-x": "quad X",
    "quad-plus": "quad +",
    "hexa-x": "hexa X",
    "hexa-plus": "hexa +",
    "octo-x": "octo X",
    "octo-plus": "octo +",
}
_AUTOPILOTS = {"px4": "PX4", "ardupilot": "ArduPilot"}

LAYOUTS = {
    f"{autopilot}-{shape}": f"{shape_title}, {title}'s motor order"
    for shape, shape_title in _SHAPES.items()
    for autopilot, title in _AUTOPILOTS.items()
}
"""Name -> what it is, in words."""

TWO_LENGTHS = ("px4-quad-x", "ardupilot-quad-x")
"""Layouts that need not be square: forward and sideways may differ."""

USUAL_ARM = 0.25
"""m."""

_ANGLE_NEAR = math.radians(12.0)
"""Rotors of a real frame are where the layout has them within this."""


def layout_rotors(name: str, arm: float | tuple[float, float]) -> tuple[Rotor, ...]:
    """The rotors of a layout, in motor order.

    Args:
        name: one of `LAYOUTS`.
        arm: m from the centre to each motor; for `TWO_LENGTHS` also m forward and m sideways.
    """
    shape = name.partition("-")[2]
    lengths = arm if isinstance(arm, tuple) else (1.0, 1.0)
    if shape in _PLUS:
        circle = [(math.radians(angle), spin) for angle, spin in _PLUS[shape]]
        rotors = tuple(Rotor(math.cos(a), math.sin(a), spin) for a, spin in circle)
    else:
        rotors = load_airframe(name).rotors
    if isinstance(arm, tuple):
        x, y = lengths
        return tuple(Rotor(math.copysign(x, r.x), math.copysign(y, r.y), r.spin) for r in rotors)
    return Airframe(name, rotors).with_arm(arm).rotors


def place_of(x: float, y: float) -> str:
    """Where a rotor is, in words: "front right", "right", "right front" (further right)."""
    if math.hypot(x, y) < 1e-6:
        return "centre"
    along, across = "front" if x > 0 else "rear", "right" if y > 0 else "left"
    if abs(y) < math.tan(math.radians(10.0)) * abs(x):
        return along
    if abs(x) < math.tan(math.radians(10.0)) * abs(y):
        return across
    return f"{along} {across}" if abs(x) >= 0.999 * abs(y) else f"{across} {along}"


def _bearings(rotors: tuple[Rotor, ...]) -> list[float]:
    return [math.atan2(r.y, r.x) for r in rotors]


def _apart(a: float, b: float) -> float:
    return abs(math.remainder(a - b, math.tau))


def same_order(rotors: tuple[Rotor, ...]) -> list[str]:
    """Layouts whose motors point the same ways, in the same order; spins aside."""
    found = []
    for name in LAYOUTS:
        usual = layout_rotors(name, USUAL_ARM)
        if len(usual) == len(rotors) and all(
            _apart(a, b) < _near(name)
            for a, b in zip(_bearings(rotors), _bearings(usual), strict=True)
        ):
            found.append(name)
    return found


def same_places(rotors: tuple[Rotor, ...]) -> list[str]:
    """Layouts with motors in the same directions, in whatever order."""
    mine = sorted(_bearings(rotors))
    found = []
    for name in LAYOUTS:
        usual = sorted(_bearings(layout_rotors(name, USUAL_ARM)))
        # Directions near +-180 deg may sort to either end.
        turns = [usual[i:] + usual[:i] for i in range(-1, 2)]
        if len(usual) == len(mine) and any(
            all(_apart(a, b) < _near(name) for a, b in zip(mine, turn, strict=True))
            for turn in turns
        ):
            found.append(name)
    return found


def _near(name: str) -> float:
    """A quad X need not be square, and stays one while its rotors are in their quadrants."""
    return math.radians(30.0) if name in TWO_LENGTHS else _ANGLE_NEAR


def reversed_spins(rotors: tuple[Rotor, ...]) -> tuple[Rotor, ...]:
    """The same rotors, each turning the other way."""
    return tuple(replace(rotor, spin=-rotor.spin) for rotor in rotors)
