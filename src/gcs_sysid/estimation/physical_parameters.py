"""From relative estimates and one scale anchor to physical parameters, with status."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from gcs_sysid.estimation.actuator_dynamics import CURVE, DELAY, LAG
from gcs_sysid.estimation.rigid_body_test import RigidBodyTest
from gcs_sysid.estimation.rotation import RotationFit
from gcs_sysid.estimation.rotor_signals import RotorInput
from gcs_sysid.estimation.scale import resolve_scale
from gcs_sysid.estimation.translation import TranslationFit
from gcs_sysid.model import rigid_body as rb
from gcs_sysid.model.scale_reference import Known, ScaleReference

Status = Literal["identified", "given", "weak", "unobservable"]

_BODY = ("mass", "Ixx", "Iyy", "Izz", "Ixy", "Iyz", "Ixz", "cg_x", "cg_y")
CORE = (*_BODY, "k_T", "k_M")
"""What a complete identification with rotor speeds consists of."""
CORE_OF: dict[RotorInput, tuple[str, ...]] = {
    "speed": CORE,
    "command": (*_BODY, "T_max", "moment_ratio"),
}
"""The same by what the rotors' input is."""

IDENTIFIED_BELOW = 0.05
"""Standard deviation over reference value, below which a parameter counts as identified."""
UNOBSERVABLE_ABOVE = 0.5
"""The same, above which the data say nothing useful."""

WEAK_BELOW_R2 = 0.8
"""Share of an axis' angular acceleration explained, below which nothing there is identified."""
UNOBSERVABLE_BELOW_R2 = 0.5
"""The same, below which it is not even weak.

Where gusts or unmodelled torques move the vehicle more than its rotors do, the controller's
reaction to them is mistaken for the vehicle's response, and intervals are confidently wrong."""

_CG_FLOOR = 6e-6
"""Of the arm (a micrometre or two), least standard deviation of the CG: speeds in whole rpm
leave a slow remainder of that size that no scatter within one flight tells."""

_CURVE_SHAPE = 1e-3
"""Of the CG's offset with commands, least standard deviation: thrust curves are not quite of the
form fitted (measured: 0.13 % where the lag is the speed's, not the command's; see `_slowness`)."""

_DELAY_YARDSTICK = 0.02
"""s, what a delay is measured against: 10 ms of it cost 30 % on Izz."""

_LAG_YARDSTICK = 0.05
"""s, what a motor's lag is measured against."""

_AXES: dict[str, tuple[int, ...]] = {
    "Ixx": (0,),
    "Iyy": (1,),
    "Izz": (2,),
    "Ixy": (0, 1),
    "Iyz": (1, 2),
    "Ixz": (0, 2),
    "k_M": (2,),
    "moment_ratio": (2,),
    "rotational_damping": (0, 1, 2),
    "rotor_inertia": (0, 1, 2),
}
"""The axes whose fit a parameter rests on. (The CG rests on the mean torque: on none.)"""


COUPLED = frozenset({"Izz", "Ixy", "Iyz", "Ixz", "k_M", "moment_ratio", "rotational_damping",
                     "rotor_inertia"})  # fmt: skip
"""What rests on the vehicle being a rigid body, see `rigid_body_test`."""

_MODEL_ERROR = 0.005
"""Relative, of what a model still tells that is known to be wrong elsewhere: the scatter within a
flight is that of noise, and says nothing of it."""


_COMMAND_ERROR = 0.0015
"""Relative, of what rests on commands: a motor is not quite of first order, nor its thrust quite a
parabola of the command. On flights of the emulator it leaves 0.1 to 0.25 %, in the thrust curve as
well; see `_slowness`."""
_QUICK_MOTOR = 0.03
"""s, lag of the motors that these errors were measured with."""
_LAG_ERROR = 0.02
"""Relative, of a motor's lag: up to 3.5 % at 100 Hz and on recorded flights."""


