"""From a result to margins and gains: what `gcs-sysid tune` shows.

The delay of the loop, from the gyro's sample to the rotors' command, is what the result's rotor
delay says where it was identified from commands; else it is given or assumed.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.control.gain_design import LIMITS, propose
from gcs_sysid.control.hover_dynamics import HoverDynamics, check_needs, hover_dynamics
from gcs_sysid.control.loop_margins import (
    Margins,
    StepResponse,
    frequencies,
    margins_of,
    open_loops,
    step_response,
)
from gcs_sysid.control.rate_loops import Autopilot, RateLoop, read_loop
from gcs_sysid.errors import InputError
from gcs_sysid.exports.exported_vehicle import ExportedVehicle, KnownEstimate, complete
from gcs_sysid.exports.vehicle_ensemble import drawn_vehicles
from gcs_sysid.intervals import Z95
from gcs_sysid.model.parameter_file import mission_planner_lines, qgroundcontrol_lines
from gcs_sysid.model.parameters import AXES

SCHEMA = "gcs-sysid-tune/1"
ASSUMED_DELAY = (0.005, 0.0015)
"""s and standard deviation: two periods of a 400 Hz loop, for computing and the ESCs' protocol."""
IDENTIFIED_DELAY = "identified, from command to rotor"
_ALIKE = ("mass", "Ixx", "Iyy", "Izz")
_APART = 0.1
"""Relative difference beyond which two results are not of one flight."""
BAND = (2.5, 97.5)
"""Percentiles of the draws, shown as the band."""


@dataclass(frozen=True)
class AxisStudy:
    """One axis with one set of gains.

    Attributes:
        whole: margins with the attitude loop closed, of every draw, the nominal vehicle first.
        alone: the same of the rate loop alone (Acro).
        attitude: response to an attitude step.
        rate: response to a rate step, with no attitude loop.
    """

    whole: Margins
    alone: Margins
    attitude: StepResponse
    rate: StepResponse


@dataclass(frozen=True)
class TuningStudy:
    """Margins of the gains that a vehicle has and of those proposed.

    Attributes:
        vehicle: identified.
        dynamics: linear, with draws from the covariance.
        delay: s and standard deviation.
        delay_from: where that comes from.
        now: loops with the gains that the vehicle has; None: not given.
        proposed: loops with the proposed gains.
        studies: name ("now", "proposed") -> roll, pitch, yaw.
        notes: what was assumed.
    """

    vehicle: ExportedVehicle
    dynamics: HoverDynamics
    delay: tuple[float, float]
    delay_from: str
    now: RateLoop | None
    proposed: RateLoop
    studies: Mapping[str, tuple[AxisStudy, ...]]
    notes: tuple[str, ...]

    @property
    def loops(self) -> dict[str, RateLoop]:
        """Name -> loops."""
        now = {} if self.now is None else {"now": self.now}
        return {**now, "proposed": self.proposed}


def study(
    vehicle: ExportedVehicle,
    autopilot: Autopilot,
    parameters: Mapping[str, float],
    *,
    delay: tuple[float, float] | None = None,
    draws: int = 100,
    seed: int = 1,
) -> TuningStudy:
    """Judge the gains that a vehicle has, and propose gains.

    Args:
        vehicle: identified.
        autopilot: that it flies with.
        parameters: of the autopilot, as far as they are known; without any gain among them there
            are none to judge.
        delay: s and standard deviation from the gyro's sample to the rotors' command.
        draws: from the covariance.
        seed: of the draws.

    Raises:
        MissingError: the result does not carry gains; says which flight would help.
        InputError: parameters make no sense, or no gains keep the margins.
    """
    loop = read_loop(autopilot, parameters, vehicle.rotors)
    # What is missing is named before anything is drawn.
    check_needs(vehicle)
    late, origin = _delay(vehicle, loop, delay)
    vehicles = [vehicle, *drawn_vehicles(vehicle, draws, seed)]
    dynamics = hover_dynamics(vehicles, loop, late, seed, traded=origin == IDENTIFIED_DELAY)
    proposed = propose(dynamics, loop)
    gains = [name for name in loop.as_parameters() if name.endswith(("_P", "RATE_P"))]
    known = any(name in parameters for name in gains)
    now = loop if known else None
    loops = {"proposed": proposed} if now is None else {"now": now, "proposed": proposed}
    studies = {name: axis_studies(dynamics, one) for name, one in loops.items()}
    filters = sorted(set(loop.assumed) - set(loop.as_parameters()))
    notes = list(dynamics.notes)
    if filters:
        notes.append(f"not given, at the autopilot's defaults: {', '.join(filters)}")
    return TuningStudy(vehicle, dynamics, late, origin, now, proposed, studies, tuple(notes))


