"""From a result to margins and gains: what `gcs-sysid tune` shows.

The delay of the loop, from the gyro's sample to the rotors' command, is what the result's rotor
delay says where it was identified from commands; else it is given or assumed.

Gains for a vehicle are the fastest loops that keep their margins over the whole interval. For each
axis the crossover is raised until a margin would fall below its design value on any draw from the
covariance: with the rate loop alone (Acro) and with the attitude loop. I, D and the attitude gain
follow the crossover in fixed proportions, so that what is chosen is one number and the lead D/P.
"""

import functools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.control.frequency_response import (
    BAND,
    FlownSignals,
    MeasuredAxis,
    Replay,
    flown_signals,
    lateness,
    measured_axes,
    measured_margins,
    measured_response,
    replay,
    smooth_ratio,
)
from gcs_sysid.control.loop_margins import (
    HoverDynamics,
    Margins,
    StepResponse,
    check_needs,
    closed_loops,
    frequencies,
    hover_dynamics,
    hover_point,
    margins_of,
    open_loops,
    step_response,
)
from gcs_sysid.control.rate_loops import Autopilot, AxisGains, RateLoop, read_loop
from gcs_sysid.errors import InputError
from gcs_sysid.exports.exported_vehicle import (
    ExportedVehicle,
    KnownEstimate,
    complete,
    drawn_vehicles,
)
from gcs_sysid.judgement.prediction import parted
from gcs_sysid.judgement.status import LINES
from gcs_sysid.model.estimate import Objection
from gcs_sysid.model.parameter_file import parameter_lines
from gcs_sysid.model.parameters import AXES
from gcs_sysid.results.words import wrapped
from gcs_sysid.signals.sampling import SampleBlock
from gcs_sysid.significance import Z95, normal_limit


@dataclass(frozen=True)
class DesignLimits:
    """What a proposal keeps to.

    Attributes:
        phase_margin: deg, with the attitude loop closed, on every draw. The requirement is 45 deg;
            5 deg of it may be lost to what the linear model leaves out (benchmarks/tune.py measures
            it), the rest is for battery and air.
        gain_margin: dB, the same; the requirement is 6 dB.
        reduction_margin: dB by which the gain may fall, as with a sagging battery.
        integral: I/P over the crossover, a tenth: costs 6 deg of phase.
        attitude: attitude gain over the crossover, a quarter: the attitude is well damped.
        observers: wo over wc, tried with ADRC.
        b0: that its CLI takes.
        leads: s, D/P that are tried on roll and pitch. PX4's default is 0.02, ArduPilot's 0.027;
            beyond, noise decides and not phase. Yaw has no D, as with both autopilots.
        crossovers: rad/s that are tried.
        authority: share of the thrust left above or below hover that an error of `error` rad/s may
            take: beyond, rotors saturate in everyday flying.
        error: rad/s on roll, pitch and yaw.
        attitude_most: 1/s on roll, pitch and yaw: attitude gains that users fly.
        draws: from the covariance, that a choice is judged by.
        required: deg and dB, what the proposal keeps for sure, on all draws, a loop period later
            than modeled and at `battery`; what is above of the other margins is for finding it.
        battery: share of the thrust that is left.
        payload: of the mass, that may be taken on besides: rotors turn faster, and react less.
        step: largest change of a gain at once.
        unmodeled: share of the response that the model may lack: the 7 deg, in rad, by which
            `phase_margin` is above the requirement. 2 dB of gain are more.
        low_passes: Hz, cutoffs of the gyro's that are tried where its own may be another.
    """

    phase_margin: float = 52.0
    gain_margin: float = 8.0
    reduction_margin: float = 7.0
    integral: float = 0.1
    attitude: float = 0.25
    observers: tuple[float, ...] = (1.5, 2.5, 4.0)
    b0: tuple[float, float] = (100.0, 65535.0)
    leads: tuple[float, ...] = (0.0, 0.005, 0.01, 0.015, 0.02, 0.025, 0.03, 0.035)
    crossovers: tuple[float, float, int] = (1.0, 60.0, 60)
    authority: float = 0.5
    error: tuple[float, float, float] = (1.5, 1.5, 0.5)
    attitude_most: tuple[float, float, float] = (10.0, 10.0, 4.0)
    draws: int = 25
    required: tuple[float, float] = (45.0, 6.0)
    battery: float = 0.8
    payload: float = 0.2
    step: float = 2.0
    unmodeled: float = 0.12
    low_passes: tuple[float, float, int] = (3.0, 300.0, 25)


LIMITS = DesignLimits()
_SURE = normal_limit()
"""Standard deviations within which a delay is surely known."""


def propose(dynamics: HoverDynamics, loop: RateLoop) -> RateLoop:
    """The loop with gains for this vehicle; filters and rates stay as they are.

    The dynamics are of the nominal vehicle and draws from its covariance.

    Raises:
        InputError: no gains keep the margins.
    """
    few = dynamics.first(LIMITS.draws)
    omega = frequencies(loop, 160)
    plant = few.response(omega, loop.period)
    for axis in range(3):
        loop = loop.with_gains(axis, _axis(few, plant[:, :, axis, axis], loop, axis, omega))
    # With the other axes' loops closed the margins are a little others: what lacks is taken back.
    least = LIMITS.phase_margin - 0.5, LIMITS.gain_margin - 0.2
    for _ in range(12):
        short = (_worst(few, loop, frequencies(loop)) < least).any(axis=1)
        if not short.any():
            return loop
        for lacking in map(int, np.flatnonzero(short)):
            loop = loop.with_gains(lacking, _scaled(loop.gains[lacking], 0.94))
    raise InputError(
        "no gains keep the margins on "
        + " and ".join(AXES[axis] for axis in np.flatnonzero(short))
        + ": the axes are coupled too strongly; give the mixer the vehicle's own geometry first"
    )


