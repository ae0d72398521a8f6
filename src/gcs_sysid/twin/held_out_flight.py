"""`gcs-sysid twin`: a result, flown along a log where the result has not seen it.

A result of another flight has seen none of the log: all of it is judged, but for the seconds in
which the attitude filter settles, and each half of it gives the noise that the other half's errors
are compared with. Of a result of the same flight nothing is held out; the model is then fitted
again, to the first part of the flight, and judged on the rest.
"""

import filecmp
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.errors import InputError, NoAnswerError
from gcs_sysid.model.airframe import ANCHORS, Airframe, builtin_names, load_airframe
from gcs_sysid.results.parameter_samples import found_in_flight
from gcs_sysid.results.result import Result
from gcs_sysid.session.analysis import analyze_log
from gcs_sysid.session.chain import ChainOptions
from gcs_sysid.twin.measured_flight import FlightRecorder
from gcs_sysid.twin.prediction_errors import HORIZONS, FlightPart, Twin, judge
from gcs_sysid.twin.twin_flight import TwinFlight

FITTED_SHARE = 0.6
"""Share of the flight that is fitted; the rest is predicted."""
_SETTLING, _SETTLING_SHARE = 5.0, 0.4
"""s in which the complementary filter finds attitude and gyro bias, and the share of a part of the
flight that may be left out for it."""


def fly_held_out(
    result: Result,
    log: Path,
    airframe: Airframe | None = None,
    wanted: tuple[int, int | None] | None = None,
    progress: Callable[[float], None] | None = None,
    seed: int = 0,
) -> TwinFlight:
    """Fly a result along a log, over every held-out stretch of 0.1, 0.3, 1 and 3 s.

    Args:
        result: of this flight or of another one of the same vehicle.
        log: its file.
        airframe: with a scale; None: that of the result.
        wanted: system and perhaps component; None: the first autopilot in the log.
        progress: called with the share of the work done.
        seed: of the samples of the covariance.

    Raises:
        InputError: the log cannot be read, or does not fit the result.
        NoAnswerError: the result lacks what a flight needs, or the log is too short.
    """
    result.need_scale()
    vehicle = airframe_of_result(result) if airframe is None else airframe
    if len(vehicle.rotors) != len(result.airframe.get("rotors") or vehicle.rotors):
        raise InputError(
            f"the result has {len(result.airframe['rotors'])} rotors, the airframe "
            f"{len(vehicle.rotors)}: give the airframe that the result was analyzed with"
        )
    # The other kind of input would need other coefficients.
    vehicle = replace(vehicle, rotor_input=result.rotor_input)
    on_progress = progress or (lambda _: None)
    with closing(FlightRecorder()) as recorder:
        whole = analyze_log(
            log, vehicle, wanted, None, lambda share: on_progress(0.5 * share), observers=[recorder]
        )
        if whole.rotor_input != result.rotor_input:
            raise InputError(
                f"{log}: has no {result.rotor_input}s of the rotors, which the result was "
                "identified from: analyze this log by itself"
            )
        same = is_same_flight(result, whole, log)
        return _flown(result, whole, recorder, log, (vehicle, wanted), on_progress, seed, same=same)


def fly_own_flight(
    result: Result,
    recorder: FlightRecorder,
    log: Path,
    airframe: Airframe,
    wanted: tuple[int, int | None] | None = None,
    start: float = 0.0,
) -> TwinFlight:
    """The same of a result of this flight, whose analysis the recorder has looked at.

    The recorder has what was flown; `start` is s after the first record, from which the log was
    analyzed.

    Raises:
        InputError: the log cannot be read.
        NoAnswerError: the result lacks what a flight needs, or the log is too short.
    """
    vehicle = replace(airframe, rotor_input=result.rotor_input), wanted
    return _flown(result, result, recorder, log, vehicle, lambda _: None, 0, same=True, start=start)