def _delay(
    vehicle: ExportedVehicle, loop: RateLoop, given: tuple[float, float] | None
) -> tuple[tuple[float, float], str]:
    if given is not None:
        return given, "given"
    found = vehicle.known.get("rotor_delay")
    if found is not None:
        # Commands are stamped before they act; that they are held for a period is half of one.
        late = -found.value - 0.5 * loop.period
        if -loop.period < late < 0.05:  # beyond, it is one of telemetry
            return (max(late, 0.0), found.std or 0.0), IDENTIFIED_DELAY
    return ASSUMED_DELAY, "assumed"


def joined_vehicle(vehicle: ExportedVehicle, other: ExportedVehicle) -> ExportedVehicle:
    """A vehicle with what another result of it adds, as of commands beside speeds.

    The first takes precedence. Values derived from two others are computed again.

    Raises:
        InputError: they are not of one vehicle, or contradict.
    """
    if vehicle.rotors != other.rotors:
        raise InputError("the two results have different rotors: give two of the same vehicle")
    for name in _ALIKE:
        one, two = vehicle.known.get(name), other.known.get(name)
        if one is None or two is None or not one.value:
            continue
        if abs(two.value / one.value - 1.0) > _APART + Z95 * (two.std or 0.0) / abs(one.value):
            raise InputError(
                f"the two results have {name} = {one.value:.4g} and {two.value:.4g}: give two of "
                "one flight, with the same scale"
            )
    known = {n: q for n, q in other.known.items() if not q.derived}
    known |= {n: q for n, q in vehicle.known.items() if not q.derived}
    complete(known)
    return replace(vehicle, known=known)


def with_delay(vehicle: ExportedVehicle) -> ExportedVehicle:
    """The vehicle with the delay from commands to rotors, where its result has it."""
    found = vehicle.result.timing.get("rotor_delay")
    if (
        not vehicle.result.rotor_input.motors
        or found is None
        or found.value is None
        or found.status not in ("identified", "weak")
    ):
        return vehicle
    delay = KnownEstimate(found.value, found.std, origin=found.status)
    return replace(vehicle, known={**vehicle.known, "rotor_delay": delay})


def axis_studies(dynamics: HoverDynamics, loop: RateLoop) -> tuple[AxisStudy, ...]:
    """Margins and step responses of roll, pitch and yaw."""
    omega = frequencies(loop)
    whole = open_loops(dynamics, loop, omega)
    alone = open_loops(dynamics, loop, omega, attitude=False)
    nominal = dynamics.first(1)
    return tuple(
        AxisStudy(
            margins_of(omega, whole[:, :, axis]),
            margins_of(omega, alone[:, :, axis]),
            step_response(nominal, loop, axis),
            step_response(nominal, loop, axis, of="rate"),
        )
        for axis in range(3)
    )


def document_of(tuning: TuningStudy) -> dict[str, Any]:
    """The study as `--json` writes it."""
    dynamics = tuning.dynamics
    plant = {}
    for axis, name in enumerate(AXES):
        values = dynamics.effectiveness[:, axis, axis]
        plant[name] = {
            "effectiveness": _banded(values),
            "damping": float(dynamics.damping[0, axis, axis]),
            "reaction": float(dynamics.reaction[0, axis, axis]),
            "unit": "rad/s^2 per normalized torque",
        }
    return {
        "schema": SCHEMA,
        "autopilot": tuning.proposed.autopilot,
        "source": tuning.vehicle.result.source,
        "loop_rate": tuning.proposed.rate,
        "motor_lag": _banded(dynamics.lag),
        "delay": {"value": tuning.delay[0], "std": tuning.delay[1], "from": tuning.delay_from},
        "plant": plant,
        "parameters": {name: loop.as_parameters() for name, loop in tuning.loops.items()},
        "margins": {
            name: {
                axis: {
                    "attitude_loop_closed": _margins(one.whole),
                    "rate_loop_alone": _margins(one.alone),
                    "attitude_step": _step(one.attitude),
                    "rate_step": _step(one.rate),
                }
                for axis, one in zip(AXES, studies, strict=True)
            }
            for name, studies in tuning.studies.items()
        },
        "notes": list(tuning.notes),
    }


def _margins(margins: Margins) -> dict[str, Any]:
    return {
        "phase_deg": _banded(margins.phase),
        "gain_db": _banded(margins.gain),
        "crossover_rad_s": _banded(margins.crossover),
        "delay_s": _banded(margins.delay),
        "stable_share": float((margins.phase > 0.0).mean()),
    }


