"""The parameters that a flight suggests to the autopilot, and files that ground stations load.

Conventions, by the autopilots' own parameter descriptions:

- MOT_THST_EXPO and THR_MDL_FAC are c of T/T_max = (1 - c) u + c u^2; MOT_THST_HOVER and
  MPC_THR_HOVER the thrust of a hover over full thrust, before that curve is inverted.
- CA_ROTORn_PX, PY are from the center of gravity, forward and right, in m; KM is the moment ratio,
  positive for counter-clockwise. INS_POSn_* and EKF2_IMU_POS_* are forward, right and down, of the
  IMU from the CG.
- MOT_SPIN_MIN is a share of the whole range of the outputs, MOT_BAT_VOLT_* are volts of the pack.

QGroundControl loads lines of vehicle, component, name, value and MAV_PARAM_TYPE between tabs;
Mission Planner lines of NAME,VALUE. Both skip lines that begin with #. Nothing is sent: a pilot
loads the file, sees the differences and decides.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from gcs_sysid.errors import InputError
from gcs_sysid.health.balance import pooled
from gcs_sysid.health.hover_tuning import TUNING
from gcs_sysid.health.vehicle_health import Health
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameter_file import SUFFIXES, parameter_lines

_FULL, _EMPTY = 4.2, 3.3
"""V of a LiPo cell: what MOT_BAT_VOLT_MAX and MIN are a pack's multiple of."""
_CELLS = 24


@dataclass(frozen=True)
class Suggestion:
    """A parameter's value by this flight.

    Attributes:
        name: of the parameter.
        quantity: its value, in the autopilot's unit.
        now: what the log says that it was; None: not logged.
        note: where it comes from.
    """

    name: str
    quantity: Estimate
    now: float | None
    note: str


def suggested(health: Health) -> tuple[Suggestion, ...]:
    """All parameters that the flight determines well enough to change them."""
    if not health.available:
        return ()
    of = {"px4": _px4, "ardupilot": _ardupilot}.get(health.autopilot)
    return () if of is None else tuple(of(health))


def proposed(flights: Sequence[Health]) -> tuple[Suggestion, ...]:
    """What flights of one vehicle determine together: one value each.

    Args:
        flights: in their order; those of other vehicles and without a hover do not count.
    """
    found: dict[str, list[Suggestion]] = {}
    for health in flights:
        for one in () if health.apart else suggested(health):
            found.setdefault(one.name, []).append(one)
    return tuple(
        replace(some[-1], quantity=pooled([one.quantity for one in some]))
        for some in found.values()
    )


def _make(health: Health, name: str, quantity: Estimate | None, note: str) -> Iterator[Suggestion]:
    if quantity is None or quantity.value is None or quantity.std is None:
        return
    if not (math.isfinite(quantity.value) and math.isfinite(quantity.std)):
        return
    yield Suggestion(name, quantity, health.parameters.get(name), note)


def _curve(health: Health) -> Estimate | None:
    if health.curve is None or health.curve.c.std is None:
        return None
    # A curve that the flight does not determine is not suggested.
    return health.curve.c if 0.0 < health.curve.c.std < TUNING.usable_curve else None


def _px4(health: Health) -> Iterator[Suggestion]:
    curve = _curve(health)
    yield from _make(health, "THR_MDL_FAC", curve, "thrust curve")
    if curve is not None:
        yield from _make(health, "MPC_THR_HOVER", health.hover_thrust, "with THR_MDL_FAC as here")
    assert health.airframe is not None
    assert health.cg is not None
    if health.arm_known:
        ratio = health.airframe.priors.get("moment_ratio")
        for i, rotor in enumerate(health.airframe.rotors):
            for axis, place, offset in zip("XY", (rotor.x, rotor.y), health.cg, strict=True):
                yield from _make(
                    health, f"CA_ROTOR{i}_P{axis}", _less(place, offset), "m from the CG as flown"
                )
            if ratio is not None:
                turn = Estimate(rotor.spin * ratio[0], ratio[1], "m", std_given=ratio[1])
                yield from _make(health, f"CA_ROTOR{i}_KM", turn, "moment ratio as given")
        yield from _imu(health, "EKF2_IMU_POS_")


def _ardupilot(health: Health) -> Iterator[Suggestion]:
    curve = _curve(health)
    yield from _make(health, "MOT_THST_EXPO", curve, "thrust curve")
    if curve is not None:
        yield from _make(health, "MOT_THST_HOVER", *_thrust_hover(health))
    yield from _make(
        health,
        "MOT_SPIN_MIN",
        _spin_min(health),
        "0.03 above the least output at which all rotors were measured turning",
    )
    if health.battery is not None:
        high, low, _ = health.battery
        cells = round(high / (_FULL - 0.05))
        unset = not health.parameters.get("MOT_BAT_VOLT_MAX")
        if unset and 1 <= cells <= _CELLS and cells * _EMPTY < high <= cells * (_FULL + 0.15):
            note = f"{cells} LiPo cells by {high:.1f} V, the highest seen ({low:.1f} V the lowest)"
            for name, volt in (("MAX", _FULL), ("MIN", _EMPTY)):
                yield from _make(
                    health, f"MOT_BAT_VOLT_{name}", Estimate(cells * volt, 0.0, "V"), note
                )
    if health.arm_known:
        yield from _imu(health, "INS_POS1_")