def _flown(
    result: Result,
    whole: Result,
    recorder: FlightRecorder,
    log: Path,
    of: tuple[Airframe, tuple[int, int | None] | None],
    on_progress: Callable[[float], None],
    seed: int,
    *,
    same: bool,
    start: float = 0.0,
) -> TwinFlight:
    """Judge a result along what was recorded while the whole log was analyzed."""
    vehicle, wanted = of
    since = max((float(segment["end"]) for segment in whole.segments), default=0.0)
    flown, notes = result, []
    if since:
        notes.append(f"the vehicle changed at {since:.1f} s; the flight before is left out")
    lag = whole.timing.get("motor_lag")
    record = recorder.record((lag.value if lag else None) or 0.0, str(log))
    times = record.flown(since)
    if len(times) < 2:
        raise NoAnswerError(f"{log}: no flight in it has attitude, rates and rotors at once")
    if same:
        cut = float(times[round(FITTED_SHARE * (len(times) - 1))])
        options = ChainOptions(start=max(since, start), end=cut)
        flown = analyze_log(
            log, vehicle, wanted, options, lambda share: on_progress(0.5 + 0.5 * share)
        )
        judged = [((cut, np.inf), _settled(times, since, cut))]
        spans = ((cut, float(times[-1])),)
        if flown.verdict != "identified":
            notes.append(f"the fit to the first part alone is {flown.verdict}")
    else:
        middle = float(times[len(times) // 2])
        first, second = _settled(times, since, middle), (middle, np.inf)
        judged = [(first, second), (second, first)]
        spans = ((first[0], float(times[-1])),)
        notes.append("noise and disturbances of each half of the log are taken from the other half")
    notes += _doubts(flown)
    record = record.of_body(np.radians(found_in_flight(flown, "imu_rotation", (3,))))
    model = flown.model()
    # Vehicles drawn from the covariance; the standard deviation is then known to 10 %.
    samples = flown.samples(48, seed, given=False)
    ensemble = flown.model(samples).over_stretches()
    twin = Twin(model, ensemble, record)
    accuracy, growth = judge(twin, judged, record.has_velocity)
    if growth is None:
        raise NoAnswerError(
            f"{log}: no stretch of {HORIZONS[0]:g} s without a gap in both parts of the flight: "
            "it is too short, or the link lost too much"
        )
    if twin.carried.any:
        notes.append(
            "moments that the model lacks, as they are at the start of a stretch, are carried on: "
            + twin.carried.says
        )
    if not record.has_velocity:
        notes.append("the log has no velocity: drag and velocity are not judged")
    return TwinFlight(flown, result.source, str(log), same, spans, accuracy, growth, tuple(notes))


def _settled(times: Array, since: float, until: float) -> FlightPart:
    """The part of a flight from when the filters have settled, up to a time."""
    begin = max(float(times[0]), since)
    return begin + min(_SETTLING, _SETTLING_SHARE * (until - begin)), until


def is_same_flight(result: Result, whole: Result, log: Path) -> bool:
    """Whether a result is of this log: of the same file, or of the same data by another name."""
    if _alike(result.validation, whole.validation):
        return True
    source = Path(result.source)
    if source.is_file() and log.is_file():
        beside = source.stem == log.stem and source.parent == log.parent
        return beside or filecmp.cmp(source, log, shallow=False)
    # A result that was moved: the name is what is left. A .ulg and a .tlog may be of one flight.
    return bool(result.source) and source.stem == log.stem


def _alike(a: Mapping[str, Any], b: Mapping[str, Any]) -> bool:
    """Whether two validations are of the same data: scale and givens do not move them."""
    first, second = a.get("r_squared"), b.get("r_squared")
    if not isinstance(first, dict) or not isinstance(second, dict) or first.keys() != second.keys():
        return False
    pairs = [(x, second[axis]) for axis, x in first.items()]
    numbers = [(x, y) for x, y in pairs if isinstance(x, float) and isinstance(y, float)]
    return bool(numbers) and all(abs(x - y) <= 1e-9 for x, y in numbers)


def airframe_of_result(result: Result) -> Airframe:
    """The airframe of a result, with its scale, as far as the result holds it.

    Raises:
        InputError: it has no rotors or no scale.
    """
    airframe = result.layout
    if airframe is None:
        raise InputError("the result has no rotor positions: give --airframe")
    if airframe.name in builtin_names():
        # It also says how well the rotors' positions are known.
        named = load_airframe(airframe.name)
        named = named if np.allclose(named.arm, airframe.arm) else named.with_arm(airframe.arm)
        if named.geometry.shape == airframe.geometry.shape and np.allclose(
            named.geometry, airframe.geometry
        ):
            airframe = named
    if result.scale is not None and result.scale.anchor in ANCHORS:
        return airframe.with_anchor(result.scale.anchor, result.scale.value)
    mass = result.parameters.get("mass")
    if mass is None or not mass.value:
        raise InputError("the result has no scale: give --airframe and --mass")
    return airframe.with_anchor("mass", mass.value)


def _doubts(result: Result) -> list[str]:
    found = {axis: gain for axis, gain in result.disturbance.items() if gain > 1.0}
    if not found:
        return []
    axes = ", ".join(f"{axis} {gain:.0f}" for axis, gain in found.items())
    return [f"disturbed air or unmodeled moments while the model was fitted (nats/s): {axes}"]
