"""Changes in flight: how many are called that were none, how soon true ones are found.

    python -m benchmarks.changes quiet [--hours H] [--only NAME ...]
    python -m benchmarks.changes steps [--seeds N] [--only NAME ...]
    python -m benchmarks.changes battery [--minutes M] [--vehicles N]

`quiet` flies vehicles of which none changes, through climbs, landings, gusts, full throttle,
saturation and aerodynamics, on speeds and on commands, and counts the changes called. `steps` adds
a fifth of the mass in flight, or takes 15 % of one rotor's thrust, and prints how many were found,
when it was decided, and errors 15 s later. `battery` flies on commands while the battery loses a
fifth of its voltage: evenly, with a resistance besides, and with a fifth of the mass taken on half
way; its voltage is reported every second, or not at all. The flights are those of `testbed.fleets`;
everything is seeded: the same command prints the same. Recorded flights are in `make accept`.
"""

import argparse
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np

from gcs_sysid.argument_types import positive
from gcs_sysid.estimation.online.fit import Fit
from gcs_sysid.estimation.rows.actuator_dynamics import Coordinate
from gcs_sysid.intervals import Z95
from sim_bridge.doublets import ALL_MISSIONS
from sim_bridge.ensemble import fly_ensemble
from sim_bridge.physics import Physics
from sim_bridge.simulated_vehicle import stack_vehicles
from sim_bridge.simulation import mass_step
from testbed.fleets import (
    FACTOR,
    INPUTS,
    QUIET,
    RATE,
    SOON,
    STEPS,
    VEHICLES,
    follow,
    is_change,
    quiet_flights,
    samples_of,
    step_flights,
    vehicles,
)
from testbed.study import arguments


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
            for key, more in quiet_flights(name, seed, count).items():
                rows[key] += more
        for key in INPUTS:
            seconds, used, passing = (
                sum(row[what] for row in rows[key]) for what in ("seconds", "used", "passing")
            )
            called = [text for row in rows[key] for text in row["called"]]
            flown[key] += seconds
            false[key] += len(called)
            print(
                f"{name:<16}{key:<9}{seconds / 3600.0:6.2f}{len(called):9d}{passing:14d}"
                f"{100.0 * used / seconds:8.1f}  {' '.join(called[:6])}",
                flush=True,
            )
    for key in INPUTS:
        rate = 10.0 * 3600.0 * false[key] / max(flown[key], 1e-9)
        print(f"{key}: {false[key]} false in {flown[key] / 3600.0:.2f} h, {rate:.1f} in 10 h")
    return sum(false.values())


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
        delays = [f["delay"] for f in found if f["delay"] is not None]
        mass, inertia = ([f[key] for f in found if key in f] for key in ("mass", "inertia"))
        soon = 100.0 * sum(d <= SOON for d in delays) / seeds
        print(
            f"{name:<24}{seeds:8d}{len(delays):7d}{soon:10.0f}"
            f"{float(np.median(delays)) if delays else np.nan:10.2f}"
            f"{sum(f['named'] for f in found):7d}{sum(f['others'] for f in found):8d}"
            f"{_worst(mass):>8}{_worst(inertia):>11}",
            flush=True,
        )


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
    parser = arguments(__doc__)
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
    args = parser.parse_args(argv)
    if args.what == "quiet":
        quiet(args.hours, args.vehicles, args.only)
    elif args.what == "steps":
        steps(args.seeds, args.only)
    else:
        battery(args.minutes, args.vehicles)
    return 0


if __name__ == "__main__":
    sys.exit(main())