_CLOCK_POWERS = dict.fromkeys(
    ("Ixx", "Iyy", "Izz", "Ixy", "Iyz", "Ixz", "k_M", "moment_ratio", "rotor_inertia",
     "rotor_delay", "motor_lag"), 1.0
) | dict.fromkeys(("mass", "k_T", "T_max"), 0.05)  # fmt: skip
"""Relative error per share by which the clock is fast. Rates and thrust need no clock, angular
acceleration does: inertia in roll and pitch, where torque is known, is off by all of it. Gyroscopic
torques do not scale, and keep Izz (0.6 to 1.2), products (0.6 to 1.2) and k_M (-0.5 to 0.2) from
following. Thrust is held against gravity, and no clock tells its mean (0.01 to 0.04)."""
_CLOCK_DAMPING = 0.1
"""1/s, of Ixx: the same of rotational damping, which takes up a part of what does not fit."""
_CLOCK_DRAG = 0.5
"""1/s, of the mass: the same of drag (0.3 to 0.6)."""


@dataclass(frozen=True)
class Value:
    """A parameter's value, standard deviation and status; None where there is nothing."""

    value: float | None
    std: float | None
    status: Status


NOTHING = Value(None, None, "unobservable")


def physical_parameters(
    anchor: ScaleReference,
    rotation: RotationFit | None,
    translation: TranslationFit | None,
    arm: float,
    known: Mapping[str, Known] | None = None,
    rotor_input: RotorInput = "speed",
    rigid_body_test: RigidBodyTest | None = None,
    lateness: float = 0.0,
) -> dict[str, Value]:
    """Physical parameters of the fits, at the anchor's scale.

    With commands T_max and the thrust curve take the places of k_T and k_M, and a rotor's inertia
    cannot be told.

    Args:
        anchor: the known value that sets the scale.
        rotation: relative to k_T or T_max; None while there is none.
        translation: the same over m, and D / m; None while there is none.
        arm: m, mean rotor distance: the yardstick for CG and moment ratio.
        known: priors on mass and k_T; those on the rotation are in its fit.
        rotor_input: what the fits are relative to.
        rigid_body_test: whether the vehicle moves like a rigid body.
        lateness: s, known delay of the gyro, and so of the attitude.
    """
    thrust = "k_T" if rotor_input == "speed" else "T_max"
    own = ("k_T", "k_M") if rotor_input == "speed" else ("T_max", "thrust_curve")
    more = ("moment_ratio", "rotational_damping", "rotor_inertia", "linear_drag")
    out = dict.fromkeys((*_BODY, *own, *more), NOTHING)
    slowness = 0.0 if rotor_input == "speed" else _slowness(rotation)
    doubt = _COMMAND_ERROR * slowness
    if rotation is not None:
        # Lengths need no scale at all.
        for name, index in (("cg_x", rb.CG_X), ("cg_y", rb.CG_Y)):
            offset = float(rotation.theta[index])
            shape = _CURVE_SHAPE * slowness * offset
            std = math.hypot(rotation.std[index], _CG_FLOOR * arm, shape)
            out[name] = _judged(offset, std, 0.2 * arm)
        ratio = float(rotation.theta[rb.MOMENT_RATIO])
        std = math.hypot(float(rotation.std[rb.MOMENT_RATIO]), doubt * ratio)
        out["moment_ratio"] = _judged(ratio, std, abs(ratio))
    scale = resolve_scale(anchor, translation, known or {})
    # What a wrong thrust curve would do to thrust over mass, as a share of it.
    bend = 0.0
    if translation is not None and translation.kappa > 0.0:
        bend = translation.curve_slope / translation.kappa
    bent = 0.0 if rotation is None else abs(bend) * float(rotation.coordinates_std[CURVE])
    for name, known_value, share in (
        ("mass", scale.mass, scale.mass_share),
        (thrust, scale.thrust, scale.thrust_share),
    ):
        if known_value is not None:
            std = known_value * math.hypot(share, bent, doubt)
            out[name] = _judged(known_value, std, known_value)
    if anchor.kind in out and anchor.std == 0.0:
        out[anchor.kind] = Value(anchor.value, 0.0, "given")
    if translation is not None and scale.mass is not None and math.isfinite(translation.delta):
        if rotor_input == "speed" and rotation is not None:
            lateness += max(-float(rotation.delay), 0.0)  # rotors ahead: the IMU is behind
        spread = math.hypot(translation.delta_std, lateness * translation.quickness)
        drag, std = scale.mass * translation.delta, scale.mass * spread
        out["linear_drag"] = _judged(drag, std, max(abs(drag), 0.05 * scale.mass))
    if rotation is not None:
        if scale.thrust is not None:
            # A given T_max does not depend on the curve.
            spread = math.hypot(scale.thrust_share, doubt)
            out |= _scaled(rotation, scale.thrust, spread, 0.0 if anchor.kind == thrust else bend)
        if rotor_input == "command":
            out["thrust_curve"] = _coordinate(rotation, CURVE, 1.0, doubt)
            out["rotor_inertia"] = NOTHING
            out.pop("k_M", None)
        for name in _AXES.keys() & out.keys():
            out[name] = _doubted(out[name], float(rotation.r_squared[list(_AXES[name])].min()))
        if rigid_body_test is not None and rigid_body_test.contradicted:
            for name in COUPLED & out.keys():
                out[name] = replace(out[name], status="unobservable")
            for name in ("Ixx", "Iyy"):
                told = out[name]
                if told.value is not None and told.std is not None:
                    doubt = math.hypot(told.std, _MODEL_ERROR * told.value)
                    out[name] = replace(told, std=doubt)
    return out


