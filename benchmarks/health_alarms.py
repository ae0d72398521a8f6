"""False alarms of the tests for weak rotors over hours of sound flight.

    python -m benchmarks.health_alarms [--hours H] [--first N] [--flights FOLDER]

Drawn vehicles of four, six and eight rotors that scatter by 3 % fly five minutes each, none with a
fault: hover and gentle doublets with climbs, in light turbulence and in wind with gusts, rotor
drag, flapping and a battery that sags. Vehicles and seeds are none that any number was chosen on.
Each flight is judged as `health` does within a flight; as the live screen does by the last 90 s,
twice as often; and stretch by stretch of ten seconds against 40 s flown before, with `--unchanged`
and without. IMU comes at 25 Hz, rotors at 10 Hz. `--flights` keeps the flights and what each gave,
and goes on where it ended. Recordings: `benchmarks.health_logs FOLDER --part every`.
"""

import tempfile
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gcs_sysid.health import balance
from gcs_sysid.health.command_curve import curve_of, thrust_of
from gcs_sysid.health.hover import windows_of
from gcs_sysid.health.rotor_condition import compare_loads, load_of, watch_rotors
from gcs_sysid.model.airframe import USUAL
from sim_bridge.missions import HoverMission, Mission
from sim_bridge.physics import IDEAL, Physics
from testbed.hover_flights import (
    LAYOUTS,
    ORDINARY,
    fly,
    hover_of,
    hovering,
    loads_of,
    streams_in,
    uneven,
)  # fmt: skip
from testbed.study import arguments, gone_on_with, markdown
from testbed.vehicles import Drawn, draw

FLIGHT, EARLIER = 300.0, 40.0
"""s of a flight, and of the one before it."""
STEP_US = 10_000
"""us of a physics step: what hover averages is slow."""
LOOK, KEPT = 5.0, 90.0
"""s between looks, of which the live screen takes every other one, and what they look at."""
FIRST = 50_000
"""Number of the first vehicle: far from those that anything was tuned on."""
TESTS = ("in flight", "live", "--unchanged", "--baseline")
INPUTS = ("speeds", "commands")


def flight_of(number: int) -> tuple[str, Mission, Physics]:
    """Name, mission and physics of a flight, one of four kinds."""
    random = np.random.default_rng([number, 0xFA15E])
    wind = Physics(
        rotor_drag=0.2,
        inflow=0.4,
        flapping=0.5,
        quadratic_drag=25.0,
        wind=(float(random.uniform(0.0, 5.0)), float(random.uniform(0.0, 6.28))),
        gusts=float(random.uniform(0.3, 1.2)),
        battery=(0.1, FLIGHT),
        battery_drop=0.05,
    )
    flown = "hover" if number % 2 else "doublets"
    mission: Mission = HoverMission("hover", 2.0 * FLIGHT) if number % 2 else ORDINARY
    windy = number % 4 >= 2
    return f"{flown}, {'wind' if windy else 'calm'}", mission, wind if windy else IDEAL


def judged(number: int, folder: Path) -> dict[str, Any]:
    """Fly a sound vehicle, and count what is called weak."""
    drawn = draw(number, LAYOUTS)
    random = np.random.default_rng([number, 0x50D])
    traits = uneven(drawn, random, USUAL.rotor_thrust.of(1.0))
    kind, mission, physics = flight_of(number)
    before, log = folder / f"{number}_before.tlog", folder / f"{number}.tlog"
    for path, seed, seconds in ((before, 2 * number, EARLIER), (log, 2 * number + 1, FLIGHT)):
        if not path.exists():
            part = path.with_suffix(".part.tlog")
            fly(part, drawn, mission, seed, traits, seconds, physics, STEP_US)
            part.replace(path)
    out: dict[str, Any] = {"number": number, "kind": kind, "seconds": FLIGHT, "hover": 0.0}
    for name in INPUTS:
        out[name] = _alarms(before, log, drawn, speeds=name == "speeds", out=out)
    return out


def _alarms(
    before: Path, log: Path, drawn: Drawn, *, speeds: bool, out: dict[str, Any]
) -> dict[str, list[int]]:
    """Alarms and judgments of each test, by speeds or by commands."""
    airframe = drawn.airframe
    windows = windows_of(streams_in(before, airframe, speeds=speeds), len(airframe.rotors))
    earlier, hover = hovering(windows, speeds=speeds), hover_of(log, airframe, speeds=speeds)
    # A later flight's commands are read by the curve of the baseline, as `health` does.
    c = curve_of(windows, None, None, "").c.value or 0.0
    curve = None if speeds else c
    thrust = thrust_of(hover, curve)
    out["hover"] = hover.seconds
    cg = balance.cg_of(hover, airframe, thrust).cg.tolist()
    told = {name: [0, 0] for name in TESTS}
    weakened, watched = watch_rotors(hover, thrust, curve, airframe, cg)
    told["in flight"] = [int(weakened is not None), watched]
    named: int | None = None
    for end in np.arange(KEPT, FLIGHT, LOOK):
        rows = (hover.t > end - KEPT) & (hover.t <= end)
        weakened, watched = watch_rotors(hover.part(rows), thrust[rows], curve, airframe, cg)
        rotor = None if weakened is None else weakened.condition.rotor
        told["live"][0] += rotor is not None and rotor != named
        told["live"][1] += watched
        named = rotor
    base_thrust = thrust_of(earlier, curve)
    base = load_of(earlier, base_thrust, curve)
    if base is None:
        return told
    cg = balance.cg_of(earlier, airframe, base_thrust).cg.tolist()
    for load in loads_of(hover, speeds=speeds, c=c):
        for name in TESTS[2:]:
            found = compare_loads(base, load, airframe, cg, unchanged=name == "--unchanged")
            told[name][0] += found.verdict == "rotor"
            told[name][1] += 1
    return told


def emulated(hours: float, first: int, folder: Path) -> Iterator[str]:
    """The table of emulated flights, those kept and those flown now."""
    numbers = range(first, first + round(3600.0 * hours / FLIGHT))
    kept = folder / "judged.jsonl"
    flown = gone_on_with(kept, "number", numbers, partial(judged, folder=folder))
    yield from markdown(("flights", "rotors by", "hours flown", "in hover", *TESTS))
    for kind in (*sorted({row["kind"] for row in flown}), "all"):
        rows = [row for row in flown if kind in (row["kind"], "all")]
        for name in INPUTS:
            yield _row(kind, name, rows)


def _row(kind: str, name: str, rows: Sequence[dict[str, Any]]) -> str:
    cells = []
    for test in TESTS:
        alarms, judged = (sum(row[name][test][i] for row in rows) for i in (0, 1))
        cells.append(f"{alarms} of {judged}")
    hours, hover = (sum(row[key] for row in rows) / 3600.0 for key in ("seconds", "hover"))
    return f"| {kind} | {name} | {hours:.2f} | {hover:.2f} | {' | '.join(cells)} |"


def main() -> None:
    """Print the table."""
    parser = arguments(__doc__)
    parser.add_argument("--hours", type=float, default=10.0, help="of emulated flight")
    parser.add_argument("--first", type=int, default=FIRST, help="number of the first vehicle")
    parser.add_argument("--flights", type=Path, help="folder that keeps flights and results")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = options.flights or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        for line in emulated(options.hours, options.first, folder):
            print(line, flush=True)


if __name__ == "__main__":
    main()