def sure_margins(
    dynamics: HoverDynamics, loop: RateLoop, measured: Mapping[str, MeasuredAxis]
) -> Array:
    """(3, 2) least phase and gain margin (deg, dB) of each axis over all draws.

    With and without attitude loop, a loop period later than modeled, or where the flight surely was
    later as much as it may have been, with the thrust of a full and of a low battery; and the lower
    bound of the phase margin by the measured response. The dynamics are of the nominal vehicle and
    draws.
    """
    omega = frequencies(loop)
    seen = (late + _SURE * std for late, std in flown_late(loop, measured) if late > _SURE * std)
    later = replace(dynamics, delay=dynamics.delay + max([loop.period, *seen]))
    low = replace(
        later,
        effectiveness=LIMITS.battery * later.effectiveness,
        # J_r dT / (2 k_T Omega), of speeds that carry the payload too.
        reaction=LIMITS.battery * later.reaction / np.sqrt(1.0 + LIMITS.payload),
    )
    least = np.minimum(_worst(later, loop, omega), _worst(low, loop, omega))
    for axis, name in enumerate(AXES):
        flown = measured_margins(measured[name], dynamics, loop, axis) if name in measured else None
        if flown is not None:
            least[axis, 0] = min(least[axis, 0], np.percentile(flown.phase, BAND[0]))
    return least


def flown_late(
    loop: RateLoop, measured: Mapping[str, MeasuredAxis]
) -> tuple[tuple[float, float], ...]:
    """By how much the loop that flew is later than modeled, and the standard deviation, s.

    Of the whole loop, in which it does not matter whose stamps are late; and of the controller
    alone, which is surer, where filters act behind the logged gyro. Empty: neither is known
    better than a delay that is assumed.
    """
    most = dict(zip(AXES, LIMITS.attitude_most, strict=True))
    vehicle = lateness((one.torque, one.model, most[name]) for name, one in measured.items())
    laws = [each.late for each in measured.values() if each.late is not None]
    # A gyro's filters are the same for all axes.
    own = min(laws, key=lambda each: each[1]) if laws else (0.0, 0.0)
    # What makes the logged gyro late makes the vehicle late, and the controller early.
    whole = vehicle[0] - 0.5 * loop.averaged + own[0], float(np.hypot(vehicle[1], own[1]))
    seen = (whole, own) if laws else (whole,)
    return tuple(each for each in seen if each[1] < ASSUMED_DELAY[0])


def late_objections(
    dynamics: HoverDynamics, loop: RateLoop, measured: Mapping[str, MeasuredAxis]
) -> tuple[Objection, ...]:
    """A loop that acts later than its gains, filters and delay say, by more than margins allow.

    Or a controller earlier than its own say: then it has others.
    """
    seen = flown_late(loop, measured)
    bounds = [(late - _SURE * std, late) for late, std in seen]
    bounds += [(-late - _SURE * std, late) for late, std in seen[1:]]
    least, late = max(bounds, default=(0.0, 0.0))
    if least <= max(loop.period, ASSUMED_DELAY[1]):
        return ()
    than, filters = ("later", "slower") if late > 0.0 else ("earlier", "faster")
    likely = ""
    if late in (own for own, _ in seen[1:]):
        given = f"{loop.gyro_cutoff:g} Hz" if loop.gyro_cutoff else "none"
        likely = (
            f": filters act that are {filters} than those given (low-pass of the gyro: {given})"
        )
    omega = frequencies(loop)
    fast = margins_of(omega, open_loops(dynamics.first(1), loop, omega)[0].T).crossover
    axis = int(np.nanargmax(fast))
    return (
        Objection(
            f"the loop acts {1e3 * abs(late):.1f} ms {than} than its parameters say, surely by "
            f"{1e3 * least:.1f} ms, {np.degrees(abs(late) * fast[axis]):.0f} deg of phase at the "
            f"crossover on {AXES[axis]}, {fast[axis]:.0f} rad/s{likely}",
            evidence={AXES[axis]: late},
            how="give all parameters that flew: notches, low-passes, switches; check the delay",
            by="frequency response",
        ),
    )


def filter_objections(
    loop: RateLoop, measured: Mapping[str, MeasuredAxis]
) -> tuple[Objection, ...]:
    """ArduPilot's gyro is logged behind its low-pass: responses of a model for another cutoff."""
    fitting = []
    for cutoff in np.geomspace(*LIMITS.low_passes) if loop.autopilot == "ardupilot" else ():
        departures, other = {}, replace(loop, gyro_cutoff=float(cutoff))
        for axis, one in measured.items():
            found = one.torque
            by = loop.logged_gyro(found.omega) / other.logged_gyro(found.omega)
            found = replace(found, values=by * found.values, std=np.abs(by) * found.std)
            if (smooth := smooth_ratio(found, one.model)) is not None:
                departures[axis] = smooth.departure()
        if departures and not [*parted(departures, LIMITS.unmodeled)]:
            fitting.append(float(cutoff))
    if not fitting:
        return ()
    given = f"at {loop.gyro_cutoff:g} Hz" if loop.gyro_cutoff else "off"
    return (
        Objection(
            f"the measured responses are those of the model with the gyro's low-pass at "
            f"{fitting[0]:.0f} to {fitting[-1]:.0f} Hz, and not {given}",
            evidence={"cutoff": float(np.sqrt(fitting[0] * fitting[-1]))},
            how="give INS_GYRO_FILTER as it flew, and all notches with their switches",
            by="frequency response",
        ),
    )


