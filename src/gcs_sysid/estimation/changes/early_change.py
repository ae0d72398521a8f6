"""Changes in the first seconds of flight, before a reference fit could watch for any.

With commands it takes up to 20 s until lag and thrust curve are known well enough for a reference,
and with any input 3 s more until the noise of its residuals is. Those seconds are looked at
afterwards, on thrust alone: with kappa such that residuals before the step have no mean, and with
lag and thrust curve as far as the fit by then knows them. No single curve explains that two levels
of command carry the same weight.

Where a step of all the stretch is likeliest is found on means over 0.15 s; it is
then judged as any alarm (`change_hypotheses`), among the noise that the whole stretch shows beside
the step.
"""

from dataclasses import replace

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.changes.change_detection import Detection
from gcs_sysid.estimation.changes.change_hypotheses import Classification, judge, likeliest_step
from gcs_sysid.estimation.changes.change_reference import N_X, TOTAL, Actuator, Reference
from gcs_sysid.estimation.changes.change_window import (
    TUNING,
    AlarmWindow,
    ResidualHistory,
)
from gcs_sysid.estimation.fit.priors import COORDINATE_MEAN, COORDINATE_STD
from gcs_sysid.estimation.fit.rotation import RotationFit
from gcs_sysid.estimation.rows.actuator_dynamics import Coordinate, LagOf
from gcs_sysid.signals.samples import Samples

_FRAME = 0.15
"""s, length of the means in which a step is looked for."""
_SHARP = 0.5
"""s around it in which its onset is found to a sample."""
LEAST_BEFORE = 10.0 * _FRAME
"""s of flight before a step that are needed: less is take-off."""
_WHOLE = replace(TUNING, frame=_FRAME, before=1e6)


def actuator_of(fit: RotationFit | None, curves: tuple[float, ...]) -> Actuator:
    """Lag and thrust curve by a fit, as far as it knows them better than they ordinarily are.

    Args:
        fit: to commands; None while there is none.
        curves: least and greatest thrust curve; one value is given.
    """
    mean, std = COORDINATE_MEAN.copy(), COORDINATE_STD.copy()
    if len(curves) == 1:
        mean[Coordinate.CURVE], std[Coordinate.CURVE] = curves[0], 0.0
    lag_of: LagOf = "command"
    if fit is not None and not (fit.warm_start is not None and fit.warm_start.stuck):
        known = fit.coordinates_std < std
        mean = np.where(known, fit.coordinates, mean)
        std = np.where(known, fit.coordinates_std, std)
        lag_of = lag_of if fit.lag_place is None else fit.lag_place.of
    return Actuator(
        float(mean[Coordinate.LAG]),
        float(mean[Coordinate.CURVE]),
        lag_of,
        float(std[Coordinate.LAG]),
        float(std[Coordinate.CURVE]),
    )


