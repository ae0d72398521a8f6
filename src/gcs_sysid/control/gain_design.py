"""Gains for a vehicle: the fastest loops that keep their margins over the whole interval.

For each axis the crossover is raised until a margin would fall below its design value on any draw
from the covariance: with the rate loop alone (Acro) and with the attitude loop. I, D and the
attitude gain follow the crossover in fixed proportions, so that what is chosen is one number and
the lead D/P.
"""

from dataclasses import dataclass, replace

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.control.hover_dynamics import HoverDynamics
from gcs_sysid.control.loop_margins import frequencies, margins_of, open_loops
from gcs_sysid.control.rate_loops import AxisGains, RateLoop
from gcs_sysid.errors import InputError
from gcs_sysid.model.parameters import AXES


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
        leads: s, D/P that are tried on roll and pitch. PX4's default is 0.02, ArduPilot's 0.027;
            beyond, noise decides and not phase. Yaw has no D, as with both autopilots.
        crossovers: rad/s that are tried.
        authority: share of the thrust left above or below hover that an error of `error` rad/s may
            take: beyond, rotors saturate in everyday flying.
        error: rad/s on roll, pitch and yaw.
        attitude_most: 1/s on roll, pitch and yaw: attitude gains that users fly.
        draws: from the covariance, that a choice is judged by.
    """

    phase_margin: float = 52.0
    gain_margin: float = 8.0
    reduction_margin: float = 7.0
    integral: float = 0.1
    attitude: float = 0.25
    leads: tuple[float, ...] = (0.0, 0.005, 0.01, 0.015, 0.02, 0.025, 0.03, 0.035)
    crossovers: tuple[float, float, int] = (1.0, 60.0, 60)
    authority: float = 0.5
    error: tuple[float, float, float] = (1.5, 1.5, 0.5)
    attitude_most: tuple[float, float, float] = (10.0, 10.0, 4.0)
    draws: int = 25


LIMITS = DesignLimits()


def propose(dynamics: HoverDynamics, loop: RateLoop) -> RateLoop:
    """The loop with gains for this vehicle; filters and rates stay as they are.

    Args:
        dynamics: the nominal vehicle and draws from its covariance.
        loop: with the filters that the vehicle has.

    Raises:
        InputError: no gains keep the margins.
    """
    few = dynamics.first(LIMITS.draws)
    omega = frequencies(loop, 160)
    plant = few.response(omega, loop.period)
    for axis in range(3):
        loop = loop.with_gains(axis, _axis(few, plant[:, :, axis, axis], loop, axis, omega))
    # With the other axes' loops closed the margins are a little others: what lacks is taken back.
    for _ in range(12):
        short = _short(few, loop)
        if not short.any():
            return loop
        for lacking in map(int, np.flatnonzero(short)):
            loop = loop.with_gains(lacking, _scaled(loop.gains[lacking], 0.94))
    raise InputError(
        "no gains keep the margins on "
        + " and ".join(AXES[axis] for axis in np.flatnonzero(short))
        + ": the axes are coupled too strongly; give the mixer the vehicle's own geometry first"
    )


def _short(few: HoverDynamics, loop: RateLoop) -> Array:
    """(3,) whether an axis lacks margin on any draw."""
    omega = frequencies(loop)
    short = np.zeros(3, bool)
    for attitude in (True, False):
        loops = open_loops(few, loop, omega, attitude=attitude)
        for axis in range(3):
            phase, gain = margins_of(omega, loops[:, :, axis]).worst()
            short[axis] |= phase < LIMITS.phase_margin - 0.5 or gain < LIMITS.gain_margin - 0.2
    return short


def _scaled(gains: AxisGains, by: float) -> AxisGains:
    """The gains of a crossover that much lower."""
    return replace(
        gains, P=gains.P * by, I=gains.I * by**2, D=gains.D * by, attitude=gains.attitude * by
    )


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
    for crossover in np.geomspace(*LIMITS.crossovers)[::-1]:
        for lead in LIMITS.leads if axis < 2 else (0.0,):
            gains = _of_crossover(plant[0], loop, axis, omega, float(crossover), lead)
            if gains.P + gains.D / max(_lag(loop, axis), lead, 1e-3) > 3.0 * most or most < gains.P:
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


def _lag(loop: RateLoop, axis: int) -> float:
    cutoff = loop.derivative_cutoff[axis]
    return 1.0 / (2.0 * np.pi * cutoff) if cutoff > 0.0 else 0.0


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
    unit = AxisGains(1.0, LIMITS.integral * crossover, lead, attitude)
    trial = loop.with_gains(axis, unit)
    at = np.array([crossover])
    size = np.exp(np.interp(np.log(crossover), np.log(omega), np.log(np.abs(plant))))
    P = 1.0 / float(size * np.abs(trial.controllers(at)[0][0, axis]))
    return AxisGains(P, P * unit.I, P * lead, attitude)


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