def stepped(loop: RateLoop, now: RateLoop) -> RateLoop:
    """Gains on the way from the present ones, none changed by more than the step; 0 stays."""
    for axis, (new, old) in enumerate(zip(loop.gains, now.gains, strict=True)):
        within = {
            name: float(np.clip(getattr(new, name), value / LIMITS.step, value * LIMITS.step))
            for name in ("P", "I", "D", "attitude", "wc", "wo", "b0")
            for value in (getattr(old, name),)
        }
        loop = loop.with_gains(axis, replace(new, **within))
    return loop


def sure_proposal(
    dynamics: HoverDynamics,
    loop: RateLoop,
    now: RateLoop | None,
    measured: Mapping[str, MeasuredAxis],
) -> tuple[RateLoop | None, tuple[str, ...]]:
    """Gains that keep the required margins for sure, or None; what they keep, and what is left.

    An axis is left as it is whose present gains keep them, or where none within a step do.
    """

    def short(least: Array) -> set[int]:
        return set(np.flatnonzero((least < LIMITS.required).any(axis=1)).tolist())

    open_axes, said = {0, 1, 2}, []
    if now is not None:
        least = sure_margins(dynamics, now, measured)
        open_axes = short(least)
        if held := sorted({0, 1, 2} - open_axes):
            said.append(f"the present gains on {_named(held)} keep {_least(least[held])}")
    try:
        best = propose(dynamics, loop) if open_axes else loop
    except InputError as error:
        return None, (str(error),)
    tries = 12
    while open_axes:
        found = best if now is None else stepped(best, now)
        for axis in {0, 1, 2} - open_axes:
            found = found.with_gains(axis, loop.gains[axis])
        least = sure_margins(dynamics, found, measured)
        lacking, tries = short(least) & open_axes, tries - 1
        if not lacking:
            steps = (
                "" if now is None else f", none changed by more than a factor of {LIMITS.step:g}"
            )
            at = sorted(open_axes)
            return found, (f"proposed gains on {_named(at)} keep {_least(least[at])}{steps}", *said)
        if tries < 0:
            at, open_axes = sorted(lacking), open_axes - lacking if now is not None else set()
            within = f" within a factor of {LIMITS.step:g} of the present ones" if now else ""
            said.append(
                f"no gains on {_named(at)}{within} are sure to keep {LIMITS.required[0]:g} deg and "
                f"{LIMITS.required[1]:g} dB: those that come nearest keep {_least(least[at])}"
            )
        for axis in lacking:
            best = best.with_gains(axis, _scaled(best.gains[axis], 0.94))
    return None, tuple(said)


def _named(axes: Iterable[int]) -> str:
    return ", ".join(AXES[axis] for axis in axes)


def _least(margins: Array) -> str:
    phase, gain = margins.min(axis=0)
    return (
        f"at least {phase:.0f} deg and {gain:.1f} dB over all draws, a loop period or more later "
        f"than modeled and at {100.0 * LIMITS.battery:.0f} % of the thrust"
    )


def _worst(dynamics: HoverDynamics, loop: RateLoop, omega: Array) -> Array:
    """(3, 2) least phase and gain margin (deg, dB) of each axis, with and without attitude loop."""
    loops = [open_loops(dynamics, loop, omega, attitude=attitude) for attitude in (True, False)]
    least = [
        np.min([margins_of(omega, one[:, :, axis]).worst() for one in loops], axis=0)
        for axis in range(3)
    ]
    return np.array(least)


def _scaled(gains: AxisGains, by: float) -> AxisGains:
    """The gains of a crossover that much lower."""
    return replace(
        gains, P=gains.P * by, I=gains.I * by**2, D=gains.D * by, attitude=gains.attitude * by,
        wc=gains.wc * by, wo=gains.wo * by,
    )  # fmt: skip


def _axis(
    few: HoverDynamics,
    plant: Array,
    loop: RateLoop,
    axis: int,
    omega: Array,
) -> AxisGains:
    """Gains of one axis, the others open."""
    most = _most_gain(few, loop, axis)
    best: tuple[float, AxisGains] | None = None
    adrc = loop.autopilot == "betaflight-adrc"
    leads = LIMITS.observers if adrc else LIMITS.leads if axis < 2 else (0.0,)
    # Of the acceleration behind the motors' lag.
    b0 = few.effectiveness[0, axis, axis] / max(few.lag[0], 1e-3)
    b0 = float(np.clip(b0, *np.radians(1000.0 * np.array(LIMITS.b0))))
    for crossover in np.geomspace(*LIMITS.crossovers)[::-1]:
        for lead in leads:
            if adrc:  # the loop crosses over at about half of wc
                wc = 2.0 * float(crossover)
                gains = AxisGains(0.0, 0.0, 0.0, wc=wc, wo=lead * wc, b0=b0)
            else:
                gains = _of_crossover(plant[0], loop, axis, omega, float(crossover), lead)
            if (
                gains.P + gains.D / max(loop.derivative_lag(axis), lead, 1e-3) > 3.0 * most
                or most < gains.at_once
            ):
                continue
            trial = loop.with_gains(axis, gains)
            # The nominal vehicle first: most fail on it already.
            if not all(_keeps(p, trial, axis, omega) for p in (plant[:1], plant)):
                continue
            if best is None or crossover > best[0]:
                best = float(crossover), gains
        if best is not None:
            return best[1]
    raise InputError(
        f"no gains keep {LIMITS.phase_margin:g} deg and {LIMITS.gain_margin:g} dB on {AXES[axis]}: "
        "filters, delay and motor lag are too slow for this inertia, or the intervals are too wide"
    )


