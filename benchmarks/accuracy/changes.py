"""A vehicle that changes in flight: how soon it is seen, what is known of it when."""

from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.accuracy.flights import GEOMETRY, VEHICLE, fly, measure, part
from benchmarks.accuracy.tracker import make as tracker_of
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
BLOCK = 25
"""Samples fed at a time."""
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
    """Estimates after the change, at the scale of the rotors' k_T as known before it."""
    flight = fly("all-axes", RATE, SECONDS, (change,))
    samples = measure(flight, "mems", 0.0, seed)
    tracker = tracker_of(GEOMETRY, DT)
    after = change.apply(VEHICLE)
    truth = np.array([after.mass, *(getattr(after, name) for name in _INERTIA)])
    out: dict[str, Any] = {"t": [], "error": []}
    for k in range(0, len(flight.t), BLOCK):
        now = slice(k, k + BLOCK)
        tracker.update(flight.t[now], part(samples, now))
        since = flight.t[now][-1] - AT
        if since < 0.0 or (k // BLOCK) % round(STEP / DT / BLOCK):
            continue
        values = np.full(7, np.nan)
        # Until the change is known for one, what was known before it is what is shown.
        before = tracker.segments[0].fit if tracker.segments else tracker.fit(quick=True)
        fit = tracker.fit(quick=True)
        if before.translation is not None:
            k_T = before.translation.kappa * VEHICLE.mass
            if fit.translation is not None and fit.translation.kappa > 0.0:
                values[0] = k_T / fit.translation.kappa
            if fit.rotation is not None:
                values[1:] = fit.rotation.theta[:6] * k_T
        out["t"].append(round(float(since), 4))
        out["error"].append([float(f"{e:.4g}") for e in 100.0 * (values / truth - 1.0)])
    detected = [e.detected for e in tracker.events]
    found = [round(d - AT, 4) for d in detected if d >= AT]
    out["delay"] = found[0] if found else None
    out["false"] = sum(d < AT for d in detected)
    out["again"] = len(found[1:])
    return out


def prepare_quiet() -> None:
    for mission in QUIET:
        fly(mission, RATE, QUIET_SECONDS)


def quiet(seed: int) -> dict[str, Any]:
    """Alarms in flights without a change."""
    out = {}
    for mission in QUIET:
        flight = fly(mission, RATE, QUIET_SECONDS)
        samples = measure(flight, "mems", 0.0, seed)
        tracker = tracker_of(GEOMETRY, DT)
        for k in range(0, len(flight.t), BLOCK):
            now = slice(k, k + BLOCK)
            tracker.update(flight.t[now], part(samples, now))
        out[mission] = {"alarms": len(tracker.events), "minutes": QUIET_SECONDS / 60.0}
    return out
