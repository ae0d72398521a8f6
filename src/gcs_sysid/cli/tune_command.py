"""`gcs-sysid tune`: margins of the gains that a vehicle has, and gains for it. Nothing is sent.

Bode diagram of the loops as SVG, complete, with the band of the covariance.

Every axis has a column: magnitude above, phase below, of the loop broken at the axis' torque with
the attitude loop closed. The band holds 95 % of the draws, points are measured.
"""

import argparse
import functools
import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.cli.airframe_choice import beside_result
from gcs_sysid.cli.output import as_json, check_outputs, deliver, is_device, say, write_text
from gcs_sysid.control.frequency_response import BAND, Replay
from gcs_sysid.control.loop_margins import bode, check_needs, frequencies, open_loops
from gcs_sysid.control.rate_loops import AUTOPILOTS, Autopilot, RateLoop
from gcs_sysid.control.tuning_study import (
    LIMITS,
    Change,
    TuningStudy,
    document_of,
    joined_vehicle,
    misread_speeds,
    parameter_text,
    response_csv,
    study,
    tuning_text,
    with_delay,
    with_deviations,
)
from gcs_sysid.errors import InputError
from gcs_sysid.exports import FORMATS
from gcs_sysid.exports.exported_vehicle import (
    ExportedVehicle,
    MissingError,
    assemble,
    drawn_vehicles,
)
from gcs_sysid.exports.indi_effectiveness import effect_range
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.model.parameter_file import SUFFIXES, read_parameter_file
from gcs_sysid.model.parameters import AXES
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.report.drawing import BLUE, INK, PALE, area, line, picture, polyline, text
from gcs_sysid.report.parts import Markup, element
from gcs_sysid.results.result_file import read_result
from gcs_sysid.signals.sampling import SampleBlock

_RESPONSE = "frequency-response"
_TARGETS: dict[str, tuple[str, ...]] = {
    "px4-params": ("px4", ".params"), "ardupilot-param": ("ardupilot", ".param", ".parm"),
    "betaflight-cli": ("betaflight", ".txt"), "inav-cli": ("inav", ".txt"),
    "betaflight-adrc": ("betaflight-adrc", ".txt"), _RESPONSE: ("", ".csv"),
}  # fmt: skip
"""Autopilot, empty for any, and endings of its files."""
_OWN = {"betaflight": "pid_process_denom", "inav": "dterm_lpf_hz"}
"""Lines of blackbox headers that the other does not write."""
_PREFIX = {"px4": "MC_", "ardupilot": "ATC_", **_OWN, "betaflight-adrc": _OWN["betaflight"]}
"""That parameters of an autopilot begin with."""
_EFFECTIVENESS = {"indi": "indiflight", "paparazzi": "paparazzi"}
_COLUMN, _UPPER, _LOWER, _LEFT, _TOP, _GAP = 300.0, 190.0, 170.0, 58.0, 66.0, 26.0
_LOW, _HIGH = 0.5, 300.0
"""rad/s, shown."""
_DECIBELS, _DEGREES = (-40.0, 40.0), (-270.0, -90.0)
_STROKES = {"now": "#c2571a", "proposed": "#1f6fb4"}


def run(options: argparse.Namespace) -> int:
    """Run the command; 1 where the result does not carry gains."""
    _check_outputs(options)
    vehicle = _vehicle(options)
    try:
        if options.to in _EFFECTIVENESS:
            return _effectiveness(options, vehicle)
        return _gains(options, vehicle)
    except MissingError as error:
        say(f"gcs-sysid: {options.result}: {error}")
        return 1


def _check_outputs(options: argparse.Namespace) -> None:
    """See beforehand whether all that is asked for can be written."""
    if (options.to is None) != (options.output is None):
        raise InputError("--to and -o go together: give both, or neither")
    given = options.result, options.beside, options.parameters
    read = [path for path in given if path is not None]
    check_outputs(options.json, options.output, options.bode, force=options.force, sources=read)
    if (options.json, options.output, options.bode).count("-") > 1:
        raise InputError("--json, --bode and --output: only one can go to standard output")
    _, *wanted = _TARGETS.get(options.to, ("",))
    if not wanted or options.output == "-" or is_device(options.output):
        return
    if Path(options.output).suffix not in wanted:
        raise InputError(f"{options.output}: {options.to} is written to a file NAME{wanted[0]}")


