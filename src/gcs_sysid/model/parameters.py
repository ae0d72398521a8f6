"""Every parameter that can be identified, declared once.

The rows of the fits, the status and the verdict, results, screen, report, coach, comparison, fleet
table, exports and the emulator's files all go through `REGISTRY`. The order here is that of theta,
tables, screens and files. The effect of each coefficient on the motion is in `model.rigid_body`.
"""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Literal

from gcs_sysid.model.rotor_input import MEASURED, THROUGH_MOTORS, RotorInput

GRAVITY = 9.80665
"""Standard gravity in m/s^2."""

INPUTS = tuple(RotorInput)
Sign = Literal["positive", "not negative", "any"]
AXES = ("roll", "pitch", "yaw")
ARM = "arm"
"""In reference values, the mean distance of the rotors from the geometric center, m."""


@dataclass(frozen=True)
class ReferenceValue:
    """What a standard deviation is divided by to give a parameter its status.

    Attributes:
        of: parameters (or `ARM`) whose geometric mean it is; none: the value itself.
        share: of that mean.
        or_value: whether the value itself is used if it is larger.
        fixed: in the parameter's unit, in place of all that; 0: none.
    """

    of: tuple[str, ...] = ()
    share: float = 1.0
    or_value: bool = False
    fixed: float = 0.0

    def size(self, value: float, others: Mapping[str, float]) -> float:
        """The reference value of this value, given those of others and the arm."""
        if self.fixed:
            return self.fixed
        if not self.of:
            return abs(value)
        size = self.share * self.counterpart(others)
        return max(size, abs(value)) if self.or_value else size

    def counterpart(self, others: Mapping[str, float]) -> float:
        """Geometric mean of the magnitudes in `of`; 0 if there are none."""
        product = math.prod(abs(others[name]) for name in self.of)
        return product ** (1.0 / len(self.of)) if self.of else 0.0


@dataclass(frozen=True)
class ClockError:
    """Error of a parameter per relative error of the vehicle's clock.

    Rates and thrust need no clock, angular acceleration does: inertia in roll and pitch, where
    torque is known, has all of the error. Gyroscopic torques do not scale, and keep Izz (0.6 to
    1.2), products (0.6 to 1.2) and k_M (-0.5 to 0.2) from following. Thrust is compared with
    gravity, whose mean needs no clock (0.01 to 0.04). Damping absorbs a part of the misfit: 0.1/s
    times Ixx. Drag: 0.3 to 0.6 /s times the mass.

    Attributes:
        power: relative error per share; 1/s where it is of another parameter.
        of: the parameter whose size counts; empty: its own.
    """

    power: float = 0.0
    of: str = ""


_STEADY, _FULL, _SLIGHT = ClockError(), ClockError(1.0), ClockError(0.05)


@dataclass(frozen=True)
class Parameter:
    """One parameter of the vehicle or of its telemetry.

    Attributes:
        name: in results (JSON).
        symbol: in text, as in docs/method/model.md.
        unit: SI.
        meaning: in words.
        excited_by: the motion or signal that makes it observable.
        label: for columns of thirteen letters; empty: the name.
        group: words shared with the parameters that are reported together.
        fit: "scale": mass or thrust, of which one fact must be known; "rotation": read off theta;
            "translation": of the equations of force; "actuator": a coordinate between a rotor's
            telemetry and its thrust (`estimation.rows.actuator_dynamics`).
        theta: entry of theta that it is read off; its own name makes it one.
        torque: of an entry of theta, the terms of its torque: axis, signal of `rigid_body.SIGNALS`
            that it multiplies, and factor. A signal such as "p|q|" of body rates need not be there.
        scale: what its relative value is multiplied by: "thrust" (k_T, T_max), "mass" or "none".
        inputs: kinds of rotor input with which it is observable.
        core: kinds of input with which a complete identification needs it.
        section: of the result: "parameters" or "timing".
        sign: physical bound.
        prior: whether a value and standard deviation may be given before a flight.
        axes: roll 0, pitch 1, yaw 2: whose fit determines it.
        mean_torque: whether the mean torque there determines it, however little else the fit
            explains.
        rigid_body: whether it depends on the gyroscopic torque of a rigid body.
        reference: of its status.
        clock: error by a wrong clock.
        usual: value and standard deviation to expect of a multirotor, relative ones over Ixx of
            its size and mass, lengths over the arm.
        in_flight: whether a simulator that has no place for it flies differently.
        of_vehicle: False for what belongs to the telemetry, which no two flights share.
        optional: whether a result has it only where the flight shows it by itself.
        exponent: power of ten of the unit in tables for people, whatever the size: -3 for ms;
            None: by the size. Files are in SI.
    """

    name: str
    symbol: str
    unit: str
    meaning: str
    excited_by: str
    label: str = ""
    group: str = ""
    fit: Literal["scale", "rotation", "translation", "actuator"] = "rotation"
    theta: str = ""
    torque: tuple[tuple[int, str, float], ...] = ()
    scale: Literal["thrust", "mass", "none"] = "thrust"
    inputs: tuple[RotorInput, ...] = INPUTS
    core: tuple[RotorInput, ...] = ()
    section: Literal["parameters", "timing"] = "parameters"
    sign: Sign = "any"
    prior: bool = False
    axes: tuple[int, ...] = ()
    mean_torque: bool = False
    rigid_body: bool = False
    reference: ReferenceValue = ReferenceValue()
    clock: ClockError = _STEADY
    usual: tuple[float, float] = (0.0, 1.0)
    in_flight: bool = False
    of_vehicle: bool = True
    optional: bool = False
    exponent: int | None = None

    def unit_per(self, own: Collection[str]) -> str:
        """Its unit where the vehicle's mass, arm or both are units, as of `Airframe.own_units`.

        All that is not of time or shape is in proportion to the mass, and all that is read off
        torque over angular acceleration to the arm.
        """
        per = ["kg"] if "mass" in own and self.scale != "none" else []
        per += ["m"] if "arm" in own and self.theta else []
        under = per[0] if len(per) == 1 else f"({' '.join(per)})"
        return f"{self.unit}/{under}" if per else self.unit

    def in_result(self, rotor_input: RotorInput) -> bool:
        """Whether a result with this rotor input has it, even if unobservable."""
        return not self.optional and (rotor_input in self.inputs or self.theta == self.name)


