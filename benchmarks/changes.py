"""Changes in flight: how many are called that were none, how soon true ones are found.

    python -m benchmarks.changes quiet [--hours H] [--only NAME ...]
    python -m benchmarks.changes steps [--seeds N] [--only NAME ...]
    python -m benchmarks.changes battery [--minutes M] [--vehicles N]
    python -m benchmarks.changes logs FOLDER ...

`quiet` flies vehicles of which none changes, through climbs, landings, gusts, full throttle,
saturation and aerodynamics, on speeds and on commands, and counts the changes called. `steps` adds
a fifth of the mass in flight, or takes 15 % of one rotor's thrust, and prints how many were found,
when it was decided, and errors 15 s later. `battery` flies on commands while the battery loses a
fifth of its voltage: evenly, with a resistance besides, and with a fifth of the mass taken on half
way; its voltage is reported every second, or not at all. `logs` lists what is found in recorded
flights, and whether that is what it is to be (`benchmarks.recorded_changes`).

Flights come from the emulator's ensemble, with noise of MEMS sensors at 250 Hz; times are of the
vehicle. Everything is seeded: the same command prints the same.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.recorded_changes import logs
from gcs_sysid.argument_types import positive
from gcs_sysid.errors import InputError
from gcs_sysid.estimation.changes.change_detection import ChangeTuning
from gcs_sysid.estimation.changes.tracking import Tracker
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.estimation.record.tuning import tuning_for
from gcs_sysid.estimation.rows.actuator_dynamics import Coordinate
from gcs_sysid.intervals import Z95
from gcs_sysid.model.parameters import GRAVITY
from gcs_sysid.model.rotor_input import RotorInput
from gcs_sysid.signals.flight_detection import FlightDetector
from gcs_sysid.signals.samples import Samples
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


def samples_of(flight: Flight, i: int, *, commands: bool, told: bool = False) -> Samples:
    """One vehicle's samples; `told`: with its voltage, every second."""
    volts = np.full((len(flight.t), 1), np.nan)
    if told:
        every = round(1.0 / flight.interval)
        volts[:, 0] = np.repeat(flight.voltage[i, ::every], every)[: len(volts)].round(3)
    return Samples(
        gyro=flight.gyro[i],
        rates=flight.gyro[i] - flight.gyro[i].mean(axis=0),
        speeds=flight.commands[i] if commands else flight.speeds[i],
        attitude=flight.quaternion[i],
        force=flight.specific_force[i],
        velocity=flight.velocity[i],
        voltage=volts,
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


def quiet_flights(name: str, seed: int, count: int) -> dict[str, dict[str, Any]]:
    """Flights in which nothing changes, by what is the rotors' input.

    Returns:
        seconds flown and used, how many changes and disturbances were called, and which changes.
    """
    mission_name, physics, lands = QUIET[name]
    mission = ALL_MISSIONS[mission_name]
    fleet = stack_vehicles(vehicles(count, seed))
    flown_mission = GroundCycle(mission, 3.0) if lands else mission
    clean = fly_ensemble(fleet, flown_mission, RATE, seed=seed, physics=physics)
    flight = clean.with_noise("mems", 0.0, [100 * seed + i for i in range(count)])
    found: dict[str, dict[str, Any]] = {}
    for key in INPUTS:
        row: dict[str, Any] = {"seconds": 0.0, "used": 0.0, "changes": 0, "passing": 0}
        row["called"] = []
        for i in range(count):
            commands = key == "command"
            samples = samples_of(flight, i, commands=commands)
            tracker = follow(samples, flight.t, commands=commands)
            called = [e for e in tracker.events if is_change(e.cause.kind if e.cause else "change")]
            row["seconds"] += float(flight.t[-1])
            row["used"] += tracker.fit(quick=True).seconds
            row["changes"] += len(called)
            row["passing"] += len(tracker.events) - len(called)
            row["called"] += [
                f"{e.cause.kind if e.cause else 'landing'}@{e.onset:.1f}" for e in called
            ]
        found[key] = row
    return found


def quiet(hours: float, count: int, only: Sequence[str]) -> int:
    """Print false changes; how many there were."""
    names = [name for name in QUIET if not only or name in only]
    print(
        f"{'flight':<16}{'input':<9}{'hours':>6}{'changes':>9}{'disturbances':>14}"
        f"{'used %':>8}  called"
    )
    flown = dict.fromkeys(INPUTS, 0.0)
    false = dict.fromkeys(INPUTS, 0)
    seed = 0
    each = hours / (len(names) * len(INPUTS))
    for name in names:
        rows: dict[str, list[dict[str, Any]]] = {key: [] for key in INPUTS}
        while sum(row["seconds"] for row in rows["speed"]) < 3600.0 * each:
            seed += 1
            for key, row in quiet_flights(name, seed, count).items():
                rows[key].append(row)
        for key in INPUTS:
            seconds, used, changed, passing = (
                sum(row[what] for row in rows[key])
                for what in ("seconds", "used", "changes", "passing")
            )
            called = [text for row in rows[key] for text in row["called"]]
            flown[key] += seconds
            false[key] += changed
            print(
                f"{name:<16}{key:<9}{seconds / 3600.0:6.2f}{changed:9d}{passing:14d}"
                f"{100.0 * used / seconds:8.1f}  {' '.join(called[:6])}",
                flush=True,
            )
    for key in INPUTS:
        rate = 10.0 * 3600.0 * false[key] / max(flown[key], 1e-9)
        print(f"{key}: {false[key]} false in {flown[key] / 3600.0:.2f} h, {rate:.1f} in 10 h")
    return sum(false.values())


def step_flights(name: str, seeds: int) -> dict[str, Any]:
    """Flights with a true change.

    Returns:
        flights; delays in s of the changes found; how many were named right; how many others were
        called; relative errors of mass and inertia at the end.
    """
    step = STEPS[name]
    fleet = stack_vehicles(vehicles(seeds, 7, step.curve))
    physics, changes = step.physics, (mass_step(step.at, FACTOR),)
    if step.rotor:
        physics = replace(physics, weakening=Weakening(2, step.at, LOSS, 0.0))
        changes = ()
    flight = fly_step(fleet, step, physics, changes)
    flight = flight.with_noise("mems", 0.0, list(range(1, seeds + 1)))
    out: dict[str, Any] = {"flights": seeds, "named": 0, "others": 0}
    out |= {"delays": [], "mass": [], "inertia": []}
    for i in range(seeds):
        tracker = follow(
            samples_of(flight, i, commands=step.commands), flight.t, commands=step.commands
        )
        found = [e for e in tracker.events if e.cause and is_change(e.cause.kind)]
        hits = [e for e in found if e.decided is not None and abs(e.onset - step.at) < 1.0]
        out["others"] += len(found) - len(hits[:1])
        if not hits or hits[0].decided is None or hits[0].cause is None:
            continue
        out["delays"].append(hits[0].decided - step.at)
        out["named"] += hits[0].cause.kind == ("rotor_failure" if step.rotor else "mass_change")
        first = tracker.segments[0] if tracker.segments else None
        before = None if first is None else first.fit.translation
        fit = tracker.fit()
        truth = {n: float(np.broadcast_to(getattr(fleet, n), seeds)[i]) for n in _TRUTH}
        if first is None or fit.translation is None:
            continue
        if step.at == EARLY and first.mass_ratio is not None:
            scale = fit.translation.kappa * first.mass_ratio[0] * truth["mass"]
        elif before is not None:
            scale = before.kappa * truth["mass"]
        else:
            continue
        out["mass"].append(float(scale / fit.translation.kappa / (FACTOR * truth["mass"]) - 1.0))
        if fit.rotation is not None:
            known = np.array([truth[n] for n in _TRUTH[1:]])
            worst = np.abs(fit.rotation.theta[:3] * scale / known - 1.0).max()
            out["inertia"].append(float(worst))
    return out


def steps(seeds: int, only: Sequence[str]) -> None:
    """Print how true changes were found."""
    print(
        f"{'change':<24}{'flights':>8}{'found':>7}{'in 2 s %':>10}{'median s':>10}{'named':>7}"
        f"{'others':>8}{'mass %':>8}{'inertia %':>11}"
    )
    for name in STEPS:
        if only and name not in only:
            continue
        found = step_flights(name, seeds)
        delays = found["delays"]
        soon = 100.0 * sum(d <= SOON for d in delays) / seeds
        print(
            f"{name:<24}{seeds:8d}{len(delays):7d}{soon:10.0f}"
            f"{float(np.median(delays)) if delays else np.nan:10.2f}{found['named']:7d}"
            f"{found['others']:8d}{_worst(found['mass']):>8}{_worst(found['inertia']):>11}",
            flush=True,
        )


_TRUTH = ("mass", "Ixx", "Iyy", "Izz")
SAG, DROP = 0.2, 0.03
"""Of the voltage: lost in all of a flight, and behind the battery's resistance in hover."""


def battery(minutes: float, count: int) -> None:
    """Print T_max, changes called and the mass of flights on a battery that sags."""
    duration = 60.0 * minutes
    print(
        f"{'battery':<28}{'voltage':<9}{'flights':>8}{'false':>7}{'found':>7}{'V_0':>7}"
        f"{'T_max at V_0 %':>16}{'+- 95 %':>9}{'hold':>6}{'mass %':>8}{'+- 95 %':>9}{'hold':>6}"
    )
    for name, drop, step in (
        ("sags", 0.0, False), ("sags, bends under load", DROP, False), ("mass +20 %", 0.0, True),
    ):  # fmt: skip
        fleet = stack_vehicles(vehicles(count, 11))
        physics = Physics(battery=(SAG, duration), battery_drop=drop)
        changes = (mass_step(0.5 * duration, FACTOR),) if step else ()
        flown = fly_ensemble(
            fleet, ALL_MISSIONS["doublets"], RATE, duration, changes=changes, physics=physics
        )
        flown = flown.with_noise("mems", 0.0, list(range(1, count + 1)))
        for told in (True, False):
            false = found = 0
            thrust: list[tuple[float, float]] = []
            mass: list[tuple[float, float]] = []
            first = []
            for i in range(count):
                samples = samples_of(flown, i, commands=True, told=told)
                tracker = follow(samples, flown.t, commands=True)
                called = [e for e in tracker.events if e.cause and is_change(e.cause.kind)]
                hits = [e for e in called if step and abs(e.onset - 0.5 * duration) < 1.0]
                found, false = found + len(hits[:1]), false + len(called) - len(hits[:1])
                fits = [s.fit for s in tracker.segments] + [tracker.fit()]
                drift = tracker.estimator.drift
                volts = drift.voltage if drift is not None and told else None
                full = float(flown.voltage[i, 0])
                first.append(volts or full)
                true_mass, T_max = (
                    float(np.broadcast_to(getattr(fleet, n), count)[i]) for n in ("mass", "T_max")
                )
                known = [_thrust_of(fit) for fit in fits if fit.translation is not None]
                T_max *= (first[-1] / full) ** 2
                thrust.append((known[0][0] * true_mass / T_max - 1.0, known[0][1]))
                if hits and len(known) > 1:
                    off = known[0][0] / known[-1][0] / FACTOR - 1.0
                    mass.append((off, float(np.hypot(known[0][1], known[-1][1]))))
            print(
                f"{name:<28}{'told' if told else '-':<9}{count:8d}{false:7d}{found:7d}"
                f"{np.mean(first):7.2f}{_medians(thrust, 16)}{_medians(mass, 8)}",
                flush=True,
            )


def _thrust_of(fit: Fit) -> tuple[float, float]:
    """T_max / m and its relative standard deviation, with that of the thrust curve."""
    thrust, rotation = fit.translation, fit.rotation
    assert thrust is not None
    curve = (
        0.0
        if rotation is None
        else thrust.curve_slope * float(rotation.coordinates_std[Coordinate.CURVE])
    )
    return thrust.kappa, float(np.hypot(thrust.kappa_std, curve)) / thrust.kappa


def _medians(errors: Sequence[tuple[float, float]], width: int) -> str:
    """Of errors and their standard deviations: medians, and how many intervals hold."""
    if not errors:
        return f"{'-':>{width}}{'-':>9}{'-':>6}"
    error, std = np.abs(np.array(errors).T)
    held = int(np.sum(error <= Z95 * std))
    return f"{100.0 * np.median(error):{width}.2f}{Z95 * 100.0 * np.median(std):9.2f}{held:6d}"


def fly_step(fleet: Vehicle, step: Step, physics: Physics, changes: Sequence[Change]) -> Flight:
    """The flight with its change, without noise."""
    return fly_ensemble(
        fleet, ALL_MISSIONS[step.mission], RATE, AT + AFTER, changes=changes, physics=physics
    )


def _worst(errors: Sequence[float]) -> str:
    return f"{100.0 * float(np.max(np.abs(errors))):.2f}" if errors else "-"


def whole(text: str) -> int:
    """A number of vehicles or flights.

    Raises:
        argparse.ArgumentTypeError: it is none.
    """
    if not text.isdecimal() or not int(text):
        raise argparse.ArgumentTypeError(f"{text}: must be a whole number from 1")
    return int(text)


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.changes", description=(__doc__ or "").partition("\n")[0]
    )
    commands = parser.add_subparsers(dest="what", required=True)
    part = commands.add_parser("quiet", help="flights in which nothing changes")
    part.add_argument("--hours", type=positive, default=1.0, metavar="H", help="in all")
    part.add_argument(
        "--vehicles", type=whole, default=VEHICLES, metavar="N", help="flown at once (%(default)s)"
    )
    part.add_argument("--only", nargs="+", default=[], choices=list(QUIET), metavar="NAME")
    part = commands.add_parser("steps", help="flights with a change")
    part.add_argument("--seeds", type=whole, default=5, metavar="N", help="of each kind")
    part.add_argument("--only", nargs="+", default=[], choices=list(STEPS), metavar="NAME")
    part = commands.add_parser("battery", help="flights on a battery that sags")
    part.add_argument("--minutes", type=positive, default=10.0, metavar="M", help="of each flight")
    part.add_argument("--vehicles", type=whole, default=VEHICLES, metavar="N")
    part = commands.add_parser("logs", help="recorded flights")
    part.add_argument("paths", type=Path, nargs="+", metavar="FOLDER")
    args = parser.parse_args(argv)
    try:
        if args.what == "quiet":
            quiet(args.hours, args.vehicles, args.only)
        elif args.what == "steps":
            steps(args.seeds, args.only)
        elif args.what == "battery":
            battery(args.minutes, args.vehicles)
        else:
            logs(args.paths)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
