"""Early results of flights on commands: how many of the intervals shown hold.

    python -m benchmarks.early [--flights N] [--lag-of WHAT ...]

Flies drawn vehicles of the emulator (thrust curve 0 to 1, motor lag 20 to 120 ms, rotor inertia of
none to twice the usual, lag of speed, thrust or command) with doublets, as a live session follows
them, and looks at 5, 11, 20 and 40 s: how many parameters are `identified` or `weak`, how many of
these 95 % intervals hold the truth, and the worst error in standard deviations. The mass is given
exactly. Everything is seeded.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks.changes import DT, GEOMETRY, PAPER, RATE, samples_of, vehicles, whole
from gcs_sysid.arrays import Array
from gcs_sysid.estimation.changes.change_detection import ChangeTuning
from gcs_sysid.estimation.changes.tracking import Tracker
from gcs_sysid.estimation.record.tuning import tuning_for
from gcs_sysid.intervals import Z95
from gcs_sysid.judgement.evidence import Evidence
from gcs_sysid.judgement.judge import Stage, judged
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.model.estimate import Estimate
from gcs_sysid.model.parameters import REGISTRY
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.model.scale_reference import ScaleReference
from gcs_sysid.results.summary import values_of
from gcs_sysid.signals.samples import Samples
from sim_bridge.doublets import ALL_MISSIONS
from sim_bridge.ensemble import fly_ensemble
from sim_bridge.physics import Physics
from sim_bridge.simulated_vehicle import LAGS, Vehicle, stack_vehicles

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
    tracker = Tracker(GEOMETRY, DT, tuning_for(RotorInput.COMMAND, DT), ChangeTuning())
    airframe = load_airframe("paper")
    anchor = ScaleReference("mass", mass)
    found = []
    for k in range(0, len(t), 50):
        now = slice(k, k + 50)
        tracker.update(t[now], samples.part(now))
        fit = tracker.fit(quick=True)
        if len(found) < len(TIMES) and t[min(k + 49, len(t) - 1)] >= TIMES[len(found)] - DT:
            seen = values_of(fit, anchor, airframe.arm, {}, RotorInput.COMMAND)
            evidence = Evidence(seen, fit, airframe, RotorInput.COMMAND, checked=False)
            found.append(judged(evidence, Stage.FLIGHT))
    return found


def study(lag_of: str, count: int) -> dict[float, dict[str, Array]]:
    """Of each time and parameter, (n, 2) errors over standard deviations, and relative errors."""
    fleet = stack_vehicles(drawn(count, 3))
    clean = fly_ensemble(
        fleet, ALL_MISSIONS[MISSION], RATE, TIMES[-1] + 0.4, physics=Physics(lag_of=lag_of)
    )
    flight = clean.with_noise("mems", 0.0, list(range(1, count + 1)))
    errors: dict[float, dict[str, list[tuple[float, float]]]] = {
        at: {name: [] for name in JUDGED} for at in TIMES
    }
    for i in range(count):
        truth = {
            name: float(np.broadcast_to(value, count)[i])
            for name, value in fleet.truth().items()
            if name in (*JUDGED, "mass")
        }
        looks = shown(samples_of(flight, i, commands=True), flight.t, truth["mass"])
        for at, values in zip(TIMES, looks, strict=True):
            for name in JUDGED:
                v = values.get(name)
                if v is None or v.status not in SHOWN or v.value is None or not v.std:
                    continue
                off = v.value - truth[name]
                size = REGISTRY[name].scale and abs(truth[name]) > 0.0
                errors[at][name].append((off / v.std, off / truth[name] if size else np.nan))
    return {
        at: {name: np.array(rows).reshape(-1, 2) for name, rows in named.items()}
        for at, named in errors.items()
    }


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.early", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--flights", type=whole, default=4, metavar="N", help="of each kind of lag")
    parser.add_argument("--lag-of", nargs="+", default=list(LAGS), choices=LAGS, metavar="WHAT")
    args = parser.parse_args(argv)
    print(f"{'lag of':<9}{'s':>4}{'shown':>7}{'hold %':>8}{'worst':>8}  missed, sigma")
    totals = {at: [0, 0] for at in TIMES}
    for lag_of in args.lag_of:
        found = study(lag_of, args.flights)
        for at in TIMES:
            rows = [(name, z) for name in JUDGED for z, _ in found[at][name]]
            holds = sum(abs(z) <= Z95 for _, z in rows)
            totals[at][0] += len(rows)
            totals[at][1] += holds
            worst = max((abs(z) for _, z in rows), default=np.nan)
            missed = " ".join(f"{name} {z:+.1f}" for name, z in rows if abs(z) > Z95)
            share = 100.0 * holds / max(len(rows), 1)
            print(
                f"{lag_of:<9}{at:4.0f}{len(rows):7d}{share:8.0f}{worst:8.1f}  {missed}", flush=True
            )
    for at, (count, holds) in totals.items():
        print(f"all at {at:2.0f} s: {holds} of {count} hold, {100.0 * holds / max(count, 1):.0f} %")
    return 0


if __name__ == "__main__":
    sys.exit(main())