def _of_crossover(
    plant: Array,
    loop: RateLoop,
    axis: int,
    omega: Array,
    crossover: float,
    lead: float,
) -> AxisGains:
    """Gains whose rate loop crosses over there on the nominal vehicle."""
    attitude = min(LIMITS.attitude * crossover, LIMITS.attitude_most[axis])
    attitude = attitude if loop.holds_attitude else 0.0
    unit = AxisGains(1.0, LIMITS.integral * crossover, lead, attitude)
    trial = loop.with_gains(axis, unit)
    at = np.array([crossover])
    size = np.exp(np.interp(np.log(crossover), np.log(omega), np.log(np.abs(plant))))
    P = 1.0 / float(size * np.abs(trial.controllers(at)[0][0, axis]))
    # Feed-forward is no part of the loop.
    return AxisGains(P, P * unit.I, P * lead, attitude, loop.gains[axis].FF)


def _keeps(plant: Array, loop: RateLoop, axis: int, omega: Array) -> bool:
    rate, angle, _ = loop.controllers(omega)
    alone = rate[:, axis] * plant
    whole = alone + angle[:, axis] / (1j * omega) * plant
    for loops in (whole, alone):
        margins = margins_of(omega, loops)
        phase, gain = margins.worst()
        if phase < LIMITS.phase_margin or gain < LIMITS.gain_margin:
            return False
        if margins.reduction.min() < LIMITS.reduction_margin:
            return False
    return True


def _most_gain(few: HoverDynamics, loop: RateLoop, axis: int) -> float:
    """P with which a rate error takes the share of the rotors' room that it may take."""
    hover = few.hover[0]
    column = np.abs(loop.mixer[:, axis])
    room = np.minimum(hover, 1.0 - hover) / np.maximum(column, 1e-9)
    return float(LIMITS.authority * room[column > 0.0].min() / LIMITS.error[axis])


SCHEMA = "gcs-sysid-tune/1"
ASSUMED_DELAY = (0.005, 0.0015)
"""s and standard deviation: two periods of a 400 Hz loop, for computing and the ESCs' protocol."""
IDENTIFIED_DELAY = "identified, from command to rotor"
_ALIKE = ("mass", "Ixx", "Iyy", "Izz")
_APART = 0.1
"""Relative difference beyond which two results are not of one flight."""


@dataclass(frozen=True)
class AxisStudy:
    """One axis with one set of gains.

    Attributes:
        whole: margins with the attitude loop closed, of every draw, the nominal vehicle first.
        alone: the same of the rate loop alone (Acro).
        attitude: response to an attitude step, or where no attitude is held to a rate step.
        rate: response to a rate step, with no attitude loop.
        measured: margins of `whole` by the measured response; None: it does not reach so far.
    """

    whole: Margins
    alone: Margins
    attitude: StepResponse
    rate: StepResponse
    measured: Margins | None = None


@dataclass(frozen=True)
class Change:
    """What is tried on a vehicle.

    Attributes:
        gains: parameters of the autopilot that are others than now, by name; None: those proposed.
        payload: kg.
        place: m, as of `ExportedVehicle.changed`.
        thrust: at full command over the usual, as of a low battery.
    """

    gains: Mapping[str, float] | None
    payload: float = 0.0
    place: tuple[float, float, float] = (0.0, 0.0, 0.0)
    thrust: float = 1.0

    @property
    def words(self) -> str:
        """What it is."""
        parts = (
            ["the gains proposed"]
            if self.gains is None
            else [f"{name} = {value:g}" for name, value in self.gains.items()]
        )
        parts[4:] = [f"{len(parts) - 4} more"] if len(parts) > 5 else parts[4:]
        parts += [f"{self.payload:g} kg besides"] if self.payload else []
        parts += [f"{100.0 * self.thrust:.0f} % of the thrust"] if self.thrust != 1.0 else []
        return ", ".join(parts)


@dataclass(frozen=True)
class WhatIf:
    """A change flown along the log's rate set-points.

    Attributes:
        change: tried.
        replay: None: nothing is claimed.
        axes: that are answered for, by their numbers.
        overshoot: axis -> (N,) of a step then, as in `AxisStudy.attitude`.
        objections: to the loop that flew, as modeled.
        why: what else stands against an answer.
    """

    change: Change
    replay: Replay | None
    axes: tuple[int, ...]
    overshoot: tuple[Array, ...]
    objections: tuple[Objection, ...]
    why: tuple[str, ...]