def _step(step: StepResponse) -> dict[str, Any]:
    return {"overshoot": float(step.overshoot[0]), "rise_s": float(step.rise[0])}


def _banded(values: Array) -> dict[str, float | None]:
    """Nominal value and 95 % of the draws; None for what is not finite."""
    finite = values[np.isfinite(values)]
    low, high = np.percentile(finite, BAND) if len(finite) else (np.nan, np.nan)
    numbers = {"value": values[0], "low": low, "high": high, "worst": values.min()}
    return {k: float(v) if np.isfinite(v) else None for k, v in numbers.items()}


def tuning_text(tuning: TuningStudy) -> str:
    """The study as lines for a terminal."""
    loop = tuning.proposed
    lines = [
        f"{loop.autopilot}, rate loop {loop.rate:g} Hz, motor lag "
        f"{1e3 * tuning.dynamics.lag[0]:.0f} ms, delay {1e3 * tuning.delay[0]:.1f} ms "
        f"({tuning.delay_from}), {len(tuning.dynamics) - 1} draws from the covariance",
        "",
        f"{'':10}{'axis':7}{'crossover':>11}{'phase margin':>20}{'gain margin':>20}"
        f"{'overshoot':>11}",
        f"{'':10}{'':7}{'rad/s':>11}{'deg (95 %)':>20}{'dB (95 %)':>20}{'attitude':>11}",
    ]
    for name, studies in tuning.studies.items():
        for axis, one in zip(AXES, studies, strict=True):
            margins = one.whole
            label = name if axis == "roll" else ""
            if margins.phase[0] <= 0.0:
                tail = f"{'unstable':>20}{'':20}{'':>11}"
            else:
                tail = (
                    f"{_interval(margins.phase, 0):>20}{_interval(margins.gain, 1):>20}"
                    f"{100.0 * one.attitude.overshoot[0]:>9.0f} %"
                )
            lines.append(f"{label:10}{axis:7}{margins.crossover[0]:>11.1f}{tail}")
    lines += ["", *_gain_table(tuning)]
    lines += [f"note: {note}" for note in tuning.notes]
    return "\n".join(lines)


def _interval(values: Array, digits: int) -> str:
    if not np.isfinite(values[0]):
        return "-"
    finite = values[np.isfinite(values)]
    low, high = np.percentile(finite, BAND)
    return f"{values[0]:.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"


def _gain_table(tuning: TuningStudy) -> list[str]:
    proposed = tuning.proposed.as_parameters()
    now = {} if tuning.now is None else tuning.now.as_parameters()
    lines = [f"{'parameter':18}{'now':>12}{'proposed':>12}"]
    for name, value in proposed.items():
        old = f"{now[name]:.4g}" if name in now else "-"
        lines.append(f"{name:18}{old:>12}{value:>12.4g}")
    return lines


def parameter_text(tuning: TuningStudy, suffix: str) -> str:
    """The proposed gains as a file that a ground station loads.

    Args:
        tuning: with the gains.
        suffix: ".params" for QGroundControl, ".param" or ".parm" for Mission Planner.
    """
    values = tuning.proposed.as_parameters()
    now = {} if tuning.now is None else tuning.now.as_parameters()
    notes = {n: f"was {now[n]:.6g}" for n in values if n in now}
    head = [
        f"# Gains proposed by gcs-sysid tune for {tuning.vehicle.name} "
        f"({tuning.proposed.autopilot}), from",
        f"# {tuning.vehicle.result.source or 'a result'}.",
        "# Review each before writing it. Fly first with room, and a hand on the mode switch.",
        f"# Design: at least {LIMITS.phase_margin:g} deg and {LIMITS.gain_margin:g} dB over the "
        "interval of the parameters; predicted:",
    ]
    for axis, one in zip(AXES, tuning.studies["proposed"], strict=True):
        head.append(
            f"#   {axis}: phase margin {_interval(one.whole.phase, 0)} deg, gain margin "
            f"{_interval(one.whole.gain, 1)} dB, crossover {one.whole.crossover[0]:.1f} rad/s"
        )
    head += [f"# Note: {note}" for note in tuning.notes]
    head = ["".join(c if c.isprintable() else " " for c in line) for line in head]
    rows = (
        qgroundcontrol_lines(values, notes)
        if suffix == ".params"
        else mission_planner_lines(values, notes)
    )
    return "\n".join([*head, "#", *rows]) + "\n"


def with_deviations(vehicle: ExportedVehicle, deviations: Mapping[str, float]) -> ExportedVehicle:
    """The vehicle with standard deviations of values given by hand."""
    known = dict(vehicle.known)
    for name, std in deviations.items():
        known[name] = replace(known[name], std=std)
    return replace(vehicle, known=known)