def early_change(
    t: Array,
    samples: Samples,
    dt: float,
    geometry: Array,
    actuator: Actuator | None,
    until: float,
) -> tuple[Detection, Classification] | None:
    """The likeliest step of thrust over mass in the beginning of a flight, judged.

    Args:
        t: (n,) s, session times from the beginning on, gaps marked by NaN samples.
        samples: n of them.
        dt: s between samples.
        geometry: (3, rotors) of the airframe.
        actuator: of commands; None with speeds.
        until: s, session time from which a detector watched.

    Returns:
        The step as an alarm, with times in s since t[0]; None where the stretch is too short,
        or the step in what was watched.
    """
    reference = _of_thrust(t, samples, dt, geometry, actuator, float(t[-1]))
    if reference is None:
        return None
    window = AlarmWindow(t, samples, dt, reference, float(t[-1]) + dt, _WHOLE)
    first, last = t[0] + LEAST_BEFORE, min(until, t[-1] - TUNING.ages[0])
    times = np.array([window.time_of(i) for i in range(len(window.e))])
    # With gaps the first mean may come this late: there is none before it to compare with.
    places = 1 + np.flatnonzero((times[1:] >= first) & (times[1:] <= last))
    if not len(places):
        return None
    nothing = ResidualHistory(np.full(4, np.nan), np.empty((0, 4)), window.step)
    at, share, sigmas = likeliest_step(window, reference, nothing, places.tolist(), _WHOLE)
    onset = _sharp(t, samples, dt, reference, window.time_of(at))
    seen = [k for k, age in enumerate(TUNING.ages) if t[-1] - onset >= age - 0.5 * dt]
    # Thrust over mass by the flight before, as of any other reference.
    before = _of_thrust(t, samples, dt, geometry, actuator, onset)
    if before is None or not seen or onset > until:
        return None
    look, history = seen[-1], _beside(window, before, at)
    near = slice(
        int(np.searchsorted(t, onset - TUNING.before - 2.0 * TUNING.frame)),
        int(np.searchsorted(t, onset + TUNING.ages[-1], side="right")),
    )
    found = judge(t[near], samples.part(near), dt, before, history, onset, look)
    if found.verdict == "changed":
        # A gust lasts for seconds, a change for all that was flown since.
        whole = judge(t, samples, dt, before, history, found.onset, look, tuning=_WHOLE)
        share_of_it, of_all = (1.0 - 1.0 / c.mass_ratio for c in (found.cause, whole.cause))
        stays = abs(of_all - share_of_it) < TUNING.agree * abs(share_of_it)
        if whole.verdict != "changed" or not stays:
            found = replace(found, verdict="disturbance")
    size = share * float(np.mean(reference.kappa * window.x[at:, TOTAL]))
    change = Detection(float(t[-1] - t[0]), onset - float(t[0]), "thrust", size, sigmas, "slow")
    return change, found


def _of_thrust(
    t: Array, samples: Samples, dt: float, geometry: Array, actuator: Actuator | None, until: float
) -> Reference | None:
    """A reference of thrust alone whose mean residual is zero until some time; None: no thrust."""
    matrix = np.full((4, N_X), np.nan)
    matrix[0] = 0.0
    y, x, _ = Reference(geometry, matrix, 0.0, actuator).rows(samples, dt)
    there = np.isfinite(y[:, 0]) & (x[:, TOTAL] > 0.0) & (t[1 : 1 + len(y)] < until)
    total = float(np.sum(x[there, TOTAL]))
    kappa = -float(np.sum(y[there, 0])) / total if total > 0.0 else 0.0
    matrix[0, TOTAL] = -kappa
    return Reference(geometry, matrix, 0.0, actuator) if kappa > 0.0 else None


def _sharp(t: Array, samples: Samples, dt: float, reference: Reference, onset: float) -> float:
    """The onset to a sample: where two means leave least of the residuals around it.

    A mean across the step would count as noise.
    """
    y, x, _ = reference.rows(samples, dt)
    times = t[1 : 1 + len(y)]
    e = y[:, 0] + reference.kappa * x[:, TOTAL]
    near = np.isfinite(e) & (np.abs(times - onset) < _SHARP)
    times, e = times[near], e[near]
    n = np.arange(1, len(e))
    if not len(n):
        return onset
    sums = np.cumsum(e)[:-1]
    gain = sums**2 / n + (e.sum() - sums) ** 2 / (len(e) - n)
    return float(times[1 + int(np.argmax(gain))])


def _beside(window: AlarmWindow, reference: Reference, at: int) -> ResidualHistory:
    """What thrust's residuals did beside a step: their level before, and how they wandered."""
    e = window.y[:, 0] + reference.kappa * window.x[:, TOTAL]
    later = np.arange(len(e)) >= at
    air = np.nan_to_num(window.air)
    # Not of thrust: where it carries a vehicle in gusts, all that these do is in proportion to it.
    columns = np.column_stack([~later, later, air[:, 2], np.sum(air[:, :2] ** 2, axis=1)])
    columns = columns / np.maximum(np.abs(columns).max(axis=0), 1e-12)
    fit = np.linalg.lstsq(columns, e, rcond=1e-6)[0]
    left, level = np.full((len(e), 4), np.nan), np.full(4, np.nan)
    left[:, 0], level[0] = e - columns @ fit, np.median(e[~later])
    left[max(at - 2, 0) : at + 2] = np.nan  # means across the step
    return ResidualHistory(level, left, window.step)
