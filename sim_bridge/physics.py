"""What real vehicles have and the ideal one has not, each to be switched on by its name.

`Physics` says which are set. Coefficients are given for a vehicle of any size: as accelerations,
times, shares, or multiples of the arm; `of_vehicle` and the modules that use them make forces of
them. Nothing is on by default.
"""

import argparse
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from gcs_sysid.argument_types import between, not_negative, positive
from sim_bridge.choices import Kind, Span, choice_help, gather, milliseconds, parse_choice, span
from sim_bridge.simulated_vehicle import (
    LAGS,
    RotorTraits,
    Value,
    Vehicle,
    even,
    hover_thrusts,
)

LEAST_SHARE = 0.2
"""Of k_T or k_M; however wide the scatter, no rotor has less."""


@dataclass(frozen=True)
class Weakening:
    """A rotor that loses thrust.

    Attributes:
        rotor: from 1, in motor order.
        start: s after the start of the flight.
        share: of thrust and torque that is lost in the end.
        seconds: over which it goes, linearly; 0: at once.
    """

    rotor: int
    start: float
    share: float
    seconds: float

    def lost(self, t: float) -> float:
        """The share lost t seconds after the start of the flight."""
        if t < self.start:
            return 0.0
        return self.share * min(1.0, (t - self.start) / self.seconds if self.seconds else 1.0)


@dataclass(frozen=True)
class Physics:
    """Effects in force; none by default. `KINDS` says what each does; angles here are in rad."""

    rotor_drag: float = 0.0
    inflow: float = 0.0
    forward_lift: float = 0.0
    flapping: float = 0.0
    quadratic_drag: float = 0.0
    damping: tuple[float, float, float] | None = None
    rotor_height: float = 0.0
    wind: tuple[float, float] = (0.0, 0.0)
    gusts: float = 0.0
    ground_effect: float = 0.0
    scatter: float = 0.0
    tilt: float = 0.0
    rotor_inertia: float | None = None
    motor_lag: float | None = None
    lag_of: str = ""
    thrust_curve: float | None = None
    weakening: Weakening | None = None
    weak: float = 0.0
    battery: tuple[float, float] = (0.0, 60.0)
    battery_drop: float = 0.0
    ou_moment: tuple[float, float] = (0.0, 1.0)
    ou_force: tuple[float, float] = (0.0, 1.0)
    slosh: tuple[float, float] = (0.0, 1.2)
    swing: tuple[float, float] = (0.0, 0.5)
    imu_place: tuple[float, float, float] | None = None
    imu_rotation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    throttle_cut: Span | None = None
    idle: float = 0.05
    punch_out: Span | None = None

    @property
    def switched_on(self) -> dict[str, Any]:
        """What differs from the default, by name as on the command line."""
        return {
            f.name.replace("_", "-"): getattr(self, f.name)
            for f in fields(self)
            if getattr(self, f.name) != f.default
        }

    @property
    def has_air(self) -> bool:
        """Whether the air does more than the vehicle's own linear drag and damping."""
        return any(
            (self.rotor_drag, self.inflow, self.forward_lift, self.flapping, self.quadratic_drag)
        )

    def of_vehicle(self, vehicle: Vehicle, random: np.random.Generator) -> Vehicle:
        """The vehicle with everything that is a property of it.

        Args:
            vehicle: as its file has it.
            random: draws the rotors' scatter.
        """
        v, changed = vehicle, dict[str, Any]()
        for name in ("rotor_inertia", "motor_lag", "thrust_curve"):
            if (value := getattr(self, name)) is not None:
                changed[name] = value
        if self.lag_of:
            changed["lag_of"] = self.lag_of
        if self.weak:
            most = hover_thrusts(v)[0]
            for thrust in hover_thrusts(v)[1:]:
                most = (
                    np.maximum(most, thrust) if isinstance(most, np.ndarray) else max(most, thrust)
                )
            changed["T_max"] = self.weak * most
        if self.imu_place is not None:
            changed |= dict(zip(("imu_x", "imu_y", "imu_z"), self.imu_place, strict=True))
        if self.damping is not None:
            d_p, d_q, d_r = self.damping
            changed["damping"] = (d_p * v.Ixx, d_q * v.Iyy, d_r * v.Izz)
            changed["rotational_damping"] = 0.5 * (d_p * v.Ixx + d_q * v.Iyy)
        if self.rotor_height:
            changed["rotor_z"] = -self.rotor_height
        if self.scatter or self.tilt or self.weakening is not None:
            changed["traits"] = self._traits(v, random)
        return replace(v, **changed) if changed else v

    def _traits(self, vehicle: Vehicle, random: np.random.Generator) -> RotorTraits:
        n = len(vehicle.rotors)
        if not self.scatter:
            return replace(even(n), tilt=self.tilt)
        return RotorTraits(
            self._scattered(n, np.shape(vehicle.mass), random),
            self._scattered(n, np.shape(vehicle.mass), random),
            self.tilt,
        )

    def _scattered(
        self, n: int, shape: tuple[int, ...], random: np.random.Generator
    ) -> tuple[Value, ...]:
        """Shares of mean 1: independent, normal, then scaled so that the mean stays exact."""
        drawn = np.maximum(1.0 + self.scatter * random.standard_normal((n, *shape)), LEAST_SHARE)
        drawn = drawn / drawn.mean(axis=0)
        return tuple(float(e) if np.ndim(e) == 0 else e for e in drawn)


