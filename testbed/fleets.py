"""Fleets of drawn vehicles that change in flight, or do not.

Flights come from the emulator's ensemble, with noise of MEMS sensors at 250 Hz; times are of the
vehicle. They are followed as a live session follows them, without frames between.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gcs_sysid.estimation.changes.change_detection import ChangeTuning
from gcs_sysid.estimation.changes.tracking import Tracker
from gcs_sysid.estimation.record.tuning import tuning_for
from gcs_sysid.model.parameters import GRAVITY
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.signals.flight_detection import FlightDetector
from gcs_sysid.signals.records import Samples
from sim_bridge.choices import Span
from sim_bridge.doublets import ALL_MISSIONS
from sim_bridge.ensemble import Flight, fly_ensemble
from sim_bridge.ground_cycle import GroundCycle
from sim_bridge.physics import IDEAL, Physics, Weakening
from sim_bridge.simulated_vehicle import Vehicle, stack_vehicles
from sim_bridge.simulation import Change, mass_step
from sim_bridge.vehicle_files import load_vehicle

RATE = 250
DT = 1.0 / RATE
PAPER = load_vehicle("paper")
GEOMETRY = np.array([[r.x, r.y, float(r.spin)] for r in PAPER.rotors]).T
AT, AFTER, FACTOR, LOSS = 30.0, 17.0, 1.2, 0.15
"""s at which a vehicle changes, and of flight after it; what the mass is multiplied by; what one
rotor loses."""
EARLY = 4.0
"""s at which one changes that no reference fit could watch yet: it is found later, and the change
itself gives the mass."""
SOON = 2.0
"""s within which a change is to be found."""
VEHICLES = 4
"""Flown at once."""
BLOCK = 50
"""Samples fed at a time."""

_AIR = Physics(
    rotor_drag=0.3, inflow=0.6, flapping=1.0, forward_lift=0.003, quadratic_drag=20.0,
    rotor_height=-0.02,
)  # fmt: skip
QUIET: dict[str, tuple[str, Physics, bool]] = {
    "climbs": ("climbs", IDEAL, False),
    "climbs, air": ("climbs", _AIR, False),
    "landings, air": ("gentle", replace(_AIR, ground_effect=0.5), True),
    "gusts": ("doublets", replace(_AIR, wind=(5.0, 0.5), gusts=1.5), False),
    "forces": ("gentle", Physics(ou_force=(0.5, 1.0), ou_moment=(1.0, 1.0)), False),
    "punch-outs": ("gentle", replace(_AIR, punch_out=Span(12.0, 0.5, 15.0)), False),
    "cuts": ("gentle", replace(_AIR, throttle_cut=Span(12.0, 0.3, 15.0)), False),
    "saturation": ("acro", replace(_AIR, weak=1.4), False),
    "aggressive": ("aggressive", _AIR, False),
    "battery": ("doublets", Physics(battery=(0.1, 60.0), battery_drop=0.05), False),
    "slosh": ("climbs", Physics(slosh=(0.15, 1.2)), False),
}
"""Mission, physics, and whether it takes off and lands."""
INPUTS = ("speed", "command")


@dataclass(frozen=True)
class Step:
    """A true change.

    Attributes:
        commands: whether these are the rotors' input.
        curve: of thrust.
        mission: flown.
        rotor: loses thrust instead of a mass that grows.
        physics: besides.
        at: s, when.
    """

    commands: bool
    curve: float = 0.5
    mission: str = "all-axes"
    rotor: bool = False
    physics: Physics = IDEAL
    at: float = AT


STEPS: dict[str, Step] = {
    **{f"commands, curve {c:g}": Step(True, c) for c in (0.0, 0.3, 0.7, 1.0)},
    "commands, doublets": Step(True, 0.5, "doublets"),
    "commands, air": Step(True, 0.5, "doublets", physics=_AIR),
    "speeds": Step(False),
    "speeds, doublets": Step(False, mission="doublets"),
    "speeds, gusts": Step(False, mission="doublets", physics=QUIET["gusts"][1]),
    "rotor, speeds": Step(False, rotor=True),
    "rotor, commands": Step(True, rotor=True),
    "commands, early": Step(True, mission="doublets", at=EARLY),
    "speeds, early": Step(False, mission="doublets", at=EARLY),
}


def vehicles(count: int, seed: int, curve: float | None = None) -> list[Vehicle]:
    """Vehicles around the emulator's own."""
    random = np.random.default_rng([seed, 0xC4A])
    drawn = []
    for _ in range(count):
        mass, size, lift = random.uniform((0.7, 0.8, 2.2), (1.4, 1.25, 3.5))
        inertia = {n: mass * size * getattr(PAPER, n) for n in ("Ixx", "Iyy", "Izz")}
        drawn.append(
            replace(
                PAPER,
                mass=mass * PAPER.mass,
                k_T=mass * PAPER.k_T,
                k_M=mass * PAPER.k_M * random.uniform(0.8, 1.25),
                T_max=lift * mass * PAPER.mass * GRAVITY / len(PAPER.rotors),
                thrust_curve=random.uniform(0.0, 1.0) if curve is None else curve,
                motor_lag=random.uniform(0.02, 0.06),
                **inertia,
            )
        )
    return drawn