def _vehicle(options: argparse.Namespace) -> ExportedVehicle:
    airframe = beside_result(options)
    given = {name: float(value) for name, value, _ in options.set}
    deviations = {name: std for name, _, std in options.set if std}
    result = read_result(Path(options.result))
    vehicle = with_delay(assemble(result, airframe, given, options.name))
    if options.beside is not None:
        other = with_delay(assemble(read_result(Path(options.beside)), airframe))
        vehicle = joined_vehicle(vehicle, other)
    return with_deviations(vehicle, deviations)


def _tuned(options: argparse.Namespace, vehicle: ExportedVehicle) -> TuningStudy:
    parameters, received, flight = _parameters(options, vehicle)
    autopilot = _autopilot(options, vehicle, received, parameters)
    try:
        return study(
            vehicle,
            autopilot,
            parameters,
            delay=options.delay,
            draws=options.draws,
            seed=options.seed,
            flight=flight,
            change=_change(options, flight),
        )
    except ValueError as error:
        raise InputError(f"{options.result}: {error}") from error


def _change(options: argparse.Namespace, flight: list[SampleBlock] | None) -> Change | None:
    """What is to be tried; None: what is proposed."""
    if not options.what_if:
        return None
    if flight is None:
        raise InputError("--what-if flies along the set-points of a log: give the LOG")
    tried = dict(options.what_if)
    gains, (payload, *place) = tried.get("gains"), tried.get("payload", (0.0, 0.0, 0.0, 0.0))
    parameters = None if gains == "proposed" else read_parameter_file(Path(gains)) if gains else {}
    wanted = Change(parameters, payload, tuple(place), tried.get("thrust", 1.0))
    if not wanted.words:
        raise InputError("--what-if changes nothing: full thrust is that of the result already")
    return wanted


def _gains(options: argparse.Namespace, vehicle: ExportedVehicle) -> int:
    tuning = _tuned(options, vehicle)
    suffix = next(each[1] for each in _TARGETS.values() if each[0] == tuning.loop.autopilot)
    responses = options.to == _RESPONSE
    there = tuning.measured if responses else tuning.proposed
    deliver(
        tuning_text(tuning),
        (options.json, lambda: as_json(document_of(tuning))),
        (options.bode, lambda: bode_svg(tuning)),
        (
            options.output if there else None,
            lambda: response_csv(tuning) if responses else parameter_text(tuning, suffix),
        ),
        force=options.force,
    )
    if options.output is not None and not there:
        say(f"gcs-sysid: {options.output} is not written: see above why")
    return 0 if there or options.output is None else 1


def _effectiveness(options: argparse.Namespace, vehicle: ExportedVehicle) -> int:
    """What INDI has in place of gains, where it is as sure as these."""
    if options.json is not None or options.bode is not None or options.what_if:
        raise InputError("--json, --bode and --what-if apply to gains: leave them out with INDI")
    check_needs(vehicle)
    if vehicle.get("rotor_inertia") is None or vehicle.get("k_T") is None:
        raise MissingError(
            "no INDI without the rotors' inertia, whose reaction in yaw it takes for motion that "
            "no command made: give the result by rotor speeds too (--with)"
        )
    target = FORMATS[_EFFECTIVENESS[options.to]]
    text = target.write(vehicle)
    drawn = drawn_vehicles(vehicle, options.draws, options.seed)
    effect = effect_range(vehicle, drawn, LIMITS.battery)
    ranges = ", ".join(
        f"{axis} {least:.2f} to {m:.2f}" for axis, (least, m) in zip(AXES, effect, strict=True)
    )
    low = f"{100.0 * LIMITS.battery:.0f} %"
    why = f"the effect is surely {ranges} times this, down to {low} of the thrust"
    leave = "" if effect.min() > 0.0 and effect.max() < 2.0 else f"{why}: INDI bears 0 to 2"
    objections = misread_speeds(vehicle)
    if options.parameters is not None and not leave:
        objections = _tuned(options, vehicle).objections
    leave = leave or "; ".join(each.words for each in objections)
    if leave:
        say(f"gcs-sysid: {options.output} is not written, leave it: {leave}")
        return 1
    write_text(options.output, text, force=options.force)
    for note in (why, *target.notes(vehicle)):
        say(f"gcs-sysid: note: {note}")
    return 0