@dataclass(frozen=True)
class TuningStudy:
    """Margins of the gains that a vehicle has and of those proposed.

    Attributes:
        vehicle: identified.
        dynamics: linear, with draws from the covariance.
        delay: s and standard deviation.
        delay_from: where that comes from.
        now: loops with the gains that the vehicle has; None: not given.
        loop: with the settings that the vehicle has, as far as they are known.
        proposed: loops with the proposed gains; None: the gains are to be left as they are.
        studies: name ("now", "proposed") -> roll, pitch, yaw.
        notes: what was assumed.
        objections: to model, speeds and loop by what was flown; no gains are proposed then.
        measured: axis -> what the flight itself shows; empty where it was not given.
        leave: why the gains are to be left as they are; empty where others are proposed.
        what_if: what is tried, or was proposed, along the log; None: neither.
    """

    vehicle: ExportedVehicle
    dynamics: HoverDynamics
    delay: tuple[float, float]
    delay_from: str
    now: RateLoop | None
    loop: RateLoop
    proposed: RateLoop | None
    studies: Mapping[str, tuple[AxisStudy, ...]]
    notes: tuple[str, ...]
    objections: tuple[Objection, ...] = ()
    measured: Mapping[str, MeasuredAxis] = field(default_factory=dict)
    leave: str = ""
    what_if: WhatIf | None = None

    @property
    def loops(self) -> dict[str, RateLoop]:
        """Name -> loops."""
        named = {"now": self.now, "proposed": self.proposed}
        return {name: loop for name, loop in named.items() if loop is not None}


