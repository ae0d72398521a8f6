"""The layout that a vehicle reports by its parameters, and an airframe's differences from it.

PX4 reports each rotor's position and spin (CA_ROTORn_*), ArduPilot the name of a frame
(FRAME_CLASS, FRAME_TYPE); both report which output drives which motor. A vehicle flies by these, so
an airframe that contradicts them is wrong, which can be reported before take-off.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import MOST_ARM, Airframe, Rotor, is_evenly_canted, load_airframe
from gcs_sysid.model.parameters import AXES
from gcs_sysid.results.words import WRONG_AIRFRAME
from gcs_sysid.signals.motor_order import MIXER, motor_outputs
from gcs_sysid.significance import normal_limit
from gcs_sysid.telemetry.dialect import mavlink
from gcs_sysid.telemetry.parameter_requests import MOST_ROTORS
from gcs_sysid.telemetry.vehicles import MavlinkSystem

_UNIT = 1e-3
"""Of a mean distance of 1 or sqrt(2): as simulators and mixers report, which need no lengths."""
_LEAST_UPRIGHT = math.cos(math.radians(30.0))
"""Of an axis; others are not of rotors that lift."""
_MULTIROTOR = 0.0
"""CA_AIRFRAME."""
_AUTOSTART = {
    4001: "quad-x", 5001: "quad-plus", 6001: "hexa-x", 7001: "hexa-plus",
    8001: "octo-x", 9001: "octo-plus",
}  # fmt: skip
"""PX4's generic airframes, by SYS_AUTOSTART."""
_TURNS, _TURNS_OF_SIX = (90, 180, -90, 45, -45), (60, -60, 30, -30, 120, -120)
"""Degrees to the right by which an autopilot, or an airframe file, is turned by mistake."""
_FRAME_CLASSES = {
    1: "quad", 2: "hexa", 3: "octo", 4: "octaquad", 5: "y6", 12: "dodecahexa", 14: "deca",
}  # fmt: skip


def _ring(first: float, step: float, count: int) -> tuple[tuple[float, int], ...]:
    """Rotors one after the other around, the first counter-clockwise."""
    return tuple((first + step * i, (-1) ** i) for i in range(count))


