"""Drawn vehicles on commands (thrust curve 0 to 1, motor lag 20 to 120 ms, rotor inertia of none to
twice the usual, lag of speed, thrust or command), and what a live session shows of them early.

They fly doublets; the mass is given exactly. Everything is seeded.
"""

from copy import deepcopy
from dataclasses import replace

import numpy as np

from gcs_sysid.arrays import Array
from gcs_sysid.estimation.changes.change_detection import ChangeTuning
from gcs_sysid.estimation.changes.tracking import Tracker
from gcs_sysid.estimation.offline.offline import OfflineFit, fit_offline
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.estimation.record.tuning import tuning_for
from gcs_sysid.judgement.evidence import Evidence
from gcs_sysid.judgement.judge import Stage, judged
from gcs_sysid.model.airframe import ScaleReference, load_airframe
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import REGISTRY
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.results.summary import values_of
from gcs_sysid.signals.records import Samples
from sim_bridge.doublets import ALL_MISSIONS
from sim_bridge.ensemble import fly_ensemble
from sim_bridge.physics import Physics
from sim_bridge.simulated_vehicle import LAGS, Vehicle, stack_vehicles
from testbed import judge
from testbed.fleets import DT, GEOMETRY, PAPER, RATE, samples_of, vehicles

__all__ = ["LAGS", "RATE", "drawn", "flights", "samples_of", "shown"]

TIMES = (5.0, 11.0, 20.0, 40.0)
"""s of flight."""
JUDGED = ("T_max", "Ixx", "Iyy", "Izz", "k_M", "motor_lag", "thrust_curve", "cg_x", "cg_y")
SHOWN = ("identified", "weak")
MISSION = "doublets"
_INERTIA = 3e-5
"""kg m^2 of a rotor of the emulator's own vehicle."""


def drawn(count: int, seed: int) -> list[Vehicle]:
    """Vehicles of all lags and rotor inertias."""
    random = np.random.default_rng([seed, 0xEA4])
    lags, shares = random.uniform(0.02, 0.12, count), random.uniform(0.0, 2.0, count)
    return [
        replace(v, motor_lag=lag, rotor_inertia=share * _INERTIA * v.mass / PAPER.mass)
        for v, lag, share in zip(vehicles(count, seed), lags, shares, strict=True)
    ]


def shown(samples: Samples, t: Array, mass: float) -> list[dict[str, Estimate]]:
    """What a live session has on its screen at each of `TIMES`."""
    offline = judge.OPTIONS.offline
    tuning = tuning_for(RotorInput.COMMAND, DT)
    tracker = Tracker(GEOMETRY, DT, tuning, ChangeTuning(), keep=offline)
    airframe = load_airframe("paper")
    anchor = ScaleReference("mass", mass)
    found = []
    for k in range(0, len(t), 50):
        now = slice(k, k + 50)
        tracker.update(t[now], samples.part(now))
        fit = tracker.fit(quick=True)
        if len(found) < len(TIMES) and t[min(k + 49, len(t) - 1)] >= TIMES[len(found)] - DT:
            if offline:
                fit = _offline(tracker)
            seen = values_of(fit, anchor, airframe.arm, {}, RotorInput.COMMAND)
            evidence = Evidence(seen, fit, airframe, RotorInput.COMMAND, checked=False)
            found.append(judged(evidence, Stage.FLIGHT))
    return found


def _offline(tracker: Tracker) -> Fit:
    """The offline estimate as of now, or the online one where there is none."""
    tracker = deepcopy(tracker)  # a full fit takes what is held back
    fit = tracker.fit()
    found = fit_offline(tracker, fit)
    return found.fit if isinstance(found, OfflineFit) else fit


def flights(lag_of: str, count: int) -> list[dict[float, dict[str, tuple[float, float]]]]:
    """Of each flight, time and parameter shown: error over standard deviation, and over truth."""
    fleet = stack_vehicles(drawn(count, 3))
    clean = fly_ensemble(
        fleet, ALL_MISSIONS[MISSION], RATE, TIMES[-1] + 0.4, physics=Physics(lag_of=lag_of)
    )
    flight = clean.with_noise("mems", 0.0, list(range(1, count + 1)))
    found = []
    for i in range(count):
        truth = {
            name: float(np.broadcast_to(value, count)[i])
            for name, value in fleet.truth().items()
            if name in (*JUDGED, "mass")
        }
        looks = shown(samples_of(flight, i, commands=True), flight.t, truth["mass"])
        found.append({at: _errors(values, truth) for at, values in zip(TIMES, looks, strict=True)})
    return found


def _errors(values: dict[str, Estimate], truth: dict[str, float]) -> dict[str, tuple[float, float]]:
    errors = {}
    for name in JUDGED:
        v = values.get(name)
        if v is None or v.status not in SHOWN or v.value is None or not v.std:
            continue
        off = v.value - truth[name]
        size = REGISTRY[name].scale and abs(truth[name]) > 0.0
        errors[name] = (off / v.std, off / truth[name] if size else np.nan)
    return errors
