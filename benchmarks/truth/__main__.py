"""Fly vehicles that are not the model, and write docs/truth.md.

Outcomes are kept as JSON under build/truth, one file a scenario; with --only, the page is written
from what is kept of the others. `benchmarks.accept judge --only truth --details` flies two vehicles
of each, and prints the table.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.truth import page
from gcs_sysid.argument_types import count
from testbed import emulated, independent, recordings
from testbed.emulated import Recording
from testbed.judge import judge
from testbed.scenarios import SCENARIOS
from testbed.study import PROJECT, WORKERS, Kept, arguments, in_processes

KEPT = Kept(PROJECT / "build" / "truth", 1)
PAGE = PROJECT / "docs" / "truth.md"
LOGS = "logs"
"""Begins the names of scenarios that are recorded flights."""

_BY_NAME = {scenario.name: scenario for scenario in SCENARIOS}
_SAYS = {name: says for name, (*_, says) in independent.PLANTS.items()}


def fly(name: str, seconds: float | None, number: int) -> dict[str, Any]:
    """Record one flight of a scenario, analyse it, and hold the result against the truth.

    Twice: with what was given as its user measured it, and `by_data` alone, with the true values.

    Args:
        name: of the scenario.
        seconds: of flight; None for the whole mission.
        number: of the vehicle.
    """
    with tempfile.TemporaryDirectory() as folder:
        recording: Recording
        if name in independent.PLANTS:
            recording = independent.record(name, number, Path(folder), seconds)
        else:
            recording = emulated.record(_BY_NAME[name], number, Path(folder), seconds)
        out = judge(recording.log, recording.airframe, recording.truth)
        by_data = judge(recording.log, recording.exact, recording.truth)
    return {**out, "vehicle": recording.vehicle, "by_data": by_data}


def run_log(log: Path) -> dict[str, Any]:
    """Hold a recorded flight against its truth."""
    airframe, truth = recordings.airframe_for(log), recordings.truth_of(log)
    out = judge(log, airframe, truth)
    if recordings.is_changed_in_flight(log):
        out["events"] = []  # some of what it tells is so; others count that
    return {**out, "vehicle": log.name}


def study(
    name: str, says: str, run: Callable[[Any], dict[str, Any]], inputs: Sequence[Any], workers: int
) -> dict[str, Any]:
    """Run a scenario over its vehicles or logs."""
    began = time.monotonic()
    outcomes = in_processes(run, inputs, workers, name)
    took = time.monotonic() - began
    print(f"{name}: {page.verdicts(outcomes)} in {took:.0f} s", file=sys.stderr, flush=True)
    return {"says": says, "seconds": round(took, 1), "outcomes": outcomes}


def kept(order: Sequence[str]) -> page.Rows:
    """Outcomes of this run and earlier ones, in the order of the page."""
    found = KEPT.all()
    return {name: found[name] for name in dict.fromkeys([*order, *found]) if name in found}


def make_parser() -> argparse.ArgumentParser:
    """The command line."""
    parser = arguments(__doc__)
    names = [*_BY_NAME, *independent.PLANTS, LOGS]
    parser.add_argument("--vehicles", type=count(1, 9999), default=8, help="of each scenario")
    parser.add_argument("--only", choices=names, action="append", help="may be repeated")
    parser.add_argument("--logs", type=Path, metavar="FOLDER", help="recorded flights with truths")
    parser.add_argument("--workers", type=count(1, 64), default=WORKERS)
    parser.add_argument("--page", action="store_true", help="write the page from what is kept")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run what is asked for."""
    options = make_parser().parse_args(argv)
    order = [*_BY_NAME, *independent.available()]
    says = {**{n: s.says for n, s in _BY_NAME.items()}, **_SAYS}
    for name in [] if options.page else order:
        if not options.only or name in options.only:
            inputs = range(options.vehicles)
            done = study(name, says[name], partial(fly, name, None), inputs, options.workers)
            KEPT.write(name, done)
    if options.logs and not options.page and (not options.only or LOGS in options.only):
        for place, logs in recordings.cases(options.logs).items():
            name = f"{LOGS}: {place}"
            what = f"recorded flights ({place})"
            KEPT.write(name, study(name, what, run_log, logs, options.workers))
    PAGE.write_text(page.page(kept(order)), encoding="utf-8", newline="\n")
    print(PAGE.relative_to(PROJECT), file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
