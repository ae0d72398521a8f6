"""What a maneuver is called by a pilot."""

import math
from collections.abc import Mapping, Sequence

from gcs_sysid.coach.manoeuvre_library import Manoeuvre
from gcs_sysid.results.number_format import PLAIN

_MOST_NAMES = 3
"""Parameters that a sentence names."""


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
        for name in names[:_MOST_NAMES]
        for share in (expected[name],)
        if share is not None
    ]
    words = motion_words(manoeuvre)
    return f"{words}: {', '.join(gains)}" if gains else words
