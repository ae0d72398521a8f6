"""A small library of maneuvers that a pilot can fly by hand.

All are swings to and fro: sine-like doublets of attitude angles and of height, about one place.

What a pilot calls them is here too.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.model.parameters import AXES
from gcs_sysid.results.words import PLAIN

RAMP = 1.0
"""s, over which a swing grows at the start of a maneuver and fades at its end."""
_PACES = (0.7, 1.0, 1.4)
"""Hz, of roll and pitch: slow, usual and brisk by hand."""
_CLIMB_LEAST, _CLIMB_MOST, _CLIMB_STEP = 0.2, 1.0, 0.05
"""m up and down: visible, flown at most, and steps of the call-outs."""
_CLIMB_PACE = 0.5
"""Hz, of height."""
_YAW_MOST = math.radians(45.0)
_STEP = math.radians(5.0)
"""Steps of the angles in call-outs."""
LEAST = math.radians(5.0)
"""A smaller swing cannot be flown by eye."""


@dataclass(frozen=True)
class Limits:
    """What the pilot does not want to exceed.

    Attributes:
        tilt: rad, of roll and pitch.
        rate: rad/s, about each body axis.
        height: m, up and down from where the maneuver begins.
    """

    tilt: float = math.radians(20.0)
    rate: float = math.radians(150.0)
    height: float = 1.0


@dataclass(frozen=True)
class Manoeuvre:
    """Swings about several axes at once.

    Attributes:
        name: in the library.
        roll: rad, how far to each side; so are pitch and yaw.
        climb: m, how far up and down.
        pace: Hz, of roll, pitch and height.
        yaw_pace: Hz, of yaw: the same or half.
        seconds: from start to end, the ramps included.
    """

    name: str
    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0
    climb: float = 0.0
    pace: float = 1.0
    yaw_pace: float = 1.0
    seconds: float = 10.0

    @property
    def effective_seconds(self) -> float:
        """Equivalent seconds at full swing: squares of the ramps count for 3/8 each."""
        return self.seconds - 2.0 * RAMP * (1.0 - 0.375)

    @property
    def can_be_seen(self) -> bool:
        """Whether no swing that belongs to it is too small to be flown by eye."""
        return all(getattr(self, axis) >= LEAST - 1e-9 for axis in AXES if axis in self.name)

    def lasting(self, seconds: float) -> "Manoeuvre":
        """The same, longer or shorter."""
        return replace(self, seconds=seconds)

    def angles(self, t: Array) -> Array:
        """(n, 4) roll, pitch, yaw (rad) and height (m) at full swing, at (n,) times in s."""
        # Pitch follows roll by a quarter: the stick goes round.
        waves = (
            np.sin(2.0 * np.pi * self.pace * t),
            np.cos(2.0 * np.pi * self.pace * t)
            if self.roll
            else np.sin(2.0 * np.pi * self.pace * t),
            np.sin(2.0 * np.pi * self.yaw_pace * t),
            np.sin(2.0 * np.pi * self.pace * t),
        )
        return np.stack(waves, axis=1) * (self.roll, self.pitch, self.yaw, self.climb)

    def as_json(self) -> dict[str, Any]:
        """For a plan's JSON, angles in degrees."""
        return {
            "name": self.name,
            "roll_deg": round(math.degrees(self.roll), 1),
            "pitch_deg": round(math.degrees(self.pitch), 1),
            "yaw_deg": round(math.degrees(self.yaw), 1),
            "climb_m": self.climb,
            "hz": self.pace,
            "yaw_hz": self.yaw_pace,
            "seconds": self.seconds,
        }