IDEAL = Physics()


def _numbers(written: str, checks: Sequence[Any], usual: Sequence[str] = ()) -> Any:
    """A type of value: several with colons between, the last of which may be left out."""

    def parse(text: str) -> tuple[Any, ...]:
        parts = text.split(":")
        missing = len(checks) - len(parts)
        if not 0 <= missing <= len(usual):
            raise argparse.ArgumentTypeError(f"write {written}, got {text!r}")
        if missing:
            parts += usual[-missing:]
        return tuple(check(part) for check, part in zip(checks, parts, strict=True))

    return parse


def _degrees(text: str) -> float:
    return math.radians(between(-45.0, 45.0, "degrees")(text))


def _direction(text: str) -> float:
    return math.radians(between(-360.0, 360.0, "degrees")(text))


def _lag_of(text: str) -> str:
    if text not in LAGS:
        raise argparse.ArgumentTypeError(f"must be one of {', '.join(LAGS)}, got {text!r}")
    return text


def _rotor(text: str) -> int:
    if not text.isascii() or not text.isdigit() or not 1 <= int(text) <= 32:
        raise argparse.ArgumentTypeError(f"must be a motor's number from 1, got {text!r}")
    return int(text)


_parts_of_weakening = _numbers(
    "ROTOR:FROM:SHARE[:S]",
    (_rotor, not_negative, between(0.0, 0.9, "of the thrust"), not_negative),
    ("5",),
)


def _weakening(text: str) -> Weakening:
    return Weakening(*_parts_of_weakening(text))


_part = between(0.0, 0.5, "of the mass")
_meters = between(-5.0, 5.0, "m")
_rate = between(0.0, 20.0, "1/s")

