"""Changes in the first seconds of flight, before a reference fit could watch for any.

With commands it takes 5 to 20 s until lag and thrust curve are known well enough for a reference,
and with any input 3 s more until the noise of its residuals is. Of those seconds the flight is
looked at again later, on thrust alone: with kappa such that the mean residual is zero, and with
lag and thrust curve as far as the fit by then knows them. No single curve explains that two levels
of command carry the same weight.

Where a step of all the stretch is likeliest is found on means over a quarter of a second; it is
then judged as any alarm (`change_hypotheses`), among the noise that the whole stretch shows beside
the step.
"""

from dataclasses import replace

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.actuator_dynamics import CURVE, LAG
from gcs_sysid.estimation.change_detection import Change
from gcs_sysid.estimation.change_hypotheses import Judgement, judge, likeliest_step
from gcs_sysid.estimation.change_reference import N_X, TOTAL, Actuator, Reference
from gcs_sysid.estimation.change_window import TUNING, History, Window
from gcs_sysid.estimation.rotation import RotationFit
from gcs_sysid.estimation.search import COORDINATE_MEAN, COORDINATE_STD
from gcs_sysid.signals.samples import Samples

LEAST_BEFORE = 2.0
"""s of flight before a step that are needed: less is take-off."""
_FRAME = 0.25
"""s, length of the means in which a step is looked for."""
_COARSE = replace(TUNING, frame=_FRAME, before=1e6, search=1e6)


def actuator_of(fit: RotationFit | None, curves: tuple[float, ...]) -> Actuator:
    """Lag and thrust curve by a fit, as far as it knows them better than they ordinarily are.

    Args:
        fit: to commands; None while there is none.
        curves: least and greatest thrust curve; one value is given.
    """
    mean, std = COORDINATE_MEAN.copy(), COORDINATE_STD.copy()
    if len(curves) == 1:
        mean[CURVE], std[CURVE] = curves[0], 0.0
    lag_of = "command"
    if fit is not None and not (fit.warm_start is not None and fit.warm_start.stuck):
        known = fit.coordinates_std < std
        mean = np.where(known, fit.coordinates, mean)
        std = np.where(known, fit.coordinates_std, std)
        lag_of = lag_of if fit.lag_place is None else fit.lag_place.of
    return Actuator(
        float(mean[LAG]), float(mean[CURVE]), lag_of, float(std[LAG]), float(std[CURVE])
    )


def early_change(
    t: Array,
    samples: Samples,
    dt: float,
    geometry: Array,
    actuator: Actuator | None,
    until: float,
) -> tuple[Change, Judgement] | None:
    """The likeliest step of thrust over mass in the beginning of a flight, judged.

    Args:
        t: (n,) s, session times from the beginning on, gaps marked by NaN samples.
        samples: n of them.
        dt: s between samples.
        geometry: (3, rotors) of the airframe.
        actuator: of commands; None with speeds.
        until: s, session time from which a detector watched.

    Returns:
        The step as an alarm, with times in s since t[0]; None where the stretch is too short.
    """
    matrix = np.full((4, N_X), np.nan)
    matrix[0] = 0.0
    matrix[0, TOTAL] = -1.0
    reference = Reference(geometry, matrix, 0.0, actuator)
    y, x, _ = reference.rows(samples, dt)
    there = np.isfinite(y[:, 0]) & (x[:, TOTAL] > 0.0)
    if not there.any():
        return None
    matrix[0, TOTAL] = float(np.sum(y[there, 0]) / np.sum(x[there, TOTAL]))
    if not reference.kappa > 0.0:
        return None
    window = Window(t, samples, dt, reference, float(t[-1]) + dt, _COARSE)
    first, last = t[0] + LEAST_BEFORE, min(until, t[-1] - TUNING.ages[0])
    times = np.array([window.time_of(i) for i in range(len(window.e))])
    places = np.flatnonzero((times >= first) & (times <= last))
    if len(window.e) < 2.0 * LEAST_BEFORE / _FRAME or not len(places):
        return None
    nothing = History(np.full(4, np.nan), np.empty((0, 4)), window.step)
    at, share, sigmas = likeliest_step(window, reference, nothing, places.tolist(), _COARSE)
    onset = window.time_of(at)
    seen = [k for k, age in enumerate(TUNING.ages) if t[-1] - onset >= age - 0.5 * dt]
    if not seen:
        return None
    near = slice(
        int(np.searchsorted(t, onset - TUNING.before - 2.0 * TUNING.frame)),
        int(np.searchsorted(t, onset + TUNING.ages[-1], side="right")),
    )
    history = _beside(window, reference, at)
    found = judge(t[near], samples.part(near), dt, reference, history, onset, seen[-1])
    size = share * float(np.mean(reference.kappa * window.x[at:, TOTAL]))
    change = Change(float(t[-1] - t[0]), onset - float(t[0]), "thrust", size, sigmas, "slow")
    return change, found


def _beside(window: Window, reference: Reference, at: int) -> History:
    """What thrust's residuals did beside a step: their level before, and how they wandered."""
    e = window.e[:, 0]
    later = np.arange(len(e)) >= at
    thrust = reference.kappa * window.x[:, TOTAL]
    air = np.nan_to_num(window.air)
    columns = np.column_stack([~later, later, thrust, air[:, 2], np.sum(air[:, :2] ** 2, axis=1)])
    columns = columns / np.maximum(np.abs(columns).max(axis=0), 1e-12)
    fit = np.linalg.lstsq(columns, e, rcond=1e-6)[0]
    left, level = np.full((len(e), 4), np.nan), np.full(4, np.nan)
    left[:, 0], level[0] = e - columns @ fit, np.median(e[~later])
    return History(level, left, window.step)
