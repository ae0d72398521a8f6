"""A vehicle that changes in flight: how soon it is seen, what is known of it when."""

from dataclasses import replace
from typing import Any

import numpy as np

from gcs_sysid.estimation.changes.change_detection import ChangeTuning
from gcs_sysid.estimation.changes.tracking import Tracker
from gcs_sysid.estimation.record.tuning import EstimatorTuning
from gcs_sysid.model.parameters import INERTIA
from sim_bridge.ensemble import Flight
from sim_bridge.simulated_vehicle import Vehicle
from sim_bridge.simulation import Change, mass_step
from testbed.article_flights import GEOMETRY, VEHICLE, fly, measure

RATE = 250
DT = 1.0 / RATE
AT = 30.0
"""s, when the vehicle changes."""
SECONDS = 52.0
FACTOR = 1.2
STEP, EARLY_STEP, EARLY = 0.5, 0.1, 2.0
"""s between estimates of the history after the change, and at first."""
BLOCK = 25
"""Samples fed at a time; 0.1 s."""
QUIET = ("hover", "paper", "all-axes")


def with_payload(vehicle: Vehicle) -> Vehicle:
    """Mass +20 %, CG shifted by a sixth of itself, inertia +10 %."""
    inertia = {name: 1.1 * getattr(vehicle, name) for name in INERTIA}
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


def motion(flight: Flight) -> dict[str, list[float]]:
    """How the vehicle flies, from its true state: [before, after] the change.

    Returns:
        "tilt": largest, degrees; "vertical speed": largest, m/s, the second of the last 5 s;
        "command": largest of any rotor, 0..1.
    """
    q, t = flight.quaternion[0], flight.t
    tilt = np.degrees(np.arccos(1.0 - 2.0 * (q[:, 1] ** 2 + q[:, 2] ** 2)))
    vertical, command = np.abs(flight.velocity[0, :, 2]), flight.commands[0].max(axis=1)
    before, after, end = t < AT, t >= AT, t >= t[-1] - 5.0
    return {
        "tilt": [float(tilt[before].max()), float(tilt[after].max())],
        "vertical speed": [float(vertical[before].max()), float(vertical[end].max())],
        "command": [float(command[before].max()), float(command[after].max())],
    }


def _follow(change: Change, seed: int) -> dict[str, Any]:
    """Estimates after the change, at the scale of the rotors' k_T as known before it."""
    flight = fly("all-axes", RATE, SECONDS, (change,))
    samples = measure(flight, "mems", 0.0, seed)
    tracker = Tracker(GEOMETRY, DT, EstimatorTuning(), ChangeTuning())
    after = change.apply(VEHICLE)
    truth = np.array([after.mass, *(getattr(after, name) for name in INERTIA)])
    out: dict[str, Any] = {"t": [], "error": []}
    for k in range(0, len(flight.t), BLOCK):
        now = slice(k, k + BLOCK)
        tracker.update(flight.t[now], samples.part(now))
        since = flight.t[now][-1] - AT
        step = EARLY_STEP if since < EARLY else STEP
        if since < 0.0 or (k // BLOCK) % round(step / DT / BLOCK):
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
    changes = [e for e in tracker.events if e.cause is None or e.cause.kind != "passing"]
    detected = [e.detected for e in changes]
    found = [round(d - AT, 4) for d in detected if d >= AT]
    out["delay"] = found[0] if found else None
    out["false"] = sum(d < AT for d in detected)
    out["minutes"] = float(flight.t[-1]) / 60.0
    out["again"] = len(found[1:])
    causes = [e.cause.kind for e in changes if e.cause is not None and e.detected >= AT]
    out["cause"] = causes[0] if causes else None
    out["motion"] = motion(flight)
    return out


def prepare_quiet() -> None:
    for mission in QUIET:
        fly(mission, RATE)


def quiet(seed: int) -> dict[str, Any]:
    """Alarms in flights without a change."""
    out = {}
    for mission in QUIET:
        flight = fly(mission, RATE)
        samples = measure(flight, "mems", 0.0, seed)
        tracker = Tracker(GEOMETRY, DT, EstimatorTuning(), ChangeTuning())
        for k in range(0, len(flight.t), BLOCK):
            now = slice(k, k + BLOCK)
            tracker.update(flight.t[now], samples.part(now))
        changes = [e for e in tracker.events if e.cause is None or e.cause.kind != "passing"]
        out[mission] = {"alarms": len(changes), "minutes": float(flight.t[-1]) / 60.0}
    return out
