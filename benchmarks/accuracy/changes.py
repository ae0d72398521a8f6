"""A vehicle that changes in flight: how soon it is seen, what is known of it when."""

from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.accuracy.flights import GEOMETRY, VEHICLE, fly, measure, part
from gcs_sysid.estimation.changes import ChangeDetector
from gcs_sysid.estimation.online import OnlineEstimator, Tuning
from gcs_sysid.estimation.regression import Samples
from sim_bridge.simulation import Change, mass_step
from sim_bridge.vehicle import Vehicle

RATE = 250
DT = 1.0 / RATE
AT = 30.0
"""s, when the vehicle changes."""
SECONDS = 62.0
FACTOR = 1.2
STEP = 0.2
"""s between estimates of the course after the change."""
QUIET = ("hover", "paper", "all-axes")
QUIET_SECONDS = 62.0
_INERTIA = ("Ixx", "Iyy", "Izz", "Ixy", "Iyz", "Ixz")


def with_payload(vehicle: Vehicle) -> Vehicle:
    """Mass +20 %, CG shifted by a sixth of itself, inertia +10 %."""
    inertia = {name: 1.1 * getattr(vehicle, name) for name in _INERTIA}
    shift = 7.0 / 6.0
    return replace(
        vehicle,
        mass=FACTOR * vehicle.mass,
        cg_x=shift * vehicle.cg_x,
        cg_y=shift * vehicle.cg_y,
        **inertia,
    )


CHANGES = {
    "mass": mass_step(AT, FACTOR),
    "payload": Change(AT, "payload", with_payload),
}


def prepare() -> None:
    for change in CHANGES.values():
        fly("all-axes", RATE, SECONDS, (change,))


def run(seed: int) -> dict[str, Any]:
    return {name: _follow(change, seed) for name, change in CHANGES.items()}


def _follow(change: Change, seed: int) -> dict[str, Any]:
    """Fly with the detector on; after the detection a fresh estimator follows.

    The detector is the program's. What comes after it is the plain way: from the detection on,
    a new online estimator without any memory, at the scale of the known rotors (k_T).
    """
    samples = measure(fly("all-axes", RATE, SECONDS, (change,)), "mems", 0.0, seed)
    found, false, before = watch(samples, stop_at=AT)
    out: dict[str, Any] = {"false": false, "delay": None, "t": [], "error": []}
    if found is None or before.translation is None:
        return out
    out["delay"] = found - AT
    k_T = before.translation.kappa * VEHICLE.mass
    after = change.apply(VEHICLE)
    truth = np.array([after.mass, *(getattr(after, name) for name in _INERTIA)])
    estimator = OnlineEstimator(GEOMETRY, DT, Tuning())
    begin, block = round(found / DT) + 1, round(STEP / DT)
    for k in range(begin, len(samples.gyro), block):
        estimator.update(part(samples, slice(k, k + block)))
        fit = estimator.fit(quick=True)
        values = np.full(7, np.nan)
        if fit.translation is not None and fit.translation.kappa > 0.0:
            values[0] = k_T / fit.translation.kappa
        if fit.rotation is not None:
            values[1:] = fit.rotation.theta[:6] * k_T
        out["t"].append(round(min(k + block, len(samples.gyro)) * DT - AT, 4))
        out["error"].append([float(f"{e:.4g}") for e in 100.0 * (values / truth - 1.0)])
    return out


def watch(samples: Samples, stop_at: float = np.inf) -> tuple[float | None, int, Any]:
    """Feed estimator and detector as a live session does.

    Returns:
        Time of the first detection after `stop_at` (s), the number of detections before, and
        the fit that was in force.
    """
    estimator, detector = OnlineEstimator(GEOMETRY, DT, Tuning()), ChangeDetector(GEOMETRY, DT)
    block, false, fit = 25, 0, estimator.fit(quick=True)
    for k in range(0, len(samples.gyro), block):
        now = part(samples, slice(k, k + block))
        for change in detector.update(now):
            if change.detected >= stop_at:
                return change.detected, false, fit
            false += 1
        estimator.update(now)
        if k % RATE == 0 and k < stop_at * RATE:
            fit = estimator.fit(quick=True)
            if fit.seconds > 3.0:
                detector.arm(fit)
    return None, false, fit


def prepare_quiet() -> None:
    for mission in QUIET:
        fly(mission, RATE, QUIET_SECONDS)


def quiet(seed: int) -> dict[str, Any]:
    """Alarms in flights without a change."""
    out = {}
    for mission in QUIET:
        samples = measure(fly(mission, RATE, QUIET_SECONDS), "mems", 0.0, seed)
        _, false, _ = watch(samples)
        out[mission] = {"alarms": false, "minutes": QUIET_SECONDS / 60.0}
    return out
