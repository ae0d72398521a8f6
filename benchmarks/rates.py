"""Do `identified` intervals hold at slow rates? Counted, for each rate and mission.

    python -m benchmarks.rates [--seeds 20] [--rate HZ ...] [--mission NAME ...]

Flies `sim-bridge --airframe px4-quad-x --rate R --mission M --noise mems --seed S`, identifies each
flight with arms and mass known exactly, and prints for each cell the verdicts, how many of the
intervals claimed hold the truth, and the error that is farthest off, in half widths of its
interval. Exit status 1: a cell is below 93 %.
"""

import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from gcs_sysid.argument_types import count
from gcs_sysid.model.airframe import load_airframe
from gcs_sysid.significance import Z95
from sim_bridge.doublets import ALL_MISSIONS
from sim_bridge.physics import IDEAL
from testbed.judge import claims, judge
from testbed.scenarios import known_exactly
from testbed.study import WORKERS, arguments, flown, in_processes, markdown

AIRFRAME = "px4-quad-x"
RATES = (10, 20, 25, 30, 50)
MISSIONS = ("doublets", "all-axes", "acro", "paper")
BAR = 0.93
"""Least share of a cell's claims that hold."""
Cell = tuple[int, str]


def fly(cell: Cell, seed: int) -> dict[str, Any]:
    """One flight, held against its truth; see `testbed.judge`."""
    rate, mission = cell
    words = ("--airframe", AIRFRAME, "--rate", str(rate), "--mission", mission)
    with tempfile.TemporaryDirectory() as folder:
        log, truth = flown((*words, "--noise", "mems", "--seed", str(seed)), Path(folder))
        airframe = load_airframe(AIRFRAME).with_anchor("mass", truth["mass"])
        return judge(log, known_exactly(airframe, IDEAL), truth)


def row(cell: Cell, outcomes: Sequence[dict[str, Any]]) -> tuple[list[str], float]:
    """A cell's row, and the share of its claims that hold; 1 where nothing is claimed."""
    found = [
        (abs(claim["z"]) / Z95, claim["holds"], f"{name}, seed {seed}")
        for seed, outcome in enumerate(outcomes, 1)
        for name, claim in claims(outcome)
    ]
    held = sum(holds for _, holds, _ in found)
    off, _, which = max(found, default=(0.0, True, ""))
    verdicts = Counter(outcome["verdict"] for outcome in outcomes)
    share = held / len(found) if found else 1.0
    cells = [
        f"{cell[0]} Hz", cell[1], ", ".join(f"{n} {verdict}" for verdict, n in verdicts.items()),
        f"{held} of {len(found)}", f"{100.0 * share:.1f} %" if found else "-",
        f"{off:.2f} ({which})" if found else "-",
    ]  # fmt: skip
    return cells, share


def main(argv: Sequence[str] | None = None) -> int:
    """Fly the cells, print the table."""
    parser = arguments(__doc__)
    parser.add_argument(
        "--seeds", type=count(1, 9999), default=20, metavar="N", help="of each cell"
    )
    parser.add_argument(
        "--rate", type=count(1, 1000), nargs="+", default=RATES, metavar="HZ", help="of the IMU"
    )
    parser.add_argument("--mission", choices=ALL_MISSIONS, nargs="+", default=MISSIONS)
    options = parser.parse_args(argv)
    head = "rate | mission | flights | held of claimed | share | worst error, half widths"
    print(*markdown(head), sep="\n")
    least = 1.0
    for cell in [(rate, mission) for rate in options.rate for mission in options.mission]:
        seeds = range(1, options.seeds + 1)
        outcomes = in_processes(partial(fly, cell), seeds, WORKERS, f"{cell[0]} {cell[1]}")
        cells, share = row(cell, outcomes)
        least = min(least, share)
        print(f"| {' | '.join(cells)} |", flush=True)
    return int(least < BAR)


if __name__ == "__main__":
    sys.exit(main())