def study(
    vehicle: ExportedVehicle,
    autopilot: Autopilot,
    parameters: Mapping[str, float],
    *,
    delay: tuple[float, float] | None = None,
    draws: int = 100,
    seed: int = 1,
    flight: Iterable[SampleBlock] | None = None,
    change: Change | None = None,
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
        flight: samples of a log with commands, whose response is compared with the model; None:
            there is no log.
        change: to be tried along that log; None: what is proposed.

    Raises:
        MissingError: the result does not carry gains; says which flight would help.
        InputError: parameters make no sense.
    """
    loop = read_loop(autopilot, parameters, vehicle.rotors, hover_point(vehicle))
    change = change or Change(None)
    if change.gains:
        change = replace(change, gains=_others(change.gains, parameters, loop))
    # What is missing is named before anything is drawn.
    check_needs(vehicle)
    late, origin = _delay(vehicle, loop, delay)
    vehicles = [vehicle, *drawn_vehicles(vehicle, draws, seed)]
    dynamics = hover_dynamics(vehicles, loop, late, seed, traded=origin == IDENTIFIED_DELAY)
    notes = [*dynamics.notes, *loop.notes]
    measured: dict[str, MeasuredAxis] = {}
    signals = None
    if flight is None:  # rotors of an octocopter that turn alike may be swapped, and fit as well
        notes.append("no flight is held against the model: give its log before you load gains")
    else:
        signals = flown_signals(flight, loop)
        if signals is not None:
            measured = measured_axes(signals, dynamics, loop)
        if not measured:
            notes.append("the log has no gapless flight with commands: its response is not shown")
        elif signals is not None and not signals.has_setpoints:
            notes.append(
                "no rate set-points in the log: the response is biased by feedback, and is not "
                "compared with the model (log vehicle_rates_setpoint, or RATE)"
            )
    smooth = {name: smooth_ratio(one.torque, one.model) for name, one in measured.items()}
    few = [name for name, one in smooth.items() if one is None and measured[name].torque.instrument]
    if few:
        notes.append(
            f"the response on {', '.join(few)} is claimed at too few frequencies to be compared "
            "with the model"
        )
    for seconds, std in flown_late(loop, measured)[:1]:
        by = f"{1e3 * seconds:.1f} +- {1e3 * Z95 * std:.1f} ms"
        notes.append(f"by the log the loop acts {by} later than modeled")
    if measured and loop.gains_known and not flown_late(loop, measured):
        notes.append(
            "filters are taken as given: the log is too slow or too calm to show whether the loop "
            "acts later (log gyro, commands and rate set-points at 200 Hz)"
        )
    departures = {name: one.departure() for name, one in smooth.items() if one is not None}
    objections = tuple(parted(departures, LIMITS.unmodeled))
    filtered = filter_objections(loop, measured) if objections else ()
    objections = (*misread_speeds(vehicle), *(filtered or objections))
    now = replace(loop, besides=()) if loop.gains_known else None
    answered = answers(signals, (dynamics, loop)) if signals is not None and now else {}
    # A loop that does not answer as modeled is another than its margins are of.
    late_loop = late_objections(dynamics, loop, measured)
    of_loop = () if filtered else late_loop or parted_answers(answered)
    misjudged = (*objections, *of_loop)
    proposed, said = None, tuple(each.words for each in misjudged)
    if not misjudged:
        proposed, said = sure_proposal(dynamics, loop, now, measured)
    if proposed is not None:
        notes += said
    loops = {"now": now, "proposed": proposed}
    studies = {
        name: axis_studies(dynamics, one, measured)
        for name, one in loops.items()
        if one is not None
    }
    if proposed is None and change.gains is None:
        change = replace(change, gains={})
    tried = None
    if flight is not None and change.words:
        gains = change.gains
        if gains is None and proposed is not None:
            gains = proposed.as_parameters()
        laden = [v.changed(change.payload, np.array(change.place), change.thrust) for v in vehicles]
        settings = {**parameters, **(gains or {})}
        other = read_loop(autopilot, settings, vehicle.rotors, hover_point(laden[0]))
        changed = hover_dynamics(laden, other, late, seed, traded=origin == IDENTIFIED_DELAY)
        if objections:
            why = ("the flight contradicts the model: see below",)
            tried = WhatIf(change, None, (), (), (), why)
        else:
            tried = what_if(change, signals, (dynamics, loop), (changed, other), answered)
    filters = sorted(set(loop.assumed) - set(loop.as_parameters()))
    if filters:
        notes.append(f"not given, at the autopilot's defaults: {', '.join(filters)}")
    return TuningStudy(
        vehicle, dynamics, late, origin, now, loop, proposed, studies, tuple(notes), misjudged,
        measured, "" if proposed is not None else "; ".join(said), tried,
    )  # fmt: skip


def _others(
    gains: Mapping[str, float], parameters: Mapping[str, float], loop: RateLoop
) -> dict[str, float]:
    """Those of the gains to try that a vehicle has, with another value.

    Raises:
        InputError: there are none.
    """
    unknown = dict.fromkeys([*loop.assumed, *(name for name, _ in loop.besides)], np.nan)
    present = {**replace(loop, besides=()).as_parameters(), **unknown, **parameters}
    # A log holds single precision.
    out = {n: v for n, v in gains.items() if n in present and not np.isclose(v, present[n], 1e-6)}
    if not out:
        raise InputError(
            f"--what-if: none of the {len(gains)} parameters to try differs from what "
            f"{loop.autopilot} has now"
        )
    return out


def what_if(
    change: Change,
    flight: FlownSignals | None,
    now: tuple[HoverDynamics, RateLoop],
    then: tuple[HoverDynamics, RateLoop],
    departures: Mapping[str, tuple[float, float, float]],
) -> WhatIf:
    """Fly a change along a log's set-points, where the loop that flew answers as it is modeled.

    Args:
        change: tried.
        flight: signals; None: there are none to go by.
        now: vehicles and loop that flew.
        then: the same, changed.
        departures: as of `answers`.
    """
    unclear = [name for name in AXES if name not in departures]
    why: tuple[str, ...] = ()
    objections = parted_answers(departures)
    said = {axis for objection in objections for axis in objection.evidence}
    # Intervals so wide that they allow for a departure do not narrow what is claimed then.
    unclear += [
        n for n, (share, *_) in departures.items() if share > LIMITS.unmodeled and n not in said
    ]
    said.update(unclear)
    axes = tuple(i for i, name in enumerate(AXES) if name in departures and name not in said)
    if unclear:
        why = (
            f"log and model are not sure enough of how {', '.join(unclear)} answers to rate "
            "set-points for the loop that flew to be checked",
        )
    omega = frequencies(then[1])
    loops = [open_loops(*then, omega, attitude=attitude) for attitude in (False, True)]
    margins = [margins_of(omega, each[:, :, axis]) for each in loops for axis in range(3)]
    unstable = np.any([each.phase <= 0.0 for each in margins], axis=0)
    heavy = then[0].hover.max(axis=1) >= 1.0
    for what, those in (("unstable", unstable), ("a hover takes more than full thrust", heavy)):
        if those.any():
            why, axes = (f"{what} with {those.sum()} of {len(those)} vehicles drawn",), ()
    # Where hardly a tenth of the motion comes back, no loop acts.
    highest = 10.0 * float(np.nanmax([each.crossover for each in margins]))
    flown = replay(flight, now, then, highest) if flight and axes else None
    of = "attitude" if then[1].holds_attitude else "rate"
    few = then[0].first(LIMITS.draws)
    overshoot = [
        step_response(few, then[1], axis, of=of).overshoot
        for axis in range(3 * (flown is not None))
    ]
    return WhatIf(change, flown, axes, tuple(overshoot), objections, why)


def answers(
    flight: FlownSignals, now: tuple[HoverDynamics, RateLoop]
) -> dict[str, tuple[float, float, float]]:
    """Axis -> by how much its answer to set-points parts from that of the loop that flew.

    As shares of the set-point, `SmoothRatio.departure`; without those that are not measured.

    Args:
        flight: signals.
        now: vehicles and loop that flew.
    """
    departures = {}
    for axis, name in enumerate(AXES):
        modeled = functools.partial(_answer, *now, axis)
        own = now[1].gains[axis].attitude, now[1].logged_gyro
        found = measured_response(flight, axis, *own, reference=modeled, of="setpoint")
        smooth = smooth_ratio(found, modeled(found.omega)) if found else None
        if smooth is not None:
            departures[name] = smooth.departure(modeled(smooth.omega)[0])
    return departures


def parted_answers(
    departures: Mapping[str, tuple[float, float, float]],
) -> tuple[Objection, ...]:
    """Objections to a loop by its answers to set-points."""
    how = "compare gains, filters and switches with those that flew; then delay, mass and layout"
    return tuple(parted(departures, LIMITS.unmodeled, "answer to set-points", how))


def _answer(dynamics: HoverDynamics, loop: RateLoop, axis: int, omega: Array) -> Array:
    """(N, w) rate of an axis over its set-point."""
    return closed_loops(dynamics, loop, omega)[0][:, :, axis, axis]


def misread_speeds(vehicle: ExportedVehicle) -> tuple[Objection, ...]:
    """Objections to the rotors' speeds: notches that follow these are off the rotors' lines."""
    return tuple(each for each in vehicle.result.objections if each.by == LINES)


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
    if not loop.holds_attitude:  # Betaflight and INAV, whose protocols take next to no time
        return (2.0 * loop.period, 0.6 * loop.period), "assumed"
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
    objections = (*vehicle.result.objections, *other.result.objections)
    return replace(vehicle, known=known, result=replace(vehicle.result, objections=objections))


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


def axis_studies(
    dynamics: HoverDynamics, loop: RateLoop, measured: Mapping[str, MeasuredAxis]
) -> tuple[AxisStudy, ...]:
    """Margins and step responses of roll, pitch and yaw."""
    omega = frequencies(loop)
    whole = open_loops(dynamics, loop, omega)
    alone = open_loops(dynamics, loop, omega, attitude=False)
    nominal = dynamics.first(1)
    return tuple(
        AxisStudy(
            margins_of(omega, whole[:, :, axis]),
            margins_of(omega, alone[:, :, axis]),
            step_response(nominal, loop, axis, of="attitude" if loop.holds_attitude else "rate"),
            step_response(nominal, loop, axis, of="rate"),
            measured_margins(measured[name], dynamics, loop, axis) if name in measured else None,
        )
        for axis, name in enumerate(AXES)
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
        "autopilot": tuning.loop.autopilot,
        "source": tuning.vehicle.result.source,
        "loop_rate": tuning.loop.rate,
        "motor_lag": _banded(dynamics.lag),
        "delay": {"value": tuning.delay[0], "std": tuning.delay[1], "from": tuning.delay_from},
        "plant": plant,
        "parameters": {name: loop.as_parameters() for name, loop in tuning.loops.items()},
        "margins": {
            name: {
                axis: {
                    "attitude_loop_closed": _margins(one.whole),
                    "rate_loop_alone": _margins(one.alone),
                    **({"measured": _margins(one.measured)} if one.measured else {}),
                    "attitude_step": _step(one.attitude),
                    "rate_step": _step(one.rate),
                }
                for axis, one in zip(AXES, studies, strict=True)
            }
            for name, studies in tuning.studies.items()
        },
        "response": {
            name: {
                "torque": one.torque.as_json() | one.model_json(),
                "setpoint": None if one.setpoint is None else one.setpoint.as_json(),
            }
            for name, one in tuning.measured.items()
        },
        "what_if": None if tuning.what_if is None else _tried(tuning.what_if),
        "leave": tuning.leave or None,
        "objections": [objection.as_json() for objection in tuning.objections],
        "notes": list(tuning.notes),
    }


def _tried(tried: WhatIf) -> dict[str, Any]:
    change, flown = tried.change, tried.replay
    out: dict[str, Any] = {
        "change": {
            "gains": "proposed" if change.gains is None else dict(change.gains),
            "payload_kg": change.payload, "place_m": list(change.place), "thrust": change.thrust,
        },
        "objections": [objection.as_json() for objection in tried.objections],
        "why": list(tried.why),
    }  # fmt: skip
    if flown is None:
        return out
    axes = {}
    for axis in tried.axes:
        axes[AXES[axis]] = {
            "error_rad_s": {name: _banded(each[:, axis]) for name, each in flown.error.items()},
            "overshoot": _banded(tried.overshoot[axis]),
            "shown_rad_s": {name: line.tolist() for name, line in flown.lines(axis).items()},
        }
    limit = (
        None
        if flown.limit is None
        else dict(zip(("flown", "then"), map(_banded, flown.limit), strict=True))
    )
    return out | {
        "seconds": flown.seconds, "highest_rad_s": flown.highest, "axes": axes,
        "rotor_limit_share": limit, "shown_s": flown.t.tolist(),
    }  # fmt: skip


def _tried_table(tried: WhatIf | None) -> list[str]:
    """Errors along the log's set-points with a change, or why nothing is claimed."""
    if tried is None:
        return []
    where = f"{tried.change.words}, along the rate set-points of the log"
    flown = tried.replay
    where += "" if flown is None else f", {flown.seconds:.0f} s, up to {flown.highest:.0f} rad/s"
    lines = wrapped(where, "what if: ")
    if flown is not None:
        lines += [
            f"{'':6}{'set-point less rate, deg/s rms':>43}{'not by':>14}{'overshoot':>12}",
            f"{'axis':6}{'flown':>9}{'model':>9}{'then (95 %)':>25}{'set-points':>14}{'then':>12}",
        ]
        for axis in tried.axes:
            error = {name: np.degrees(each[:, axis]) for name, each in flown.error.items()}
            lines.append(
                f"{AXES[axis]:6}{error['flown'][0]:>9.2f}{error['now'][0]:>9.2f}"
                f"{_interval(error['then'], 2):>25}{error['left'][0]:>14.2f}"
                f"{100.0 * tried.overshoot[axis][0]:>10.0f} %"
            )
        if flown.limit is not None:
            before, after = 100.0 * flown.limit
            lines.append(
                f"a rotor at its limit: {before[0]:.1f} % of the time as flown, "
                f"{_interval(after, 1)} % then"
            )
    for said in (*(each.words for each in tried.objections), *tried.why):
        lines += wrapped(said, "nothing is claimed: ")
    return [*lines, ""]


def response_csv(tuning: TuningStudy) -> str:
    """The measured responses to torque beside the model's as a table: a row a frequency."""
    lines: list[str] = []
    for name, one in tuning.measured.items():
        columns = one.torque.as_json() | one.model_json()
        del columns["instrument"]
        lines = lines or [",".join(["axis", *columns])]
        for row in zip(*columns.values(), strict=True):
            lines.append(",".join([name, *("" if v is None else f"{v:.6g}" for v in row)]))
    return "\n".join(lines) + "\n"


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
    loop = tuning.loop
    of = "attitude" if loop.holds_attitude else "rate"
    head = (
        f"{loop.autopilot}, rate loop {loop.rate:g} Hz, motor lag "
        f"{1e3 * tuning.dynamics.lag[0]:.0f} ms, delay {1e3 * tuning.delay[0]:.1f} ms "
        f"({tuning.delay_from}), {len(tuning.dynamics) - 1} draws from the covariance"
    )
    lines = [
        *wrapped(head),
        "",
        f"{'':10}{'axis':7}{'crossover':>11}{'phase margin':>20}{'gain margin':>20}"
        f"{'overshoot':>11}",
        f"{'':10}{'':7}{'rad/s':>11}{'deg (95 %)':>20}{'dB (95 %)':>20}{of:>11}",
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
            if one.measured is not None:
                own = one.measured
                lines.append(
                    f"{'':10}{'  flown':7}{own.crossover[0]:>11.1f}{_interval(own.phase, 0):>20}"
                )
    lines += ["", *_response_table(tuning), *_gain_table(tuning)]
    lines += _tried_table(tuning.what_if)
    lines += wrapped(tuning.leave, "leave it: ") if tuning.leave else []
    for note in tuning.notes:
        lines += wrapped(note, "note: ")
    return "\n".join(lines)


def _interval(values: Array, digits: int) -> str:
    found = _banded(values)
    if found["value"] is None:
        return "-"
    return "{value:.{0}f} ({low:.{0}f} to {high:.{0}f})".format(digits, **found)


def _response_table(tuning: TuningStudy) -> list[str]:
    """A few frequencies of each axis, measured and modeled."""
    rows = []
    for name, one in tuning.measured.items():
        found = one.torque
        at = np.flatnonzero(found.claimed)
        few = at[np.unique(np.linspace(0, len(at) - 1, 4).round().astype(int))] if len(at) else []
        for i in few:
            size, half = np.abs(found.values[i]), found.half_width[i]
            turn, off = np.degrees(np.arcsin(min(half, 1.0))), np.angle(found.values / one.model[0])
            model = np.abs(one.model[:, i])
            phase = np.degrees(np.angle(one.model[0, i]))
            rows.append(
                f"{name:6}{found.omega[i]:>5.1f}{found.coherence[i]:>5.2f}"
                f"{f'{size:.3g} ({size * (1 - half):.3g} to {size * (1 + half):.3g})':>24}"
                f"{_interval(model, 2):>23}"
                f"{f'{phase + np.degrees(off[i]):.0f} +- {turn:.0f}':>10}{phase:>6.0f}"
            )
    if not rows:
        return []
    source = next(iter(tuning.measured.values())).torque.instrument
    return [
        *wrapped(
            f"rate over normalized torque, measured with {source} as instruments, 95 % (coh.: "
            "coherence):"
        ),
        f"{'axis':6}{'rad/s':>5}{'coh.':>5}{'measured, rad/s':>24}{'model':>23}"
        f"{'deg':>10}{'model':>6}",
        *rows,
        "",
    ]


def _gain_table(tuning: TuningStudy) -> list[str]:
    if tuning.proposed is None:
        return []
    proposed = tuning.proposed.as_parameters()
    now = {} if tuning.now is None else tuning.now.as_parameters()
    lines = [f"{'parameter':18}{'now':>12}{'proposed':>12}"]
    for name, value in proposed.items():
        old, new = f"{now[name]:.4g}" if name in now else "-", f"{value:.4g}"
        lines += [f"{name:18}{old:>12}{new:>12}"] if old != new else []
    return [*lines, "others: as now"] if len(lines) <= len(proposed) else lines


def parameter_text(tuning: TuningStudy, suffix: str) -> str:
    """The proposed gains as a file that a ground station loads.

    `suffix` is ".params" for QGroundControl, ".param" or ".parm" for Mission Planner.
    """
    assert tuning.proposed is not None
    values = tuning.proposed.as_parameters()
    now = {} if tuning.now is None else tuning.now.as_parameters()
    notes = {n: f"was {now[n]:.6g}" for n in values if n in now}
    head = [
        f"# Gains proposed by gcs-sysid tune for {tuning.vehicle.name} "
        f"({tuning.proposed.autopilot}), from",
        f"# {tuning.vehicle.result.source or 'a result'}.",
        "# Review each before writing it. Fly first with room, and a hand on the mode switch.",
        "# Predicted over the interval of the parameters:",
    ]
    for axis, one in zip(AXES, tuning.studies["proposed"], strict=True):
        head.append(
            f"#   {axis}: phase margin {_interval(one.whole.phase, 0)} deg, gain margin "
            f"{_interval(one.whole.gain, 1)} dB, crossover {one.whole.crossover[0]:.1f} rad/s"
        )
    head += [f"# Note: {note}" for note in tuning.notes]
    head = ["".join(c if c.isprintable() else " " for c in line) for line in head]
    tail = ["save"] if suffix == ".txt" else []
    return "\n".join([*head, "#", *parameter_lines(values, notes, suffix), *tail]) + "\n"


def with_deviations(vehicle: ExportedVehicle, deviations: Mapping[str, float]) -> ExportedVehicle:
    """The vehicle with standard deviations of values given by hand."""
    known = dict(vehicle.known)
    for name, std in deviations.items():
        known[name] = replace(known[name], std=std)
    return replace(vehicle, known=known)