def library(limits: Limits) -> tuple[Manoeuvre, ...]:
    """Every maneuver within the limits, as hard as they allow."""
    out: list[Manoeuvre] = []
    for pace in _PACES:
        tilt = _rounded(min(limits.tilt, limits.rate / (2.0 * math.pi * pace)))
        yaw = _rounded(min(_YAW_MOST, limits.rate / (2.0 * math.pi * pace)))
        slow = _rounded(min(_YAW_MOST, limits.rate / (math.pi * pace)))
        found = [
            Manoeuvre("roll", roll=tilt, pace=pace),
            Manoeuvre("pitch", pitch=tilt, pace=pace),
            Manoeuvre("yaw", yaw=yaw, pace=pace, yaw_pace=pace),
            Manoeuvre("roll and pitch", roll=tilt, pitch=tilt, pace=pace),
            Manoeuvre("roll and yaw", roll=tilt, yaw=yaw, pace=pace, yaw_pace=pace),
            Manoeuvre("pitch and yaw", pitch=tilt, yaw=yaw, pace=pace, yaw_pace=pace),
            Manoeuvre("roll and slow yaw", roll=tilt, yaw=slow, pace=pace, yaw_pace=0.5 * pace),
            Manoeuvre("pitch and slow yaw", pitch=tilt, yaw=slow, pace=pace, yaw_pace=0.5 * pace),
        ]
        out += [m for m in found if m.can_be_seen]
    if limits.height >= _CLIMB_LEAST:
        climb = math.floor(min(limits.height, _CLIMB_MOST) / _CLIMB_STEP + 1e-9) * _CLIMB_STEP
        out.append(Manoeuvre("climb", climb=climb, pace=_CLIMB_PACE))
    return tuple(out)


def _rounded(angle: float) -> float:
    return math.floor(angle / _STEP + 1e-9) * _STEP


def motion_words(manoeuvre: Manoeuvre) -> str:
    """What to do, how far and how fast, such as "roll and yaw together, ±20°, about 1 Hz, 10 s"."""
    return f"{_what(manoeuvre)}, {manoeuvre.seconds:.0f} s"


def _what(m: Manoeuvre) -> str:
    pace = f"about {m.pace:g} Hz"
    if m.climb:
        return f"up and down, ±{m.climb:.2g} m, {pace}"
    if m.roll and m.pitch:
        return f"circle the stick: roll and pitch, {_angle(m.roll)}, {pace}"
    first, angle = ("roll", m.roll) if m.roll else ("pitch", m.pitch)
    if not m.yaw:
        return f"{first} to and fro, {_angle(angle)}, {pace}"
    if not angle:
        return f"yaw to and fro, {_angle(m.yaw)}, {pace}"
    if m.yaw_pace != m.pace:
        return (
            f"{first} and yaw together: {first} {_angle(angle)}, {pace}, "
            f"yaw {_angle(m.yaw)}, half as fast"
        )
    if m.yaw == angle:
        return f"{first} and yaw together, {_angle(angle)}, {pace}"
    return f"{first} and yaw together, {_angle(angle)} and {_angle(m.yaw)}, {pace}"


def axis_words(m: Manoeuvre) -> tuple[str, ...]:
    """The motion in a few words for each axis, such as "roll ±20° 1 Hz", for large print."""
    if m.climb:
        return (f"climb ±{m.climb:.2g} m {m.pace:g} Hz",)
    swings = (("roll", m.roll, m.pace), ("pitch", m.pitch, m.pace), ("yaw", m.yaw, m.yaw_pace))
    return tuple(f"{axis} {_angle(angle)} {pace:g} Hz" for axis, angle, pace in swings if angle)


def _angle(angle: float) -> str:
    return f"±{math.degrees(angle):.0f}°"


def damped_words(manoeuvre: Manoeuvre, share: float) -> str:
    """What came of a maneuver: "swing too small (±8° of ±20° at 1.4 Hz)"."""
    asked = max(manoeuvre.roll, manoeuvre.pitch, manoeuvre.yaw)
    pace = manoeuvre.pace if asked > manoeuvre.yaw else manoeuvre.yaw_pace
    return f"swing too small ({_angle(share * asked)} of {_angle(asked)} at {pace:g} Hz)"


def gain_words(name: str, now: float | None, expected: float) -> str:
    """What a parameter gains, such as "Izz from 12 % to about 3 %"."""
    if now is None or now > 1.0:
        return f"{name} to about {PLAIN.percent(expected, 1)}"
    return f"{name} from {PLAIN.percent(now, 1)} to about {PLAIN.percent(expected, 1)}"


def sentence(
    manoeuvre: Manoeuvre,
    names: Sequence[str],
    now: Mapping[str, float | None],
    expected: Mapping[str, float | None],
) -> str:
    """All in one sentence, the widest intervals first."""
    gains = [
        gain_words(name, now.get(name), share)
        for name in names[:3]
        for share in (expected[name],)
        if share is not None
    ]
    words = motion_words(manoeuvre)
    return f"{words}: {', '.join(gains)}" if gains else words