def _parameters(
    options: argparse.Namespace, vehicle: ExportedVehicle
) -> tuple[Mapping[str, float], str, list[SampleBlock] | None]:
    """The autopilot's parameters from a file of them or a log; of a log its name and samples."""
    if options.parameters is None:
        return {}, "", None
    path = Path(options.parameters)
    if path.suffix.lower() in SUFFIXES:
        return read_parameter_file(path), "", None
    # Only who reads a log waits for these.
    from gcs_sysid.session.analysis import aligned_samples
    from gcs_sysid.telemetry.logs import open_log

    log = open_log(path, options.vehicle)
    named = beside_result(options)
    airframe = Airframe("result", vehicle.rotors) if named is None else named
    # The loop by the autopilot's parameters makes torques of the log's commands.
    samples = [*aligned_samples(log, replace(airframe, rotor_input=RotorInput.COMMAND))]
    own = vehicle.result.vehicle.get("sysid")
    others = {each.system for each in log.systems if each != log.vehicle}
    if options.vehicle is None and log.vehicle and own != log.vehicle.system and own in others:
        raise InputError(
            f"{path}: the result is of vehicle {own}, and the log begins with "
            f"{log.vehicle.system}: give --vehicle"
        )
    if not log.parameters:
        raise InputError(
            f"{path}: holds no parameters of the autopilot: give a .params or .param file saved "
            "by the ground station"
        )
    return log.parameters, "" if log.vehicle is None else log.vehicle.key, samples


def _autopilot(
    options: argparse.Namespace,
    vehicle: ExportedVehicle,
    received: str,
    parameters: Mapping[str, Any],
) -> Autopilot:
    wanted = _TARGETS.get(options.to, ("",))[0]
    received = next((name for name, line in _OWN.items() if line in parameters), received)
    named = options.autopilot or wanted or received or vehicle.result.vehicle.get("autopilot")
    if options.autopilot and wanted and options.autopilot != wanted:
        raise InputError(f"--to {options.to} is not for --autopilot {options.autopilot}")
    if named not in AUTOPILOTS:
        raise InputError(f"which autopilot? Give --autopilot, of {', '.join(AUTOPILOTS)}")
    prefix = _PREFIX[named]
    if parameters and not any(name.startswith(prefix) for name in parameters):
        raise InputError(
            f"{options.parameters}: holds no {prefix}* parameters, as gains of {named} are: give a "
            "log or file that has them, or --autopilot if it is another one"
        )
    return cast(Autopilot, named)


def bode_svg(tuning: TuningStudy) -> str:
    """The diagram of the gains now and proposed."""
    width = _LEFT + 3 * (_COLUMN + _GAP)
    height = _TOP + _UPPER + _GAP + _LOWER + 60.0
    title = f"Loops of {tuning.vehicle.name} with {tuning.loop.autopilot}"
    parts: list[Markup] = [_label(_LEFT, 22.0, title, size=16)]
    for i, (name, stroke) in enumerate((n, _STROKES[n]) for n in tuning.studies):
        parts.append(
            _label(_LEFT + 180.0 * i, 42.0, f"{name} (band: 95 % of the interval)", fill=stroke)
        )
    for axis in range(3):
        parts += _grid(axis)
    for name, loop in tuning.loops.items():
        parts += _curves(tuning, loop, _STROKES[name])
    if tuning.what_if is not None and (flown := tuning.what_if.replay) is not None:
        colors = "set-point gray, flown black, modeled as it is orange, then blue"
        parts.append(_label(_LEFT, height, f"what if: {tuning.what_if.change.words}: {colors}"))
        height += 30.0
        for axis in tuning.what_if.axes:
            parts += _replayed(flown, axis, height)
        height += _UPPER + 60.0
    return picture((width, height), title, parts, letters=12)


def _replayed(flown: Replay, axis: int, top: float) -> Iterator[Markup]:
    """Rates along the log's liveliest set-points, and the band of what is tried."""
    shown = {name: np.degrees(values) for name, values in flown.lines(axis).items()}
    most = max(float(np.abs(values).max()) for values in shown.values())
    left, middle = _x(axis, _LOW), top + 0.5 * _UPPER
    across = left + _COLUMN * flown.t / flown.t[-1]

    def at(values: Array) -> list[tuple[float, float]]:
        return [
            *zip(across.tolist(), (middle - 0.5 * _UPPER * values / most).tolist(), strict=True)
        ]

    yield _rule(left, middle, left + _COLUMN, middle)
    yield _label(left, top - 6.0, f"{AXES[axis]}, {flown.t[-1]:.0f} s, up to {most:.0f} deg/s")
    outline = at(shown["then_high"]) + at(shown["then_low"])[::-1]
    yield area(outline, _STROKES["proposed"])
    strokes = {"setpoint": PALE, "flown": INK, "now": _STROKES["now"], "then": BLUE}
    for name, stroke in strokes.items():
        yield polyline(at(shown[name]), stroke, 1.0)


