"""Doublets as docs/flying.md asks for them, from gentle to acro, level or with climbs between.

A doublet goes one way, then the other, then back to level, as after a pilot's quick pushes of the
stick: in a quarter of its length T each, the angle rises to A, swings over to -A and returns, along
the quintic of `missions.ramp`, with an eighth of T between. The fastest is the swing:
15/4 A / (T/4).

Roll, pitch and yaw come alone first, then roll with yaw and pitch with
yaw, whose doublets have different lengths, so that all their products come about.
"""

import math
from dataclasses import dataclass

from sim_bridge.controller import multiply
from sim_bridge.missions import HEIGHT, MISSIONS, Mission, Reference, Swing, Triple, ramp

LEAD = 5.0
"""s of hover first."""
PART = 10.0
"""s of each part."""
REST = 0.3
"""s level after each doublet."""
_PARTS = ((0,), (1,), (2,), (0, 2), (1, 2))
"""Axes that are moved, part by part."""
_STILL: Swing = (0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class DoubletMission:
    """Doublets on all axes, again and again.

    Attributes:
        name: as on the command line.
        rate: rad/s, largest of roll and pitch.
        length: s of a doublet in roll or pitch.
        yaw_rate: rad/s, largest of yaw.
        yaw_length: s of a doublet in yaw.
        climb: m up and down again in every part; 0: level.
        turbulence: rate wobble in rad/s rms.
    """

    name: str
    rate: float
    length: float
    yaw_rate: float
    yaw_length: float
    climb: float = 0.0
    turbulence: float = 0.0

    @property
    def duration(self) -> float:
        """The hover and each part once, s."""
        return LEAD + PART * len(_PARTS)

    def reference(self, t: float) -> Reference:
        """Set-points t seconds after the start."""
        turn, at = divmod(max(t - LEAD, 0.0), PART)
        axes = _PARTS[int(turn) % len(_PARTS)] if t >= LEAD else ()
        roll, pitch, yaw = (self._swing(axis, at) if axis in axes else _STILL for axis in range(3))
        height, climb, upward = self._height(at) if t >= LEAD else (0.0, 0.0, 0.0)
        c_r, s_r = math.cos(0.5 * roll[0]), math.sin(0.5 * roll[0])
        c_p, s_p = math.cos(0.5 * pitch[0]), math.sin(0.5 * pitch[0])
        return Reference(
            (0.0, 0.0, -HEIGHT - height),
            (0.0, 0.0, -climb),
            (0.0, 0.0, -upward),
            (math.cos(0.5 * yaw[0]), 0.0, 0.0, math.sin(0.5 * yaw[0])),
            multiply((c_p, 0.0, s_p, 0.0), (c_r, s_r, 0.0, 0.0)),  # type: ignore[arg-type]
            *(_body(roll[0], pitch[0], (roll[k], pitch[k], yaw[k])) for k in (1, 2, 3)),
        )

    def _swing(self, axis: int, t: float) -> Swing:
        """Angle and derivatives of one axis, t seconds into a part."""
        length, rate = (self.length, self.rate) if axis < 2 else (self.yaw_length, self.yaw_rate)
        count, at = divmod(t, length + REST)
        # Each doublet ends within its part.
        if at >= length or (count + 1) * (length + REST) > PART:
            return _STILL
        quarter = 0.25 * length
        size = self.rate_to_angle(rate, length) * (1.0 if count % 2 == 0 else -1.0)
        parts = [
            (share, _quintic((at - begin * length) / quarter))
            for share, begin in ((1.0, 0.0), (-2.0, 0.375), (1.0, 0.75))
        ]
        angle, speed, acceleration, jerk = (
            size / quarter**k * sum(share * step[k] for share, step in parts) for k in range(4)
        )
        return angle, speed, acceleration, jerk

    @staticmethod
    def rate_to_angle(rate: float, length: float) -> float:
        """Angle of a doublet that reaches this rate, rad."""
        return rate * 0.25 * length / 3.75

    def _height(self, t: float) -> Triple:
        """Height above the mission's and two derivatives: up in 3 s, 2 s there, down in 3 s."""
        if not self.climb:
            return 0.0, 0.0, 0.0
        rise, fall = ramp((t - 0.5) / 3.0), ramp((t - 5.5) / 3.0)
        return (
            self.climb * (rise[0] - fall[0]),
            self.climb * (rise[1] - fall[1]) / 3.0,
            self.climb * (rise[2] - fall[2]) / 9.0,
        )


def _quintic(u: float) -> Swing:
    """`ramp` with its third derivative."""
    value, rate, acceleration = ramp(u)
    return value, rate, acceleration, 60.0 * (1.0 + 6.0 * u * (u - 1.0)) if 0.0 < u < 1.0 else 0.0


def _body(roll: float, pitch: float, derivatives: Triple) -> Triple:
    """Body rates from those of the angles; for higher derivatives without products of rates."""
    p, q, r = derivatives
    s_r, c_r, c_p = math.sin(roll), math.cos(roll), math.cos(pitch)
    return p - r * math.sin(pitch), q * c_r + r * c_p * s_r, r * c_p * c_r - q * s_r


DOUBLETS = tuple(
    DoubletMission(*row)
    for row in (
        ("gentle", 0.5, 2.5, 0.3, 4.0),
        ("doublets", 1.5, 1.5, 0.8, 3.0),
        ("climbs", 1.5, 1.5, 0.8, 3.0, 2.0),
        ("aggressive", 3.0, 1.5, 1.2, 3.0),
        ("acro", 6.0, 1.6, 1.6, 3.0),
    )
)
"""From gentle to acro."""

ALL_MISSIONS: dict[str, Mission] = {**MISSIONS, **{m.name: m for m in DOUBLETS}}
"""Every mission that the command line knows, by its name."""