def with_clock_error(values: Mapping[str, Value], share: float) -> dict[str, Value]:
    """Values with what they may be off by, were the vehicle's clock wrong.

    Args:
        values: parameters or timing, by name.
        share: by which it may run fast or slow.
    """
    if not share:
        return dict(values)
    errors = {
        name: power * abs(value.value)
        for name, power in _CLOCK_POWERS.items()
        for value in (values.get(name, NOTHING),)
        if value.value is not None
    }
    for name, rate, of in (
        ("rotational_damping", _CLOCK_DAMPING, "Ixx"),
        ("linear_drag", _CLOCK_DRAG, "mass"),
    ):
        size = values.get(of, NOTHING).value
        if size is not None:
            errors[name] = rate * size
    return {
        name: replace(value, std=math.hypot(value.std, share * errors[name]))
        if name in errors and value.std and value.status != "given"
        else value
        for name, value in values.items()
    }


def rests_on_prior(rotation: RotationFit) -> frozenset[str]:
    """Parameters of whose information more than half does not come from the flight's data."""
    leaning = rotation.std**2 < 0.5 * rotation.data_std**2
    names = {name for name, leans in zip(rb.THETA, leaning, strict=True) if leans}
    return frozenset(names | ({"k_M"} if "moment_ratio" in names else set()))


def rotor_delay(rotation: RotationFit | None) -> Value:
    """How far the rotor stream lags behind the IMU stream, s."""
    if rotation is None or rotation.r_squared.min() < UNOBSERVABLE_BELOW_R2:
        return NOTHING
    return _coordinate(rotation, DELAY, _DELAY_YARDSTICK)


def motor_lag(rotation: RotationFit | None) -> Value:
    """Time constant from command to rotor, s."""
    if rotation is None or rotation.r_squared.min() < UNOBSERVABLE_BELOW_R2:
        return NOTHING
    doubt = _LAG_ERROR * float(rotation.coordinates[LAG])
    return _coordinate(rotation, LAG, _LAG_YARDSTICK, doubt)


def _slowness(rotation: RotationFit | None) -> float:
    """What the errors of a motor's form are multiplied with, at least 1.

    Whether a rotor's speed lags or its command is of no account for small changes; for large ones
    it is, the more so the longer the lag: 60 ms leave 0.44 %, three times what 30 ms leave.
    """
    return 1.0 if rotation is None else max(1.0, float(rotation.coordinates[LAG]) / _QUICK_MOTOR)


def _coordinate(rotation: RotationFit, which: int, yardstick: float, doubt: float = 0.0) -> Value:
    """One of the grid's coordinates; given where it was not estimated.

    Args:
        rotation: the fit.
        which: coordinate.
        yardstick: what it is measured against.
        doubt: what its form may be off by, in its unit.
    """
    value = float(rotation.coordinates[which])
    std = float(rotation.coordinates_std[which])
    if std == 0.0:
        return Value(value, 0.0, "given")
    return _judged(value, math.hypot(std, doubt), yardstick)