def _pairs(first: float, count: int) -> tuple[tuple[float, int], ...]:
    """Pairs one after the other around, the upper ones in turn as those of a ring."""
    spins = (1, -1, -1, 1)
    return tuple((first + 720.0 / count * (i // 2), spins[i % 4]) for i in range(count))


# Degrees clockwise from the front and spin (+1 counter-clockwise seen from above), in motor order:
# AP_MotorsMatrix.cpp of ArduPilot. PX4's generic airframes have the same.
_SHAPES: dict[str, tuple[tuple[float, int], ...]] = {
    "quad-x": ((45, +1), (-135, +1), (-45, -1), (135, -1)),
    "quad-plus": ((90, +1), (-90, +1), (0, -1), (180, -1)),
    "quad-h": ((45, -1), (-135, -1), (-45, +1), (135, +1)),
    "quad-bf-x": ((135, -1), (45, +1), (-135, +1), (-45, -1)),
    "quad-dji-x": _ring(45, -90, 4),
    "quad-cw-x": _ring(45, 90, 4),
    "hexa-x": ((90, -1), (-90, +1), (-30, -1), (150, +1), (30, +1), (-150, -1)),
    "hexa-plus": ((0, -1), (180, +1), (-120, -1), (60, +1), (-60, +1), (120, -1)),
    "hexa-dji-x": _ring(30, -60, 6),
    "hexa-cw-x": _ring(30, 60, 6),
    "octo-plus": (
        (0, -1), (180, -1), (45, +1), (135, +1), (-45, +1), (-135, +1), (-90, -1), (90, -1),
    ),
    "octo-dji-x": _ring(22.5, -45, 8),
    "octo-cw-x": _ring(22.5, 45, 8),
    "octaquad-plus": (
        (0, +1), (-90, -1), (180, +1), (90, -1), (-90, +1), (0, -1), (90, +1), (180, -1),
    ),
    "octaquad-x": (
        (45, +1), (-45, -1), (-135, +1), (135, -1), (-45, +1), (45, -1), (135, +1), (-135, -1),
    ),
    "octaquad-bf-x": (
        (135, -1), (45, +1), (-135, +1), (-45, -1), (135, +1), (45, -1), (-135, -1), (-45, +1),
    ),
    "octaquad-cw-x": _pairs(45, 8),
    "y6-a": ((60, +1), (-60, -1), (-60, +1), (180, -1), (60, -1), (180, +1)),
    "y6-b": ((60, -1), (60, +1), (180, -1), (180, +1), (-60, -1), (-60, +1)),
    "y6-f": ((180, +1), (60, +1), (-60, +1), (180, -1), (60, -1), (-60, -1)),
    "dodecahexa-plus": _pairs(0, 12),
    "dodecahexa-x": _pairs(30, 12),
    "deca-plus": _ring(0, 36, 10),
    "deca-x": _ring(18, 36, 10),
}  # fmt: skip
_FRAME_TYPES = {
    "quad": {
        0: "plus", 1: "x", 3: "h", 6: "plus-reversed", 12: "bf-x", 13: "dji-x", 14: "cw-x",
        18: "bf-x-reversed",
    },
    "hexa": {0: "plus", 1: "x", 13: "dji-x", 14: "cw-x"},
    "octo": {0: "plus", 1: "x", 13: "dji-x", 14: "cw-x"},
    "octaquad": {
        0: "plus", 1: "x", 3: "x-reversed", 12: "bf-x", 14: "cw-x", 18: "bf-x-reversed",
    },
    "y6": {0: "a", 1: "a", 10: "b", 11: "f"},
    "dodecahexa": {0: "plus", 1: "x"},
    "deca": {0: "plus", 1: "x", 14: "x"},
}  # fmt: skip
"""FRAME_TYPE -> shape, of each class; others have motors elsewhere than on a circle."""


@dataclass(frozen=True)
class ReportedLayout:
    """The rotors as a vehicle reports them.

    Attributes:
        rotors: in motor order; of mean distance 1 where no size is reported.
        sized: whether the distances are meters.
        by: the parameters that define it.
        shown: whether the log shows the mixer at work, which no airframe file outweighs.
        outputs: motors, from 0, in the order of the outputs that drive them.
    """

    rotors: tuple[Rotor, ...]
    sized: bool
    by: str
    outputs: tuple[int, ...] = ()
    shown: bool = False

    def as_json(self) -> dict[str, object]:
        """For the result's `telemetry`."""
        rotors = Airframe("reported", self.rotors).as_json()["rotors"]
        reported: dict[str, object] = {"by": self.by, "sized": self.sized, "rotors": rotors}
        if self.outputs:
            reported["outputs"] = [motor + 1 for motor in self.outputs]
        return reported


def reported_layout(autopilot: str, parameters: Mapping[str, float]) -> ReportedLayout | None:
    """The layout by the parameters so far; None: not enough of them, or no usual frame.

    The autopilot is "px4", "ardupilot", ...
    """
    if autopilot == "px4":
        reported = _px4(parameters)
    elif autopilot == "ardupilot":
        reported = _ardupilot(parameters)
    else:
        reported = _by_mixer(parameters)
    if reported is None:
        return None
    drivers = motor_outputs(autopilot, parameters).values()
    outputs = min((tuple(sorted(driver, key=driver.__getitem__)) for driver in drivers), default=())
    return replace(reported, outputs=outputs)


def suggested_airframe(kind: str, vehicle: MavlinkSystem | None) -> str | None:
    """The built-in airframe to try where no parameters report a layout; None: any is a guess."""
    # Betaflight numbers motors in one way; its logs do not hold where they are.
    quad = vehicle is not None and vehicle.vehicle_type == mavlink.MAV_TYPE_QUADROTOR
    return "betaflight-quad-x" if kind == "blackbox" and quad else None


def _px4(parameters: Mapping[str, float]) -> ReportedLayout | None:
    if parameters.get("CA_AIRFRAME", _MULTIROTOR) != _MULTIROTOR:
        return None
    count = parameters.get("CA_ROTOR_COUNT", 0.0)
    if count == 0.0:  # before 1.13, or a mixer file
        shape = _AUTOSTART.get(round(parameters.get("SYS_AUTOSTART", 0.0)))
        name = f"SYS_AUTOSTART {parameters.get('SYS_AUTOSTART', 0.0):.0f}"
        return None if shape is None else ReportedLayout(on_circle(shape), False, name)
    rotors = px4_rotors(parameters)
    if rotors is None or not all(math.hypot(r.x, r.y) <= MOST_ARM for r in rotors):
        return None
    if not is_evenly_canted(rotors):
        rotors = [Rotor(r.x, r.y, r.spin) for r in rotors]
    arm = Airframe("reported", tuple(rotors)).arm
    if arm == 0.0:
        return None
    sized = min(abs(arm - 1.0), abs(arm - math.sqrt(2.0))) > _UNIT
    scale = 1.0 if sized else 1.0 / arm
    placed = tuple(replace(r, x=r.x * scale, y=r.y * scale) for r in rotors)
    return ReportedLayout(placed, sized, "CA_ROTORn_PX, _PY and _KM")


def px4_rotors(parameters: Mapping[str, float]) -> list[Rotor] | None:
    """The rotors of CA_ROTORn, in whatever unit; None where one of them is not known."""
    count = parameters.get("CA_ROTOR_COUNT", 0.0)
    if not 4 <= count <= MOST_ROTORS:
        return None
    rotors = []
    for i in range(round(count)):
        x, y, ratio = (parameters.get(f"CA_ROTOR{i}_{name}") for name in ("PX", "PY", "KM"))
        if x is None or y is None or not ratio:
            return None
        rotors.append(Rotor(x, y, 1 if ratio > 0.0 else -1, _axis(parameters, i)))
    return rotors


def _axis(parameters: Mapping[str, float], i: int) -> tuple[float, float, float]:
    """Of thrust, upright where not reported."""
    x, y, z = (parameters.get(f"CA_ROTOR{i}_A{axis}", -(axis == "Z")) for axis in "XYZ")
    length = math.hypot(x, y, z)
    if not 0.0 < length < math.inf or -z < _LEAST_UPRIGHT * length:
        return 0.0, 0.0, -1.0
    return x / length, y / length, z / length


def _ardupilot(parameters: Mapping[str, float]) -> ReportedLayout | None:
    numbers = parameters.get("FRAME_CLASS"), parameters.get("FRAME_TYPE")
    if None in numbers:
        return None
    kind, form = (round(number or 0.0) for number in numbers)
    name = _FRAME_CLASSES.get(kind, "")
    shape = _FRAME_TYPES.get(name, {}).get(form)
    if shape is None:
        return None
    rotors = on_circle(f"{name}-{shape}")
    return ReportedLayout(rotors, False, f"FRAME_CLASS {kind} and FRAME_TYPE {form}")


def _by_mixer(parameters: Mapping[str, float]) -> ReportedLayout | None:
    """By what PID sums do to the motors, about axes forward, left and up.

    Motors that a sum to the right raises are on the left; those that one to the left about the
    upright axis raises turn clockwise, as their reaction is what turns the vehicle.
    """
    rotors = []
    for i in range(MOST_ROTORS):
        gains = [parameters.get(f"{MIXER}{axis}[{i}]") for axis in AXES]
        if None in gains:
            break
        roll, pitch, yaw = (gain or 0.0 for gain in gains)
        rotors.append(Rotor(-pitch, -roll, -1 if yaw > 0.0 else 1))
    arm = Airframe("mixer", tuple(rotors)).arm if len(rotors) >= 4 else 0.0
    if arm == 0.0:
        return None
    placed = tuple(replace(r, x=r.x / arm, y=r.y / arm) for r in rotors)
    return ReportedLayout(placed, False, "PID sums and motors of the log", shown=True)


def on_circle(shape: str) -> tuple[Rotor, ...]:
    """Rotors of a usual frame ("quad-x", "quad-x-reversed": the spins), at a distance of 1."""
    base = shape.removesuffix("-reversed")
    if base != shape:
        return tuple(replace(rotor, spin=-rotor.spin) for rotor in on_circle(base))
    if shape not in _SHAPES:
        return load_airframe(f"ardupilot-{shape}").with_arm(1.0).rotors
    circle = [(math.radians(angle), spin) for angle, spin in _SHAPES[shape]]
    return tuple(Rotor(math.cos(a), math.sin(a), spin) for a, spin in circle)


@cache
def usual_layouts(count: int) -> dict[str, tuple[Rotor, ...]]:
    """The frames that autopilots know by name, of so many rotors, at a distance of 1.

    Without octaquads, of which several differ in nothing but their spins.
    """
    named = {
        f"{kind} {form}": on_circle(f"{kind}-{form}")
        for kind, forms in _FRAME_TYPES.items()
        for form in forms.values()
        if kind != "octaquad"
    }
    return {name: rotors for name, rotors in named.items() if len(rotors) == count}


# --- the airframe for it


def airframe_of_layout(reported: ReportedLayout, arm: float | None) -> Airframe:
    """The airframe that a vehicle's own layout proposes.

    `arm` is m, mean distance of the rotors from the center; None: as reported.

    Raises:
        InputError: neither gives its size.
    """
    airframe = Airframe("auto", reported.rotors)
    if arm is not None:
        return airframe.with_arm(arm)
    if not reported.sized:
        raise InputError(
            f"--airframe auto: the vehicle reports its layout ({reported.by}) but no lengths: "
            "give --arm M, from the center to each motor"
        )
    return airframe


def proposal(reported: ReportedLayout) -> str:
    """The layout in words, for who takes it."""
    spins = ", ".join(
        f"{i} {place_words(r)} {'ccw' if r.spin > 0 else 'cw'}"
        for i, r in enumerate(reported.rotors, 1)
    )
    size = f", arm {_arm(reported.rotors):.3g} m" if reported.sized else ""
    return f"{len(reported.rotors)} rotors by {reported.by}: {spins}{size}"


def differences(airframe: Airframe, reported: ReportedLayout) -> tuple[str, ...]:
    """What an airframe says otherwise than the vehicle, in words; empty where they agree.

    Props-out is a note where the log shows the mixer: nothing but k_M rests on it.
    """
    if reported.shown and _are_reversed(airframe.rotors, reported.rotors):
        return ()
    return tuple(
        f"{WRONG_AIRFRAME} {airframe.name}: {what} (the vehicle: {reported.by})"
        for what in _differences(airframe.rotors, reported.rotors)
    )


def notes(airframe: Airframe, reported: ReportedLayout) -> tuple[str, ...]:
    """What is worth knowing where they agree in kind."""
    out = []
    ours, theirs = airframe.arm, _arm(reported.rotors)
    # Theirs is hardly measured better.
    share = math.sqrt(2.0) * airframe.uncertainty.arm.of(ours) / ours
    own, said = f"{ours:.3g}", f"{theirs:.3g}"  # exact ones part by the rounding of parameters
    if reported.sized and own != said and abs(ours / theirs - 1.0) > normal_limit() * share:
        out.append(
            f"arms of {own} m, where the vehicle's {reported.by} say {said} m: inertia "
            "is proportional to the arm, so measure it"
        )
    if reported.shown and _are_reversed(airframe.rotors, reported.rotors):
        out.append(
            f"props-out: all rotors spin the other way than those of {airframe.name}, by "
            f"{reported.by}; --airframe auto takes them from the log"
        )
    if reported.outputs != tuple(range(len(reported.outputs))):
        order = ", ".join(str(motor + 1) for motor in reported.outputs)
        out.append(f"its outputs drive motors {order}, in this order: sorted by motor here")
    return tuple(out)


def _are_reversed(ours: Sequence[Rotor], theirs: Sequence[Rotor]) -> bool:
    turned = [replace(rotor, spin=-rotor.spin) for rotor in theirs]
    return not _differences(ours, turned)


def _arm(rotors: Sequence[Rotor]) -> float:
    return Airframe("", tuple(rotors)).arm


def _differences(ours: Sequence[Rotor], theirs: Sequence[Rotor]) -> tuple[str, ...]:
    """What `ours` says otherwise than `theirs`, the plainest explanation first."""
    if len(ours) != len(theirs):
        return (f"it has {len(ours)} rotors, the vehicle {len(theirs)}",)
    a, b = bearings(ours), bearings(theirs)
    near = 0.4 * _narrowest(b)
    spins = np.array([r.spin for r in ours]), np.array([r.spin for r in theirs])
    if turned_between(a, b).max() < near:
        return _spin_differences(ours, *spins)
    for degrees in _TURNS if len(ours) == 4 else (*_TURNS, *_TURNS_OF_SIX):
        apart = turned_between(a, b + math.radians(degrees)).max()
        if apart < 0.6 * near and (spins[0] == spins[1]).all():
            way = "" if degrees == 180 else " to the right" if degrees > 0 else " to the left"
            return (f"it is turned by {abs(degrees)} degrees{way}",)
    match = [int(np.argmin(turned_between(angle, b))) for angle in a]
    if sorted(match) == list(range(len(b))) and turned_between(a, b[match]).max() < near:
        moved = [i for i, j in enumerate(match) if i != j]
        words = "; ".join(
            f"motor {i + 1} is {place_words(ours[i])}, on the vehicle {place_words(theirs[i])}"
            for i in moved
        )
        out = [f"motor order: {words}"]
        if (spins[0] != spins[1][match]).any():
            wrong = [i for i in range(len(ours)) if ours[i].spin != theirs[match[i]].spin]
            out.append(f"spins by place: {', '.join(place_words(ours[i]) for i in wrong)}")
        return tuple(out)
    elsewhere = np.flatnonzero(turned_between(a, b) >= near)
    words = "; ".join(
        f"motor {i + 1} is {place_words(ours[i])}, on the vehicle {place_words(theirs[i])}"
        for i in elsewhere.tolist()
    )
    return (f"rotors elsewhere: {words}",)


def _spin_differences(rotors: Sequence[Rotor], ours: Array, theirs: Array) -> tuple[str, ...]:
    wrong = np.flatnonzero(ours != theirs)
    if not len(wrong):
        return ()
    if len(wrong) == len(ours):
        return ("all its rotors spin the other way",)
    names = ", ".join(f"{i + 1} ({place_words(rotors[i])})" for i in wrong.tolist())
    many = len(wrong) > 1
    return (f"motor{'s' if many else ''} {names} spin{'' if many else 's'} the other way",)


def bearings(rotors: Sequence[Rotor]) -> Array:
    """(rotors,) rad from the front to the right."""
    return np.array([math.atan2(r.y, r.x) for r in rotors])


def turned_between(a: Array, b: Array) -> Array:
    """Angles between bearings, 0 to pi rad."""
    return np.abs((a - b + np.pi) % (2.0 * np.pi) - np.pi)


def _narrowest(bearings: Array) -> float:
    """The least angle between two arms, rad; coaxial rotors share theirs."""
    apart = np.abs(turned_between(bearings[:, None], bearings))
    return float(min(apart[apart > 0.1].min(), math.pi / 2.0)) if (apart > 0.1).any() else 0.5


def place_words(rotor: Rotor) -> str:
    """Where a rotor is: "front right", "left", "right front" (further right), ..."""
    x, y = rotor.x, rotor.y
    if math.hypot(x, y) < 1e-6:
        return "center"
    along, across = "front" if x > 0 else "rear", "right" if y > 0 else "left"
    if abs(y) < math.tan(math.radians(10.0)) * abs(x):
        return along
    if abs(x) < math.tan(math.radians(10.0)) * abs(y):
        return across
    return f"{along} {across}" if abs(x) >= 0.999 * abs(y) else f"{across} {along}"