KINDS: dict[str, Kind] = {
    "rotor-drag": Kind(
        "rotor drag (H-force): deceleration in hover, over speed", _rate, "1/S", "0.3"
    ),
    "inflow": Kind(
        "thrust lost against the inflow: deceleration in climb, over its speed", _rate, "1/S", "0.6"
    ),
    "forward-lift": Kind(
        "thrust gained in forward flight: share of the weight, over speed squared",
        between(0.0, 0.1, "s^2/m^2"),
        "S2/M2",
        "0.003",
    ),
    "flapping": Kind(
        "blade flapping: angular acceleration that raises the nose, over speed",
        between(0.0, 50.0, "1/(m s)"),
        "1/MS",
        "1",
    ),
    "quadratic-drag": Kind(
        "quadratic drag: terminal velocity with stopped rotors",
        positive,
        "M/S",
        "20",
    ),
    "damping": Kind(
        "damping rate of roll, pitch and yaw",
        _numbers("P:Q:R", (_rate, _rate, _rate)),
        "P:Q:R 1/S",
        "0.5:0.5:0.05",
    ),
    "rotor-height": Kind("height of the rotors above the CG", _meters, "M", "0.03"),
    "wind": Kind(
        "steady wind, direction from (north is 0)",
        _numbers("M/S[:DEG]", (between(0.0, 40.0, "m/s"), _direction), ("0",)),
        "M/S[:DEG]",
        "5:30",
    ),
    "gusts": Kind(
        "Dryden gusts, horizontal standard deviation", between(0.0, 10.0, "m/s"), "M/S", "1"
    ),
    "ground-effect": Kind(
        "more thrust near the ground; rotor radius in arms", between(0.0, 2.0, "arms"), "R", "0.5"
    ),
    "scatter": Kind(
        "each rotor's k_T and k_M differ: 1 sigma", between(0.0, 0.3, "of them"), "SHARE", "0.03"
    ),
    "tilt": Kind("rotors canted about their arms, in the direction of yaw", _degrees, "DEG", "4"),
    "rotor-inertia": Kind("inertia of one rotor, also with commands", not_negative, "KGM2", "3e-5"),
    "motor-lag": Kind("time constant of the motors", milliseconds, "MS", "40"),
    "lag-of": Kind("what lags: speed, thrust or command", _lag_of, "WHAT", "speed"),
    "thrust-curve": Kind(
        "c of T/T_max = (1 - c) u + c u^2", between(0.0, 1.0, "(linear to square)"), "C", "0.65"
    ),
    "weakening": Kind(
        "a rotor loses this share of its thrust, over this time",
        _weakening,
        "ROTOR:FROM:SHARE[:S]",
        "1:20:0.1:5",
    ),
    "weak": Kind(
        "full thrust over the hover thrust of the most loaded rotor",
        between(1.15, 20.0, "times hover"),
        "RATIO",
        "1.8",
    ),
    "battery": Kind(
        "share of its voltage that the battery loses over this time",
        _numbers("SHARE[:S]", (between(0.0, 0.4, "of the voltage"), positive), ("60",)),
        "SHARE[:S]",
        "0.05:60",
    ),
    "battery-drop": Kind(
        "voltage behind the battery's resistance at hover power, share of all",
        between(0.0, 0.2, "of the voltage"),
        "SHARE",
        "0.03",
    ),
    "ou-moment": Kind(
        "unmodeled moment (Ornstein-Uhlenbeck), rms over inertia on each axis",
        _numbers("RAD/S2[:TAU]", (between(0.0, 50.0, "rad/s^2"), positive), ("1",)),
        "RAD/S2[:TAU]",
        "1:1",
    ),
    "ou-force": Kind(
        "unmodeled force, rms over mass on each axis",
        _numbers("M/S2[:TAU]", (between(0.0, 10.0, "m/s^2"), positive), ("1",)),
        "M/S2[:TAU]",
        "0.3:1",
    ),
    "slosh": Kind(
        "share of the mass that sloshes in a tank",
        _numbers("SHARE[:HZ]", (_part, between(0.1, 20.0, "Hz")), ("1.2",)),
        "SHARE[:HZ]",
        "0.15:1.2",
    ),
    "swing": Kind(
        "share of the mass that swings on a line below the CG",
        _numbers("SHARE[:M]", (_part, between(0.05, 20.0, "m")), ("0.5",)),
        "SHARE[:M]",
        "0.1:0.5",
    ),
    "imu-place": Kind(
        "position of the IMU from the CG: forward, right, down",
        _numbers("X:Y:Z", (_meters, _meters, _meters)),
        "X:Y:Z M",
        "0.03:0.02:-0.02",
    ),
    "imu-rotation": Kind(
        "rotation of the IMU relative to the body: roll, pitch, yaw",
        _numbers("R:P:Y", (_degrees, _degrees, _degrees)),
        "R:P:Y DEG",
        "1:-1:1",
    ),
    "throttle-cut": Kind(
        "all rotors at idle in the air, duration", span, "FROM:S[:EVERY]", "20:0.3"
    ),
    "idle": Kind("command of a rotor at idle", between(0.0, 0.3, "of full"), "SHARE", "0.05"),
    "punch-out": Kind("full throttle, duration", span, "FROM:S[:EVERY]", "30:0.5"),
}
"""Every effect by its name on the command line."""

ALL = "all"
"""Stands for every effect at its usual value."""


def parse_physics(text: str) -> tuple[str, Any]:
    """The field of `Physics` and its value, for NAME or NAME=VALUE; `ALL` stands for itself.

    Raises:
        argparse.ArgumentTypeError: no such effect, or its value makes no sense.
    """
    return (ALL, True) if text == ALL else parse_choice(text, KINDS, "effect")


def make_physics(parsed: Iterable[tuple[str, Any]]) -> Physics:
    """All of them together; of an effect given twice the last counts."""
    chosen: list[tuple[str, Any]] = []
    for field, value in parsed:
        chosen += map(parse_physics, KINDS) if field == ALL else [(field, value)]
    return gather(IDEAL, chosen, frozenset())


def physics_help() -> str:
    """One line an effect, for --help."""
    return f"{choice_help(KINDS)}\n  {ALL:<26} all of these at their usual values"
