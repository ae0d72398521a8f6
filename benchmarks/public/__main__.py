"""Fly, estimate by everybody, score, and write docs/benchmark.md.

    python -m benchmarks.public [--logs FOLDER] [--estimator FILE.py:FUNCTION]

Outcomes are kept as JSON under build/public, one file a flight, and not made again; --fresh makes
them again, --page writes the page from what is kept. With --estimator one more is entered, and the
table is printed, not written.
"""

import argparse
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.public import entries, score
from benchmarks.public.flight import Claims, Entry, Onlooker, flight_of
from gcs_sysid.errors import InputError
from gcs_sysid.model.airframe import Airframe
from gcs_sysid.results.result import Result
from gcs_sysid.session.analysis import analyze_log
from testbed import emulated, independent, recordings
from testbed.scenarios import SCENARIOS
from testbed.study import PROJECT, Kept, arguments, say

KEPT = Kept(PROJECT / "build" / "public", 2)
PAGE = PROJECT / "docs" / "benchmark.md"
MODEL, BEYOND, OTHERS = "the model", "not the model", "other simulators"
EMULATED = {
    MODEL: ("a",),
    BEYOND: ("j", "s", "d", "i", "ou", "b"),
    OTHERS: ("rotorpy", "mujoco"),
}
"""Group -> scenarios of `benchmarks.truth`."""
_BY_NAME = {scenario.name: scenario for scenario in SCENARIOS}
Make = Callable[[Path], tuple[Path, Airframe, Mapping[str, Any]]]


def cases(vehicles: int, logs: Path | None) -> list[tuple[str, str, Make]]:
    """(group, name, what makes the log) of every flight."""
    found: list[tuple[str, str, Make]] = []
    there = {*_BY_NAME, *independent.available()}
    for group, scenarios in EMULATED.items():
        for scenario in scenarios:
            for number in range(vehicles) if scenario in there else ():
                found.append((group, f"{scenario} {number}", _emulate(scenario, number)))
    for place, files in recordings.cases(logs).items() if logs else ():
        for log in files:
            truth, changes = recordings.truth_of(log), recordings.is_changed_in_flight(log)
            if not changes:  # one truth for the whole flight
                found.append((place, log.name, _recorded(log, truth)))
    return found


def _emulate(scenario: str, number: int) -> Make:
    def make(folder: Path) -> tuple[Path, Airframe, Mapping[str, Any]]:
        if scenario in _BY_NAME:
            recording = emulated.record(_BY_NAME[scenario], number, folder)
        else:
            recording = independent.record(scenario, number, folder)
        return recording.log, recording.exact, recording.truth

    return make


def _recorded(log: Path, truth: Mapping[str, Any]) -> Make:
    return lambda _: (log, recordings.airframe_for(log), truth)


def claims_of(result: Result) -> Claims:
    """What our own result calls identified."""
    return {
        name: (estimate.value, estimate.std)
        for name, estimate in result.parameters.items()
        if estimate.status == "identified" and estimate.value is not None and estimate.std
    }


def fly(group: str, name: str, make: Make, others: Mapping[str, Entry]) -> score.Flown:
    """One flight: our own result, then the others on the samples that it rests on."""
    onlooker = Onlooker()
    estimators: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        log, airframe, truth = make(Path(folder))
        began = time.process_time()
        try:
            ours = claims_of(analyze_log(log, airframe, observers=[onlooker]))
            estimators[score.OURS] = {"claims": ours}
        except InputError as error:
            estimators[score.OURS] = {"error": str(error).replace(str(log), log.name)}
        estimators[score.OURS]["seconds"] = time.process_time() - began
    flight = flight_of(onlooker.blocks, airframe)
    for who, entry in others.items():
        began = time.process_time()
        try:
            found = {} if flight is None else {n: (v, s) for n, (v, s) in entry(flight).items()}
            estimators[who] = {"claims": found}
        except Exception as error:  # noqa: BLE001 - whatever an entry fails by is its outcome
            where = traceback.extract_tb(error.__traceback__)[-1].name
            estimators[who] = {"error": f"{type(error).__name__}: {error} (in {where})"}
        estimators[who]["seconds"] = time.process_time() - began
    arm = float(np.mean(np.hypot(*airframe.geometry[:2])))
    for outcome in estimators.values():
        if "claims" in outcome:
            outcome["claims"] = score.judge(outcome["claims"], truth, arm)
    possible = [n for n in score.SCORED if n in truth]
    if flight is None or flight.commands:
        possible = [n for n in possible if n not in ("k_T", "k_M")]
        for outcome in estimators.values():
            outcome["claims"] = {
                n: c for n, c in outcome.get("claims", {}).items() if n in possible
            }
    return {
        "group": group,
        "flight": name,
        "possible": possible,
        "estimators": estimators,
    }


def study(options: argparse.Namespace, others: Mapping[str, Entry]) -> list[score.Flown]:
    """All flights, as far as they are kept already and nothing new is entered."""
    flown = []
    todo = cases(options.vehicles, options.logs)
    for count, (group, name, make) in enumerate(todo, 1):
        done = None if options.fresh else KEPT.read(f"{group} {name}")
        if options.page:
            flown += [done] if done else []
            continue
        if done is None or any(who not in done["estimators"] for who in others):
            say(f"{count}/{len(todo)} {group} {name}")
            done = fly(group, name, make, others)
            if not options.estimator:
                KEPT.write(f"{group} {name}", done)
        flown.append(done)
    return flown


def main(argv: Sequence[str] | None = None) -> int:
    """Run what is asked for."""
    parser = arguments(__doc__)
    parser.add_argument("--vehicles", type=int, default=1, metavar="N", help="of each scenario")
    parser.add_argument("--logs", type=Path, metavar="FOLDER", help="recorded flights with truths")
    parser.add_argument(
        "--estimator", action="append", default=[], metavar="FILE.py:FUNCTION", help="one more"
    )
    parser.add_argument("--fresh", action="store_true", help="make again what is kept")
    parser.add_argument("--page", action="store_true", help="write from what is kept")
    options = parser.parse_args(argv)
    others = entries.available()
    try:
        if options.vehicles < 1:
            raise ValueError("--vehicles begins at 1")
        if options.logs and not options.logs.is_dir():
            raise ValueError(f"{options.logs}: no such folder")
        for named in options.estimator:
            others[named.rpartition(":")[2]] = entries.load(named)
    except ValueError as error:
        print(f"benchmarks.public: error: {error}", file=sys.stderr)
        return 2
    flown = study(options, others)
    if options.estimator:
        print("\n".join(score.main_table(flown)))
        return 0
    PAGE.write_text(score.page(flown), encoding="utf-8", newline="\n")
    print(PAGE.relative_to(PROJECT), file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