def _thrust_hover(health: Health) -> tuple[Estimate | None, str]:
    """Throttle of a hover, as ArduPilot has it before it makes up for the battery's voltage.

    With v the voltage over MOT_BAT_VOLT_MAX, an output u is that of the thrust f(v u), and the
    throttle is that thrust times lift_max = (1 - c) v + c v^2 (AP_MotorsMulticopter).
    """
    hover, curve = health.hover_thrust, health.curve
    full = health.parameters.get("MOT_BAT_VOLT_MAX", 0.0)
    note = "with MOT_THST_EXPO as here"
    if not full > 0.0 or hover is None or curve is None or health.hover_throttle is None:
        return hover, note
    if health.battery is None or curve.c.value is None or health.hover_throttle.value is None:
        return None, note
    c, u = curve.c.value, health.hover_throttle.value
    v = min(health.battery[2] / full, 1.0)
    value = ((1.0 - c) * u * v + c * (u * v) ** 2) * ((1.0 - c) * v + c * v**2)
    assert hover.value is not None
    assert hover.std is not None
    std = math.hypot(hover.std * value / hover.value, TUNING.voltage_std * value)
    at = f"{health.battery[2]:.1f} V of MOT_BAT_VOLT_MAX {full:.1f} V"
    note = f"{note}, at {at}, air as on the ground"
    return Estimate(value, std, "1", std_given=TUNING.voltage_std * value), note


def _spin_min(health: Health) -> Estimate | None:
    """A little above the least output at which all rotors turned, over the range of outputs."""
    low, high = (health.parameters.get(f"MOT_PWM_{end}", 0.0) for end in ("MIN", "MAX"))
    if not 0.0 < low < high:
        low, high = 1000.0, 2000.0
    now = health.parameters.get("MOT_SPIN_MIN")
    if health.idle is None or now is None:
        return None
    share = (health.idle - low) / (high - low)
    # In flight no output is below MOT_SPIN_MIN: only an idle on the ground shows it.
    if not 0.0 < share < now - TUNING.idle_std:
        return None
    return Estimate(share + TUNING.above_idle, TUNING.idle_std, "1", std_given=TUNING.idle_std)


def _imu(health: Health, prefix: str) -> Iterator[Suggestion]:
    assert health.airframe is not None
    assert health.cg is not None
    place = health.airframe.imu_position
    if place is None:
        return
    for axis, value, offset in zip("XY", place[:2], health.cg, strict=True):
        yield from _make(health, f"{prefix}{axis}", _less(value, offset), "m from the CG as flown")


def _less(place: float, offset: Estimate) -> Estimate:
    assert offset.value is not None
    return Estimate(place - offset.value, offset.std, "m", std_given=offset.std_given)


def check_suffix(path: Path) -> None:
    """See that a name's ending stands for a format.

    Raises:
        InputError: it stands for none.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(
            f"{path}: end its name with .params (QGroundControl) or .param (Mission Planner)"
        )


def parameter_file(flights: Sequence[Health], suffix: str) -> str:
    """The file's text.

    Args:
        flights: of one vehicle, that hover; at least one.
        suffix: of the file: ".params" is QGroundControl's, others are Mission Planner's.

    Raises:
        InputError: they suggest no parameter.
    """
    found, health = proposed(flights), flights[-1]
    names = ", ".join(Path(flight.source).name for flight in flights if not flight.apart)
    if not found:
        raise InputError(f"{names}: no hover there suggests parameters of the autopilot")
    address = int(health.vehicle.get("sysid") or 1), int(health.vehicle.get("compid") or 1)
    values: dict[str, float] = {}
    notes: dict[str, str] = {}
    for one in found:
        value = one.quantity.value
        assert value is not None
        half = one.quantity.half or 0.0
        now = "" if one.now is None else f"; was {one.now:.6g}"
        interval = f"{value - half:.6g} to {value + half:.6g}" if half else "no interval"
        values[one.name], notes[one.name] = round(value, 6), f"{interval} ({one.note}{now})"
    seconds = sum(flight.seconds for flight in flights if not flight.apart)
    lines = [
        f"# Suggested by gcs-sysid health from {names}, {seconds:.0f} s of hover.",
        "# Values with 95 % intervals; review each before writing it to the vehicle.",
        *(f"# Assumed: {text}" for text in health.assumptions),
        "#",
        *parameter_lines(values, notes, suffix, address),
    ]
    return "\n".join(lines) + "\n"