def _scaled(rotation: RotationFit, thrust: float, spread: float, bend: float) -> dict[str, Value]:
    """Inertia and coefficients: relative values times thrust (k_T or T_max).

    Args:
        rotation: the fit.
        thrust: of the scale.
        spread: its relative standard deviation, the thrust curve's part apart.
        bend: relative change of thrust with the thrust curve.
    """
    values = rotation.theta * thrust
    n, curve = rb.N_THETA, rb.N_THETA + CURVE
    full = rotation.full_covariance
    # Errors of the curve move the relative values and the scale together.
    variance = rotation.std**2 + rotation.theta * bend * (
        2.0 * full[:n, curve] + rotation.theta * bend * full[curve, curve]
    )
    std = np.hypot(np.sqrt(np.maximum(variance, 0.0)) * thrust, values * spread)
    Ixx, Iyy, Izz = (float(v) for v in values[:3])
    scales = {
        "Ixx": Ixx,
        "Iyy": Iyy,
        "Izz": Izz,
        # A product matters against the moments it couples.
        "Ixy": 0.3 * math.sqrt(abs(Ixx * Iyy)),
        "Iyz": 0.3 * math.sqrt(abs(Iyy * Izz)),
        "Ixz": 0.3 * math.sqrt(abs(Ixx * Izz)),
        # Damping matters against inertia at 1 rad/s; a rotor against a hundredth of the body.
        "rotational_damping": max(abs(float(values[rb.DAMPING])), Ixx),
        "rotor_inertia": max(abs(float(values[rb.ROTOR_INERTIA])), 0.002 * Izz),
    }
    out = {
        name: _judged(float(values[i]), float(std[i]), scale)
        for name, scale in scales.items()
        for i in (rb.THETA.index(name),)
    }
    k_M = float(values[rb.MOMENT_RATIO])
    out["k_M"] = _judged(k_M, float(std[rb.MOMENT_RATIO]), abs(k_M))
    return out


def _judged(value: float, std: float, yardstick: float) -> Value:
    if not (math.isfinite(value) and math.isfinite(std)):
        return NOTHING
    ratio = std / yardstick if yardstick > 0.0 else math.inf
    if ratio < IDENTIFIED_BELOW:
        return Value(value, std, "identified")
    return Value(value, std, "weak" if ratio < UNOBSERVABLE_ABOVE else "unobservable")


def _doubted(value: Value, r_squared: float) -> Value:
    """The value with its status lowered where the model explains too little."""
    if value.status == "given" or r_squared >= WEAK_BELOW_R2:
        return value
    status: Status = "weak" if r_squared >= UNOBSERVABLE_BELOW_R2 else "unobservable"
    return replace(value, status=status if value.status != "unobservable" else value.status)


def verdict(
    parameters: Mapping[str, Value],
    rotor_input: RotorInput = "speed",
    rigid_body_test: RigidBodyTest | None = None,
) -> tuple[str, tuple[str, ...]]:
    """One word for the whole, and why it is not better."""
    core = CORE_OF[rotor_input]
    missing = [n for n in core if parameters[n].status == "unobservable"]
    weak = [n for n in core if parameters[n].status == "weak"]
    reasons = []
    if missing:
        reasons.append(f"the data do not tell {', '.join(missing)}")
    if weak:
        reasons.append(f"only roughly known: {', '.join(weak)}")
    torque = core[-1]
    if rigid_body_test is not None and rigid_body_test.contradicted:
        share = ", ".join(f"{value:.2f}" for value in rigid_body_test.share)
        reasons.append(
            f"it does not move like a rigid body (gyroscopic torque on roll, pitch, yaw {share} "
            "times that of one): Izz, products and rotor torque cannot be told"
        )
    elif {"Izz", torque} <= set(missing) | set(weak):
        reasons.append(
            f"Izz and {torque} share one scale: only rotation about several axes at once, "
            "such as roll and yaw together, tells them apart"
        )
    ratio = parameters.get("moment_ratio", NOTHING)
    if ratio.value is not None and ratio.status == "identified" and ratio.value < 0.0:
        reasons.append(
            f"{torque} is negative: every rotor turns the vehicle the wrong way; "
            "check spin in the airframe file"
        )
    identified = [n for n in core if parameters[n].status == "identified"]
    if not identified:
        return "refused", tuple(reasons)
    return ("partial" if reasons else "identified"), tuple(reasons)
