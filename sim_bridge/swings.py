"""A mission made of maneuvers, one after the other, as the flight coach's plan lists them.

The emulated pilot reads the plan's JSON (`gcs-sysid plan --json`) and swings roll, pitch, yaw and
height as it says. Set-points of body rates and their derivatives follow from the attitude angles,
so that the loops do not work against each other.
"""

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gcs_sysid.errors import InputError
from gcs_sysid.files import read_text
from sim_bridge.controller import multiply
from sim_bridge.missions import HEIGHT, Reference, Triple, ramp

LEAD = 2.0
"""s of hover before the first maneuver."""
PAUSE = 1.0
"""s of hover after each."""
LATEST = 3600
"""s at which a maneuver may start."""
"""Of a plan: some thousand maneuvers."""
_RAMP = 1.0
_STEP = 2e-3
"""s, of the differences that make derivatives of the body rates."""
_MOST = {"roll_deg": 60.0, "pitch_deg": 60.0, "yaw_deg": 180.0, "climb_m": 5.0}


@dataclass(frozen=True)
class Swings:
    """One maneuver; see `gcs-sysid plan` for the keys.

    Attributes:
        roll: rad to each side; so are pitch and yaw.
        climb: m up and down.
        pace: Hz of roll, pitch and height.
        yaw_pace: Hz of yaw.
        seconds: from start to end.
    """

    roll: float
    pitch: float
    yaw: float
    climb: float
    pace: float
    yaw_pace: float
    seconds: float

    @classmethod
    def from_json(cls, entry: Mapping[str, Any]) -> "Swings":
        """Of an entry of a plan's list of maneuvers.

        Raises:
            ValueError: a number is missing or cannot be flown.
        """
        values = {}
        for key in (*_MOST, "hz", "yaw_hz", "seconds"):
            value = entry.get(key)
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise ValueError(f"{key} must be a number")
            most = _MOST.get(key, 600.0 if key == "seconds" else 5.0)
            if not 0.0 <= value <= most:
                raise ValueError(f"{key} must lie in 0..{most:g}, got {value:g}")
            values[key] = float(value)
        if not (values["hz"] > 0.0 and values["yaw_hz"] > 0.0):
            raise ValueError("hz and yaw_hz must be positive")
        if values["seconds"] < 2.0 * _RAMP:
            raise ValueError(f"seconds must be at least {2.0 * _RAMP:g}")
        return cls(
            math.radians(values["roll_deg"]),
            math.radians(values["pitch_deg"]),
            math.radians(values["yaw_deg"]),
            values["climb_m"],
            values["hz"],
            values["yaw_hz"],
            values["seconds"],
        )

    def angles(self, t: float) -> tuple[float, float, float, float]:
        """Roll, pitch, yaw (rad) and height (m) t seconds after the maneuver's start."""
        gain = ramp(t / _RAMP)[0] * ramp((self.seconds - t) / _RAMP)[0]
        if gain == 0.0:
            return 0.0, 0.0, 0.0, 0.0
        at = 2.0 * math.pi * self.pace * t
        wave = gain * math.sin(at)
        return (
            self.roll * wave,
            # The stick goes round where both are asked for.
            self.pitch * (gain * math.cos(at) if self.roll else wave),
            self.yaw * gain * math.sin(2.0 * math.pi * self.yaw_pace * t),
            self.climb * wave,
        )


class ManoeuvreMission:
    """Maneuvers one after the other; more may be added while it is flown.

    Attributes:
        name: as on the command line.
        turbulence: rate wobble in rad/s rms.
    """

    name = "plan"
    turbulence = 0.0

    def __init__(self, swings: Iterable[Swings] = ()) -> None:
        self._parts: list[tuple[float, Swings]] = []
        self._free = LEAD
        for part in swings:
            self.add(part, self._free)

    @property
    def duration(self) -> float:
        """Until a pause after the last maneuver, s."""
        return self._free

    def add(self, swings: Swings, start: float) -> None:
        """Fly this as well.

        Args:
            swings: what to fly.
            start: s after the mission's start; later where another maneuver goes on until then.
        """
        start = max(start, self._free)
        self._parts.append((start, swings))
        self._free = start + swings.seconds + PAUSE

    def reference(self, t: float) -> Reference:
        """Set-points t seconds after the start."""
        roll, pitch, yaw, height = self._angles(t)
        earlier, now, later = (self._rates(t + step) for step in (-_STEP, 0.0, _STEP))
        below, above = self._angles(t - _STEP)[3], self._angles(t + _STEP)[3]
        climb = (above - below) / (2.0 * _STEP)
        upward = (above - 2.0 * height + below) / _STEP**2
        return Reference(
            (0.0, 0.0, -HEIGHT - height),
            (0.0, 0.0, -climb),
            (0.0, 0.0, -upward),
            (math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)),
            multiply(  # type: ignore[arg-type]
                (math.cos(0.5 * pitch), 0.0, math.sin(0.5 * pitch), 0.0),
                (math.cos(0.5 * roll), math.sin(0.5 * roll), 0.0, 0.0),
            ),
            now,
            _each(lambda a, b, c: (c - a) / (2.0 * _STEP), earlier, now, later),
            _each(lambda a, b, c: (c - 2.0 * b + a) / _STEP**2, earlier, now, later),
        )

    def _angles(self, t: float) -> tuple[float, float, float, float]:
        for start, swings in reversed(self._parts):
            if t >= start:
                return swings.angles(min(t - start, swings.seconds))
        return 0.0, 0.0, 0.0, 0.0

    def _rates(self, t: float) -> Triple:
        """Body rates of the attitude that the angles make."""
        roll, pitch, _, _ = self._angles(t)
        before, after = self._angles(t - _STEP), self._angles(t + _STEP)
        p, q, r = ((b - a) / (2.0 * _STEP) for a, b in zip(before[:3], after[:3], strict=True))
        return (
            p - r * math.sin(pitch),
            q * math.cos(roll) + r * math.cos(pitch) * math.sin(roll),
            r * math.cos(pitch) * math.cos(roll) - q * math.sin(roll),
        )


def _each(rule: Any, *triples: Triple) -> Triple:
    x, y, z = (rule(*values) for values in zip(*triples, strict=True))
    return x, y, z


def read_plan(path: Path) -> ManoeuvreMission:
    """The mission of a plan's JSON file.

    Raises:
        InputError: it cannot be read, or is no plan.
    """
    try:
        content = json.loads(read_text(path, "the plan"))
    except (ValueError, RecursionError):
        raise InputError(f"{path} is not JSON") from None
    entries = content.get("manoeuvres") if isinstance(content, dict) else None
    if not isinstance(entries, list) or not entries:
        raise InputError(f"{path} is not a plan: it has no maneuvers")
    mission = ManoeuvreMission()
    for number, entry in enumerate(entries, 1):
        try:
            if not isinstance(entry, dict):
                raise ValueError("must be an object")
            start = entry.get("start", 0.0)
            if isinstance(start, bool) or not isinstance(start, int | float):
                raise ValueError("start must be a number of seconds")
            if not 0 <= start <= LATEST:
                raise ValueError(f"start must lie between 0 and {LATEST} s")
            mission.add(Swings.from_json(entry), float(start))
        except ValueError as error:
            raise InputError(f"{path}: maneuver {number}: {error}") from None
    return mission