def _axis_damping(axis: int) -> Parameter:
    """Where the axes are damped differently; `rotational_damping` is then that of roll and
    pitch.
    """
    name = AXES[axis]
    return Parameter(
        f"{name}_damping", f"d_{'pqr'[axis]}", "N m s", f"{name} damping torque over {name} rate",
        f"decay of {name}", sign="not negative", axes=(axis,), rigid_body=axis == 2,
        reference=ReferenceValue(("Ixx",), or_value=True), clock=ClockError(0.1, "Ixx"),
        optional=True,
    )  # fmt: skip


def _moment(axis: int, excited_by: str, usual: float) -> Parameter:
    letter = "xyz"[axis]
    name = f"I{letter}{letter}"
    return Parameter(
        name, name, "kg m^2", f"moment of inertia about the body {letter} axis", excited_by,
        group="moments of inertia", theta=name, core=INPUTS, sign="positive", prior=True,
        axes=(axis,), rigid_body=axis == 2, clock=_FULL, usual=(usual, usual),
    )  # fmt: skip


def _product(first: int, second: int) -> Parameter:
    a, b, axes = "xyz"[first], "xyz"[second], AXES
    name = f"I{a}{b}"
    # A product matters against the moments it couples.
    moments = ReferenceValue((f"I{a}{a}", f"I{b}{b}"), 0.3)
    return Parameter(
        name, name, "kg m^2", f"inertia matrix element [{a}, {b}]",
        f"coupling of {axes[first]} and {axes[second]}", group="products of inertia", theta=name,
        core=INPUTS, prior=True, axes=(first, second), rigid_body=True, reference=moments,
        clock=_FULL, usual=(0.0, 0.3),
    )  # fmt: skip


def _offset(name: str, symbol: str, way: str, axis: int) -> Parameter:
    return Parameter(
        name, symbol, "m", f"CG from the geometric center, {way}",
        f"mean {('roll', 'pitch')[axis]} torque of the rotors", group="center of gravity",
        theta=name, torque=((axis, "thrust", (1.0, -1.0)[axis]),),
        scale="none", core=INPUTS, prior=True, axes=(axis,), mean_torque=True,
        reference=ReferenceValue((ARM,), 0.2), usual=(0.0, 0.3), in_flight=True,
    )  # fmt: skip


_AGAINST_GRAVITY = "climbing and sinking against gravity"
_GYROSCOPIC = "yaw and gyroscopic torque"