def _curves(tuning: TuningStudy, loop: RateLoop, stroke: str) -> Iterator[Markup]:
    omega = frequencies(loop, 160)
    omega = omega[(omega >= _LOW) & (omega <= _HIGH)]
    loops = open_loops(tuning.dynamics, loop, omega)
    for axis in range(3):
        for values, place in zip(bode(loops[:, :, axis]), (_upper, _lower), strict=True):
            low, high = np.percentile(values, BAND, axis=0)
            band = [*zip(omega, high, strict=True), *zip(omega[::-1], low[::-1], strict=True)]
            yield area(((_x(axis, float(w)), place(float(v))) for w, v in band), stroke)
            nominal = ((_x(axis, w), place(v)) for w, v in zip(omega, values[0], strict=True))
            yield polyline(nominal, stroke, 1.5)
    yield from _measured(tuning, loop, stroke)


def _measured(tuning: TuningStudy, loop: RateLoop, stroke: str) -> Iterator[Markup]:
    """The loops' controllers with the measured responses, each with its 95 % interval."""
    for axis, one in ((AXES.index(name), one) for name, one in tuning.measured.items()):
        found = one.torque
        shown = found.claimed & (found.omega >= _LOW) & (found.omega <= _HIGH)
        omega, half = found.omega[shown], np.minimum(found.half_width[shown], 0.99)
        own = loop.feedback(omega)[:, axis] * found.values[shown]
        size, phase = 20.0 * np.log10(np.abs(own)), np.degrees(np.angle(own))
        phase = np.where(phase > 0.0, phase - 360.0, phase)
        turn = np.degrees(np.arcsin(half))
        for place, middle, low, high in (
            (_upper, size, size + 20.0 * np.log10(1.0 - half), size + 20.0 * np.log10(1.0 + half)),
            (_lower, phase, phase - turn, phase + turn),
        ):
            for w, value, least, most in zip(omega, middle, low, high, strict=True):
                x = _x(axis, w)
                yield line(x, place(least), x, place(most), "", stroke=stroke)
                yield element("circle", cx=f"{x:.1f}", cy=f"{place(value):.1f}", r="2", fill=stroke)


def _x(axis: int, omega: float) -> float:
    share = math.log(omega / _LOW) / math.log(_HIGH / _LOW)
    return _LEFT + axis * (_COLUMN + _GAP) + share * _COLUMN


def _upper(decibels: float) -> float:
    low, high = _DECIBELS
    return _TOP + _UPPER * (high - min(max(decibels, low), high)) / (high - low)


def _lower(degrees: float) -> float:
    low, high = _DEGREES
    share = (high - min(max(degrees, low), high)) / (high - low)
    return _TOP + _UPPER + _GAP + _LOWER * share


def _grid(axis: int) -> Iterator[Markup]:
    left, right = _x(axis, _LOW), _x(axis, _HIGH)
    yield _label(left, _TOP - 4.0, AXES[axis])
    for decibels in range(-40, 41, 20):
        yield _rule(left, _upper(decibels), right, _upper(decibels), bold=decibels == 0)
        if axis == 0:
            yield _label(left - 8.0, _upper(decibels) + 4.0, f"{decibels} dB", anchor="end")
    for degrees in range(-270, -89, 45):
        yield _rule(left, _lower(degrees), right, _lower(degrees), bold=degrees == -180)
        if axis == 0:
            yield _label(left - 8.0, _lower(degrees) + 4.0, f"{degrees}°", anchor="end")
    bottom = _TOP + _UPPER + _GAP + _LOWER
    for omega in (1.0, 10.0, 100.0):
        x = _x(axis, omega)
        yield _rule(x, _TOP, x, _TOP + _UPPER)
        yield _rule(x, _TOP + _UPPER + _GAP, x, bottom)
        yield _label(x, bottom + 16.0, f"{omega:g}", anchor="middle")
    yield _label(0.5 * (left + right), bottom + 34.0, "rad/s", anchor="middle")


def _rule(x1: float, y1: float, x2: float, y2: float, *, bold: bool = False) -> Markup:
    return line(x1, y1, x2, y2, "grid", stroke="#555" if bold else "#ddd")


_label = functools.partial(text, size=12)
