"""What the vehicle is asked to fly: trajectories with multisine rate set-points on top.

A multisine is defined by the angle it swings through; its rate and angular acceleration are exact
derivatives, envelope included, so that the set-points of all control loops agree.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

HEIGHT = 10.0
"""Height of every mission above the take-off point, m."""

Array = NDArray[np.float64]
Triple = tuple[float, float, float]
Swing = tuple[float, float, float, float]
"""An angle (rad) and its first three derivatives."""


class Reference(NamedTuple):
    """Set-points at one instant, the same for every vehicle of an ensemble.

    Attributes:
        position: NED, m; velocity and acceleration are its derivatives.
        velocity: m/s.
        acceleration: m/s^2.
        heading: quaternion of the yaw set-point, multisine included.
        tilt: quaternion of the roll and pitch multisines, about the body axes.
        rate: body-rate set-point, rad/s.
        angular_acceleration: rad/s^2.
        angular_jerk: rad/s^3, for motors that lag.
    """

    position: Triple
    velocity: Triple
    acceleration: Triple
    heading: tuple[float, float, float, float]
    tilt: tuple[float, float, float, float]
    rate: Triple
    angular_acceleration: Triple
    angular_jerk: Triple


class Mission(Protocol):
    """A flight to fly."""

    @property
    def name(self) -> str:
        """As on the command line."""
        ...

    @property
    def duration(self) -> float:
        """Usual length, s. Asked for more, a mission repeats its modes."""
        ...

    @property
    def turbulence(self) -> float:
        """Usual strength of the turbulence: rate wobble in rad/s rms."""
        ...

    def reference(self, t: float) -> Reference:
        """Set-points t seconds after the start."""
        ...


@dataclass(frozen=True)
class Multisine:
    """A sum of sines on one axis, scaled to a body rate of 1 rad/s rms.

    Attributes:
        frequencies: Hz.
        fall: the rate amplitude of a tone goes with frequency to the power -fall.
        phases: rad.
    """

    frequencies: tuple[float, ...]
    fall: float
    phases: tuple[float, ...]

    @cached_property
    def _tones(self) -> tuple[Array, Array, Array, Array]:
        """Of n tones: omega and phase (n,), what sine and cosine weigh in a `Swing` (n, 4)."""
        omega = 2.0 * math.pi * np.array(self.frequencies)
        raw = omega**-self.fall
        amplitude = raw / math.sqrt((raw * raw).sum() / 2.0)
        none = np.zeros_like(omega)
        sine = np.stack([amplitude / omega, none, -amplitude * omega, none], axis=1)
        cosine = np.stack([none, amplitude, none, -amplitude * omega**2], axis=1)
        return omega, np.array(self.phases), sine, cosine

    def __call__(self, t: Array | float) -> Array:
        """Angle and its derivatives, (..., 4), at times (...) in s."""
        omega, phase, sine, cosine = self._tones
        phases = np.multiply.outer(t, omega) + phase
        swing: Array = np.sin(phases) @ sine + np.cos(phases) @ cosine
        return swing


# Interleaved frequencies on a grid of 0.05 Hz: whole periods in 20 s, no tone on two axes. The
# phases were found by random search for the least peak (crest factor about 2): of the angle for
# roll and pitch, which tilt limits; of the angular acceleration for yaw, which rotor thrust
# limits, as does the choice to let its rate fall with frequency.
ROLL = Multisine(
    (0.30, 0.60, 0.95, 1.25, 1.60, 1.95, 2.30, 2.65),
    -0.25,
    (5.83, 2.97, 4.99, 5.40, 3.09, 1.72, 1.35, 1.38),
)
PITCH = Multisine(
    (0.40, 0.70, 1.05, 1.35, 1.70, 2.05, 2.40, 2.70),
    -0.25,
    (5.60, 3.42, 5.47, 0.61, 1.43, 0.26, 2.38, 2.70),
)
YAW = Multisine(
    (0.35, 0.65, 0.85, 1.15, 1.45, 1.80, 2.15, 2.50),
    1.3,
    (5.43, 4.81, 2.58, 5.01, 1.13, 0.26, 3.51, 4.76),
)


def ramp(u: float) -> Triple:
    """Rise from 0 to 1 over u = 0..1 with no jump up to the second derivative; both of them."""
    if u <= 0.0:
        return 0.0, 0.0, 0.0
    if u >= 1.0:
        return 1.0, 0.0, 0.0
    return _quintic(u)


def _quintic(u: Any) -> tuple[Any, Any, Any]:
    """`ramp` of numbers or arrays within 0..1."""
    return (
        u * u * u * (10.0 + u * (6.0 * u - 15.0)),
        30.0 * u * u * (1.0 - u) * (1.0 - u),
        60.0 * u * (1.0 - u) * (1.0 - 2.0 * u),
    )


def ramp_integral(u: float) -> float:
    """Integral of `ramp` from 0 to u."""
    if u <= 0.0:
        return 0.0
    if u >= 1.0:
        return u - 0.5
    return u**4 * (2.5 + u * (u - 3.0))


@dataclass(frozen=True)
class Leg:
    """A flight at constant velocity from `start` to `end` (s), `rise` seconds to reach it."""

    start: float
    end: float
    speed: float
    rise: float

    def at(self, t: float) -> Triple:
        """Distance (m), speed (m/s) and acceleration (m/s^2) at time t."""
        if t <= self.start:
            return 0.0, 0.0, 0.0
        if t >= self.end + self.rise:
            return self.length, 0.0, 0.0
        u, w = (t - self.start) / self.rise, (t - self.end) / self.rise
        up, up_rate, _ = ramp(u)
        down, down_rate, _ = ramp(w)
        return (
            self.speed * self.rise * (ramp_integral(u) - ramp_integral(w)),
            self.speed * (up - down),
            self.speed / self.rise * (up_rate - down_rate),
        )

    @property
    def length(self) -> float:
        """Distance flown, m."""
        return self.speed * (self.end - self.start)


@dataclass(frozen=True)
class Mode:
    """One part of a mission.

    Attributes:
        length: s.
        gains: multisine set-points on roll, pitch and yaw, rad/s rms.
        forward: the leg flown north, or None.
        right: the leg flown east, or None.
    """

    length: float
    gains: Triple
    forward: Leg | None = None
    right: Leg | None = None


@dataclass(frozen=True)
class ExcitationMission:
    """Modes one after the other, again and again, after a short hover.

    Attributes:
        name: as on the command line.
        modes: in order.
        lead: s of hover before the first mode.
        blend: s over which the multisines pass from one mode to the next.
        turbulence: rate wobble in rad/s rms.
    """

    name: str
    modes: tuple[Mode, ...]
    lead: float = 2.0
    blend: float = 1.0
    turbulence: float = 0.0

    @cached_property
    def cycle(self) -> float:
        """Length of all modes together, s."""
        return sum(m.length for m in self.modes)

    @cached_property
    def _begins(self) -> list[float]:
        """When each mode begins in a cycle, s."""
        return [0.0, *accumulate(m.length for m in self.modes[:-1])]

    @cached_property
    def _legs(self) -> list[tuple[float, int, Leg]]:
        """When their modes begin, axis (0 north, 1 east) and the legs themselves."""
        return [
            (begin, axis, leg)
            for begin, mode in zip(self._begins, self.modes, strict=True)
            for axis, leg in enumerate((mode.forward, mode.right))
            if leg is not None
        ]

    @property
    def duration(self) -> float:
        """One hover and one cycle, s."""
        return self.lead + self.cycle

    def reference(self, t: float) -> Reference:
        """Set-points t seconds after the start."""
        return next(self.references([t]))

    def references(self, times: Sequence[float]) -> Iterator[Reference]:
        """`reference` at many times; one of them costs nearly as much as a hundred."""
        t = np.array(times) - self.lead
        return map(self._reference, t.tolist(), self._swings(t).tolist())

    def _swings(self, t: Array) -> Array:
        """The axes' swings, (K, 3, 4), at K times after the lead: multisines in their envelopes."""
        begins = np.array(self._begins)
        at = t % self.cycle
        mode = np.searchsorted(begins, at, side="right") - 1
        gains = np.array([m.gains for m in self.modes])
        low, high = gains[mode - 1], gains[mode]
        # The first mode of the first cycle grows out of the hover.
        low[(mode == 0) & (t < self.cycle)] = 0.0
        u = np.clip((at - begins[mode]) / self.blend, 0.0, 1.0)
        rise, rise_rate, rise_accel = (x[:, None] for x in _quintic(u))
        gain = low + (high - low) * rise
        gain_rate = (high - low) * rise_rate / self.blend
        gain_accel = (high - low) * rise_accel / self.blend**2
        multisines = np.stack([axis(t) for axis in (ROLL, PITCH, YAW)], axis=1)
        angle, rate, accel, jerk = np.moveaxis(multisines, -1, 0)
        return np.stack(
            [
                gain * angle,
                gain * rate + gain_rate * angle,
                gain * accel + 2.0 * gain_rate * rate + gain_accel * angle,
                # Without the ramp's own third derivative, which jumps at its ends.
                gain * jerk + 3.0 * (gain_rate * accel + gain_accel * rate),
            ],
            axis=-1,
        )

    def _reference(self, t: float, swings: Sequence[Sequence[float]]) -> Reference:
        """Set-points t seconds after the lead, with the three axes' swings."""
        if t < 0.0:
            return hover_reference()
        turns, at = divmod(t, self.cycle)
        position = [0.0, 0.0]
        velocity = [0.0, 0.0]
        acceleration = [0.0, 0.0]
        for begin, axis, leg in self._legs:
            s, v, a = leg.at(at - begin)
            position[axis] += s + turns * leg.length
            velocity[axis] += v
            acceleration[axis] += a
        return make_reference(position, velocity, acceleration, swings)