# Izz over Ixx is near 2 of flat things, 1.7 of multirotors.
_DECLARED = (
    Parameter(
        "mass", "m", "kg", "mass of the whole vehicle", _AGAINST_GRAVITY, group="mass",
        fit="scale", scale="mass", core=INPUTS, sign="positive", prior=True, clock=_SLIGHT,
    ),
    _moment(0, "roll", 1.0),
    _moment(1, "pitch", 1.0),
    _moment(2, _GYROSCOPIC, 1.7),
    _product(0, 1),
    _product(1, 2),
    _product(0, 2),
    _offset("cg_x", "α", "forward", 1),
    _offset("cg_y", "β", "to the right", 0),
    Parameter(
        "k_T", "k_T", "N s^2", "thrust of a rotor over its speed squared", _AGAINST_GRAVITY,
        group="thrust", fit="scale", inputs=MEASURED, core=MEASURED, sign="positive",
        prior=True, clock=_SLIGHT,
    ),
    Parameter(
        "k_M", "k_M", "N m s^2", "torque of a rotor over its speed squared", _GYROSCOPIC,
        group="rotor torque", theta="moment_ratio", inputs=MEASURED, core=MEASURED,
        sign="positive", prior=True, axes=(2,), rigid_body=True, clock=_FULL,
    ),
    Parameter(
        "T_max", "T_max", "N", "thrust of a rotor at full command", _AGAINST_GRAVITY,
        group="thrust", fit="scale", inputs=THROUGH_MOTORS, core=THROUGH_MOTORS, sign="positive",
        clock=_SLIGHT,
    ),
    Parameter(
        "thrust_curve", "c", "1", "T/T_max = (1-c) u + c u^2", "torque at low and at high command",
        fit="actuator", scale="none", inputs=THROUGH_MOTORS,
        reference=ReferenceValue(fixed=1.0),
    ),
    # Of usual propellers k_M / k_T is 0.07 of the arm.
    Parameter(
        "moment_ratio", "k_M/k_T", "m", "rotor torque over rotor thrust", _GYROSCOPIC,
        group="rotor torque", theta="moment_ratio", torque=((2, "yaw", 1.0),), scale="none",
        core=THROUGH_MOTORS, sign="positive", prior=True, axes=(2,), rigid_body=True, clock=_FULL,
        usual=(0.07, 0.07),
    ),
    # Damping matters against inertia at 1 rad/s, a rotor against a five-hundredth of the body.
    Parameter(
        "rotational_damping", "d", "N m s", "damping torque over body rate", "decay of rotation",
        label="rot_damping", theta="rotational_damping",
        torque=tuple((axis, rate, -1.0) for axis, rate in enumerate("pqr")),
        sign="not negative", prior=True,
        axes=(0, 1, 2), rigid_body=True, reference=ReferenceValue(("Ixx",), or_value=True),
        clock=ClockError(0.1, "Ixx"), in_flight=True,
    ),
    *(_axis_damping(axis) for axis in range(3)),
    Parameter(
        "rotor_inertia", "J_r", "kg m^2", "inertia of one rotor about its axis",
        "changes of rotor speed", theta="rotor_inertia",
        torque=((0, "qH", 1.0), (1, "pH", -1.0), (2, "dH", 1.0)), inputs=MEASURED,
        sign="not negative", prior=True, axes=(0, 1, 2), rigid_body=True,
        reference=ReferenceValue(("Izz",), 0.002, or_value=True), clock=_FULL, usual=(0.0, 0.002),
        in_flight=True,
    ),
    Parameter(
        "linear_drag", "D", "N s/m", "drag force over velocity", "horizontal speed",
        fit="translation", scale="mass", sign="not negative",
        reference=ReferenceValue(("mass",), 0.05, or_value=True), clock=ClockError(0.5, "mass"),
        in_flight=True,
    ),
    # 10 ms of delay cost 30 % on Izz.
    Parameter(
        "rotor_delay", "τ_r", "s", "rotor stream behind the IMU stream", "fast rotation",
        fit="actuator", scale="none", section="timing", prior=True,
        reference=ReferenceValue(fixed=0.02), clock=_FULL, of_vehicle=False, exponent=-3,
    ),
    Parameter(
        "motor_lag", "τ_m", "s", "first-order lag from command to rotor speed", "fast rotation",
        fit="actuator", scale="none", inputs=THROUGH_MOTORS, section="timing",
        sign="not negative", reference=ReferenceValue(fixed=0.05), clock=_FULL, in_flight=True,
        exponent=-3,
    ),
)  # fmt: skip

REGISTRY: dict[str, Parameter] = {p.name: p for p in _DECLARED}
"""Every parameter and timing value, by name."""
PARAMETERS = {n: p for n, p in REGISTRY.items() if p.section == "parameters"}
"""Those under `parameters` of a result."""
TIMING = {n: p for n, p in REGISTRY.items() if p.section == "timing"}
"""Those under `timing`."""

THETA = tuple(n for n, p in REGISTRY.items() if p.theta == n)
"""Names of theta's entries, relative to k_T (commands: T_max), except lengths."""
INERTIA = tuple(n for n, p in REGISTRY.items() if p.group.endswith("of inertia"))
"""The elements of the inertia matrix."""
AXIS_DAMPINGS = ("roll_damping", "pitch_damping", "yaw_damping")
"""Names of the damping of each axis."""
CORE_OF: dict[RotorInput, tuple[str, ...]] = {
    kind: tuple(n for n, p in REGISTRY.items() if kind in p.core) for kind in INPUTS
}
"""What a complete identification consists of, by what the rotors' input is."""


def grouped(name: str) -> tuple[str, ...]:
    """Parameters of a group, such as "center of gravity"."""
    return tuple(n for n, p in REGISTRY.items() if p.group == name)