def samples_of(flight: Flight, i: int, *, commands: bool) -> Samples:
    """One vehicle's samples."""
    return Samples(
        gyro=flight.gyro[i],
        rates=flight.gyro[i] - flight.gyro[i].mean(axis=0),
        speeds=flight.commands[i] if commands else flight.speeds[i],
        attitude=flight.quaternion[i],
        force=flight.specific_force[i],
        velocity=flight.velocity[i],
    )


def follow(samples: Samples, t: np.ndarray, *, commands: bool) -> Tracker:
    """The estimate of a flight."""
    tuning = tuning_for(RotorInput.COMMAND if commands else RotorInput.SPEED, DT)
    tracker = Tracker(GEOMETRY, DT, tuning, ChangeTuning())
    unknown = np.full(len(t), np.nan)
    flying = FlightDetector().update(
        t, unknown, unknown, samples.speeds, np.full((len(t), 3), np.nan)
    )
    for k in range(0, len(t), BLOCK):
        now = slice(k, k + BLOCK)
        tracker.update(t[now], samples.part(now), flying[now])
    tracker.finish()
    return tracker


def is_change(kind: str) -> bool:
    """Whether an event of this kind says that the vehicle changed."""
    return kind != "passing"


def quiet_flights(name: str, seed: int, count: int) -> dict[str, list[dict[str, Any]]]:
    """Flights in which nothing changes, by what is the rotors' input.

    Returns:
        Of each: seconds flown and used, disturbances called, and the changes called.
    """
    mission_name, physics, lands = QUIET[name]
    mission = ALL_MISSIONS[mission_name]
    fleet = stack_vehicles(vehicles(count, seed))
    flown_mission = GroundCycle(mission, 3.0) if lands else mission
    clean = fly_ensemble(fleet, flown_mission, RATE, seed=seed, physics=physics)
    flight = clean.with_noise("mems", 0.0, [100 * seed + i for i in range(count)])
    found: dict[str, list[dict[str, Any]]] = {key: [] for key in INPUTS}
    for i in range(count):
        for key, rows in found.items():
            commands = key == "command"
            samples = samples_of(flight, i, commands=commands)
            tracker = follow(samples, flight.t, commands=commands)
            called = [e for e in tracker.events if is_change(e.cause.kind if e.cause else "change")]
            rows.append(
                {
                    "seconds": float(flight.t[-1]),
                    "used": tracker.fit(quick=True).seconds,
                    "passing": len(tracker.events) - len(called),
                    "called": [
                        f"{e.cause.kind if e.cause else 'landing'}@{e.onset:.1f}" for e in called
                    ],
                }
            )
    return found


def fly_step(fleet: Vehicle, step: Step, physics: Physics, changes: Sequence[Change]) -> Flight:
    """The flight with its change, without noise."""
    return fly_ensemble(
        fleet, ALL_MISSIONS[step.mission], RATE, AT + AFTER, changes=changes, physics=physics
    )


_TRUTH = ("mass", "Ixx", "Iyy", "Izz")


def step_flights(name: str, seeds: int) -> list[dict[str, Any]]:
    """Flights with a true change.

    Returns:
        Of each: `delay` in s until it was decided (None: not found), whether it was `named` right,
        how many `others` were called, and relative errors of `mass` and `inertia` at the end, as
        far as they are known.
    """
    step = STEPS[name]
    fleet = stack_vehicles(vehicles(seeds, 7, step.curve))
    physics, changes = step.physics, (mass_step(step.at, FACTOR),)
    if step.rotor:
        physics = replace(physics, weakening=Weakening(2, step.at, LOSS, 0.0))
        changes = ()
    flight = fly_step(fleet, step, physics, changes)
    flight = flight.with_noise("mems", 0.0, list(range(1, seeds + 1)))
    all_found = []
    for i in range(seeds):
        tracker = follow(
            samples_of(flight, i, commands=step.commands), flight.t, commands=step.commands
        )
        truth = {n: float(np.broadcast_to(getattr(fleet, n), seeds)[i]) for n in _TRUTH}
        all_found.append(_step_found(step, tracker, truth))
    return all_found


def _step_found(step: Step, tracker: Tracker, truth: dict[str, float]) -> dict[str, Any]:
    """Of one flight, see `step_flights`."""
    called = [e for e in tracker.events if e.cause and is_change(e.cause.kind)]
    hits = [e for e in called if e.decided is not None and abs(e.onset - step.at) < 1.0]
    out: dict[str, Any] = {"delay": None, "named": False, "others": len(called) - len(hits[:1])}
    if not hits or hits[0].decided is None or hits[0].cause is None:
        return out
    out["delay"] = hits[0].decided - step.at
    out["named"] = hits[0].cause.kind == ("rotor_failure" if step.rotor else "mass_change")
    first = tracker.segments[0] if tracker.segments else None
    before = None if first is None else first.fit.translation
    fit = tracker.fit()
    if first is None or fit.translation is None:
        return out
    if step.at == EARLY and first.mass_ratio is not None:
        scale = fit.translation.kappa * first.mass_ratio[0] * truth["mass"]
    elif before is not None:
        scale = before.kappa * truth["mass"]
    else:
        return out
    out["mass"] = float(scale / fit.translation.kappa / (FACTOR * truth["mass"]) - 1.0)
    if fit.rotation is not None:
        known = np.array([truth[n] for n in _TRUTH[1:]])
        out["inertia"] = float(np.abs(fit.rotation.theta[:3] * scale / known - 1.0).max())
    return out