@dataclass(frozen=True)
class HoverMission:
    """Hover in gentle turbulence."""

    name: str = "hover"
    duration: float = 60.0
    turbulence: float = 0.02

    def reference(self, t: float) -> Reference:
        """The same set-points always."""
        del t
        return hover_reference()


@runtime_checkable
class _ManyAtOnce(Protocol):
    """A mission that has a cheaper way for many times."""

    def references(self, times: Sequence[float]) -> Iterator[Reference]:
        """`Mission.reference` at these times."""
        ...


def references(mission: Mission, times: Sequence[float]) -> Iterator[Reference]:
    """A mission's set-points at these times; multisines are far cheaper many at a time."""
    if isinstance(mission, _ManyAtOnce):
        return mission.references(times)
    return map(mission.reference, times)


def hover_reference() -> Reference:
    """Set-points of a hover over the starting point."""
    return _HOVER


def make_reference(
    position: list[float],
    velocity: list[float],
    acceleration: list[float],
    swings: Sequence[Sequence[float]],
) -> Reference:
    """Put horizontal motion and the swings of the three axes together."""
    (roll, *p), (pitch, *q), (yaw, *r) = swings
    x, y = 0.5 * roll, 0.5 * pitch
    # A unit quaternion of a turn about (roll, pitch, 0), good to second order in the angle.
    norm = math.sqrt(1.0 + x * x + y * y)
    return Reference(
        (position[0], position[1], -HEIGHT),
        (velocity[0], velocity[1], 0.0),
        (acceleration[0], acceleration[1], 0.0),
        (math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)),
        (1.0 / norm, x / norm, y / norm, 0.0),
        (p[0], q[0], r[0]),
        (p[1], q[1], r[1]),
        (p[2], q[2], r[2]),
    )


_HOVER = make_reference([0.0, 0.0], [0.0, 0.0], [0.0, 0.0], [(0.0, 0.0, 0.0, 0.0)] * 3)

# Set-point gains are tuned so that the simulated body rates of the paper's vehicle come out at
# 0.85, 0.88 and 0.56 rad/s rms on the modes' own axes, and a quarter of that on the others.
PAPER = ExcitationMission(
    "paper",
    (
        Mode(20.0, (0.825, 0.200, 0.214), right=Leg(7.0, 16.0, 1.0, 3.0)),
        Mode(20.0, (0.165, 0.830, 0.218), forward=Leg(7.0, 16.0, 1.0, 3.0)),
        Mode(20.0, (0.132, 0.127, 0.570)),
    ),
)

ALL_AXES = ExcitationMission("all-axes", (Mode(60.0, (0.85, 0.85, 0.55)),))

MISSIONS: dict[str, Mission] = {m.name: m for m in (PAPER, ALL_AXES, HoverMission())}
"""Every mission, by its name on the command line."""
