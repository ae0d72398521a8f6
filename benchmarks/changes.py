"""Changes in flight: how many are called that were none, how soon true ones are found.

    python -m benchmarks.changes quiet [--hours H] [--only NAME ...]
    python -m benchmarks.changes steps [--seeds N] [--only NAME ...]

`quiet` flies vehicles of which none changes, through climbs, landings, gusts, full throttle,
saturation and aerodynamics, on speeds and on commands, and counts the changes called. `steps` adds
a fifth of the mass in flight, or takes 15 % of one rotor's thrust, and prints how many were found,
when it was decided, and errors 15 s later. The flights are those of `testbed.fleets`; everything is
seeded: the same command prints the same. Recorded flights are in `make accept`.
"""

import sys
from collections.abc import Sequence
from typing import Any

import numpy as np

from gcs_sysid.argument_types import count, positive
from testbed.fleets import INPUTS, QUIET, SOON, STEPS, VEHICLES, quiet_flights, step_flights
from testbed.study import arguments


def quiet(hours: float, vehicles: int, only: Sequence[str]) -> int:
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
            for key, more in quiet_flights(name, seed, vehicles).items():
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


def _worst(errors: Sequence[float]) -> str:
    return f"{100.0 * float(np.max(np.abs(errors))):.2f}" if errors else "-"


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point."""
    parser = arguments(__doc__)
    commands = parser.add_subparsers(dest="what", required=True)
    part = commands.add_parser("quiet", help="flights in which nothing changes")
    part.add_argument("--hours", type=positive, default=1.0, metavar="H", help="in all")
    part.add_argument(
        "--vehicles", type=count(1, 999), default=VEHICLES, metavar="N", help="flown at once"
    )
    part.add_argument("--only", nargs="+", default=[], choices=list(QUIET), metavar="NAME")
    part = commands.add_parser("steps", help="flights with a change")
    part.add_argument("--seeds", type=count(1, 999), default=5, metavar="N", help="of each kind")
    part.add_argument("--only", nargs="+", default=[], choices=list(STEPS), metavar="NAME")
    args = parser.parse_args(argv)
    if args.what == "quiet":
        quiet(args.hours, args.vehicles, args.only)
    else:
        steps(args.seeds, args.only)
    return 0


if __name__ == "__main__":
    sys.exit(main())
